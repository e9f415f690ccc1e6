"""Running in the background: the command reports when the node is ready, and ends."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from dcp_codec.common.commandline import UNUSABLE

from .errors import NodeError


class LogFileError(NodeError):
    """The log file cannot be opened; the message names the file and the cause."""


def in_background(work: Callable[[Callable[[str], None]], int]) -> int:
    """Run ``work`` in a process and session of its own; return 0 when it is ready, its exit status if it ends before.

    ``work`` is called with a function that takes a line for standard output and reports that it is ready. Until then it
    has the standard streams of this process, so errors appear as in the foreground. Afterwards standard input and
    output are /dev/null, and so is standard error unless it is a file.
    """
    ready, tell = os.pipe()
    # Both processes have the buffers after the fork, and would write them twice.
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    child = os.fork()
    if not child:
        os.close(ready)
        _work(work, tell)
    os.close(tell)
    with os.fdopen(ready, "rb") as told:
        line = told.read()
    if line:
        sys.stdout.write(line.decode())
        return 0
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else UNUSABLE


def _work(work: Callable[[Callable[[str], None]], int], tell: int) -> NoReturn:
    """Run ``work`` in a new session; report over descriptor ``tell`` when it is ready. Does not return."""
    os.setsid()

    def on_ready(line: str) -> None:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for fd in (0, 1, *([2] if not _is_file(2) else [])):
            os.dup2(nowhere, fd)
        os.close(nowhere)
        os.write(tell, f"{line}\n".encode())
        os.close(tell)

    # sys.exit lets the command line report errors as in the foreground: expected ones in one line.
    sys.exit(work(on_ready))


def _is_file(fd: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/self/fd/{fd}").is_file()
    return False


def log_to(path: str) -> None:
    """Append standard error to a file from now on. Raises LogFileError if it cannot be opened."""
    try:
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise LogFileError(f"{path}: {error.strerror}") from None
    os.dup2(fd, 2)
    os.close(fd)
