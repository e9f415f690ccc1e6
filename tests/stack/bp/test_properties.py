"""BP against a simple model of its queues, and against octets of every kind."""

from __future__ import annotations

import pytest
from dcp_lab.testing import strategies
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.reasons import REASONS
from dcp_spec.status import BPStatus
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from dcp_codec.codec import get_codec
from dcp_stack.drops import DROPS
from dcp_stack.effects import Dropped, PayloadReceived

from ...parts import every
from ..bp_rig import DROPHEAD, DROPTAIL, ME, MS, OK, ONCE, OTHER, PROFILES, QUEUE, REPEAT, Rig

CLIENTS = (1, 2, 3, 4, 5)
PROTOCOLS = st.sampled_from(CLIENTS)
SIZES = (0, 1, 5, 60, 99, 100, 101)
LIMITS = (60, 104, 130, 240, 400, 1500)


class Kept:
    """State of a client in the model: a list, and operations on it."""

    def __init__(self, mode, entries, several):
        self.mode = mode
        self.places = {QUEUE: None, ONCE: 1, REPEAT: 1}.get(mode, entries)
        self.several = several and mode in (DROPTAIL, DROPHEAD)
        self.payloads = []

    def submit(self, payload):
        if self.places is not None and len(self.payloads) == self.places:
            if self.mode is DROPTAIL:
                return
            del self.payloads[0]
        self.payloads.append(payload)


