"""Limit the CPU time of a call in this process."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType

#: Maximum CPU time of one test in seconds; sequences of thousands of frames take the longest.
TIME_LIMIT = 8.0


class TimeLimitExceeded(BaseException):
    """Raised in code that exceeds its time limit. A BaseException, so that ``except Exception`` does not catch it."""


class TimeLimit:
    """Context manager that raises :class:`TimeLimitExceeded` in its block after ``seconds`` of CPU time; reusable.

    It has no effect outside of the main thread, because Python handles signals only there. It must not be nested: a
    process has one virtual timer. The handler of SIGVTALRM is not restored, because installing it for each test would
    take longer than setting the timer.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self._thread: int | None = None

    def __enter__(self) -> None:
        if self._thread is None:
            main = threading.main_thread()
            if threading.current_thread() is not main:
                return
            signal.signal(signal.SIGVTALRM, _raise_time_limit_exceeded)
            self._thread = main.ident
        if threading.get_ident() == self._thread:
            # The timer repeats, because an exception that is raised in a finaliser is lost.
            signal.setitimer(signal.ITIMER_VIRTUAL, self.seconds, self.seconds)

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, at: TracebackType | None) -> None:
        if threading.get_ident() == self._thread:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)


def _raise_time_limit_exceeded(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature of handlers
    raise TimeLimitExceeded
