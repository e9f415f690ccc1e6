"""Taking the implementation's link down and up again, where the tester can do that."""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Callable

from dcp_conformance.definitions.pics import Testing
from dcp_conformance.errors import ConformanceError

from .control import SutControl

#: Seconds that a command may take.
_PATIENCE = 30.0

Switch = Callable[[bool], None]
"""Takes the link up (True) or down. Raises ``ConformanceError`` if that does not work."""


def link_switch(control: SutControl | None, pixit: Testing) -> Switch | None:
    """How to take the link down and up: with the commands of the PIXIT, or as our own node offers it; None if not."""
    if pixit.link_down and pixit.link_up:
        commands = {False: pixit.link_down, True: pixit.link_up}
        return lambda up: _run(commands[up])
    found: Switch | None = getattr(control, "switch_link", None)
    return found


def _run(command: str) -> None:
    try:
        done = subprocess.run(  # noqa: S603 - the command is the user's own
            shlex.split(command), capture_output=True, text=True, errors="replace", check=False, timeout=_PATIENCE
        )
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise ConformanceError(f"{command}: {error}") from None
    if done.returncode:
        raise ConformanceError(f"{command}: exit status {done.returncode}: {done.stderr.strip()[-300:]}")
