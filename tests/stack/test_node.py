"""The node as a whole: entities together, in virtual time."""

from __future__ import annotations

import random

import pytest
from dcp_spec.profile.loading import load_profile, profile_names
from dcp_spec.status import BPStatus
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec import Codec
from dcp_codec.values import Beacon, BPHeader, Payload
from dcp_stack.config import NodeConfig, SRPConfig
from dcp_stack.effects import Dropped, NeighbourSeen, PayloadReceived, PayloadTransmitted, SendBeacon, VariableChanged
from dcp_stack.node import Node

from ..chance import examples

WALL = 1_795_225_151_000_000_000
MS = 1_000_000
#: A profile without a beacon header has no sender for a node to be.
PROFILES = [name for name in profile_names() if name != "student-2024"]


def node_id(number: int) -> bytes:
    return bytes((2, 0, 0, 0, 0, number))


class Pair:
    """Two nodes that hear each other, and what each of them did."""

    def __init__(self, profile: str = "dcp-2.0", **config: object) -> None:
        self.codec = Codec(profile)
        self.now = 0
        if self.codec.report_plan is None:
            # The profile has no octets for state reports.
            config.setdefault("srp", None)
        self.nodes = [
            Node(
                NodeConfig(node_id=node_id(number), codec=self.codec, **config),
                rng=random.Random(number),
                now=0,
                wall=WALL,
            )
            for number in (1, 2)
        ]
        self.effects: list[list] = [[], []]
        for index, node in enumerate(self.nodes):
            node.start(0, WALL)
            self.take(index)

    @property
    def wall(self) -> int:
        return WALL + self.now

    def take(self, index: int) -> None:
        for effect in self.nodes[index].take_effects():
            self.effects[index].append(effect)
            if isinstance(effect, SendBeacon):
                self.nodes[1 - index].handle_frame(effect.octets, now=self.now, wall=self.wall)
                self.take(1 - index)

    def run(self, ms: int) -> None:
        end = self.now + ms * MS
        while True:
            due = [when for node in self.nodes if (when := node.poll_timeout()) is not None]
            if not due or min(due) > end:
                break
            self.now = max(self.now, min(due))
            for index, node in enumerate(self.nodes):
                node.handle_timeout(self.now, self.wall)
                self.take(index)
        self.now = end

    def settle(self, index: int) -> None:
        self.nodes[index].settle(self.now, self.wall)
        self.take(index)


@pytest.mark.parametrize("profile", PROFILES)
def test_a_variable_reaches_the_other_node(profile):
    pair = Pair(profile)
    first, second = pair.nodes
    assert first.vardis.create(7, None, 2, b"pos", b"ABCD", 0, now=0, wall=WALL).status.is_ok
    pair.settle(0)
    pair.run(1000)
    read = second.vardis.read(7)
    assert read.status.is_ok
    assert read.value == b"ABCD"
    assert any(isinstance(e, VariableChanged) and e.event == "created" for e in pair.effects[1])
    first.vardis.update(7, b"EFGHI", now=pair.now, wall=pair.wall)
    pair.settle(0)
    pair.run(1000)
    assert second.vardis.read(7).value == b"EFGHI"
    first.vardis.delete(7, now=pair.now, wall=pair.wall)
    pair.settle(0)
    pair.run(1000)
    assert not second.vardis.read(7).status.is_ok


@pytest.mark.parametrize("profile", [name for name in PROFILES if load_profile(name).srp.is_report])
def test_a_state_report_reaches_the_other_node(profile):
    pair = Pair(profile)
    data = {member.name: 1 for member in pair.codec.profile.srp.safety_data}
    assert pair.nodes[0].srp.update_safety_data(data, now=0, wall=WALL).status.is_ok
    pair.settle(0)
    pair.run(500)
    assert [e.node_id for e in pair.effects[1] if isinstance(e, NeighbourSeen)][:1] == [node_id(1)]
    assert not [e for e in pair.effects[0] if isinstance(e, NeighbourSeen)]


@pytest.mark.req("BP-FMT-03")
def test_a_node_with_nothing_to_say_is_silent():
    pair = Pair()
    pair.run(5000)
    assert pair.effects == [[], []]


def test_indications_for_clients_of_our_own_are_handled_inside():
    pair = Pair()
    pair.nodes[0].vardis.create(1, None, 1, b"d", b"v", 0, now=0, wall=WALL)
    pair.settle(0)
    pair.run(500)
    assert not [e for side in pair.effects for e in side if isinstance(e, PayloadReceived)]
    assert not [e for side in pair.effects for e in side if isinstance(e, Dropped) and e.layer == "bp"]


@pytest.mark.req("BP-INI-01", "BP-INI-02")
def test_reset_is_the_state_after_start():
    pair = Pair()
    node = pair.nodes[0]
    fresh = node.snapshot()
    node.vardis.create(1, None, 1, b"d", b"v", 0, now=0, wall=WALL)
    pair.settle(0)
    pair.run(1000)
    assert node.snapshot()["vardis"] != fresh["vardis"]
    node.reset(pair.now, pair.wall)
    assert not node.vardis.describe_database().variables
    assert [registration.protocol_id for registration in node.bp.list_registered().protocols] == [1, 2]
    node.vardis.create(1, None, 1, b"d", b"v", 0, now=pair.now, wall=pair.wall)
    pair.effects[0].clear()
    pair.settle(0)
    pair.run(300)
    assert next(e.seqno for e in pair.effects[0] if isinstance(e, SendBeacon)) == 0


