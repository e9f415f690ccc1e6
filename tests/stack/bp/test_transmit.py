"""Beacons that BP sends: header, queueing modes, space, and the order of serving."""

from __future__ import annotations

import msgspec
import pytest
from dcp_spec.constants import BP_MAX_PAYLOADS

from dcp_codec.codec import Codec, get_codec
from dcp_stack.effects import PayloadTransmitted, SendBeacon

from ..bp_rig import DROPHEAD, DROPTAIL, ME, ONCE, PROFILES, QUEUE, REPEAT, SINCE_1_1, VERSIONS, Rig

HEADERS = {
    "1.0": "497e 020000000001 01 01 00000001",
    "1.1": "01 497e 020000000001 01 00000000",
    "1.2": "01 497e 020000000001 0008 01 00000000",
    "1.3": "01 497e 020000000001 0008 01 00000000",
    "2.0": "01 497e 020000000001 1111 0008 01 00000000",
}


def queue_of(version):
    return QUEUE if version == "1.0" else DROPTAIL


# -- octets -------------------------------------------------------------------------------------------------------


@pytest.mark.req("BP-HDR-01")
@pytest.mark.req("BP-HDR-02")
@pytest.mark.req("BP-HDR-03")
@pytest.mark.req("BP-HDR-04")
@pytest.mark.req("BP-HDR-05")
@pytest.mark.req("BP-HDR-06")
@pytest.mark.req("BP-HDR-07")
@pytest.mark.req("BP-HDR-10")
@pytest.mark.req("BP-HDR-11")
@pytest.mark.req("BP-FMT-01")
@pytest.mark.req("BP-INI-02")
@pytest.mark.req("DATA-01")
@pytest.mark.req("DATA-02")
@pytest.mark.req("DATA-03")
@pytest.mark.req("UWB-04")
@pytest.mark.parametrize("version", VERSIONS)
def test_the_octets_of_the_first_beacon(version):
    rig = Rig(version)
    rig.register(1, ONCE)
    rig.submit(b"ABCD", 1)
    rig.tick()
    (sent,) = rig.sent()
    assert sent.octets == bytes.fromhex(HEADERS[version] + "0001 0004 41424344")
    assert (sent.num_payloads, sent.seqno) == (1, 1 if version == "1.0" else 0)


@pytest.mark.req("BP-HDR-06")
@pytest.mark.req("BP-HDR-07")
@pytest.mark.req("BP-FMT-01")
def test_several_blocks_follow_without_gaps():
    rig = Rig()
    rig.register(1, ONCE)
    rig.register(2, ONCE)
    rig.submit(b"A", 1)
    rig.submit(b"BCD", 2)
    rig.tick()
    octets = rig.sent()[0].octets
    assert octets[18:] == bytes.fromhex("0001 0001 41 0002 0003 424344")
    assert int.from_bytes(octets[rig.field("length")]) == 12
    assert octets[rig.field("numPayloads")] == b"\2"


@pytest.mark.req("BP-HDR-08")
@pytest.mark.parametrize(
    ("version", "readings", "first"),
    [
        *((version, {}, 1 if version == "1.0" else 0) for version in VERSIONS),
        *((version, {"X03": "increment-then-write"}, 1) for version in VERSIONS),
    ],
)
def test_sequence_numbers(version, readings, first):
    rig = Rig(version, readings=readings)
    rig.register(7, REPEAT)
    rig.submit(b"A")
    assert [rig.beacon().bp.seqno for _ in range(5)] == list(range(first, first + 5))
    assert [effect.seqno for effect in rig.sent()] == list(range(first, first + 5))


@pytest.mark.req("BP-HDR-08")
def test_sequence_numbers_wrap():
    rig = Rig()
    rig.bp._seqno = (1 << 32) - 2
    rig.register(7, REPEAT)
    rig.submit(b"A")
    assert [rig.beacon().bp.seqno for _ in range(4)] == [(1 << 32) - 2, (1 << 32) - 1, 0, 1]


@pytest.mark.req("BP-HDR-09")
@pytest.mark.req("BP-FMT-03")
@pytest.mark.parametrize("version", VERSIONS)
def test_an_empty_slot_uses_no_beacon_and_no_number(version):
    rig = Rig(version)
    assert [rig.tick() for _ in range(3)] == [None] * 3
    rig.register(7, ONCE)
    assert [rig.tick() for _ in range(3)] == [None] * 3
    numbers = []
    for _ in range(3):
        rig.submit(b"A")
        numbers.append(rig.beacon().bp.seqno)
        assert [rig.tick() for _ in range(4)] == [None] * 4
    assert numbers == list(range(numbers[0], numbers[0] + 3))


