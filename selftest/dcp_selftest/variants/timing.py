"""Variants with other permitted periods, with delayed processing of received payloads, and with slow upper testers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from dcp_conformance.model.pics import Testing
from dcp_conformance.reference.inprocess import MakeNode
from dcp_conformance.reference.surroundings import Setup
from dcp_spec.constants import SpecVersion

from dcp_stack.config import MS, BPConfig, VardisConfig
from dcp_stack.vardis.entity import Vardis

from .services import TOO_SLOW_FOR_A_GAP
from .variant import Variant, node_of, setup, slow

_V = SpecVersion

#: The two payloads of a beacon are processed separately, so that a record that the second cancels may have been sent.
_ONE_BY_ONE = (
    r"^TC_VD_PEND_BV_0[1236]: .*; but it processes received payloads one at a time and may answer in between"
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
    what = "checks the buffer every 400 ms and has an upper tester that takes 100 ms for each call"
    made = _changed(vardis=_check(400), upper=slow(100))
    yield Variant("V-TIME-all-slow", what, "VD-PAR-08", made, explains=(TOO_SLOW_FOR_A_GAP,))


VARIANTS = tuple(_variants())
