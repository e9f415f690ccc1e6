"""Several stations: who hears whom, partitions, stations that are disconnected, and the counters."""

from __future__ import annotations

import json

import pytest

from dcp_codec.impairment import Impairment, ImpairmentError, Network

MS = 1_000_000
LINE = [(0, 1), (1, 0), (1, 2), (2, 1)]


def heard(network: Network, sender: int, now: int = 0) -> list[int]:
    network.broadcast(sender, b"x", now)
    return [transit.receiver for transit in network.due(now + 1000 * MS)]


def test_all_stations_hear_each_other_by_default() -> None:
    assert heard(Network(4), 1) == [0, 2, 3]
    assert [heard(Network(3, hears=LINE), sender) for sender in range(3)] == [[1], [0, 2], [1]]
    assert heard(Network(2, hears=[(0, 1)]), 1) == [], "one way"


def test_each_direction_has_a_quality_of_its_own() -> None:
    network = Network(3)
    network.set(Impairment(loss=1.0), 0, 1)
    assert heard(network, 0) == [2]
    assert heard(network, 1) == [0, 2]
    network.set(Impairment(loss=1.0))
    assert heard(network, 2) == [], "all that have none of their own"
    network.set(Impairment(), 0, 1)
    assert heard(network, 0) == [1]
    network.set(Impairment(), receiver=2)
    assert heard(network, 0) == [1, 2]


def test_frames_stay_within_their_group() -> None:
    network = Network(5)
    network.partition([[0, 1], [2]])
    assert [heard(network, sender) for sender in range(5)] == [[1], [0], [], [4], [3]]
    network.partition([])
    assert heard(network, 0) == [1, 2, 3, 4]
    network.partition([[0], [1]])
    network.heal()
    assert heard(network, 0) == [1, 2, 3, 4]


def test_a_disconnected_station_neither_hears_nor_is_heard() -> None:
    network = Network(3, default=Impairment(delay=5 * MS))
    network.broadcast(0, b"under way", 0)
    network.port(1, up=False)
    assert [each.receiver for each in network.due(5 * MS)] == [2]
    assert network.of(0, 1).down == 1
    assert heard(network, 1) == []
    network.port(1, up=True)
    assert heard(network, 0, 2000 * MS) == [1, 2]


def test_arrivals_come_in_the_order_of_time_then_of_sending() -> None:
    network = Network(3, default=Impairment(delay=5 * MS))
    network.set(Impairment(delay=1 * MS), 1, 0)
    network.broadcast(0, b"a", 0)
    network.broadcast(1, b"b", 2 * MS)
    assert network.poll_timeout() == 3 * MS
    assert network.due(3 * MS - 1) == []
    found = [(each.time, each.sender, each.receiver, each.octets, each.sent) for each in network.due(100 * MS)]
    assert found == [
        (3 * MS, 1, 0, b"b", 2 * MS),
        (5 * MS, 0, 1, b"a", 0),
        (5 * MS, 0, 2, b"a", 0),
        (7 * MS, 1, 2, b"b", 2 * MS),
    ]
    assert network.poll_timeout() is None


def test_traffic_of_one_station_does_not_affect_frames_of_another() -> None:
    def received(*, others: bool) -> list[bytes]:
        network = Network(3, default=Impairment(loss=0.4), seed=11)
        for number in range(100):
            network.broadcast(0, bytes([number]), number * MS)
            if others:
                network.broadcast(1, b"noise", number * MS)
        return [each.octets for each in network.due(1000 * MS) if (each.sender, each.receiver) == (0, 2)]

    assert received(others=True) == received(others=False)


def test_counters_balance_and_are_plain_data() -> None:
    network = Network(3, default=Impairment(loss=0.3, duplicate=0.2, delay=MS), seed=4, hears=LINE)
    for number in range(300):
        network.broadcast(number % 3, b"x", number * MS)
    network.due(10_000 * MS)
    found = json.loads(json.dumps(network.counters()))
    assert sorted(found) == ["0>1", "1>0", "1>2", "2>1"]
    for each in found.values():
        assert each["offered"] == 100
        assert each["delivered"] == each["offered"] + each["duplicated"] - each["lost"] - each["down"]


@pytest.mark.parametrize(
    "wrong",
    [
        lambda network: network.set(Impairment(), 0, 7),
        lambda network: network.set(Impairment(), 0, 2),
        lambda network: network.partition([[0], [0]]),
        lambda network: network.partition([[9]]),
        lambda network: network.port(-1, up=False),
        lambda network: Network(2, hears=[(0, 2)]),
    ],
)
def test_stations_that_do_not_exist_are_refused(wrong: object) -> None:
    with pytest.raises(ImpairmentError, match=r"station|link 0>2|partition"):
        wrong(Network(3, hears=LINE))  # type: ignore[operator]
