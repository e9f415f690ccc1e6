"""Going on in the background: the command ends when the node is ready, and says so."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from dcp_codec.common.commandline import UNUSABLE


class LogFileError(Exception):
    """The log file cannot be opened; the message names it and says why."""


def in_background(work: Callable[[Callable[[str], None]], int]) -> int:
    """Do ``work`` in a process and a session of its own; return when it is ready, or its exit status if it ends before.

    ``work`` gets a function to call with a line for standard output once it is ready. Until then it has the standard
    streams of this process, so its failures are told like those of a command in the foreground; afterwards input and
    output lead nowhere, and so does standard error unless it is a file.
    """
    ready, tell = os.pipe()
    # Nothing that waits to be written may be written by both.
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
    os.setsid()

    def on_ready(line: str) -> None:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for fd in (0, 1, *([2] if not _is_file(2) else [])):
            os.dup2(nowhere, fd)
        os.close(nowhere)
        os.write(tell, f"{line}\n".encode())
        os.close(tell)

    # The command line ends the process as it does in the foreground: with one line for what is to be expected.
    sys.exit(work(on_ready))


def _is_file(fd: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/self/fd/{fd}").is_file()
    return False


def log_to(path: str) -> None:
    """Append to a file what goes to standard error from now on. Raises LogFileError."""
    try:
        fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise LogFileError(f"{path}: {error.strerror}") from None
    os.dup2(fd, 2)
    os.close(fd)
