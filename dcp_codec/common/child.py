"""A process that is started here: in its own session, with its output in a file, and ended with all of its group."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import re
import signal
import subprocess
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import IO

from .printable import printable
from .sanitizers import findings

#: Lines at the end of the output that are quoted, octets of each, and octets of the file that are read for that.
_LINES, _LINE, _TAIL = 10, 500, 64 * 1024
#: Octets of output that a temporary file keeps; then only the last ones remain.
_MOST, _KEPT = 1024 * 1024, 64 * 1024
#: Maximum seconds from SIGKILL to the end of a process group, and seconds between two checks.
_GONE, _AGAIN = 0.5, 0.02
#: Unit of ``st_blocks``, in octets.
_BLOCK = 512
_PR_SET_PDEATHSIG = 1
#: A frame in the traceback of an exception in Python, and the first line of the traceback.
_FRAME = re.compile(r'\s+File "(?P<file>.+)", line (?P<line>\d+)')
_TRACEBACK = "Traceback (most recent call last):"
#: ``FALLOC_FL_KEEP_SIZE`` and ``FALLOC_FL_PUNCH_HOLE`` of <linux/falloc.h>.
_PUNCH_HOLE = 0x01 | 0x02


class Child:
    """A process that leads a session, so that signals of the terminal do not reach it. Its output is in a file."""

    def __init__(
        self,
        command: Sequence[str],
        log: Path | None = None,
        *,
        pipes: bool = False,
        environment: Mapping[str, str] | None = None,
        around: Callable[[], AbstractContextManager[object]] = contextlib.nullcontext,
        ends_with_parent: bool = False,
    ) -> None:
        """``log``: the output is appended to this file; None: to a temporary one, which :meth:`trim` keeps small.

        ``pipes``: standard input and output are pipes, and the file has the standard error only. ``around`` is entered
        while the process is created. ``ends_with_parent``: it gets SIGKILL when this process ends, in whatever way.

        Raises ``OSError``; its text has the name of the command.
        """
        self._output: IO[bytes] = tempfile.TemporaryFile() if log is None else log.open("ab+")  # noqa: SIM115
        self._begun = os.fstat(self._output.fileno()).st_size
        # The process writes at the end, also after the file was truncated.
        fcntl.fcntl(self._output, fcntl.F_SETFL, os.O_APPEND)
        try:
            with around():
                self.popen = subprocess.Popen(  # noqa: S603 - commands of the user or of ours, without a shell
                    command,
                    stdin=subprocess.PIPE if pipes else subprocess.DEVNULL,
                    stdout=subprocess.PIPE if pipes else self._output,
                    stderr=self._output,
                    start_new_session=True,
                    env=environment,
                    preexec_fn=ending_with_parent() if ends_with_parent else None,
                )
        except BaseException as error:
            self._output.close()
            if not isinstance(error, OSError):
                raise
            raise OSError(f"{command[0]} cannot be started: {error.strerror or error}") from None

    @property
    def pid(self) -> int:
        """Its number, which is also that of its session."""
        return self.popen.pid

    def status(self, patience: float = 0.0) -> int | None:
        """Return its exit status (-N: ended by signal N); None if it does not end within ``patience`` s."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.popen.wait(patience)
        return None

    def end(self, patience: float) -> None:
        """End its process group, see :func:`end_group`, and close the files."""
        end_group(self.popen, patience=patience)
        self.close()

    def kill(self, patience: float) -> bool:
        """Kill its process group, and close the files. Return whether the process ends within ``patience`` s."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self.close()
        return self.status(patience) is not None

    def close(self) -> None:
        """Close the files; may be called twice."""
        for each in (self.popen.stdin, self.popen.stdout, self._output):
            if each is not None:
                with contextlib.suppress(OSError):
                    each.close()

    # -- output --------------------------------------------------------------------------------------------------------

    def last_line(self) -> str:
        """Return the last line of the output, at most 300 characters; empty if there is none."""
        lines = self._tail().decode(errors="replace").strip().splitlines()
        return lines[-1][-300:] if lines else ""

    def last_lines(self) -> str:
        """Return the last lines of the output as the end of a message, after what a sanitizer has found.

        Its report is longer than what is quoted, and ends with less than it begins with.
        """
        lines = LastLines()
        tail = self._tail(_KEPT)
        lines.take(tail)
        found = findings(tail.decode(errors="replace"))
        named = " | ".join(printable(each[:_LINE]) for each in found)
        return f"; {named}{lines.shown()}" if found else lines.shown()

    def _tail(self, most: int = _TAIL) -> bytes:
        """Return the end of the output of this process; a file may have that of earlier ones before it."""
        size = os.fstat(self._output.fileno()).st_size
        return os.pread(self._output.fileno(), most, max(0, size - most, self._begun if size >= self._begun else 0))

    def trim(self) -> None:
        """Free the disk space of old output, if it is more than 1 MiB."""
        status = os.fstat(self._output.fileno())
        if status.st_blocks * _BLOCK > _MOST:
            # Punch a hole at the beginning; concurrent writes at the end are not affected.
            size = ctypes.c_int64(max(0, status.st_size - _KEPT))
            if ctypes.CDLL(None).fallocate64(self._output.fileno(), _PUNCH_HOLE, ctypes.c_int64(0), size):
                # No holes in this file system: output between fstat and truncate is lost.
                self._output.truncate(0)


class LastLines:
    """The last lines of the output of a program, bounded."""

    def __init__(self) -> None:
        self._lines: deque[bytes] = deque(maxlen=_LINES)
        self._rest = b""

    def take(self, data: bytes) -> None:
        """Add more output."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._lines.extend(line[:_LINE] for line in lines[-_LINES:] if line.strip())
        self._rest = rest[:_LINE]

    def shown(self) -> str:
        """Return the last lines of output, as the end of an error message. A traceback of Python becomes one line."""
        lines = [*self._lines, self._rest] if self._rest.strip() else [*self._lines]
        text = b"\n".join(lines[-_LINES:]).decode(errors="replace").strip("\n")
        text = "\n".join(_without_traceback(text.split("\n"))).strip()
        return f"; its output: {printable(text)}" if text else "; it wrote nothing"


