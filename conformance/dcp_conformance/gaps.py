"""Stimuli that must fall between two beacons of the implementation.

Whether they did is seen from the kernel's stamps of its beacons. What did not is repeated, and not judged if it never
works: neither a failure nor a pass may come from a beacon that left in between.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable
from typing import Final, TypeVar

from .bench import MS, Bench
from .errors import StopCase, UpperTesterError
from .heard import Heard

T = TypeVar("T")

_SWITCHES: Final = frozenset({"BP-MGMT-Activate", "BP-MGMT-Deactivate"})
_ATTEMPTS: Final = 4
#: A beacon that leaves within this fraction of a period after the stimuli may have been prepared before the last one.
_GUARD: Final = 20
#: Slow calls of a service from which something is concluded, and the share of them that must end after a beacon.
_TELLING, _MOSTLY = 3, 0.8


def pausable(bench: Bench) -> bool:
    """Whether BP can be deactivated to keep beacons from coming in between.

    Not where this was found to go wrong: that is a fault of its own, which cases about other things must not meet.
    """
    session = bench.session
    return session.upper is not None and session.upper.methods >= _SWITCHES and not session.pausing_fails


def in_a_gap(
    bench: Bench, act: Callable[[], T], sent: Callable[[Heard], object], *, paused: bool = False
) -> tuple[T, bool]:
    """Carry out ``act``; its result, and whether no beacon for which ``sent`` is true left meanwhile.

    ``paused``: with BP deactivated meanwhile; stops as inconclusive if that does not work.
    """
    guard = bench.period // _GUARD
    with bench.deactivated("BP") if paused else contextlib.nullcontext():
        if paused:
            # A beacon that was sent before may still be in transit.
            bench.wait_ns(guard)
        start = bench.mark()
        try:
            result = act()
        except (StopCase, UpperTesterError):
            bench.session.pausing_fails = bench.session.pausing_fails or paused
            raise
        end = bench.now()
    if not paused:
        bench.wait_ns(guard)
        end += guard
    bench.mark()
    return result, not any(heard.time <= end and sent(heard) for heard in bench.heard[start:])


def between_beacons(
    bench: Bench, what: str, act: Callable[[], T], sent: Callable[[Heard], object], *, flush: float = 12
) -> T:
    """Carry out ``act`` between two beacons, and return its result.

    ``sent`` says of a beacon that what ``act`` does was seen in it. If one came in between, ``act`` is tried again when
    such beacons have stopped, at last with BP deactivated where that can be done. Stops as inconclusive if a beacon
    came in between each time. ``what`` completes "... between two beacons". ``flush``: beacon periods in which all that
    an attempt has submitted can leave the node.
    """
    can_pause = pausable(bench)
    # Calls that take longer than the gap lasts need no attempts.
    first = _ATTEMPTS - 1 if can_pause and bench.session.typical_call > bench.period / 2 else 0
    for attempt in range(first, _ATTEMPTS):
        result, good = in_a_gap(bench, act, sent, paused=can_pause and attempt == _ATTEMPTS - 1)
        if good:
            break
        # Flush what still waits, so that it is not mistaken for the next attempt, and begin right after a beacon.
        bench.until_quiet(sent, flush)
        bench.beacons(1, 1.5)
    else:
        bench.inconclusive(f"{what} between two beacons", f"a beacon in between in each attempt{pace(bench)}")
    return result


def pace(bench: Bench) -> str:
    """The end of a sentence: how long calls take, if they may be the reason that a beacon came in between."""
    slow, period = bench.session.slow_call, bench.period
    if slow <= period / 4:
        return ""
    text = f"; calls take up to {slow / MS:.0f} ms, with a beacon every {period / MS:.0f} ms"
    return f"{text}; {waiting}" if (waiting := _waits_for_beacons(bench)) else text


def _waits_for_beacons(bench: Bench) -> str:
    """Which service is answered when a beacon has left, and what decides such a case, in words; empty if none is."""
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
                f"{ended[method]} of {count} slow calls of {method} end when a beacon has left: it may wait until its "
                "queue is empty. A beacon period that is longer than it waits (some seconds, also in "
                "pixit.beacon_period_ms) shows what it answers then"
            )
    return ""
