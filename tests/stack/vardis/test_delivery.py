"""Values that do not reach neighbours are noticed, without false alarms."""

from __future__ import annotations

import json
import random
from typing import Any

import pytest

from dcp_codec.codec import get_codec
from dcp_stack.cli import status, var
from dcp_stack.config import NodeConfig
from dcp_stack.control.server import ControlServer
from dcp_stack.node import Node
from dcp_stack.vardis.delivery import ASKED_OFTEN, MOST_ENTRIES

from ..vardis_rig import ME, MS, OTHER, THIRD, WALL, Rig, VarReqCreate, VarReqUpdate, VarSumm

SECOND = 1000 * MS


def found(rig: Rig) -> list[str]:
    return [str(each) for each in rig.vardis.obstacles(rig.now)]


def test_a_neighbour_that_repeats_a_request_forever() -> None:
    rig = Rig()
    rig.create()
    rig.vardis.hears(OTHER)
    for _ in range(ASKED_OFTEN - 1):
        rig.receive(VarReqCreate(7))
    assert found(rig) == []
    rig.receive(VarReqCreate(7))
    assert found(rig) == [
        f"02:00:00:00:00:02 requested variable 7 {ASKED_OFTEN} times, and it was sent each time: "
        "its record is longer, or its repetition count higher, than that node accepts"
    ]
    # It has it after all.
    rig.receive(VarSumm(7, 0))
    assert found(rig) == []


def test_requests_of_several_neighbours_are_counted_separately() -> None:
    rig = Rig()
    rig.create()
    rig.update()
    for _ in range(ASKED_OFTEN - 1):
        for peer in (OTHER, THIRD):
            rig.vardis.hears(peer)
            rig.receive(VarReqUpdate(7, 0))
    assert found(rig) == []


def test_a_request_is_pending_until_the_neighbour_shows_the_value() -> None:
    rig = Rig()
    rig.create()
    delivery = rig.vardis._core.delivery
    rig.vardis.hears(OTHER)
    rig.receive(VarReqCreate(7))
    assert (delivery.asked_by(OTHER), delivery.asked_by(THIRD)) == (True, False)
    rig.receive(VarSumm(7, 0))
    assert not delivery.asked_by(OTHER)


def test_counters_are_bounded() -> None:
    rig = Rig()
    rig.create()
    for number in range(2 * MOST_ENTRIES):
        rig.vardis.hears(number.to_bytes(6, "big"))
        rig.receive(VarReqCreate(7))
    assert len(rig.vardis._core.delivery._asked) <= MOST_ENTRIES


def test_an_update_that_no_neighbour_confirms() -> None:
    rig = Rig()
    rig.create()
    rig.update()
    for _ in range(100):
        rig.wait(100)
        rig.receive(VarSumm(7, 0))
    assert found(rig) == [
        "variable 7: no summary of a neighbour has the update of 10 s ago, "
        "and 100 summaries have an older sequence number"
    ]
    rig.receive(VarSumm(7, 1))
    assert found(rig) == []


def test_updates_that_come_faster_than_their_confirmations() -> None:
    rig = Rig()
    rig.create()
    for number in range(300):
        rig.update(value=b"%d" % number)
        rig.wait(100)
        # The neighbour is always three updates late.
        rig.receive(VarSumm(7, max(0, number - 2) % 256))
        assert found(rig) == []


def test_without_neighbours_there_are_no_confirmations() -> None:
    rig = Rig()
    rig.create()
    rig.update()
    rig.wait(60_000)
    assert found(rig) == []


def test_a_variable_that_another_node_takes_over() -> None:
    rig = Rig()
    rig.create()
    rig.receive(rig.vc(prod_id=OTHER, created=WALL + SECOND))
    rig.receive(rig.vc(prod_id=OTHER, created=WALL + 2 * SECOND))
    assert found(rig) == [
        "variable 7: 02:00:00:00:00:02 has created it again and is its producer now; "
        "this node cannot update it any more"
    ]
    rig.vardis.shutdown()
    rig.vardis.start(rig.now, rig.wall)
    assert found(rig) == []


def test_a_deleted_variable_that_another_node_creates_is_not_taken_over() -> None:
    rig = Rig()
    rig.create()
    rig.delete()
    rig.receive(rig.vc(prod_id=OTHER, created=WALL + SECOND))
    assert found(rig) == []


@pytest.mark.req("VD-CRE-09")
def test_a_restart_with_a_clock_that_is_slow() -> None:
    rig = Rig()
    rig.receive(rig.vc(prod_id=ME, created=WALL + 3600 * SECOND))
    rig.create()
    assert rig.entry().spec.creation_time == WALL + 3600 * SECOND + 1
    assert found(rig) == []


