"""``dcp-node`` on a virtual cable: frames, rates, and an interface that goes and comes back."""

from __future__ import annotations

import time

import pytest

from .node_processes import NodeProcess, eventually


@pytest.fixture
def pair(namespace, tmp_path):
    """Two nodes, one at each end of the cable."""
    nodes = [
        NodeProcess(tmp_path, 1, "--position", "track:circle,rate=40", link="eth:near", namespace=namespace.name),
        NodeProcess(tmp_path, 2, "--position", "track:circle,rate=40", link="eth:far", namespace=namespace.name),
    ]
    yield nodes
    for node in nodes:
        node.end()


def test_two_nodes_beacon_at_10_hz_and_hear_each_other(pair):
    first, second = (node.client() for node in pair)
    with first, second:
        eventually(lambda: second.call("SRP-NeighbourTable")["neighbours"], "the neighbour is seen")
        before = second.call("UT-Status")
        time.sleep(20)
        after = second.call("UT-Status")
        assert first.call("RTDB-Create", varId=1, repCnt=3, descr="x", value="0a")["status"] == "VARDIS-STATUS-OK"
        eventually(lambda: second.call("RTDB-Read", varId=1).get("value") == "0a", "the variable arrives")
    seconds = (after["now"] - before["now"]) / 1e9
    for counter in ("beacons-sent", "beacons-received"):
        beacons = after["node"]["bp"]["counters"][counter] - before["node"]["bp"]["counters"][counter]
        # 2 % are asked for (200 intervals of 10 % jitter: standard deviation 0.4 %), and a beacon at each edge.
        assert beacons / seconds == pytest.approx(10, rel=0.03)


def test_an_interface_that_goes_and_comes_back_does_not_silence_a_node(pair, namespace):
    first, second = (node.client() for node in pair)
    with first, second:
        eventually(lambda: second.call("SRP-NeighbourTable")["neighbours"], "the neighbour is seen")
        namespace.ip("link", "set", "near", "down")
        eventually(lambda: first.call("UT-Status")["runtime"]["link"]["outages"] == 1, "the outage is noticed")
        eventually(lambda: not second.call("SRP-NeighbourTable")["neighbours"], "the neighbour is forgotten")
        namespace.ip("link", "set", "near", "up")
        eventually(lambda: second.call("SRP-NeighbourTable")["neighbours"], "the neighbour is back")
        eventually(lambda: first.call("SRP-NeighbourTable")["neighbours"], "and hears again")
