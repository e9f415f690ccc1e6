"""Several stations: who hears whom, partitions, stations that are disconnected, and the counters."""

from __future__ import annotations

import json

import pytest

from dcp_codec.impairment import Impairment, ImpairmentError
from dcp_stack.virtual.medium import ImpairedMedium

MS = 1_000_000
LINE = [(0, 1), (1, 0), (1, 2), (2, 1)]


def heard(medium: ImpairedMedium, sender: int, now: int = 0) -> list[int]:
    medium.broadcast(sender, b"x", now)
    return [receiver for each in medium.arrivals(now + 1000 * MS) for receiver in each.receivers]


def test_all_stations_hear_each_other_by_default() -> None:
    assert heard(ImpairedMedium(4), 1) == [0, 2, 3]
    assert [heard(ImpairedMedium(3, pairs=LINE), sender) for sender in range(3)] == [[1], [0, 2], [1]]
    assert heard(ImpairedMedium(2, pairs=[(0, 1)]), 1) == [], "one way"


def test_each_direction_has_a_quality_of_its_own() -> None:
    medium = ImpairedMedium(3)
    medium.set_quality(Impairment(loss=1.0), 0, 1)
    assert heard(medium, 0) == [2]
    assert heard(medium, 1) == [0, 2]
    medium.set_quality(Impairment(loss=1.0))
    assert heard(medium, 2) == [], "all that have none of their own"
    medium.set_quality(Impairment(), 0, 1)
    assert heard(medium, 0) == [1]
    medium.set_quality(Impairment(), receiver=2)
    assert heard(medium, 0) == [1, 2]


def test_frames_stay_within_their_group() -> None:
    medium = ImpairedMedium(5)
    medium.partition([[0, 1], [2]])
    assert [heard(medium, sender) for sender in range(5)] == [[1], [0], [], [4], [3]]
    medium.partition()
    assert heard(medium, 0) == [1, 2, 3, 4]
    medium.partition([[0], [1]])
    medium.partition()
    assert heard(medium, 0) == [1, 2, 3, 4]


def test_a_disconnected_station_neither_hears_nor_is_heard() -> None:
    medium = ImpairedMedium(3, quality=Impairment(delay=5 * MS))
    medium.broadcast(0, b"under way", 0)
    medium.switch(1, up=False)
    assert [each.receivers for each in medium.arrivals(5 * MS)] == [(2,)]
    assert medium.direction(0, 1).counters.down == 1
    assert heard(medium, 1) == []
    medium.switch(1, up=True)
    assert heard(medium, 0, 2000 * MS) == [1, 2]


def test_arrivals_come_in_the_order_of_time_then_of_sending() -> None:
    medium = ImpairedMedium(3, quality=Impairment(delay=5 * MS))
    medium.set_quality(Impairment(delay=1 * MS), 1, 0)
    medium.broadcast(0, b"a", 0)
    medium.broadcast(1, b"b", 2 * MS)
    assert medium.poll_timeout() == 3 * MS
    assert list(medium.arrivals(3 * MS - 1)) == []
    found = [tuple(each)[:5] for each in medium.arrivals(100 * MS)]
    assert found == [
        (3 * MS, 1, (0,), b"b", 2 * MS),
        (5 * MS, 0, (1,), b"a", 0),
        (5 * MS, 0, (2,), b"a", 0),
        (7 * MS, 1, (2,), b"b", 2 * MS),
    ]
    assert medium.poll_timeout() is None


def test_traffic_of_one_station_does_not_affect_frames_of_another() -> None:
    def received(*, others: bool) -> list[bytes]:
        medium = ImpairedMedium(3, quality=Impairment(loss=0.4), seed=11)
        for number in range(100):
            medium.broadcast(0, bytes([number]), number * MS)
            if others:
                medium.broadcast(1, b"noise", number * MS)
        return [each.octets for each in medium.arrivals(1000 * MS) if (each.sender, each.receivers) == (0, (2,))]

    assert received(others=True) == received(others=False)


def test_counters_balance_and_are_plain_data() -> None:
    medium = ImpairedMedium(3, quality=Impairment(loss=0.3, duplicate=0.2, delay=MS), seed=4, pairs=LINE)
    for number in range(300):
        medium.broadcast(number % 3, b"x", number * MS)
    assert list(medium.arrivals(10_000 * MS))
    found = json.loads(json.dumps(medium.directions()))
    assert sorted(found) == ["0>1", "1>0", "1>2", "2>1"]
    for each in found.values():
        assert each["offered"] == 100
        assert each["delivered"] == each["offered"] + each["duplicated"] - each["lost"] - each["down"]


@pytest.mark.parametrize(
    "wrong",
    [
        lambda medium: medium.set_quality(Impairment(), 0, 7),
        lambda medium: medium.set_quality(Impairment(), 0, 2),
        lambda medium: medium.partition([[0], [0]]),
        lambda medium: medium.partition([[9]]),
        lambda medium: medium.switch(-1, up=False),
        lambda medium: ImpairedMedium(2, pairs=[(0, 2)]),
    ],
)
def test_stations_that_do_not_exist_are_refused(wrong: object) -> None:
    with pytest.raises(ImpairmentError, match=r"station|link 0>2|partition"):
        wrong(ImpairedMedium(3, pairs=LINE))  # type: ignore[operator]