@pytest.mark.req("VD-CRE-09")
def test_a_later_creation_that_is_heard_too_late() -> None:
    rig = Rig()
    rig.create()
    rig.receive(rig.vc(prod_id=ME, created=WALL + 3600 * SECOND))
    assert found(rig) == [
        "variable 7: other nodes have a creation with a later time and ignore this one; "
        "create it again, and check the clock"
    ]
    rig.delete()
    assert found(rig) == []
    rig.create()
    assert rig.entry().spec.creation_time == WALL + 3600 * SECOND + 1


@pytest.mark.req("VD-CRE-09")
def test_the_system_time_can_be_taken_literally() -> None:
    rig = Rig(readings={"X38": "system-clock"})
    rig.receive(rig.vc(prod_id=ME, created=WALL + 3600 * SECOND))
    rig.create()
    assert rig.entry().spec.creation_time == WALL


def test_own_repetitions_do_not_count_as_a_later_creation() -> None:
    rig = Rig()
    rig.create()
    rig.receive(rig.vc(prod_id=ME, created=rig.entry().spec.creation_time))
    assert found(rig) == []


def test_confirmations_of_foreign_variables_are_not_awaited() -> None:
    rig = Rig()
    rig.receive(rig.vc())
    for _ in range(200):
        rig.wait(100)
        rig.receive(VarSumm(7, 255))
    assert [each for each in rig.vardis.obstacles(rig.now) if each.kind == "unconfirmed"] == []


STATUS: dict[str, Any] = {
    "nodeId": "02:00:00:00:00:01",
    "profile": "dcp-2.0",
    "specVersion": "2.0",
    "node": {"bp": {"active": True, "next_seqno": 65, "clients": [], "counters": {"beacons-sent": 65}}},
    "drops": {},
    "obstacles": [{"kind": "superseded", "varId": 7, "text": "variable 7: others know a later creation"}],
    "runtime": {"link": {"name": "eth:dcp0", "up": False, "send_errors": 33, "outages": 1}},
}


def test_the_status_shows_undelivered_variables() -> None:
    lines = status._lines(STATUS)
    assert "link       eth:dcp0, DOWN, 33 send errors, 1 outage" in lines
    assert "beacons    32 sent (33 could not be sent), 0 received" in lines
    assert "undelivered variable 7: others know a later creation" in lines
    up = {**STATUS, "runtime": {"link": {"name": "eth:dcp0", "up": True}}, "obstacles": []}
    lines = status._lines(up)
    assert "link       eth:dcp0" in lines
    assert "beacons    65 sent, 0 received" in lines
    assert not any(line.startswith("undelivered") for line in lines)


def test_the_control_interface_reports_undelivered_variables() -> None:
    node = Node(NodeConfig(node_id=ME, codec=get_codec("dcp-2.0")), rng=random.Random(1), now=0, wall=WALL)
    node.start(0, WALL)
    assert node.vardis is not None
    node.vardis.create(7, None, 1, b"pos", b"1", now=0, wall=WALL)
    rig = Rig()
    node.vardis.handle_payload(rig.octets((rig.vc(prod_id=ME, created=WALL + 3600 * SECOND),)), now=0, wall=WALL)
    session = ControlServer(node).open()
    session.receive(b'{"jsonrpc":"2.0","id":1,"method":"UT-Status","params":{}}\n')
    session.process(now=0, wall=WALL)
    found = json.loads(bytes(session.output).splitlines()[0])["result"]["obstacles"]
    assert [(each["kind"], each["varId"]) for each in found] == [("superseded", 7)]
    assert "later time" in found[0]["text"]


class Answers:
    """The control interface of a node with a profile."""

    def __init__(self, profile: str, most: int) -> None:
        self.answers = {
            "VD-GetParameters": {"parameters": {"VARDISPAR_MAX_REPETITIONS": most}},
            "UT-Hello": {"profile": profile},
        }

    def call(self, method: str) -> dict[str, Any]:
        return self.answers[method]


@pytest.mark.parametrize(
    ("profile", "most", "expected"), [("dcp-2.0", 15, 3), ("dcp-2.0", 2, 2), ("cpp-2.0", 15, 1), ("mine.toml", 15, 3)]
)
def test_variables_get_as_many_repetitions_as_neighbours_accept(profile: str, most: int, expected: int) -> None:
    assert var._repetitions(Answers(profile, most)) == expected  # type: ignore[arg-type]


def test_more_repetitions_than_neighbours_accept_cause_a_warning() -> None:
    warnings = list(var._ignored_by_others(Answers("cpp-2.0", 15), "pos", 3))  # type: ignore[arg-type]
    assert warnings == [
        "unless configured otherwise, nodes of this profile refuse variables with more than 1 repetitions"
    ]
    assert list(var._ignored_by_others(Answers("dcp-2.0", 15), "pos", 3)) == []  # type: ignore[arg-type]