class Queues(RuleBasedStateMachine):
    """Service requests and beacons in any order. Each payload is unique, so nothing can be mistaken for another."""

    @initialize(
        version=st.sampled_from(("1.0", "1.1", "1.2", "2.0")),
        reading=st.sampled_from(("with-header", "with-header", "blocks-only")),
        triggered=st.booleans(),
        seed=st.integers(0, 100),
    )
    def start(self, version, reading, triggered, seed):
        self.rig = Rig(version, readings={"X04": reading}, triggered=triggered, seed=seed)
        self.version = version
        self.limit = 1500
        self.counts_header = reading == "with-header"
        self.clients = {}
        self.active = True
        self.seqno = 1 if version == "1.0" else 0
        self.serial = 0
        # Number of beacons with other clients' payloads for which a client that fits alone has waited.
        self.waited = dict.fromkeys(CLIENTS, 0)

    @property
    def room(self):
        return self.limit - self.rig.header if self.counts_header else min(self.limit, 1500 - self.rig.header)

    @rule(
        protocol=PROTOCOLS,
        mode=st.sampled_from((DROPTAIL, DROPHEAD, ONCE, REPEAT)),
        entries=st.integers(0, 4),
        several=st.booleans(),
    )
    def register(self, protocol, mode, entries, several):
        if self.version == "1.0" and mode in (DROPTAIL, DROPHEAD):
            mode = QUEUE
        status = self.rig.register(protocol, mode, size=100, entries=entries, several=several).status
        if protocol in self.clients:
            assert status is BPStatus.PROTOCOL_ALREADY_REGISTERED
        elif self.limit - 4 - (4 if self.version == "1.0" else self.rig.header) < 100:
            assert status is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
        elif mode in (DROPTAIL, DROPHEAD) and entries == 0:
            assert status is BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE
        else:
            assert status is OK
            self.clients[protocol] = Kept(mode, entries, several and self.version != "1.0")
            self.waited[protocol] = 0

    @rule(protocol=PROTOCOLS)
    def deregister(self, protocol):
        known = self.clients.pop(protocol, None)
        assert self.rig.bp.deregister(protocol).status is (BPStatus.UNKNOWN_PROTOCOL if known is None else OK)

    @rule(protocol=PROTOCOLS, size=st.sampled_from(SIZES))
    def submit(self, protocol, size):
        self.serial += 1
        payload = (self.serial.to_bytes(4) * 26)[:size] if size >= 4 else bytes(size)
        if size in (1, 5):
            payload = bytes([self.serial % 256]) * size
        status = self.rig.submit(payload, protocol)
        client = self.clients.get(protocol)
        if client is None:
            assert status is BPStatus.UNKNOWN_PROTOCOL
        elif size > 100:
            assert status is BPStatus.PAYLOAD_TOO_LARGE
        elif size == 0 and self.version == "1.0" and client.mode is not QUEUE:
            assert status is OK
            client.payloads.clear()
        elif size == 0:
            assert status is BPStatus.EMPTY_PAYLOAD
        else:
            assert status is OK
            client.submit(payload)

    @precondition(lambda self: self.version != "1.0")
    @rule(protocol=PROTOCOLS)
    def clear(self, protocol):
        client = self.clients.get(protocol)
        assert self.rig.bp.clear_buffer(protocol).status is (BPStatus.UNKNOWN_PROTOCOL if client is None else OK)
        if client is not None:
            client.payloads.clear()

    @rule(limit=st.sampled_from(LIMITS))
    def set_limit(self, limit):
        assert self.rig.bp.set_parameter("BPPAR_MAXIMUM_PACKET_SIZE", limit) is None
        self.limit = limit

    @precondition(lambda self: self.version >= "1.2")
    @rule(active=st.booleans())
    def switch(self, active):
        assert (self.rig.bp.activate(self.rig.now) if active else self.rig.bp.deactivate()).status is OK
        self.active = active

    @rule(later=st.integers(0, 30 * MS))
    def wait(self, later):
        self.rig.now += later
        due = self.rig.bp.poll_timeout()
        if due is None or self.rig.now < due:
            before = len(self.rig.effects)
            self.rig.bp.handle_timeout(self.rig.now, 0)
            assert len(self.rig.effects) == before

    @rule(late=st.integers(0, 300 * MS))
    def beacon(self, late):
        if not self.active:
            assert self.rig.bp.poll_timeout() is None
            return
        fitting = {
            protocol
            for protocol, client in self.clients.items()
            if client.payloads and len(client.payloads[0]) + 4 <= self.room
        }
        beacon = self.rig.beacon(late)
        assert self.rig.bp.poll_timeout() > self.rig.now
        if beacon is None:
            assert not fitting
            return
        self.check(beacon)
        served = {block.protocol_id for block in beacon.payloads}
        assert served <= fitting
        for protocol in CLIENTS:
            self.waited[protocol] = self.waited[protocol] + 1 if protocol in fitting - served else 0
        # A client that was skipped has a better position next time.
        assert max(self.waited.values()) < len(CLIENTS)

    def check(self, beacon):
        sent = self.rig.sent()[-1]
        assert beacon.bp.seqno == sent.seqno == self.seqno
        self.seqno += 1
        assert len(sent.octets) - self.rig.header <= self.room
        assert len(sent.octets) <= 1500
        assert sent.num_payloads == len(beacon.payloads) > 0
        left = self.room
        count = dict.fromkeys(CLIENTS, 0)
        for block in beacon.payloads:
            client = self.clients[block.protocol_id]
            # First in, first out: it is the oldest one, and it is not there a second time.
            assert block.content == client.payloads[0]
            if client.mode is not REPEAT:
                del client.payloads[0]
            count[block.protocol_id] += 1
            left -= 4 + len(block.content)
        for protocol, client in self.clients.items():
            assert count[protocol] <= 1 or client.several
            # A payload that was not sent had no room, or its client had its turn.
            if client.payloads and (count[protocol] == 0 or client.several):
                assert len(client.payloads[0]) + 4 > left
        announced = [effect.protocol_id for effect in self.rig.transmitted()[-len(beacon.payloads) :]]
        assert announced == [block.protocol_id for block in beacon.payloads]

    @invariant()
    def numbers(self):
        listed = [entry.protocol_id for entry in self.rig.bp.list_registered().protocols]
        assert sorted(listed) == sorted(self.clients)
        for protocol, client in self.clients.items():
            assert self.rig.number(protocol) == len(client.payloads)
        assert all(effect.seqno < self.seqno for effect in self.rig.sent())