@pytest.mark.req("BP-PAR-09")
@pytest.mark.req("DATA-04")
@pytest.mark.parametrize("node_id", [ME, bytes(6), b"\xff" * 6])
def test_the_sender_is_always_the_own_node(node_id):
    rig = Rig(node_id=node_id)
    rig.register(7, REPEAT)
    rig.submit(b"A")
    assert {rig.beacon().bp.sender_id for _ in range(5)} == {node_id}
    assert rig.bp.parameters()["ownNodeIdentifier"] == node_id


@pytest.mark.parametrize("profile", PROFILES)
def test_every_profile_reads_what_its_node_sends(profile):
    node_id = b"02:00:00:00:00:01" if profile == "student-2024" else ME
    rig = Rig(profile=profile, node_id=node_id)
    other = Rig(profile=profile, node_id=node_id[::-1])
    for each in (rig, other):
        each.register(1, ONCE)
        each.register(2, REPEAT)
    rig.submit(b"report", 1)
    rig.submit(b"containers", 2)
    rig.tick()
    delivered, dropped = other.receive(rig.sent()[0].octets)
    assert (delivered, dropped) == ([(1, b"report"), (2, b"containers")], [])
    assert other.effects[0].sender_id == (node_id if rig.header else b"")


# -- queueing modes -----------------------------------------------------------------------------------------------


@pytest.mark.req("BP-QM-01")
@pytest.mark.parametrize("version", SINCE_1_1)
def test_droptail_discards_the_newest(version):
    rig = Rig(version)
    rig.register(7, DROPTAIL, entries=2)
    for payload in (b"A", b"B", b"C"):
        rig.submit(payload)
    assert rig.contents(3) == [b"A", b"B", None]


@pytest.mark.req("BP-QM-02")
@pytest.mark.parametrize("version", SINCE_1_1)
def test_drophead_displaces_the_oldest(version):
    rig = Rig(version)
    rig.register(7, DROPHEAD, entries=2)
    for payload in (b"A", b"B", b"C"):
        rig.submit(payload)
    assert rig.contents(3) == [b"B", b"C", None]


@pytest.mark.req("BP-QM-03")
@pytest.mark.req("DATA-12")
@pytest.mark.parametrize(
    ("version", "mode"), [("1.0", QUEUE), *((v, m) for v in SINCE_1_1 for m in (DROPTAIL, DROPHEAD))]
)
def test_queues_send_everything_once_and_in_order(version, mode):
    rig = Rig(version)
    rig.register(7, mode, entries=300)
    payloads = [index.to_bytes(2) for index in range(300)]
    for payload in payloads:
        rig.submit(payload)
    assert rig.contents(301) == [*payloads, None]


@pytest.mark.req("BP-QM-04")
@pytest.mark.parametrize("version", VERSIONS)
def test_once(version):
    rig = Rig(version)
    rig.register(7, ONCE)
    rig.submit(b"A")
    rig.submit(b"B")
    assert rig.contents(3) == [b"B", None, None]


@pytest.mark.req("BP-QM-05")
@pytest.mark.req("BP-TX-05")
@pytest.mark.parametrize("version", VERSIONS)
def test_repeat(version):
    rig = Rig(version)
    rig.register(7, REPEAT)
    rig.submit(b"A")
    assert rig.contents(5) == [b"A"] * 5
    rig.submit(b"B")
    assert rig.contents(3) == [b"B"] * 3


@pytest.mark.req("BP-QM-07")
@pytest.mark.parametrize("version", VERSIONS)
def test_one_payload_of_a_client_per_beacon(version):
    rig = Rig(version)
    # In 1.0 there is no such parameter, and one payload is always the limit.
    rig.register(7, queue_of(version), entries=3, several=version == "1.0")
    for payload in (b"A", b"B", b"C"):
        rig.submit(payload)
    assert rig.contents(4) == [b"A", b"B", b"C", None]


@pytest.mark.req("BP-QM-08")
@pytest.mark.parametrize("mode", [DROPTAIL, DROPHEAD])
@pytest.mark.parametrize("version", SINCE_1_1)
def test_several_payloads_of_a_client_share_a_beacon(version, mode):
    rig = Rig(version)
    rig.register(7, mode, entries=3, several=True)
    for payload in (b"A", b"B", b"C"):
        rig.submit(payload)
    assert rig.tick() == [(7, b"A"), (7, b"B"), (7, b"C")]
    assert rig.tick() is None


@pytest.mark.parametrize("mode", [ONCE, REPEAT])
def test_buffers_ignore_several_payloads_per_beacon(mode):
    rig = Rig()
    rig.register(7, mode, several=True)
    rig.submit(b"A")
    assert rig.tick() == [(7, b"A")]


# -- BP-PayloadTransmitted ----------------------------------------------------------------------------------------