def _without_traceback(lines: list[str]) -> list[str]:
    """Replace the traceback of an exception in Python by the exception, with the file and line that raised it."""
    frames = [(place, frame) for place, line in enumerate(lines) if (frame := _FRAME.match(line))]
    if not frames:
        return lines
    last, frame = frames[-1]
    end = next((place for place in range(last + 1, len(lines)) if not lines[place].startswith(" ")), None)
    if end is None:
        return lines
    # The first line of a long traceback may be lost.
    begin = lines.index(_TRACEBACK) if _TRACEBACK in lines else 0
    return [*lines[:begin], f"{lines[end]} ({frame['file']}, line {frame['line']})", *lines[end + 1 :]]


def end_group(process: subprocess.Popen[bytes], *, patience: float, ask_first: bool = True) -> None:
    """End a process that leads a session, and its process group: SIGTERM, then SIGKILL after ``patience`` s.

    Without ``ask_first``, wait first: the process has got another request to end.
    """
    if not ask_first:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(patience)
    _signal_group(process, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(patience)
    # Orphans of the group, too. Another process reaps them, which may take a moment.
    deadline = time.monotonic() + min(patience, _GONE)
    while _signal_group(process, signal.SIGKILL) and time.monotonic() < deadline:
        process.poll()
        time.sleep(_AGAIN)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(patience)


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> bool:
    """Send a signal to a process group. Return whether it had members."""
    try:
        os.killpg(process.pid, number)
    except (ProcessLookupError, PermissionError):
        return False
    return True


def ending(status: int) -> str:
    """Return the text for an exit status or signal."""
    if status >= 0:
        return f"exit status {status}"
    try:
        return f"signal {signal.Signals(-status).name}"
    except ValueError:
        return f"signal {-status}"


def ending_with_parent() -> Callable[[], None]:
    """Return a function for a new process: the kernel then ends it when its parent ends, in whatever way."""
    libc = ctypes.CDLL(None)
    return lambda: libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
