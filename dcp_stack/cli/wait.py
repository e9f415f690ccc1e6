"""``dcp-node wait``: wait until a node answers."""

from __future__ import annotations

import time

import click

from dcp_codec.common.commandline import ExpectedError
from dcp_stack.control.client import ControlClient, ControlError
from dcp_stack.control.places import default_socket

from .common import EXIT_STATUS, UNREACHABLE, Seconds

#: Seconds between two attempts.
_AGAIN = 0.05


@click.command("wait", epilog=EXIT_STATUS)
@click.option("--timeout", type=Seconds(0), default=30, show_default=True, metavar="S", help="Maximum waiting time.")
@click.option(
    "--control",
    envvar="DCP_NODE_CONTROL",
    metavar="PATH",
    help="Control socket of the node.  [env: DCP_NODE_CONTROL; default: that of a node without --control]",
)
def command(timeout: float, control: str | None) -> int:
    """Wait until the node answers at its control socket, for scripts that start it in the background."""
    path = control or default_socket()
    if path is None:
        raise ExpectedError("no default control socket: XDG_RUNTIME_DIR is not set; give --control PATH")
    deadline = time.monotonic() + timeout
    while True:
        try:
            with ControlClient(path) as client:
                client.call("UT-Hello")
                return 0
        except ControlError as error:
            if time.monotonic() >= deadline:
                raise ExpectedError(f"{error} (after {timeout:g} s)", UNREACHABLE) from None
        time.sleep(_AGAIN)
