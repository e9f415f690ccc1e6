"""The times of the tester's steps in one case."""

from __future__ import annotations

from typing import Protocol


class Clock(Protocol):
    """The clock of a lower tester."""

    def now(self) -> int:
        """Return the monotonic time in ns."""
        ...

    def wall(self) -> int:
        """Return the time in ns since 1970."""
        ...


class Steps:
    """How late the tester took its steps, and whether the implementation has reacted to the last one.

    A step is a transmission, a call or a wait. Times are ns of the lower tester's monotonic clock.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._ended: int | None = None
        """When the last step ended; None before the first one."""
        self._stimulus: int | None = None
        """When the tester sent the last stimulus; None if a frame of the implementation was received since."""
        self.late_ns = 0
        """The longest delay of the tester before one of its steps, in ns; see :meth:`begin`."""
        self.held_ns = 0
        """The longest delay of the tester in ns, including late ends of waits and calls that took longer than usual."""
        self.silence_ns = 0
        """The longest time without a frame of the implementation, in ns, from its first frame or the first stimulus."""
        self.overtaken_ns = 0
        """The longest time in ns by which a frame was sent before the end of a wait that did not return it."""
        self._waited_until = 0
        """Time in ns until which waits have returned all frames, as far as the tester could know."""
        self._heard: int | None = None
        """Time of the last frame of the implementation, or of the first stimulus before any frame."""

    def begin(self) -> int:
        """Record that a step begins now, and return the time.

        Between two steps the tester should only compute. The longest time between two steps is its lateness
        (``late_ns``). A lateness of more than one beacon period is an excuse, because a stimulus may have been sent too
        late. The moment at which the tester *reads* a frame does not matter: frames have the time stamp of the kernel,
        and a wait ends only after all frames with a time stamp before its end have been read.
        """
        now = self._clock.now()
        if self._ended is not None:
            self.late_ns = max(self.late_ns, now - self._ended)
            self.held(now - self._ended)
        self._ended = now
        return now

    def end(self, time: int) -> None:
        """Record that the current step ended at ``time``; the tester notices it now."""
        self.held(self._clock.now() - time)
        self._ended = time

    def held(self, duration: int) -> None:
        """Record that tester or implementation may have been held up for ``duration`` ns."""
        self.held_ns = max(self.held_ns, duration)

    def waited(self, until: int) -> None:
        """Record that a wait has returned all frames that were sent before ``until``, and ended."""
        self._waited_until = max(self._waited_until, until)

    def forget(self) -> None:
        """Do not count the time since the last step as lateness."""
        self._ended = None

    def stimulated(self) -> None:
        """Record that the tester has just sent a stimulus."""
        self._stimulus = self._clock.now()
        if self._heard is None:
            self._heard = self._stimulus

    def reacted(self, time: int) -> None:
        """Record that a frame of the implementation was received at ``time``."""
        if self._stimulus is not None and time >= self._stimulus:
            self._stimulus = None
        if self._heard is not None:
            self.silence_ns = max(self.silence_ns, time - self._heard)
        self._heard = time
        self.overtaken_ns = max(self.overtaken_ns, self._waited_until - time)

    @property
    def silent(self) -> bool:
        """Whether no frame of the implementation was received since the last stimulus."""
        return self._stimulus is not None