@pytest.mark.req("BP-PTI-01")
@pytest.mark.req("BP-PTI-02")
@pytest.mark.parametrize("version", VERSIONS)
def test_indications_follow_their_beacon_in_the_order_of_the_blocks(version):
    rig = Rig(version)
    rig.register(9, ONCE)
    rig.register(3, queue_of(version), several=version != "1.0")
    for payload, protocol in ((b"A", 9), (b"B", 3), (b"C", 3)):
        rig.submit(payload, protocol)
    blocks = rig.tick()
    protocols = [9, 3] if version == "1.0" else [9, 3, 3]
    assert [protocol for protocol, _ in blocks] == protocols
    assert isinstance(rig.effects[0], SendBeacon)
    epoch = rig.bp.poll_timeout()
    assert rig.effects[1:] == [PayloadTransmitted(protocol, epoch) for protocol in protocols]


@pytest.mark.req("BP-PTI-02")
def test_the_announced_epoch_is_when_the_next_beacon_leaves():
    rig = Rig()
    rig.register(7, REPEAT)
    rig.submit(b"A")
    announced = None
    for _ in range(20):
        rig.tick()
        assert announced is None or rig.now == announced
        announced = rig.transmitted()[-1].next_epoch


@pytest.mark.req("BP-PTI-03")
@pytest.mark.parametrize("version", VERSIONS)
def test_repeated_payloads_are_indicated_each_time(version):
    rig = Rig(version)
    rig.register(7, REPEAT)
    rig.submit(b"A")
    for _ in range(5):
        rig.tick()
    assert len(rig.transmitted()) == len(rig.sent()) == 5


# -- space --------------------------------------------------------------------------------------------------------


@pytest.mark.req("BP-FMT-02")
@pytest.mark.req("BP-TX-04")
@pytest.mark.parametrize("spare", [0, 1])
@pytest.mark.parametrize("version", VERSIONS)
def test_payloads_may_fill_the_packet_to_the_last_octet(version, spare):
    """Two payloads that fill the packet to the octet share a beacon; with one octet less each has its own beacon."""
    rig = Rig(version)
    rig.register(1, ONCE)
    rig.register(2, ONCE)
    rig.submit(bytes(100), 1)
    rig.submit(bytes(100), 2)
    limit = rig.header + 2 * 104
    assert rig.bp.set_parameter("BPPAR_MAXIMUM_PACKET_SIZE", limit - spare) is None
    first, second = rig.tick(), rig.tick()
    if spare:
        assert (first, second) == ([(1, bytes(100))], [(2, bytes(100))])
    else:
        assert (first, second) == ([(1, bytes(100)), (2, bytes(100))], None)
    assert max(len(effect.octets) for effect in rig.sent()) <= limit - spare


@pytest.mark.req("BP-TX-04")
def test_the_largest_registration_fits_alone():
    rig = Rig()
    rig.register(7, ONCE, size=1478)
    rig.submit(bytes(1478))
    rig.tick()
    assert len(rig.sent()[0].octets) == 1500


@pytest.mark.parametrize(("reading", "together"), [("with-header", False), ("blocks-only", True)])
def test_reading_x04(reading, together):
    rig = Rig(readings={"X04": reading}, max_packet_size=208)
    rig.register(1, ONCE)
    rig.register(2, ONCE)
    rig.submit(bytes(100), 1)
    rig.submit(bytes(100), 2)
    assert len(rig.tick()) == (2 if together else 1)


@pytest.mark.req("UWB-03")
def test_reading_x04_never_exceeds_the_bearer():
    rig = Rig(readings={"X04": "blocks-only"})
    for protocol in (1, 2):
        rig.register(protocol, ONCE, size=746)
        rig.submit(bytes(746), protocol)
    # The blocks are exactly 1500 octets, which the bearer cannot carry with a header.
    assert len(rig.tick()) == 1
    assert len(rig.tick()) == 1


@pytest.mark.req("BP-TX-06")
@pytest.mark.parametrize("version", VERSIONS)
def test_a_large_head_blocks_the_rest_of_its_queue(version):
    rig = Rig(version)
    rig.register(1, ONCE, size=1000)
    rig.register(2, queue_of(version), size=1000, several=version != "1.0")
    rig.submit(bytes(1000), 1)
    rig.submit(bytes(900), 2)
    rig.submit(b"small", 2)
    assert rig.tick() == [(1, bytes(1000))]
    assert rig.bp.query_number_buffered(2).number == 2
    if version == "1.0":
        assert [rig.tick(), rig.tick()] == [[(2, bytes(900))], [(2, b"small")]]
    else:
        assert rig.tick() == [(2, bytes(900)), (2, b"small")]


