"""Whether the intervals between beacons after two starts follow the same sequence of random numbers."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Sequence
from typing import Final, Literal

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.frames.received import ReceivedBeacon

#: The first beacon that is heard may be this many later in the sequence after one start than after the other.
SHIFT: Final = 12
#: The probability, under independence, below which two sequences count as the same.
_BY_CHANCE: Final = 1e-4
#: Intervals are equal if they differ by less than this fraction of their spread.
_EQUAL: Final = 0.25
#: The spread of a strictly periodic sender, as a fraction of the period, is below this.
_STRICT: Final = 0.01
#: Beacons in a row that may be missing between two that were heard.
_MOST_MISSED: Final = 8

Intervals = Sequence[int | None]
"""Times between consecutive beacons in ns; None next to a beacon that was not heard."""
Comparison = Literal["strict", "same", "different", "coarse"]
"""Strictly periodic; the same sequence; different ones; too few different values to tell."""


def intervals(frames: Sequence[ReceivedBeacon]) -> Intervals:
    """The intervals between beacons, one for each sequence number."""
    found: list[int | None] = []
    for before, after in itertools.pairwise(frames):
        step = 1
        if before.seqno is not None and after.seqno is not None:
            step = (after.seqno - before.seqno) % BP_SEQNO_MODULUS
        if 1 < step <= _MOST_MISSED:
            found += [None] * step
        else:
            found.append(after.time - before.time)
    return found


def compare(one: Intervals, two: Intervals, period: int) -> Comparison:
    """Compare the intervals after two starts; ``period`` in ns.

    A late beacon changes two intervals, and a lost one hides two: the sequences are the same if more intervals agree at
    one shift than independent sequences would have in common by chance. How often intervals agree by chance is taken
    from all pairs of them, so that a coarse clock, with few different intervals, shows nothing.
    """
    values = [each for each in (*one, *two) if each is not None]
    if len(values) < SHIFT:
        return "coarse"
    first, _, last = statistics.quantiles(values, n=4)
    # The standard deviation if they are normally distributed; unlike that it does not depend on a few late beacons.
    spread = (last - first) / 1.35
    if spread < _STRICT * period:
        return "strict"
    limit = _EQUAL * spread
    pairs = [abs(a - b) < limit for a, b in itertools.product(one, two) if a is not None and b is not None]
    chance = sum(pairs) / len(pairs) if pairs else 1.0
    shifts = range(-SHIFT, SHIFT + 1)
    overlaps = [_overlap(one, two, shift) for shift in shifts]
    likely = [_at_least(sum(abs(a - b) < limit for a, b in pairs), len(pairs), chance) for pairs in overlaps]
    if min(likely) * len(shifts) < _BY_CHANCE:
        return "same"
    # Even complete agreement would have shown nothing.
    longest = max(map(len, overlaps))
    return "coarse" if _at_least(longest, longest, chance) * len(shifts) >= _BY_CHANCE else "different"


def _overlap(one: Intervals, two: Intervals, shift: int) -> list[tuple[int, int]]:
    """Pairs of intervals, with the second sequence this many intervals later."""
    pairs = zip(one[max(0, shift) :], two[max(0, -shift) :], strict=False)
    return [(a, b) for a, b in pairs if a is not None and b is not None]


def _at_least(count: int, of: int, chance: float) -> float:
    """The probability that at least ``count`` of ``of`` independent trials succeed."""
    return sum(math.comb(of, each) * chance**each * (1 - chance) ** (of - each) for each in range(count, of + 1))