@pytest.mark.req("SRP-SHD-01", "VD-SHD-02")
def test_shutdown_deregisters_all_clients():
    pair = Pair()
    pair.nodes[0].shutdown(0, WALL)
    assert not pair.nodes[0].bp.list_registered().protocols


def test_initial_safety_data_is_submitted():
    pair = Pair(srp=SRPConfig(safety_data={"x": 1.0, "y": 2.0, "z": 3.0}))
    pair.run(300)
    assert any(isinstance(e, NeighbourSeen) for e in pair.effects[1])


def test_a_node_without_clients_runs():
    pair = Pair(srp=None, vardis=None)
    pair.run(500)
    assert pair.nodes[0].srp is None
    assert pair.effects == [[], []]


def register(pair, prot_id):
    """Register a client outside the node at its BP, and submit a payload."""
    bp = pair.nodes[0].bp
    confirm = bp.register(prot_id, "another", 100, "BP_QMODE_ONCE", 1, False, now=pair.now, wall=pair.wall)
    assert confirm.status is BPStatus.OK
    assert bp.transmit_payload(prot_id, b"theirs", now=pair.now).status is BPStatus.OK
    pair.settle(0)


def hear(pair, prot_id, payload=b"whatever"):
    codec = pair.codec
    header = BPHeader(node_id(2), 0, network_id=codec.profile.bp.network_id)
    pair.nodes[0].handle_frame(
        codec.encode_envelope(Beacon(header, (Payload(prot_id, payload),))), now=pair.now, wall=pair.wall
    )
    pair.take(0)


def seen_by_clients(pair):
    return [e for e in pair.effects[0] if isinstance(e, PayloadReceived | PayloadTransmitted)]


@pytest.mark.req("BP-RXP-03")
@pytest.mark.parametrize("prot_id", [1, 2])
def test_the_numbers_of_srp_and_vardis_are_free_where_the_node_runs_without_them(prot_id):
    pair = Pair(srp=None, vardis=None)
    register(pair, prot_id)
    hear(pair, prot_id)
    pair.run(300)
    received, transmitted = seen_by_clients(pair)
    assert received == PayloadReceived(prot_id, b"whatever", node_id(2))
    assert isinstance(transmitted, PayloadTransmitted)
    assert transmitted.protocol_id == prot_id


@pytest.mark.req("BP-RXP-03", "BP-DRG-04", "BP-REG-10")
@pytest.mark.parametrize("prot_id", [1, 2])
def test_a_client_that_takes_the_number_of_srp_or_vardis_gets_its_payloads(prot_id):
    pair = Pair()
    node = pair.nodes[0]
    # Both have something to say, all the time.
    node.vardis.create(7, None, 1, b"pos", b"ABCD", 0, now=0, wall=WALL)
    node.srp.update_safety_data({"x": 1, "y": 2, "z": 3}, now=0, wall=WALL)
    assert node.bp.deregister(prot_id).status is BPStatus.OK
    register(pair, prot_id)
    hear(pair, prot_id)
    assert seen_by_clients(pair) == [PayloadReceived(prot_id, b"whatever", node_id(2))]
    assert not [e for e in pair.effects[0] if isinstance(e, Dropped)]
    for _ in range(3):
        node.srp.update_safety_data({"x": 1, "y": 2, "z": 3}, now=pair.now, wall=pair.wall)
        pair.settle(0)
        pair.run(100)
    # The payload of the new client is sent, and none of the old one under its number.
    sent = [
        block.data
        for e in pair.effects[0]
        if isinstance(e, SendBeacon)
        for block in pair.codec.decode_envelope(e.octets)[0].payloads
        if block.protocol_id == prot_id
    ]
    assert sent == [b"theirs"]
    transmitted = [e.protocol_id for e in seen_by_clients(pair) if isinstance(e, PayloadTransmitted)]
    assert transmitted == [prot_id]


@pytest.mark.req("SRP-INI-04", "VD-INI-03")
@pytest.mark.parametrize("prot_id", [1, 2])
def test_srp_and_vardis_regain_their_number_when_they_restart(prot_id):
    pair = Pair()
    node = pair.nodes[0]
    node.bp.deregister(prot_id)
    register(pair, prot_id)
    {1: node.srp, 2: node.vardis}[prot_id].start(pair.now, pair.wall)
    hear(pair, prot_id)
    assert not seen_by_clients(pair)
    reasons = [e.reason for e in pair.effects[0] if isinstance(e, Dropped)]
    assert reasons == [{1: "wrong-length", 2: "unknown-type"}[prot_id]]


@settings(max_examples=examples(60))
@given(frames=st.lists(st.binary(max_size=200), max_size=8), profile=st.sampled_from(PROFILES))
def test_no_octets_raise(frames, profile):
    pair = Pair(profile)
    for octets in frames:
        pair.nodes[0].handle_frame(octets, now=pair.now, wall=pair.wall)
        pair.take(0)
    pair.run(200)
    assert all(isinstance(e, Dropped) for e in pair.effects[0])
