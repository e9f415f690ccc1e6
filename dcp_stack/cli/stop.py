"""``dcp-node stop``: end a node that runs in the background."""

from __future__ import annotations

import os
import signal
import time

import click

from dcp_codec.common.commandline import ExpectedError
from dcp_stack.control.client import ControlError

from .common import EXIT_STATUS, NOT_OK, Seconds, connect, control_option

#: Seconds between two checks whether the node has ended.
_LOOK = 0.05


@click.command("stop", epilog=EXIT_STATUS)
@click.option("--timeout", type=Seconds(0), default=10, show_default=True, metavar="S", help="Maximum waiting time.")
@control_option
def command(timeout: float, control: str) -> int:
    """End a node as SIGTERM does, and wait for its end: it deregisters its protocols and closes the recording."""
    with connect(control) as client:
        pid = client.call("UT-Status")["runtime"].get("pid")
        if not isinstance(pid, int):
            raise ExpectedError("the node does not report its process", NOT_OK)
        try:
            os.kill(pid, signal.SIGTERM)
        except ProcessLookupError:
            raise ExpectedError(f"process {pid} is not in this PID namespace: end it there", NOT_OK) from None
        except PermissionError:
            raise ExpectedError(f"process {pid} belongs to another user", NOT_OK) from None
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            try:
                client.call("UT-Hello")
            except ControlError:
                # The node closes its connections last.
                return 0
            time.sleep(_LOOK)
    raise ExpectedError(f"process {pid} has not ended within {timeout:g} s", NOT_OK)
