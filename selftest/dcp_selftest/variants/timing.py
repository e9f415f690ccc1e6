"""Variants with other permitted periods, with delayed processing of received payloads, and with slow upper testers."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from dcp_conformance.definitions.pics import Capabilities, Testing
from dcp_conformance.lower_tester import Arrival
from dcp_conformance.reference.inprocess import InProcess, MakeNode, VirtualLowerTester
from dcp_conformance.reference.surroundings import Setup, Tested, UpperTesting
from dcp_spec.constants import SpecVersion

from dcp_stack.bp.timing import BeaconSchedule
from dcp_stack.config import MS, BPConfig, VardisConfig
from dcp_stack.node import Node
from dcp_stack.vardis.entity import Vardis

from .services import TOO_SLOW_FOR_A_GAP
from .variant import Variant, node_of, setup, slow

_V = SpecVersion

#: The two payloads of a beacon are processed separately, so that a record that the second cancels may have been sent.
_ONE_BY_ONE = (
    r"^TC_VD_PEND_BV_0[12368]: .*; but it processes received payloads one at a time and may answer in between"
    r"|^TC_VD_SCR_TI_15: payloads full of VarCreates, which this case needs: room for a VarReqUpdate$"
)

#: After an idle time, a variable with a short timeout expires before VarDis checks the buffer.
_TIMED_OUT = (
    r"^TC_VD_(INI_BV_05|STATE_TI_01-[a-z-]+\.timeout): .*, which this case needs: none in time$",
    r"^TC_VD_SCR_TI_0[18](-\d+)?: a forwarded VarCreate of a variable with a timeout: none in time$",
)


def polling(interval_ms: int, room: int | None = None) -> MakeNode:
    """Return a constructor of nodes whose VarDis processes one received payload every ``interval_ms``.

    ``room`` is the maximum number of waiting payloads; further ones are lost. None: unlimited.
    """

    class Polling(Vardis):
        def __init__(self, *args: Any, now: int, **more: Any) -> None:
            super().__init__(*args, now=now, **more)
            self._inbox: deque[bytes] = deque()
            self._polled = now

        def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
            del now, wall
            if self.active and (room is None or len(self._inbox) < room):
                self._inbox.append(payload)

        def _due(self) -> int:
            return self._polled + interval_ms * MS

        def handle_timeout(self, now: int, wall: int) -> None:
            while self._due() <= now:
                self._polled = self._due()
                if self._inbox:
                    super().handle_payload(self._inbox.popleft(), now=now, wall=wall)
            super().handle_timeout(now, wall)

        def poll_timeout(self) -> int | None:
            due = super().poll_timeout()
            return self._due() if due is None else min(due, self._due())

    return node_of(Polling)


class LateFrames(Node):
    """Processes received frames 150 ms after their reception."""

    late_ms = 150

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self._waiting_frames: deque[tuple[int, bytes]] = deque()

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        del wall
        self._waiting_frames.append((now + self.late_ms * MS, octets))

    def handle_timeout(self, now: int, wall: int) -> None:
        while self._waiting_frames and self._waiting_frames[0][0] <= now:
            super().handle_frame(self._waiting_frames.popleft()[1], now=now, wall=wall)
        super().handle_timeout(now, wall)

    def poll_timeout(self) -> int | None:
        due = super().poll_timeout()
        if not self._waiting_frames:
            return due
        return self._waiting_frames[0][0] if due is None else min(due, self._waiting_frames[0][0])


class Grid(BeaconSchedule):
    """Sends each beacon within 49 % of a period around a point of a strict grid."""

    def _place(self) -> None:
        self._slot = self._anchor + self._period
        self._gap = 1
        self.due = self._slot + round(self._period * 0.49 * self._rng.uniform(-1, 1))


class Lossy(Tested):
    """The node of a set-up, and a link that loses two of a hundred frames."""

    def lower_tester(self) -> VirtualLowerTester:
        return _LossyLink(self)


class _LossyLink(VirtualLowerTester):
    """Loses frames in both directions, without a report of it."""

    def __init__(self, sut: InProcess) -> None:
        super().__init__(sut)
        self._chance = random.Random("loss")  # noqa: S311 - no secret

    def _lost(self) -> bool:
        return self._chance.random() < LOSS

    def send(self, octets: bytes, source: bytes) -> bytes:
        return self.framed(octets, source) if self._lost() else super().send(octets, source)

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
        while (arrival := super().receive(until, also)) is not None and self._lost():
            pass
        return arrival


LOSS = 0.02


def _changed(**changes: Any) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, **changes)


def _check(period: int) -> VardisConfig:
    return VardisConfig(buffer_check_period_ms=period)


def _variants() -> Iterator[Variant]:
    for period in (20, 50, 200, 500, 1000, 5000):
        what = f"has a beacon period of {period} ms, stated in the PIXIT"
        made = _changed(bp=BPConfig(beacon_period_ms=period), pixit=Testing(beacon_period_ms=period))
        yield Variant(f"V-TIME-beacon-{period}", what, "BP-PAR-03", made)
    for period in (1, 10, 200, 300, 400, 1000, 2000):
        late = _TIMED_OUT if period >= 1000 else ()
        what = f"checks the buffer every {period} ms"
        yield Variant(f"V-TIME-check-{period}", what, "VD-PAR-08", _changed(vardis=_check(period)), explains=late)
    for period in (1, 10, 300, 1000):
        late = _TIMED_OUT if period >= 1000 else ()
        what = f"checks the buffer every {period} ms, and composes when it becomes empty"
        made = _changed(vardis=_check(period), readings={"X54": "after-the-beacon"})
        yield Variant(f"V-TIME-check-{period}-after", what, "VD-PAR-08, X54", made, explains=late)
    for period in (1, 100, 2000, 5000):
        made = _changed(vardis=VardisConfig(scrubbing_period_ms=period))
        yield Variant(f"V-TIME-scrub-{period}", f"scrubs every {period} ms", "VD-PAR-07", made, since=_V.V2_0)
    for interval in (20, 100, 200):
        what = f"processes one received payload every {interval} ms"
        why = "the specification has no time limit for the processing of received payloads"
        made = _changed(make=polling(interval))
        yield Variant(f"V-TIME-polling-{interval}", what, why, made, explains=(_ONE_BY_ONE,))
    why = "the specification has no time limit for the processing of received payloads"
    yield Variant("V-TIME-frames-150", "processes received frames 150 ms late", why, _changed(make=node_of(LateFrames)))
    why = "the contract of the upper tester has no time limit for notifications"
    late_notifications = _changed(upper=UpperTesting(notification_ms=200))
    yield Variant("V-TIME-notifications-200", "has notifications that are 200 ms late", why, late_notifications)
    what = "sends each beacon at a random time within 49 % of a period around a point of a grid"
    yield Variant(
        "V-TIME-grid", what, "BP-TX-01, BP-TX-02", _changed(make=node_of(Grid), pics=Capabilities(jitter=True))
    )
    what = "and the tester have a link that loses two of a hundred frames, as the PIXIT says"
    lossy = _changed(surroundings=Lossy, pixit=Testing(loss=LOSS))
    yield Variant("V-TIME-loss-2", what, "the bearer does not guarantee delivery", lossy)
    what = "checks the buffer every 400 ms and has an upper tester that takes 100 ms for each call"
    made = _changed(vardis=_check(400), upper=slow(100))
    yield Variant("V-TIME-all-slow", what, "VD-PAR-08", made, explains=(TOO_SLOW_FOR_A_GAP,))


VARIANTS = tuple(_variants())
