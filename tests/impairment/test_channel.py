"""One direction of a bad link: the laws that hold for every choice of parameters, and the statistics."""

from __future__ import annotations

import itertools
from statistics import mean, pstdev

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec.impairment import Channel, Fate, Impairment, Outage

MS = 1_000_000
shares = st.floats(0, 0.9)
times = st.integers(0, 50 * MS)


@st.composite
def impairments(draw: st.DrawFn) -> Impairment:
    loss = draw(st.one_of(st.just({}), shares.map(lambda each: {"loss": each}), st.just({"loss": 0.3, "burst": 4.0})))
    return Impairment(
        **loss,
        delay=draw(times),
        jitter=draw(times),
        distribution=draw(st.sampled_from(["uniform", "normal", "exponential"])),
        duplicate=draw(shares),
        reorder=draw(shares),
        corrupt=draw(st.floats(0, 0.1)),
        corrupt_frames=draw(shares),
        flips=draw(st.integers(1, 5)),
        down=draw(st.sampled_from([(), (Outage(50 * MS, 20 * MS),), (Outage(10 * MS, 5 * MS, 30 * MS),)])),
    )


def played(channel: Channel, frames: int = 60, size: int = 20) -> list[Fate]:
    return [channel.offer(bytes([number % 256]) * size, number * 3 * MS, 4) for number in range(frames)]


@given(impairments(), st.integers(0, 9))
def test_the_same_seed_makes_the_same_decisions(impairment: Impairment, seed: int) -> None:
    assert played(Channel(impairment, seed, "0>1")) == played(Channel(impairment, seed, "0>1"))


def test_another_seed_and_another_direction_make_other_decisions() -> None:
    impairment = Impairment(loss=0.5)
    found = [played(Channel(impairment, seed, name)) for seed, name in [(1, "0>1"), (2, "0>1"), (1, "1>0")]]
    assert all(one != other for one, other in itertools.combinations(found, 2))


@given(impairments())
def test_counters_account_for_every_frame(impairment: Impairment) -> None:
    channel = Channel(impairment, 3)
    fates = played(channel)
    counters = channel.counters
    assert counters.offered == len(fates)
    assert [each.number for each in fates] == list(range(1, len(fates) + 1))
    assert counters.copies == sum(len(each.copies) for each in fates)
    assert counters.copies == counters.offered + counters.duplicated - counters.lost - counters.down
    for name, event in [("lost", "lost"), ("down", "down"), ("corrupted", "corrupted"), ("duplicated", "duplicated")]:
        assert getattr(counters, name) == sum(event in each.events for each in fates)
    assert all(bool(each.copies) == (not each.events & {"lost", "down"}) for each in fates)


@given(impairments())
def test_uncorrupted_frames_arrive_unchanged(impairment: Impairment) -> None:
    for number, fate in enumerate(played(Channel(impairment, 3))):
        sent = bytes([number % 256]) * 20
        for copy in fate.copies:
            assert len(copy.octets) == len(sent)
            assert copy.octets[:4] == sent[:4], "the header is spared"
            assert (copy.octets != sent) == ("corrupted" in fate.events)


@given(impairments())
def test_frames_that_are_not_held_back_keep_their_order(impairment: Impairment) -> None:
    last = 0
    for number, fate in enumerate(played(Channel(impairment, 3))):
        assert all(copy.time >= number * 3 * MS for copy in fate.copies)
        if "reordered" not in fate.events:
            for copy in fate.copies:
                assert copy.time >= last
                last = copy.time


def test_a_frame_that_is_held_back_is_overtaken() -> None:
    channel = Channel(Impairment(delay=MS, reorder=0.2, reorder_delay=30 * MS), 5)
    fates = played(channel, 200)
    assert channel.counters.reordered > 20
    for number, fate in enumerate(fates):
        late = 30 * MS if "reordered" in fate.events else 0
        assert [copy.time for copy in fate.copies] == [number * 3 * MS + MS + late]


@settings(max_examples=20)
@given(impairments())
def test_an_effect_that_is_off_does_not_happen(impairment: Impairment) -> None:
    changed = Impairment(delay=impairment.delay, jitter=impairment.jitter)
    fates = played(Channel(changed, 2))
    assert all(len(each.copies) == 1 and not each.events for each in fates)


def test_a_perfect_link_passes_everything_at_once() -> None:
    for number, fate in enumerate(played(Channel(Impairment(loss=0.0)))):
        assert fate.copies == ((number * 3 * MS, bytes([number % 256]) * 20),)


