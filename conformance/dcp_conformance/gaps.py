"""Stimuli that must fall between two beacons of the implementation.

Whether they did is seen from the kernel's stamps of its beacons. What did not is repeated, and not judged if it never
works: neither a failure nor a pass may come from a beacon that left in between.
"""

from __future__ import annotations

import contextlib
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
        bench.inconclusive(f"{what} between two beacons", f"a beacon came in between each time{pace(bench)}")
    return result


def pace(bench: Bench) -> str:
    """The end of a sentence: how long calls take, if they may be the reason that a beacon came in between."""
    slow, period = bench.session.slow_call, bench.period
    return (
        f"; calls take up to {slow / MS:.0f} ms, with a beacon every {period / MS:.0f} ms" if slow > period / 4 else ""
    )
