"""Waiting and hearing: time passes in here, and nowhere else in a case."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from dcp_spec.constants import ICType

from .case import Case
from .findings import MS
from .heard import Heard, Instruction
from .naming import Naming
from .session import Session
from .upper import Notification

T = TypeVar("T")


class Listening(Naming):
    """What a case hears of the implementation, and how long it waits for it."""

    def __init__(self, session: Session, case: Case) -> None:
        super().__init__(session, case)
        self.others: list[Heard] = []
        """Frames with another sender's identifier that the tester has not sent."""
        self.notifications: list[Notification] = []
        self._stimulus: int | None = None
        """When something was done to the implementation since its last frame."""

    def stimulated(self) -> None:
        """Note that something was done to the implementation just now."""
        self._stimulus = self.now()

    @property
    def silent(self) -> bool:
        """Whether no frame of the implementation has come since the last stimulus."""
        return self._stimulus is not None

    # -- waiting -------------------------------------------------------------------------------------------------------

    def mark(self) -> int:
        """A place in ``heard``: what comes from now on is ``heard[mark:]``; what has arrived already lies before it."""
        self.wait_ns(0)
        return len(self.heard)

    def wait(self, periods: float) -> list[Heard]:
        """Let time pass; what was heard meanwhile."""
        return self.wait_ns(round(periods * self.period))

    def wait_ns(self, duration: int) -> list[Heard]:
        """As :meth:`wait`, in ns."""
        before = len(self.heard)
        deadline = self.now() + duration
        for _ in self._listen(deadline):
            pass
        return self.heard[before:]

    def until(self, wanted: Callable[[Heard], T], periods: float | None = None) -> T | None:
        """Wait for a frame for which ``wanted`` says something true, and return that; None if none comes in time.

        Frames that came before are not asked, those that came during the last call are. ``periods`` is
        :attr:`reaction` unless given; for a slow implementation what is given is extended, too.
        """
        if periods is None:
            periods = self.reaction
        elif periods > 1:
            periods *= self.slowness
        deadline = self.now() + self._patience(periods)
        for heard in self._listen(deadline):
            if found := wanted(heard):
                return found
        return None

    def until_instruction(self, kind: ICType, var_id: int, periods: float | None = None) -> Any | None:
        """Wait for a record of this kind about a variable, and return it; None if none comes in time."""
        return self.until(lambda heard: heard.about(kind, var_id), periods)

    def beacons(self, count: int, periods: float | None = None) -> list[Heard]:
        """Wait for so many beacons; those that came, which may be fewer at the end of the time."""
        # What came during a call was not waited for.
        before = self.mark()
        deadline = self.now() + self._patience(2 * count + self.reaction if periods is None else periods)
        if count > 0:
            for _ in self._listen(deadline):
                if len(self.heard) - before >= count:
                    break
        return self.heard[before:]

    def until_quiet(
        self, present: Callable[[Heard], object], periods: float = 60, since: int | None = None
    ) -> list[Heard]:
        """Wait until what is ``present`` has stopped: the frames that had it, from ``since`` (a mark) on.

        It has stopped when ``quiet_beacons`` beacons in a row (PIXIT) do not have it, or when no beacons come at all
        for the time of :attr:`reaction`. Gives up after ``periods``; then what came until then is returned.
        """
        start = len(self.heard) if since is None else since
        # What waits at an implementation that takes payloads one at a time may bring it up again.
        busy = self.session.busy_until
        deadline = max(self.now(), busy) + round(periods * self.slowness * self.period)
        while self.now() < deadline:
            frames = self.heard[start:]
            having = [index for index, heard in enumerate(frames) if present(heard)]
            behind = len(frames) - 1 - having[-1] if having else 0
            if behind >= self.pixit.quiet_beacons and self.now() >= busy:
                break
            if not self.beacons(1, self.reaction):
                break
        return [heard for heard in self.heard[start:] if present(heard)]

    def repeated(self, kind: ICType, var_id: int, since: int, periods: float = 60) -> list[Instruction]:
        """Wait until the records of a kind about a variable have stopped; those that came from a mark on."""
        self.until_quiet(lambda heard: heard.instructions(kind, var_id), periods, since)
        return self.instructions(kind, var_id, since)

    def check_repeated(
        self, kind: ICType, var_id: int, count: int, since: int, /, *requirements: str, absent: str = ""
    ) -> list[Instruction]:
        """Check that exactly so many distinct beacons from a mark on have one record of this kind about a variable.

        Too many are a failure whatever was lost (``shown``): what makes it send them must not be repeated meanwhile.
        ``absent``: the requirement that decides if there is none at all, where that is another one.
        """
        found = self.repeated(kind, var_id, since)
        if absent and not found:
            requirements = (absent,)
        beacons = {id(each.heard) for each in found}
        what = f"exactly {count} beacon{'s' if count != 1 else ''} with one {kind.label} record of variable {var_id}"
        came = f"{len(found)} records in {len(beacons)} beacons"
        self.check(
            len(found) == len(beacons) == count,
            what,
            came,
            *requirements,
            frames=found[:32],
            shown=len(found) > min(count, len(beacons)),
        )
        return found

    def _patience(self, periods: float) -> int:
        """How long to wait, in ns, for what ends the wait when it comes: never less than a busy machine may sleep."""
        return max(round(periods * self.period), round(self.pixit.least_patience_ms * MS))

    # -- hearing -------------------------------------------------------------------------------------------------------

    def _listen(self, deadline: int) -> Iterator[Heard]:
        """The implementation's frames as they come in, until the deadline."""
        lower, upper = self.lower, self.session.upper
        also = upper.filenos() if upper is not None else ()
        self.acts()
        begun = self._acted or 0
        while True:
            # Before receiving: the wait is over when nothing had arrived at a time after the deadline.
            now = lower.now()
            arrival = lower.receive(deadline, also)
            self.take_notifications()
            if arrival is None:
                if now >= deadline:
                    self._acted = max(begun, deadline)
                    return
                continue
            heard = Heard(self.codec, 0, arrival.time, arrival.wall, arrival.octets, arrival.source)
            ours = self.is_sut(heard)
            start = len(arrival.frame) - len(arrival.octets)
            who = (heard.sender or arrival.source).hex(":")
            heard.number = self.traffic.frame("heard" if ours else "other", arrival.wall, who, arrival.frame, start)
            if ours:
                self.heard.append(heard)
                if self._stimulus is not None and arrival.time >= self._stimulus:
                    self._stimulus = None
                self.session.heard(heard, arrival, self)
                # What the case does next it does on account of this frame.
                self._acted = max(begun, heard.time)
                yield heard
            else:
                self.others.append(heard)
                for var_id in heard.known:
                    # The implementation learns it from that node, too.
                    self.session.identifiers.offered(var_id, by_peer=False)

    def take_notifications(self) -> None:
        """Note what the implementation has told without being asked, so far."""
        upper = self.session.upper
        if upper is None:
            return
        for notification in upper.poll():
            self.traffic.note("notified", self.lower.wall(), notification.method, notification.params)
            self.notifications.append(notification)

    def is_sut(self, heard: Heard) -> bool:
        """Whether the implementation has sent a frame. The sender of the first one counts as it, if nobody said who."""
        known, sender = self.session.sut_id, heard.sender
        if sender is None:
            # Too short to say who sent it, or a profile without senders: whoever else is there is not ours either.
            return known is None or known == heard.source or not self.profile.bp.header
        if known is None:
            self.session.sut_id = sender
            return True
        return sender == known

    def take_newcomer(self) -> None:
        """The implementation does not answer after a start. Some draw a new identifier with each of them.

        Whoever has spoken instead is taken for it from now on, unless the PICS names the node.
        """
        if self.others and self.session.pics.pixit.node_id is None:
            self.session.sut_id = None
            self.others.clear()

    # -- looking back --------------------------------------------------------------------------------------------------

    def instructions(self, kind: ICType, var_id: int | None = None, since: int = 0) -> list[Instruction]:
        """All records of a kind that were heard from a mark on, about one variable or any."""
        return [each for heard in self.heard[since:] for each in heard.instructions(kind, var_id)]

    def frames_with(self, kind: ICType, var_id: int, since: int = 0) -> list[Heard]:
        """The beacons with a record of this kind about a variable."""
        return [heard for heard in self.heard[since:] if heard.instructions(kind, var_id)]
