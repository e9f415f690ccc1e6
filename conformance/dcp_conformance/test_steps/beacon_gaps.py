"""Stimuli that must fall between two beacons of the implementation.

The kernel's time stamps of its beacons show whether they did. Otherwise the stimuli are repeated; if that never
succeeds, the case is inconclusive: a beacon in between must cause neither a failure nor a pass.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable
from typing import Final, TypeVar

from dcp_conformance.errors import StopCase, UpperTesterError
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_system.bench import MS, Bench

from .kept_payloads import keeps_payloads

T = TypeVar("T")

_SWITCHES: Final = ("BP-MGMT-Activate", "BP-MGMT-Deactivate")
_ATTEMPTS: Final = 4
#: A beacon sent within this fraction of a period after the stimuli may have been prepared before the last one.
_GUARD: Final = 20
#: Minimum number of slow calls of a service for a conclusion, and the share of them that must end after a beacon.
_TELLING, _MOSTLY = 3, 0.8


def pausable(bench: Bench) -> bool:
    """Return whether BP can be deactivated to prevent beacons in between.

    False if deactivation failed before: that is a separate fault, which must not affect cases about other features.
    """
    return bench.services.offers(*_SWITCHES) and not bench.session.pausing_fails


def in_a_gap(
    bench: Bench, act: Callable[[], T], sent: Callable[[ReceivedBeacon], object], *, paused: bool = False
) -> tuple[T, bool]:
    """Call ``act``; return its result, and whether no beacon for which ``sent`` is true was sent in this time.

    ``paused``: deactivate BP for this time; inconclusive if that fails.
    """
    guard = bench.period // _GUARD
    with bench.services.deactivated("BP") if paused else contextlib.nullcontext():
        if paused:
            # A beacon that was sent before may still be in transit.
            bench.waiting.wait_ns(guard)
        start = bench.mark()
        try:
            result = act()
        except (StopCase, UpperTesterError):
            bench.session.pausing_fails = bench.session.pausing_fails or paused
            raise
        end = bench.now()
    if not paused:
        bench.waiting.wait_ns(guard)
        end += guard
    bench.mark()
    return result, not any(heard.time <= end and sent(heard) for heard in bench.heard[start:])


def between_beacons(
    bench: Bench, what: str, act: Callable[[], T], sent: Callable[[ReceivedBeacon], object], *, flush: float = 12
) -> T:
    """Call ``act`` between two beacons, and return its result.

    ``sent`` returns whether a beacon contains an effect of ``act``. After such a beacon in between, ``act`` is tried
    again when such beacons have stopped, finally with BP deactivated if possible. Inconclusive if there is a beacon in
    between in each attempt. ``what`` is a noun phrase that completes "... between two beacons". ``flush``: number of
    beacon periods in which all payloads of an attempt can be sent.
    """
    can_pause = pausable(bench)
    lost = ""
    # If calls take longer than the gap, only the attempt with BP deactivated is useful.
    first = _ATTEMPTS - 1 if can_pause and bench.session.typical_call > bench.period / 2 else 0
    for attempt in range(first, _ATTEMPTS):
        paused = can_pause and attempt == _ATTEMPTS - 1
        if paused and not keeps_payloads(bench):
            # Nothing about queues and buffers would follow from payloads that are missing afterwards.
            lost = "; while BP is deactivated, the implementation loses payloads (BP-MGT-04)"
            paused = False
        result, good = in_a_gap(bench, act, sent, paused=paused)
        if good:
            break
        # Wait for remaining payloads, so that they are not mistaken for those of the next attempt, and begin right
        # after a beacon.
        bench.until_quiet(sent, flush)
        bench.beacons(1, 1.5)
    else:
        bench.inconclusive(f"{what} between two beacons", f"a beacon in between in each attempt{lost}{pace(bench)}")
    return result


def pace(bench: Bench) -> str:
    """Return the end of a sentence about slow calls, if they may be the reason for a beacon in between."""
    slow, period = bench.session.slow_call, bench.period
    if slow <= period / 4:
        return ""
    text = f"; calls take up to {slow / MS:.0f} ms, with a beacon every {period / MS:.0f} ms"
    return f"{text}; {waiting}" if (waiting := _waits_for_beacons(bench)) else text


def _waits_for_beacons(bench: Bench) -> str:
    """Return which service is answered after a beacon only, and how to decide such a case; empty if none is."""
    period, events = bench.period, bench.traffic.events
    beacons = [each.wall for each in events if each.direction == "heard"]
    slow, ended = Counter[str](), Counter[str]()
    begun: dict[str, int] = {}
    for event in events:
        if event.direction == "call":
            begun[event.text] = event.wall
        elif event.direction == "answer":
            method = event.text.partition(":")[0]
            since, answered = begun.pop(method, event.wall), event.wall
            if answered - since > period / 4:
                slow[method] += 1
                latest = max((each for each in beacons if since < each <= answered), default=since)
                ended[method] += latest > since and answered - latest < period / 4
    for method, count in slow.items():
        if count >= _TELLING and ended[method] >= _MOSTLY * count:
            return (
                f"{ended[method]} of {count} slow calls of {method} end after a beacon: it may wait until its "
                "queue is empty. A beacon period longer than it waits (some seconds, also in "
                "pixit.beacon_period_ms) shows its answer"
            )
    return ""
