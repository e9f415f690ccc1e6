"""Signals that end a command in an orderly way: what was found is reported, what was started is ended."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any, Final

_ENDING: Final = (signal.SIGTERM, signal.SIGHUP)


class Stop:
    """Handler of signals that end a process: remembers them, and raises only where an interruption does no harm."""

    def __init__(self) -> None:
        self.wanted = False
        """Whether a signal has come."""
        self._raises = False

    def __call__(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - the signature of handlers
        """Handle a signal."""
        self.wanted = True
        if self._raises:
            # Only once: the cleanup that follows must not be interrupted.
            self._raises = False
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def heeded(self) -> Iterator[None]:
        """Let signals end the ``with`` block with :class:`KeyboardInterrupt`, also a signal that has come before."""
        self._raises = True
        try:
            if self.wanted:
                raise KeyboardInterrupt
            yield
        finally:
            self._raises = False

    def install(self) -> None:
        """Handle SIGINT, SIGTERM and SIGHUP from now on, except those that the process was started to ignore."""
        for number in (signal.SIGINT, *_ENDING):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self)


@contextlib.contextmanager
def ending_like_interrupts() -> Iterator[None]:
    """SIGTERM and SIGHUP raise ``KeyboardInterrupt``, as Ctrl-C does, while the ``with`` block runs.

    A signal that the process was started to ignore (``nohup``) stays ignored. Signal handlers belong to the main
    thread: elsewhere this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _ENDING}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """Signals that would end the process have no effect while the ``with`` block runs; for closing and reporting.

    What they ask for is under way already: a second Ctrl-C while a report is written does not lose the report.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ignore(_number: int, _frame: Any) -> None:
        # A handler, unlike SIG_IGN, is not inherited by processes that are started meanwhile.
        return

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *_ENDING)}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, ignore)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