@pytest.mark.req("BP-TX-04")
@pytest.mark.req("BP-PAR-06")
def test_a_payload_that_no_longer_fits_waits_for_a_larger_packet_size():
    rig = Rig()
    rig.register(1, REPEAT)
    rig.register(2, DROPTAIL)
    rig.submit(b"small", 1)
    rig.submit(bytes(100), 2)
    rig.bp.set_parameter("BPPAR_MAXIMUM_PACKET_SIZE", 100)
    assert [rig.tick(), rig.tick()] == [[(1, b"small")]] * 2
    rig.bp.clear_buffer(1)
    number = rig.sent()[-1].seqno
    assert [rig.tick(), rig.tick()] == [None, None]
    rig.bp.set_parameter("BPPAR_MAXIMUM_PACKET_SIZE", 1500)
    assert rig.tick() == [(2, bytes(100))]
    assert rig.sent()[-1].seqno == number + 1


@pytest.mark.req("BP-TX-08")
@pytest.mark.parametrize("version", VERSIONS)
def test_at_most_255_blocks(version):
    rig = Rig(version)
    for protocol in range(300):
        rig.register(protocol, ONCE)
        rig.submit(b"A", protocol)
    first, second = rig.tick(), rig.tick()
    assert (len(first), len(second)) == (BP_MAX_PAYLOADS, 300 - BP_MAX_PAYLOADS)
    assert {protocol for protocol, _ in first + second} == set(range(300))


@pytest.mark.req("BP-TX-08")
def test_at_most_255_payloads_of_one_client():
    rig = Rig()
    rig.register(7, DROPTAIL, entries=300, several=True)
    payloads = [index.to_bytes(1) for index in range(256)]
    for payload in payloads:
        rig.submit(payload)
    assert [octets for _, octets in rig.tick()] == payloads[:255]
    assert rig.tick() == [(7, payloads[255])]


def test_the_length_field_bounds_a_beacon():
    profile = get_codec("dcp-2.0").profile
    limits = msgspec.structs.replace(profile.limits, uwb_max_packet=100_000, max_beacon_size=100_000)
    rig = Rig(codec=Codec(msgspec.structs.replace(profile, name="wide", limits=limits)))
    for protocol in (1, 2):
        rig.register(protocol, ONCE, size=0xFFFF)
        rig.submit(bytes(40_000), protocol)
    assert [rig.tick(), rig.tick()] == [[(1, bytes(40_000))], [(2, bytes(40_000))]]
    # A payload for which the length fields have no number is kept out rather than sent wrongly.
    rig.submit(bytes(0xFFFF), 1)
    assert rig.tick() is None


# -- order of serving ---------------------------------------------------------------------------------------------


@pytest.mark.req("BP-TX-03")
def test_clients_that_do_not_fit_together_take_turns():
    rig = Rig()
    for protocol in (1, 2, 3):
        rig.register(protocol, REPEAT, size=1000)
        rig.submit(bytes(1000), protocol)
    assert [rig.tick()[0][0] for _ in range(6)] == [1, 2, 3, 1, 2, 3]


@pytest.mark.req("BP-TX-03")
def test_idle_clients_take_no_turn_from_others():
    rig = Rig()
    for protocol in (1, 2, 3):
        rig.register(protocol, REPEAT, size=1000)
    rig.submit(bytes(1000), 1)
    rig.submit(bytes(1000), 3)
    assert [rig.tick()[0][0] for _ in range(4)] == [1, 3, 1, 3]


@pytest.mark.req("BP-TX-03")
def test_a_large_payload_is_not_starved_by_small_ones():
    rig = Rig()
    for protocol in range(1, 6):
        rig.register(protocol, REPEAT)
        rig.submit(bytes(10), protocol)
    rig.register(9, ONCE, size=1478)
    rig.submit(bytes(1478), 9)
    served = [[protocol for protocol, _ in rig.tick()] for _ in range(3)]
    assert served == [[1, 2, 3, 4, 5], [9], [1, 2, 3, 4, 5]]


@pytest.mark.req("BP-TX-03")
def test_each_client_has_a_turn_before_any_has_a_second():
    rig = Rig()
    rig.register(1, DROPTAIL, entries=9, several=True)
    rig.register(2, ONCE)
    rig.register(3, DROPTAIL, entries=9, several=True)
    for index in range(3):
        rig.submit(b"1%d" % index, 1)
        rig.submit(b"3%d" % index, 3)
    rig.submit(b"2", 2)
    assert [octets for _, octets in rig.tick()] == [b"10", b"2", b"30", b"11", b"31", b"12", b"32"]


def test_beacons_depend_only_on_the_calls():
    def run():
        rig = Rig(seed=3)
        for protocol in range(5):
            rig.register(protocol, (DROPTAIL, ONCE, REPEAT)[protocol % 3], entries=5, size=700)
        for step in range(40):
            rig.submit(bytes([step]) * (20 * step % 700 + 1), step % 5)
            rig.tick()
        return rig.effects

    assert run() == run()
