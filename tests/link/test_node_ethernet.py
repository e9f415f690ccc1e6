"""``dcp-node`` on a virtual cable: frames, rates, and an interface that goes and comes back."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ..waiting import PATIENCE, eventually
from .node_processes import NodeProcess, keeps_rate


@pytest.fixture
def pair(namespace, tmp_path):
    """Two nodes, one at each end of the cable, that beacon every 20 ms."""
    options = ("--position", "track:circle,rate=100", "--beacon-period", "20")
    nodes = [
        NodeProcess(tmp_path, number, *options, link=f"eth:{end}", namespace=namespace.name)
        for number, end in enumerate(("near", "far"), 1)
    ]
    yield nodes
    for node in nodes:
        node.end()


def test_two_nodes_keep_their_period_and_hear_each_other(pair):
    first, second = (node.client() for node in pair)
    with first, second:
        eventually(lambda: second.call("SRP-NeighbourTable")["neighbours"], "the neighbour is seen")
        before = first.call("UT-Status")
        # 2 % are asked for (200 intervals of 10 % jitter: standard deviation 0.4 %), and a beacon at each edge.
        after = keeps_rate(first, before, 50, rel=0.03, seconds=4)
        last = after["node"]["bp"]["next_seqno"] - 1

        def heard() -> dict:
            (found,) = second.call("UT-Status")["node"]["bp"]["losses"]
            return found if found["seqno"] >= last else {}

        found = eventually(heard, "the last beacon arrives")
        assert (found["lost"], found["repeated"], found["restarts"]) == (0, 0, 0)
        assert found["received"] >= last - before["node"]["bp"]["next_seqno"]
        assert first.call("RTDB-Create", varId=1, repCnt=3, descr="x", value="0a")["status"] == "VARDIS-STATUS-OK"
        eventually(lambda: second.call("RTDB-Read", varId=1).get("value") == "0a", "the variable arrives")


def test_an_interface_that_carries_too_little_is_named(namespace):
    namespace.ip("link", "set", "near", "mtu", "68")
    run = [sys.executable, "-m", "dcp_stack.cli", "run", "--interface", "near"]
    shown = subprocess.run(
        ["ip", "netns", "exec", namespace.name, *run], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert shown.returncode == 2
    assert "(beacons of at most 68 octets, the maximum of eth:near)" in shown.stderr


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
