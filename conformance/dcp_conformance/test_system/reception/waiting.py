"""Waiting: the only place where time passes in a case."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from dcp_spec.constants import ICType

from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.test_system.judgement.losses import Losses
from dcp_conformance.test_system.judgement.matchers import Matchers
from dcp_conformance.test_system.judgement.verdicts import Verdicts
from dcp_conformance.test_system.steps import Clock
from dcp_conformance.test_system.sut_properties import MS, SutProperties

from .receiver import Receiver

T = TypeVar("T")


class Waiting:
    """Waits for frames of the implementation. Times in beacon periods unless a name ends in ``_ns``."""

    def __init__(self, receiver: Receiver, clock: Clock, sut: SutProperties, losses: Losses) -> None:
        self._receiver = receiver
        self._heard = receiver.heard
        self._clock = clock
        self._sut = sut
        self._losses = losses

    def mark(self) -> int:
        """Return an index into ``heard``: later frames are ``heard[mark:]``; frames that have already arrived come
        before it.
        """
        self.wait_ns(0)
        return len(self._heard)

    def wait(self, periods: float) -> list[ReceivedBeacon]:
        """Let time pass; return the frames received in this time."""
        return self.wait_ns(round(periods * self._sut.period))

    def wait_ns(self, duration: int) -> list[ReceivedBeacon]:
        """As :meth:`wait`, in ns."""
        before = len(self._heard)
        deadline = self._clock.now() + duration
        for _ in self._receiver.listen(deadline):
            pass
        return self._heard[before:]

    def until(self, wanted: Callable[[ReceivedBeacon], T], periods: float | None = None) -> T | None:
        """Wait for a frame for which ``wanted`` returns a true value, and return that value; None if there is none in
        time.

        Frames received before are not checked, except those received during the last call. ``periods`` is
        :attr:`.SutProperties.reaction` by default; any other value is extended for a slow implementation.
        """
        if periods is None:
            periods = self._sut.reaction
        elif periods > 1:
            periods *= self._sut.slowness
        deadline = self._clock.now() + self._patience(periods)
        for heard in self._receiver.listen(deadline):
            if found := wanted(heard):
                return found
        return None

    def until_instruction(self, kind: ICType, var_id: int, periods: float | None = None) -> Any | None:
        """Wait for a record of this kind about a variable, and return it; None if there is none in time."""
        return self.until(lambda heard: heard.about(kind, var_id), periods)

    def beacons(self, count: int, periods: float | None = None) -> list[ReceivedBeacon]:
        """Wait for ``count`` beacons and return those received, which may be fewer."""
        # Beacons received during a call do not count.
        before = self.mark()
        deadline = self._clock.now() + self._patience(2 * count + self._sut.reaction if periods is None else periods)
        if count > 0:
            for _ in self._receiver.listen(deadline):
                if len(self._heard) - before >= count:
                    break
        return self._heard[before:]

    def until_quiet(
        self,
        present: Callable[[ReceivedBeacon], object],
        periods: float = 60,
        since: int | None = None,
        complete: Callable[[], bool] = lambda: False,
    ) -> list[ReceivedBeacon]:
        """Wait until frames for which ``present`` is true have stopped; return those since ``since`` (a mark).

        They have stopped after ``quiet_beacons`` (PIXIT) consecutive beacons without, or if there are no beacons for
        the time of :attr:`.SutProperties.reaction`, or twice that time right after such a frame. After ``periods`` the
        wait ends in any case. ``complete``: whether all frames have come that should come, so that one beacon without
        is enough; not for cases that judge how many there are.
        """
        sut, start = self._sut, len(self._heard) if since is None else since
        # An implementation that processes payloads one at a time may still have some that cause such frames.
        busy, silences = sut.busy_until, 0
        deadline = max(self._clock.now(), busy) + round(periods * sut.slowness * sut.period)
        while self._clock.now() < deadline:
            frames = self._heard[start:]
            having = [index for index, heard in enumerate(frames) if present(heard)]
            without = len(frames) - 1 - having[-1] if having else 0
            quiet = without >= sut.pixit.quiet_beacons or (without >= 1 and complete())
            if quiet and self._clock.now() >= busy:
                break
            known = self._losses.of_link
            if self.beacons(1, sut.reaction) or self._losses.of_link > known:
                silences = 0
                continue
            silences += 1
            # After such a frame, an implementation on a busy machine may have more to send.
            if silences > 1 or not frames or not present(frames[-1]):
                break
        return [heard for heard in self._heard[start:] if present(heard)]

    def repeated(self, kind: ICType, var_id: int, since: int, periods: float = 60) -> list[Instruction]:
        """Wait until records of a kind about a variable have stopped; return those since a mark."""
        self.until_quiet(lambda heard: heard.instructions(kind, var_id), periods, since)
        return self._receiver.instructions(kind, var_id, since)

    def _patience(self, periods: float) -> int:
        """Return the time limit of a wait in ns, not less than the time that a busy machine may sleep."""
        return max(round(periods * self._sut.period), round(self._sut.pixit.least_patience_ms * MS))


class Repetitions:
    """Checks how often the implementation repeats a record."""

    def __init__(self, waiting: Waiting, verdicts: Verdicts) -> None:
        self._waiting = waiting
        self._verdicts = verdicts

    def check(
        self, kind: ICType, var_id: int, count: int, since: int, /, *requirements: str, absent: str = ""
    ) -> list[Instruction]:
        """Check that exactly ``count`` distinct beacons since a mark have one record of this kind about a variable.

        Returns the records. More records are a failure even after losses, unless tester or implementation were late, so
        the stimulus must not be repeated during the check. ``absent``: the requirement that decides if
        there is no record at all, if it is another one.
        """
        found = self._waiting.repeated(kind, var_id, since)
        if absent and not found:
            requirements = (absent,)
        what, matchers = f"{kind.label} record of variable {var_id}", Matchers(self._verdicts)
        if len({id(each.heard) for each in found}) < len(found):
            matchers.one_each(found, f"at most one {what} in each beacon", *requirements)
        else:
            matchers.repeated(found, count, f"beacons with one {what}", *requirements)
        return found
