"""Waiting and receiving: the only place where time passes in a case."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from dcp_spec.constants import ICType

from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.model.case import Case
from dcp_conformance.upper_tester import Notification

from .allocation import Allocation
from .checks import MS
from .session import Session

T = TypeVar("T")


class Waiting(Allocation):
    """The frames that a case receives from the implementation, and how long it waits for them."""

    def __init__(self, session: Session, case: Case) -> None:
        super().__init__(session, case)
        self.others: list[ReceivedBeacon] = []
        """Frames with another senderId that the tester has not sent."""
        self.notifications: list[Notification] = []
        self._stimulus: int | None = None
        """Time of the last stimulus since the implementation's last frame; None if there was none."""

    def stimulated(self) -> None:
        """Record that the tester has just sent a stimulus."""
        self._stimulus = self.now()

    @property
    def silent(self) -> bool:
        """Whether no frame of the implementation was received since the last stimulus."""
        return self._stimulus is not None

    # -- waiting -------------------------------------------------------------------------------------------------------

    def mark(self) -> int:
        """Return an index into ``heard``: later frames are ``heard[mark:]``; frames that have already arrived come
        before it.
        """
        self.wait_ns(0)
        return len(self.heard)

    def wait(self, periods: float) -> list[ReceivedBeacon]:
        """Let time pass; return the frames received in this time."""
        return self.wait_ns(round(periods * self.period))

    def wait_ns(self, duration: int) -> list[ReceivedBeacon]:
        """As :meth:`wait`, in ns."""
        before = len(self.heard)
        deadline = self.now() + duration
        for _ in self._listen(deadline):
            pass
        return self.heard[before:]

    def until(self, wanted: Callable[[ReceivedBeacon], T], periods: float | None = None) -> T | None:
        """Wait for a frame for which ``wanted`` returns a true value, and return that value; None if there is none in
        time.

        Frames received before are not checked, except those received during the last call. ``periods`` is
        :attr:`reaction` by default; any other value is extended for a slow implementation.
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
        """Wait for a record of this kind about a variable, and return it; None if there is none in time."""
        return self.until(lambda heard: heard.about(kind, var_id), periods)

    def beacons(self, count: int, periods: float | None = None) -> list[ReceivedBeacon]:
        """Wait for ``count`` beacons and return those received, which may be fewer."""
        # Beacons received during a call do not count.
        before = self.mark()
        deadline = self.now() + self._patience(2 * count + self.reaction if periods is None else periods)
        if count > 0:
            for _ in self._listen(deadline):
                if len(self.heard) - before >= count:
                    break
        return self.heard[before:]

    def until_quiet(
        self,
        present: Callable[[ReceivedBeacon], object],
        periods: float = 60,
        since: int | None = None,
        complete: Callable[[], bool] = lambda: False,
    ) -> list[ReceivedBeacon]:
        """Wait until frames for which ``present`` is true have stopped; return those since ``since`` (a mark).

        They have stopped after ``quiet_beacons`` (PIXIT) consecutive beacons without, or if there are no beacons for
        the time of :attr:`reaction`. After ``periods`` the wait ends in any case. ``complete``: whether all frames have
        come that should come, so that one beacon without is enough; not for cases that judge how many there are.
        """
        start = len(self.heard) if since is None else since
        # An implementation that processes payloads one at a time may still have some that cause such frames.
        busy = self.session.busy_until
        deadline = max(self.now(), busy) + round(periods * self.slowness * self.period)
        while self.now() < deadline:
            frames = self.heard[start:]
            having = [index for index, heard in enumerate(frames) if present(heard)]
            behind = len(frames) - 1 - having[-1] if having else 0
            quiet = behind >= self.pixit.quiet_beacons or (behind >= 1 and complete())
            if quiet and self.now() >= busy:
                break
            known = self.link_losses
            if not self.beacons(1, self.reaction) and self.link_losses == known:
                break
        return [heard for heard in self.heard[start:] if present(heard)]

    def repeated(self, kind: ICType, var_id: int, since: int, periods: float = 60) -> list[Instruction]:
        """Wait until records of a kind about a variable have stopped; return those since a mark."""
        self.until_quiet(lambda heard: heard.instructions(kind, var_id), periods, since)
        return self.instructions(kind, var_id, since)

    def check_repeated(
        self, kind: ICType, var_id: int, count: int, since: int, /, *requirements: str, absent: str = ""
    ) -> list[Instruction]:
        """Check that exactly ``count`` distinct beacons since a mark have one record of this kind about a variable.

        More records are a failure even after losses (``shown``), so the stimulus must not be repeated during the check.
        ``absent``: the requirement that decides if there is no record at all, if it is another one.
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
        """Return the time limit of a wait in ns, not less than the time that a busy machine may sleep."""
        return max(round(periods * self.period), round(self.pixit.least_patience_ms * MS))

    # -- hearing -------------------------------------------------------------------------------------------------------

    def _listen(self, deadline: int) -> Iterator[ReceivedBeacon]:
        """Yield the implementation's frames on reception, until the deadline."""
        lower, upper = self.lower, self.session.upper
        also = upper.filenos() if upper is not None else ()
        self.acts()
        begun = self._acted or 0
        while True:
            # Taken before receiving: the wait ends if no frame had arrived at a time after the deadline.
            now = lower.now()
            arrival = lower.receive(deadline, also)
            self.take_notifications()
            if arrival is None:
                if now >= deadline:
                    self._acted = max(begun, deadline)
                    return
                continue
            heard = ReceivedBeacon(self.codec, 0, arrival.time, arrival.wall, arrival.octets, arrival.source)
            ours = self.is_sut(heard)
            start = len(arrival.frame) - len(arrival.octets)
            who = (heard.sender or arrival.source).hex(":")
            heard.number = self.traffic.frame("heard" if ours else "other", arrival.wall, who, arrival.frame, start)
            if ours:
                self.heard.append(heard)
                if self._stimulus is not None and arrival.time >= self._stimulus:
                    self._stimulus = None
                self.session.heard(heard, arrival, self)
                # The next step of the case is a reaction to this frame.
                self._acted = max(begun, heard.time)
                yield heard
            else:
                self.others.append(heard)
                for var_id in heard.known:
                    # The implementation also learns it from that node.
                    self.session.identifiers.offered(var_id, by_peer=False)

    def take_notifications(self) -> None:
        """Record the notifications of the implementation so far."""
        upper = self.session.upper
        if upper is None:
            return
        for notification in upper.poll():
            self.traffic.note("notified", self.lower.wall(), notification.method, notification.params)
            self.notifications.append(notification)

    def is_sut(self, heard: ReceivedBeacon) -> bool:
        """Return whether the implementation sent a frame. If its identifier is unknown, the sender of the first frame
        counts.
        """
        known, sender = self.session.sut_id, heard.sender
        if sender is None:
            # Too short for a senderId, or a profile without it: frames of other nodes are not the implementation's.
            return known is None or known == heard.source or not self.profile.bp.header
        if known is None:
            self.session.sut_id = sender
            return True
        return sender == known

    def take_newcomer(self) -> None:
        """Accept another node identifier if the implementation does not answer after a start; some draw a new one each
        time.

        The next sender counts as the implementation, unless the PICS names the node.
        """
        if self.others and self.session.pics.pixit.node_id is None:
            self.session.sut_id = None
            self.others.clear()

    # -- looking back --------------------------------------------------------------------------------------------------

    def instructions(self, kind: ICType, var_id: int | None = None, since: int = 0) -> list[Instruction]:
        """Return all records of a kind since a mark, about one variable or any."""
        return [each for heard in self.heard[since:] for each in heard.instructions(kind, var_id)]

    def frames_with(self, kind: ICType, var_id: int, since: int = 0) -> list[ReceivedBeacon]:
        """Return the beacons with a record of this kind about a variable."""
        return [heard for heard in self.heard[since:] if heard.instructions(kind, var_id)]
