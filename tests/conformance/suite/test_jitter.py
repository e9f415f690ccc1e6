"""Comparing the intervals between beacons after two starts."""

from __future__ import annotations

import itertools
import random

import pytest
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.jitter import SHIFT, compare, intervals

from dcp_codec.values import VarSumm

from ..air import MS, Script

PERIOD = 100 * MS
COUNT = 24 + SHIFT


def drawn(seed: int, *, jitter: float = 0.1, clock_ms: int = 0, count: int = COUNT) -> list[int | None]:
    """Intervals with jitter, as a clock with this resolution (0: 1 ns) sees them."""
    rng, now, stamps = random.Random(seed), 0, [0]
    for _ in range(count):
        now += round(PERIOD * rng.uniform(1 - jitter, 1 + jitter))
        stamps.append(now // (clock_ms * MS) * clock_ms * MS if clock_ms else now)
    return [after - before for before, after in itertools.pairwise(stamps)]


def with_late(sequence: list[int | None], *places: int, by_ms: int = 60) -> list[int | None]:
    """Some beacons came late; the next one is on time."""
    changed = [each or 0 for each in sequence]
    for place in places:
        changed[place] += by_ms * MS
        changed[place + 1] -= by_ms * MS
    return list(changed)


@pytest.mark.parametrize("seed", range(20))
def test_different_sequences(seed: int):
    assert compare(drawn(seed), drawn(1000 + seed), PERIOD) == "different"


@pytest.mark.parametrize("late", [(), (3,), (0, 7, 15, 22)])
@pytest.mark.parametrize("shift", [0, 1, SHIFT])
def test_the_same_sequence_in_spite_of_late_beacons(late: tuple[int, ...], shift: int):
    whole = drawn(7, count=COUNT + SHIFT)
    again = with_late(whole[shift:][:COUNT], *late)
    assert compare(whole[:COUNT], again, PERIOD) == "same"
    assert compare(again, whole[:COUNT], PERIOD) == "same"


def test_the_same_sequence_in_spite_of_noise_and_lost_beacons():
    rng = random.Random(3)
    noisy = [(each or 0) + round(rng.uniform(-0.5, 0.5) * MS) for each in drawn(7)]
    again: list[int | None] = [None if place in (5, 6, 20, 21) else each for place, each in enumerate(noisy)]
    assert compare(drawn(7), again, PERIOD) == "same"


@pytest.mark.parametrize("clock_ms", [10, 15, 20])
def test_sequences_of_a_coarse_clock_do_not_count_as_equal(clock_ms: int):
    """Intervals take few values, so that many agree by chance."""
    pairs = [(drawn(seed, clock_ms=clock_ms), drawn(500 + seed, clock_ms=clock_ms)) for seed in range(200)]
    assert "same" not in {compare(one, two, PERIOD) for one, two in pairs}


def test_two_values_are_not_enough_evidence():
    one = [PERIOD if place % 8 else PERIOD + 10 * MS for place in range(COUNT)]
    assert compare(one, one, PERIOD) in ("strict", "coarse")


@pytest.mark.parametrize("late", [(), (3,), (3, 9, 20)])
def test_strictly_periodic_beacons_with_some_late_ones(late: tuple[int, ...]):
    strict: list[int | None] = [PERIOD] * COUNT
    assert compare(strict, with_late(strict, *late), PERIOD) == "strict"


def test_too_few_beacons():
    assert compare([PERIOD], [], PERIOD) == "coarse"


def test_a_missed_beacon_removes_two_intervals():
    air = Script("dcp-2.0")
    air.step = PERIOD
    for number in (4, 5, 8, 9):
        air.time += PERIOD if number == 8 else 0
        air.say(1, VarSumm(1, 0), seqno=number)
    heard = [ReceivedBeacon(air.codec, each.number, each.time_ns, each.time_ns, each.data[14:], each.data[6:12])
             for each in air.frames]  # fmt: skip
    assert intervals(heard) == [PERIOD, None, None, None, PERIOD]
