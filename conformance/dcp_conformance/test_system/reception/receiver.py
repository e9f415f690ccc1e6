"""Reception of frames and notifications."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.lower_tester import Arrival, LowerTester
from dcp_conformance.test_system.identifiers.allocation import Identifiers
from dcp_conformance.test_system.steps import Steps
from dcp_conformance.test_system.traffic import Traffic
from dcp_conformance.upper_tester import Notification, UpperTester


class RunReceiver(Protocol):
    """The parts of a run that are informed of each received frame."""

    codec: Codec
    pics: Pics
    upper: UpperTester | None
    sut_id: bytes | None

    def heard(self, heard: ReceivedBeacon, arrival: Arrival, case: str, traffic: Traffic, departure: int) -> None:
        """Take a frame of the implementation into account for the rest of the run."""
        ...


@dataclass(eq=False)
class Receiver:
    """The frames and notifications that one case receives."""

    _run: RunReceiver
    _case_id: str
    _link: LowerTester
    _traffic: Traffic
    _steps: Steps
    _identifiers: Identifiers
    heard: list[ReceivedBeacon]
    """The implementation's frames since the case began."""
    others: list[ReceivedBeacon] = field(default_factory=list, init=False)
    """Frames with another senderId that the tester has not sent."""
    notifications: list[Notification] = field(default_factory=list, init=False)
    """Notifications from the upper tester."""

    def listen(self, deadline: int) -> Iterator[ReceivedBeacon]:
        """Yield the implementation's frames on reception, until the deadline (ns). Raises ``LowerTesterError``."""
        link, upper, steps = self._link, self._run.upper, self._steps
        also = upper.filenos() if upper is not None else ()
        begun = steps.begin()
        while True:
            # Taken before receiving: the wait ends if no frame had arrived at a time after the deadline.
            now = link.now()
            arrival = link.receive(deadline, also)
            self.take_notifications()
            if arrival is None:
                if now >= deadline:
                    steps.end(max(begun, deadline))
                    steps.waited(deadline)
                    return
                continue
            heard = self._take(arrival)
            if heard is not None:
                # The next step of the case is a reaction to this frame.
                steps.end(max(begun, heard.time))
                yield heard

    def _take(self, arrival: Arrival) -> ReceivedBeacon | None:
        """Record a frame, and return it if it is the implementation's."""
        heard = ReceivedBeacon(self._run.codec, 0, arrival.time, arrival.wall, arrival.octets, arrival.source)
        ours = self.is_sut(heard)
        start = len(arrival.frame) - len(arrival.octets)
        sender = (heard.sender or arrival.source).hex(":")
        heard.number = self._traffic.frame("heard" if ours else "other", arrival.wall, sender, arrival.frame, start)
        if not ours:
            self.others.append(heard)
            for var_id in heard.known:
                self._identifiers.created_by_others(var_id)
            return None
        self.heard.append(heard)
        self._steps.reacted(arrival.time)
        self._run.heard(heard, arrival, self._case_id, self._traffic, self._identifiers.departure())
        return heard

    def take_notifications(self) -> None:
        """Record the notifications of the implementation so far."""
        upper = self._run.upper
        if upper is None:
            return
        for notification in upper.poll():
            self._traffic.note("notified", self._link.wall(), notification.method, notification.params)
            self.notifications.append(notification)

    def is_sut(self, heard: ReceivedBeacon) -> bool:
        """Return whether the implementation sent a frame. If its identifier is unknown, the sender of the first frame
        counts.
        """
        known, sender = self._run.sut_id, heard.sender
        if sender is None:
            # Too short for a senderId, or a profile without it: frames of other nodes are not the implementation's.
            return known is None or known == heard.source or not self._run.codec.profile.bp.header
        if known is None:
            self._run.sut_id = sender
            return True
        return sender == known

    def take_newcomer(self) -> None:
        """Accept another node identifier if the implementation does not answer after a start; some draw a new one each
        time.

        The next sender counts as the implementation, unless the PICS names the node.
        """
        if self.others and self._run.pics.pixit.node_id is None:
            self._run.sut_id = None
            self.others.clear()

    def instructions(self, kind: ICType, var_id: int | None = None, since: int = 0) -> list[Instruction]:
        """Return all records of a kind since a mark, about one variable or any."""
        return [each for heard in self.heard[since:] for each in heard.instructions(kind, var_id)]

    def frames_with(self, kind: ICType, var_id: int, since: int = 0) -> list[ReceivedBeacon]:
        """Return the beacons with a record of this kind about a variable."""
        return [heard for heard in self.heard[since:] if heard.instructions(kind, var_id)]
