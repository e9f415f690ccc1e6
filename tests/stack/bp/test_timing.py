"""When beacons leave: mean, jitter, late calls, triggers, changes of the period."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import pytest

from ..bp_rig import DROPHEAD, DROPTAIL, MS, ONCE, REPEAT, VERSIONS, Rig

PERIOD = 100 * MS


def repeating(**settings):
    rig = Rig(**settings)
    rig.register(7, REPEAT)
    rig.submit(b"A")
    return rig


def times(rig, count, late=lambda: 0):
    """When the next beacons leave, if the caller is so late each time."""
    found = []
    for _ in range(count):
        assert rig.tick(late()) is not None
        found.append(rig.now)
    return found


def intervals(moments):
    return [after - before for before, after in pairwise(moments)]


@pytest.mark.req("BP-TX-01")
@pytest.mark.req("BP-TX-02")
@pytest.mark.req("BP-PAR-03")
@pytest.mark.parametrize(("jitter", "seed"), [(0.0, 1), (0.1, 1), (0.1, 2), (0.5, 3), (0.99, 4)])
def test_ten_thousand_beacons(jitter, seed):
    rig = repeating(jitter=jitter, seed=seed)
    moments = times(rig, 10_000)
    found = intervals(moments)
    # Within 0.5 %, or where the jitter is wide within 4 standard deviations of the mean of so many intervals.
    tolerance = max(0.005, 4 * jitter / math.sqrt(3) / math.sqrt(len(found)))
    assert abs(sum(found) / len(found) / PERIOD - 1) < tolerance
    assert PERIOD * (1 - jitter) - 1 <= min(found)
    assert max(found) <= PERIOD * (1 + jitter) + 1
    if not jitter:
        assert set(found) == {PERIOD}
    else:
        # The jitter is used, and evenly.
        spread = PERIOD * jitter
        assert min(found) < PERIOD - 0.95 * spread
        assert max(found) > PERIOD + 0.95 * spread
        assert sum(value < PERIOD for value in found) == pytest.approx(len(found) / 2, rel=0.05)


@pytest.mark.req("BP-TX-01")
@pytest.mark.parametrize("late", [1, 30, 74])
def test_a_caller_that_is_always_late_does_not_slow_beacons_down(late):
    rig = repeating(jitter=0.0)
    moments = times(rig, 1000, lambda: late * MS)
    assert set(intervals(moments)) == {PERIOD}


@pytest.mark.req("BP-TX-01")
def test_a_caller_that_is_late_at_random_neither_shifts_the_mean_nor_causes_bursts():
    rig, lateness = repeating(), random.Random(5)
    moments = times(rig, 10_000, lambda: lateness.randrange(60 * MS))
    found = intervals(moments)
    assert sum(found) / len(found) == pytest.approx(PERIOD, rel=0.005)
    assert min(found) >= PERIOD * 0.9 / 4


def test_beacons_are_spaced_however_late_the_caller_is():
    rig, lateness = repeating(), random.Random(6)
    moments = times(rig, 5000, lambda: lateness.randrange(99 * MS))
    assert min(intervals(moments)) >= PERIOD * 0.9 / 4


@pytest.mark.parametrize("sleep", [101 * MS, 150 * MS, 1000 * MS, 3600 * 1000 * MS, 10**9 * 1000 * MS])
def test_missed_beacons_are_not_sent_later(sleep):
    rig = repeating()
    times(rig, 10)
    before = len(rig.sent())
    rig.tick(sleep)
    woken = rig.now
    assert len(rig.sent()) == before + 1
    rig.bp.handle_timeout(rig.now, 0)
    assert len(rig.sent()) == before + 1
    moments = [woken, *times(rig, 10)]
    assert min(intervals(moments)) >= PERIOD * 0.9 / 4
    assert moments[-1] - woken >= 9 * PERIOD * 0.9


@pytest.mark.req("BP-MGT-06")
@pytest.mark.parametrize("longest", [60, 250, 3000])
def test_beacons_missed_by_a_late_caller_are_counted(longest):
    """The counters distinguish a busy machine from a node with another period."""
    rig, lateness = repeating(), random.Random(7)
    begun = rig.now
    times(rig, 2000, lambda: lateness.randrange(longest * MS))
    counters = rig.bp.counters()
    assert (counters["beacons-left-out"] > 0) == (longest > 100)
    slots = counters["beacons-sent"] + counters["beacons-left-out"]
    assert slots == pytest.approx((rig.now - begun) / PERIOD, rel=0.01)


def test_calling_early_does_no_harm():
    rig = repeating()
    due = rig.bp.poll_timeout()
    for moment in (rig.now, due - 1):
        rig.bp.handle_timeout(moment, 0)
        assert rig.bp.poll_timeout() == due
    assert rig.sent() == []


def test_the_schedule_continues_while_there_is_nothing_to_send():
    """A payload waits for the next slot: neighbours that answer the same beacon must not all send at once."""
    rig = Rig(jitter=0.0)
    start = rig.now
    rig.register(7, ONCE)
    for _ in range(5):
        assert rig.tick() is None
    rig.now += 30 * MS
    rig.submit(b"A")
    assert rig.bp.poll_timeout() == start + 6 * PERIOD
    assert rig.tick() == [(7, b"A")]


@pytest.mark.req("BP-TX-02")
def test_nodes_that_start_together_drift_apart():
    first, second = repeating(seed=1), repeating(seed=2)
    gaps = [abs(a - b) for a, b in zip(times(first, 500), times(second, 500), strict=True)]
    assert max(gaps) > PERIOD / 2


@pytest.mark.parametrize("jitter", [-0.1, 1.0, 2.0, math.nan])
def test_jitter_out_of_range(jitter):
    with pytest.raises(ValueError, match="jitter must be in"):
        Rig(jitter=jitter)


# -- triggered beacons --------------------------------------------------------------------------------------------


@pytest.mark.req("BP-TXP-07")
@pytest.mark.parametrize("version", VERSIONS)
def test_a_payload_brings_the_next_beacon_forward(version):
    rig = Rig(version, triggered=True, jitter=0.0)
    rig.register(7, ONCE)
    rig.now += 40 * MS
    rig.submit(b"A")
    assert rig.bp.poll_timeout() == rig.now
    assert rig.tick() == [(7, b"A")]
    rig.now += 60 * MS
    rig.submit(b"B")
    assert rig.bp.poll_timeout() == rig.now


def test_a_trigger_keeps_no_distance_to_an_empty_slot():
    rig = Rig(triggered=True)
    rig.register(7, ONCE)
    assert rig.tick() is None
    rig.submit(b"A")
    assert rig.bp.poll_timeout() == rig.now


def test_without_triggers_a_payload_waits():
    rig = Rig()
    due = rig.bp.poll_timeout()
    rig.register(7, ONCE)
    rig.submit(b"A")
    assert rig.bp.poll_timeout() == due


def test_a_discarded_payload_triggers_no_beacon():
    rig = Rig(triggered=True)
    rig.register(7, DROPTAIL, entries=1)
    rig.submit(bytes(100))
    # The queue stays full, as the payload fits into no beacon any more.
    rig.bp.set_parameter("BPPAR_MAXIMUM_PACKET_SIZE", 100)
    assert rig.tick() is None
    due = rig.bp.poll_timeout()
    for payload in (b"", bytes(101), b"B"):
        rig.submit(payload)
    assert rig.bp.poll_timeout() == due


def test_a_trigger_keeps_its_distance_to_a_late_beacon():
    rig = Rig(triggered=True, jitter=0.0)
    rig.register(7, DROPHEAD)
    rig.submit(b"A")
    rig.submit(b"B")
    rig.tick()
    rig.tick(10 * MS)
    rig.submit(b"C")
    assert rig.bp.poll_timeout() == rig.now + PERIOD // 4


@pytest.mark.req("BP-TX-01")
@pytest.mark.parametrize("late", [0, 10, 40])
def test_a_client_that_answers_every_transmission_does_not_send_without_end(late):
    rig = Rig(triggered=True)
    rig.register(7, DROPHEAD)
    start = rig.now
    rig.submit(b"0")
    moments = []
    for index in range(2000):
        assert rig.tick(late * MS) is not None
        moments.append(rig.now)
        rig.submit(b"%d" % index)
    assert (moments[-1] - start) / len(moments) == pytest.approx(PERIOD, rel=0.01)
    assert min(intervals(moments)) >= PERIOD * 0.9 / 4


# -- changes ------------------------------------------------------------------------------------------------------


@pytest.mark.req("BP-PAR-02")
@pytest.mark.parametrize("version", VERSIONS)
def test_a_period_holds_from_the_next_beacon_on(version):
    rig = Rig(version, jitter=0.0)
    rig.register(7, REPEAT)
    rig.submit(b"A")
    (last,) = times(rig, 1)
    assert rig.bp.set_parameter("BPPAR_BEACON_PERIOD", 250) is None
    assert intervals([last, *times(rig, 3)]) == [250 * MS] * 3
    assert rig.bp.set_parameter("BPPAR_BEACON_PERIOD", 20.5) is None
    assert intervals([rig.now, *times(rig, 3)]) == [20_500_000] * 3


@pytest.mark.req("BP-PAR-02")
def test_a_shorter_period_does_not_wait_for_the_end_of_the_longer_one():
    rig = repeating(jitter=0.0, beacon_period_ms=3_600_000)
    rig.tick()
    rig.now += 1000 * MS
    rig.bp.set_parameter("BPPAR_BEACON_PERIOD", 100)
    found = intervals([rig.now, *times(rig, 5)])
    assert found[0] <= PERIOD
    assert found[1:] == [PERIOD] * 4


@pytest.mark.req("BP-PAR-03")
@pytest.mark.parametrize("period", [1e-9, 1e-300, 1 << 60, 10**300, 1e300])
def test_any_positive_period_is_workable(period):
    rig = repeating()
    assert rig.bp.set_parameter("BPPAR_BEACON_PERIOD", period) is None
    moments = times(rig, 5)
    assert min(intervals(moments)) > 0


def test_activation_starts_a_new_interval():
    rig = repeating(jitter=0.0)
    times(rig, 3)
    rig.bp.deactivate()
    rig.now += 12_345 * MS
    rig.bp.activate(rig.now)
    assert rig.bp.poll_timeout() == rig.now + PERIOD
