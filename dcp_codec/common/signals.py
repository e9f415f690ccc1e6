"""Handling of signals that end a command: findings are still reported, and started processes are ended."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
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
    def interruptible_by_signals(self) -> Iterator[None]:
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
    """Make SIGTERM and SIGHUP raise ``KeyboardInterrupt``, as Ctrl-C does, during the ``with`` block.

    A signal that is ignored at the start of the process (``nohup``) stays ignored. In other threads than the main
    thread, which cannot set signal handlers, the function has no effect.
    """
    with _handled(_ENDING, signal.default_int_handler):
        yield


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """Ignore signals that would end the process during the ``with`` block; for closing and reporting.

    The process is ending already: a second Ctrl-C while a report is written must not lose the report.
    """

    def ignore(_number: int, _frame: Any) -> None:
        # Processes that are started in the block inherit SIG_IGN, but not a handler.
        return

    with _handled((signal.SIGINT, *_ENDING), ignore):
        yield


@contextlib.contextmanager
def _handled(numbers: Sequence[signal.Signals], handle: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    """Handle signals during the ``with`` block, except ignored ones; in other threads than the main one do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in numbers}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
