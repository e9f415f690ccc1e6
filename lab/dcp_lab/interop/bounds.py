"""Upper bounds of the time in which a change reaches every station, with a given probability of a miss."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

from .world import Limits

#: The probability that a correct network misses the bound.
MISS: Final = 1e-6
#: Beacon periods of one attempt to cross a hop: a station may share its beacons among clients, vary its intervals by up
#: to a period, and answer a summary with a request, and a request with a create, each in a beacon of its own.
_PERIODS: Final = 8
#: Seconds added to each bound for slow machines and for the start of a station.
_PATIENCE: Final = 1.0


@cache
def attempts(hops: int, success: float) -> int:
    """Return the smallest k for which fewer than ``hops`` of k attempts succeed with at most probability MISS."""
    if success >= 1:
        return hops
    k = hops
    while True:
        terms = (math.comb(k, i) * success**i * (1 - success) ** (k - i) for i in range(hops))
        if sum(terms) <= MISS:
            return k
        k += 1


def spreading_time(hops: int, loss: float, variables: int, limits: Limits) -> float:
    """Return the seconds within which a change crosses ``hops`` hops, each frame being lost with probability ``loss``.

    An attempt succeeds if summary, request and record are all received. Attempts happen each time that the summary of
    the variable comes round, so their interval grows with ``variables``.
    """
    return _seconds(attempts(max(hops, 1), _success(loss)), hops, variables, limits)


def expected_time(hops: int, loss: float, variables: int, limits: Limits) -> float:
    """Return the seconds that such a change takes on the average, by the same model; at most ``spreading_time``."""
    return _seconds(max(hops, 1) / max(_success(loss), MISS), hops, variables, limits)


def cycle_time(limits: Limits) -> tuple[float, float]:
    """Return for how many seconds a link is up and then down: each interval up is long enough for an attempt."""
    up = 10 * limits.beacon_period_ms + max(0.0, 2 * limits.buffer_check_ms - limits.beacon_period_ms)
    return up / 1000, 2 * up / 1000


def time_through_outages(hops: int, limits: Limits) -> tuple[float, float]:
    """Return the bound and the average of the seconds in which a change crosses links of :func:`cycle_time`.

    Each interval in which a link is up is enough for one hop. The bound adds three cycles, one of them because a change
    can occur in the middle of an interval.
    """
    up, down = cycle_time(limits)
    return (hops + 3) * (up + down) + _PATIENCE, (hops + 1) * (up + down) + _PATIENCE


def _success(loss: float) -> float:
    return (1 - loss) ** 3


def _seconds(tries: float, hops: int, variables: int, limits: Limits) -> float:
    # An entry of a summary has 3 octets at most in all versions; 30 octets are left for containers and a record.
    room = max(1, min(limits.summaries or 20, (limits.payload - 30) // 3))
    rounds = math.ceil(variables / room)
    # Values need room as well: at least one record of each variable on each hop.
    records = (
        math.ceil(variables * (limits.description + limits.value + 30) / max(limits.payload, 1)) if variables > 1 else 0
    )
    crossing = tries * (_PERIODS + rounds - 1) + records * max(hops, 1) * 4
    checks = crossing / _PERIODS * 2 * limits.buffer_check_ms
    return (crossing * limits.beacon_period_ms + checks) / 1000 + _PATIENCE
