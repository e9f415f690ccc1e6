"""Processes of this machine: each held by a descriptor until it ends, and all that a command has started."""

from __future__ import annotations

import contextlib
import os
import secrets
import select
import signal
import time
import weakref
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import psutil

#: Environment variable that marks what a command has started.
_MARK = "DCP_STARTED_BY"
#: Seconds between two searches, and seconds that a process may have no environment while it executes a program.
_AGAIN, _EXEC = 0.02, 0.05
#: Maximum seconds from SIGKILL to the end of a process.
_KILLED = 30.0


class Held:
    """A process, held by a descriptor (pidfd): a later process with the same number is not mistaken for it."""

    def __init__(self, pid: int) -> None:
        """Raises ``ProcessLookupError`` if there is no such process, or it has ended."""
        self.pid = pid
        self.refused = False
        try:
            self._descriptor = os.pidfd_open(pid)
        except (OSError, OverflowError) as error:
            raise ProcessLookupError(f"process {pid}: {error}") from None
        weakref.finalize(self, os.close, self._descriptor)
        if self.ended():
            raise ProcessLookupError(f"process {pid} has ended")

    def ended(self, patience: float = 0.0) -> bool:
        """Return whether it has ended and closed its files, reaped or not; wait for that at most ``patience`` s."""
        # Not select(2), which takes descriptors below 1024 only.
        waiting = select.poll()
        waiting.register(self._descriptor, select.POLLIN)
        return bool(waiting.poll(patience * 1000))

    def signal(self, number: signal.Signals) -> None:
        """Send a signal, if the process runs; set ``refused`` if this user may not do that."""
        try:
            signal.pidfd_send_signal(self._descriptor, number)
        except PermissionError:
            self.refused = True
        except ProcessLookupError:
            pass


class Started:
    """All that a command has started: processes with a mark in their environment, and the children of those.

    They are found also if they have left the session of the command and lost their parents. The kernel removes the
    environment of a process some ms before it closes its files: a process that was found once is held until it ends.
    Needs psutil.
    """

    def __init__(self) -> None:
        self._mark = secrets.token_hex(8)
        self._held: dict[int, Held] = {}
        self._without: set[psutil.Process] = set()
        """Processes without an environment, such as threads of the kernel."""

    def environment(self) -> dict[str, str]:
        """Return the environment with which the command must be started."""
        return {**os.environ, _MARK: self._mark}

    def running(self) -> list[Held]:
        """Search for the processes, and return those that have not ended."""
        self._held = {pid: each for pid, each in self._held.items() if not each.ended()}
        unclear, deadline = [each for each in _all() if each not in self._without], time.monotonic() + _EXEC
        while unclear := [each for each in unclear if self._is_unclear(each)]:
            if time.monotonic() > deadline:
                self._without.update(unclear)
                break
            time.sleep(0.001)
        return list(self._held.values())

    def _is_unclear(self, process: psutil.Process) -> bool:
        """Hold a process if it is one of them. Return whether that is unclear: it has no environment at this moment."""
        import psutil

        if process.pid in self._held:
            return False
        variables: dict[str, str] = {}
        try:
            held = Held(process.pid)
            # Also raised for a process that runs and has no memory.
            with contextlib.suppress(psutil.NoSuchProcess):
                variables = process.environ()
            ours = variables.get(_MARK) == self._mark or process.ppid() in self._held
        except (ProcessLookupError, psutil.Error):
            # It has ended, or belongs to another user.
            return False
        # Until it has ended its number is that of no other process.
        if held.ended():
            return False
        if ours:
            self._held[process.pid] = held
        return not ours and not variables


def end_all(search: Callable[[], Iterable[Held]], patience: float) -> None:
    """End processes, and wait until they have ended: SIGTERM, and SIGKILL after ``patience`` s.

    ``search`` is repeated until it finds no other ones, since processes may be started in that time. Those of another
    user that this one may not end are left.
    """
    for number, seconds in ((signal.SIGTERM, patience), (signal.SIGKILL, _KILLED)):
        told: dict[int, Held] = {}
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            new = [each for each in search() if each.pid not in told or told[each.pid].ended()]
            for each in new:
                each.signal(number)
            told |= {each.pid: each for each in new}
            left = [each for each in told.values() if not (each.refused or each.ended())]
            if left:
                left[0].ended(_AGAIN)
            elif not new:
                break


def _all() -> Iterator[psutil.Process]:
    """Yield all processes. Unlike psutil.process_iter it notices if a number is used again."""
    import psutil

    for pid in psutil.pids():
        with contextlib.suppress(psutil.NoSuchProcess):
            yield psutil.Process(pid)


def started_at(pid: int) -> int | None:
    """Return when a process started, in ticks since the machine did; None if it does not exist or is a zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(errors="replace")
    except OSError:
        return None
    # The name of the program, in parentheses, may contain any character.
    fields = stat.rpartition(")")[2].split()
    return None if fields[0] in ("Z", "X") else int(fields[19])