def test_another_delay_does_not_change_which_frames_are_lost() -> None:
    """So that two runs that differ in one parameter can be compared frame by frame."""
    plain = played(Channel(Impairment(loss=0.3)))
    other = played(Channel(Impairment(loss=0.3, delay=5 * MS, jitter=2 * MS, duplicate=0.3, corrupt=0.2, reorder=0.4)))
    assert [bool(each.copies) for each in plain] == [bool(each.copies) for each in other]


def test_a_link_is_down_by_schedule() -> None:
    channel = Channel(Impairment(down=(Outage(6 * MS, 6 * MS, 15 * MS),)))
    up = [bool(each.copies) for each in played(channel, 10)]
    assert up == [True, True, False, False, True] * 2


def test_the_quality_can_change() -> None:
    channel = Channel(Impairment(loss=1.0))
    assert not channel.offer(b"a", 0).copies
    channel.change(Impairment(delay=10 * MS))
    assert channel.offer(b"b", 0).copies[0].time == 10 * MS
    channel.change(Impairment())
    assert channel.offer(b"c", 2 * MS).copies[0].time == 10 * MS, "it does not overtake what is still under way"


# -- statistics; bounds are five standard deviations or more ---------------------------------------------------------


def test_bursts_have_a_geometric_length() -> None:
    channel = Channel(Impairment(loss=0.2, burst=5.0), 7)
    lost = [not channel.offer(b"", number).copies for number in range(200_000)]
    lengths = [len(list(run)) for is_lost, run in itertools.groupby(lost) if is_lost]
    assert mean(lost) == pytest.approx(0.2, abs=0.02)
    assert mean(lengths) == pytest.approx(5.0, abs=0.3)
    assert channel.counters.mean_burst == pytest.approx(mean(lengths), rel=1e-9)
    # Of a geometric distribution with the mean 5: a fifth has length 1, and the standard deviation is sqrt(20).
    assert lengths.count(1) / len(lengths) == pytest.approx(0.2, abs=0.025)
    assert lengths.count(2) / lengths.count(1) == pytest.approx(0.8, abs=0.12)
    assert pstdev(lengths) == pytest.approx(20**0.5, abs=0.4)


def test_p_and_r_are_the_same_as_loss_and_burst() -> None:
    one, other = Impairment(loss=0.2, burst=5.0), Impairment(p=0.05, r=0.2)
    assert one.bursts == pytest.approx(other.bursts)
    assert one.mean_loss == pytest.approx(other.mean_loss)


def test_a_bad_state_that_loses_a_part() -> None:
    impairment = Impairment(p=0.05, r=0.2, bad=0.5)
    channel = Channel(impairment, 7)
    for number in range(100_000):
        channel.offer(b"", number)
    assert impairment.mean_loss == pytest.approx(0.1)
    assert channel.counters.loss == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(
    ("distribution", "expected", "deviation"),
    [("uniform", 6.0, 2 / 12**0.5), ("normal", 5.0, 2.0), ("exponential", 7.0, 2.0)],
)
def test_delays_follow_the_distribution(distribution: str, expected: float, deviation: float) -> None:
    impairment = Impairment(delay=5 * MS, jitter=2 * MS, distribution=distribution)  # type: ignore[arg-type]
    channel = Channel(impairment, 7)
    delays = [channel.offer(b"", at).copies[0].time - at for at in range(0, 10_000 * 100 * MS, 100 * MS)]
    assert mean(delays) / MS == pytest.approx(expected, abs=0.12)
    assert pstdev(delays) / MS == pytest.approx(deviation, abs=0.15)
    assert channel.counters.mean_delay == pytest.approx(mean(delays))


def test_corruption_inverts_one_bit_in_a_share_of_octets() -> None:
    channel = Channel(Impairment(corrupt=0.01), 7)
    flipped = 0
    for number in range(3000):
        copy = channel.offer(bytes(100), number).copies[0]
        assert all(each == 0 or each.bit_count() == 1 for each in copy.octets)
        flipped += sum(each.bit_count() for each in copy.octets)
    assert channel.counters.octets == 300_000
    assert flipped == channel.counters.flipped
    assert flipped / 300_000 == pytest.approx(0.01, abs=0.001)


def test_corrupted_frames_have_the_configured_number_of_inverted_bits() -> None:
    channel = Channel(Impairment(corrupt_frames=0.25, flips=3), 7)
    found = [sum(each.bit_count() for each in channel.offer(bytes(40), n).copies[0].octets) for n in range(8000)]
    assert set(found) == {0, 3}
    assert found.count(3) / len(found) == pytest.approx(0.25, abs=0.03)