TestQueues = pytest.mark.req("BP-QM-03")(Queues.TestCase)


# -- octets of every kind -----------------------------------------------------------------------------------------


def listening(profile, **settings):
    rig = Rig(profile=profile, node_id=b"02:00:00:00:00:01" if profile == "student-2024" else ME, **settings)
    for protocol in (1, 2):
        rig.register(protocol, ONCE)
    return rig


def survives(rig, octets):
    """Octets raise nothing, have consequences of the known kinds only, and the next good beacon is processed."""
    delivered, dropped = rig.receive(octets)
    assert all(protocol in (1, 2) and payload in octets for protocol, payload in delivered)
    for effect in dropped:
        assert effect.layer == "bp"
        assert effect.reason in REASONS or effect.reason in DROPS
        assert effect.requirement in requirements()
        assert -1 <= effect.offset <= len(octets)
    assert rig.receive(rig.builder((1, b"good"))) == ([(1, b"good")], [])


READINGS = st.sampled_from(("length-field", "frame-size"))


@pytest.mark.req("BP-RX-16")
@pytest.mark.parametrize("profile", every(4, PROFILES))
@given(octets=st.binary(max_size=80), reading=READINGS)
@example(octets=b"", reading="length-field")
@example(octets=b"", reading="frame-size")
def test_any_octets(profile, octets, reading):
    survives(listening(profile, readings={"X02": reading}), octets)


@pytest.mark.req("BP-RX-16")
@pytest.mark.req("BP-RX-09")
@pytest.mark.parametrize("profile", every(4, PROFILES))
@given(data=st.data(), reading=READINGS)
def test_damaged_beacons(profile, data, reading):
    codec = get_codec(profile)
    rig = listening(profile, readings={"X02": reading})
    good = st.lists(st.tuples(st.sampled_from((1, 2, 99)), st.binary(max_size=30)), min_size=1, max_size=4).map(
        lambda blocks: rig.builder(*blocks)
    )
    survives(rig, data.draw(strategies.mutations(good, codec.dissect)))


@pytest.mark.parametrize("profile", every(4, PROFILES))
@given(data=st.data())
def test_every_envelope_of_another_node_is_delivered(profile, data):
    codec = get_codec(profile)
    rig = listening(profile)
    envelope = data.draw(strategies.envelopes(codec))
    delivered, dropped = rig.receive(codec.encode_envelope(envelope))
    expected = [(block.protocol_id, block.content) for block in envelope.payloads]
    own = rig.bp.parameters().get("BPPAR_NETWORK_ID")
    if envelope.bp is not None and (envelope.bp.sender_id == ME or (own is not None and envelope.bp.network_id != own)):
        assert (delivered, len(dropped)) == ([], 1)
        assert dropped[0].reason in ("foreign-network", "own-beacon")
        return
    assert delivered == [block for block in expected if block[0] in (1, 2)]
    assert len(dropped) == len(envelope.payloads) - len(delivered)


@pytest.mark.req("BP-RX-14")
@given(padding=st.binary(min_size=1, max_size=60), blocks=st.lists(st.binary(min_size=1, max_size=20), max_size=5))
@pytest.mark.parametrize("profile", every(4, [profile for profile in PROFILES if profile != "student-2024"]))
def test_any_padding_is_ignored(profile, padding, blocks):
    rig = listening(profile)
    blocks = [(1, block) for block in (b"first", *blocks)]
    assert rig.receive(rig.builder(*blocks) + padding) == (blocks, [])


def test_nothing_that_is_received_is_answered():
    rig = listening("dcp-2.0")
    rig.receive(rig.builder((1, b"A"), sender=OTHER))
    assert rig.tick() is None
    assert all(isinstance(effect, PayloadReceived | Dropped) for effect in rig.effects)
