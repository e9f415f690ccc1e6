"""Reception by BP: every decision of the receive path, on boundaries and on damaged beacons."""

from __future__ import annotations

import json

import pytest

from dcp_stack.bp.statistics import SMOOTHING, Counters, LossTable, NeighbourLoss
from dcp_stack.effects import Dropped, PayloadReceived

from ..bp_rig import ME, MS, ONCE, OTHER, SINCE_1_1, SINCE_1_2, VERSIONS, Rig

A, B = (7, b"first"), (8, b"second")


def listening(version="2.0", **settings):
    rig = Rig(version, **settings)
    rig.register(7, ONCE)
    rig.register(8, ONCE)
    return rig


def drop(reason, requirement, offset):
    return [Dropped("bp", reason, requirement, offset)]


# -- the header ---------------------------------------------------------------------------------------------------


@pytest.mark.req("BP-RX-01")
@pytest.mark.parametrize("value", [0x00, 0x02, 0x81, 0xFF])
@pytest.mark.parametrize("version", VERSIONS)
def test_other_versions(version, value):
    rig = listening(version)
    octets = rig.patch(rig.builder(A), "version", value)
    assert rig.receive(octets) == ([], drop("bad-version", "BP-RX-01", rig.field("version").start))


@pytest.mark.req("BP-RX-02")
@pytest.mark.parametrize("value", [0x497F, 0x7E49, 0x0000, 0x487E])
@pytest.mark.parametrize("version", VERSIONS)
def test_other_magic_numbers(version, value):
    rig = listening(version)
    octets = rig.patch(rig.builder(A), "magicNo", value)
    assert rig.receive(octets) == ([], drop("bad-magic", "BP-RX-02", rig.field("magicNo").start))


@pytest.mark.req("BP-RX-03")
@pytest.mark.parametrize("reading", ["length-field", "frame-size"])
@pytest.mark.parametrize("version", SINCE_1_2)
def test_length_zero(version, reading):
    rig = listening(version, readings={"X02": reading})
    octets = rig.patch(rig.builder(A), "length", 0)
    assert rig.receive(octets) == ([], drop("zero-length", "BP-RX-03", rig.field("length").start))


@pytest.mark.req("BP-RX-04")
@pytest.mark.parametrize("version", VERSIONS)
def test_no_payloads(version):
    rig = listening(version)
    octets = rig.patch(rig.builder(A), "numPayloads", 0)
    assert rig.receive(octets) == ([], drop("zero-count", "BP-RX-04", rig.field("numPayloads").start))


@pytest.mark.req("BP-RX-05")
@pytest.mark.parametrize("value", [0x1112, 0x0000, 0xFFFF, 0x1011])
def test_other_networks(value):
    rig = listening()
    assert rig.receive(rig.builder(A, network=value)) == ([], drop("foreign-network", "BP-RX-05", 9))


@pytest.mark.req("BP-RX-05")
@pytest.mark.req("BP-PAR-05")
def test_the_network_follows_the_parameter():
    rig = listening(network_id=0x2222)
    assert rig.reasons(rig.builder(A, network=0x1111)) == ["foreign-network"]
    assert rig.receive(rig.builder(A, network=0x2222)) == ([A], [])
    rig.bp.set_parameter("BPPAR_NETWORK_ID", 0)
    assert rig.reasons(rig.builder(A, network=0x2222)) == ["foreign-network"]
    assert rig.receive(rig.builder(A, network=0)) == ([A], [])


@pytest.mark.req("BP-RX-06")
@pytest.mark.parametrize("version", VERSIONS)
def test_the_own_beacon(version):
    rig = listening(version)
    place = rig.field("senderId").start
    assert rig.receive(rig.builder(A, sender=ME)) == ([], drop("own-beacon", "BP-RX-06", place))


@pytest.mark.req("DATA-04")
@pytest.mark.parametrize("sender", [bytes(6), b"\xff" * 6, ME[:-1] + b"\0", b"\3" + ME[1:]])
def test_other_senders_are_only_compared(sender):
    rig = listening()
    assert rig.receive(rig.builder(A, sender=sender)) == ([A], [])
    assert rig.effects == [PayloadReceived(7, b"first", sender)]


def test_order_of_the_checks():
    """Each beacon breaks one rule less than the one before, in the order of the text."""
    rig = listening()
    octets = rig.builder(A, sender=ME, network=0x2222)
    octets = rig.patch(octets, "numPayloads", 0)
    octets = rig.patch(octets, "length", 0)
    octets = rig.patch(octets, "magicNo", 0)
    octets = rig.patch(octets, "version", 0)
    rig.bp.deactivate()
    assert rig.reasons(octets) == ["inactive"]
    rig.bp.activate(rig.now)
    repairs = (
        ("bad-version", "version", 1),
        ("bad-magic", "magicNo", 0x497E),
        ("zero-length", "length", 10),
        ("zero-count", "numPayloads", 1),
        ("foreign-network", "networkId", 0x1111),
        ("own-beacon", "senderId", OTHER),
        ("beacon-overrun", "length", 9),
    )
    for reason, field, value in repairs:
        assert rig.reasons(octets) == [reason]
        octets = rig.patch(octets, field, value)
    assert rig.receive(octets) == ([A], [])


# -- blocks -------------------------------------------------------------------------------------------------------


@pytest.mark.req("BP-RXP-01")
@pytest.mark.req("BP-RXP-02")
@pytest.mark.parametrize("size", [1, 2, 255, 256, 1000, 1478])
@pytest.mark.parametrize("version", VERSIONS)
def test_payloads_arrive_unchanged_and_once(version, size):
    rig = listening(version)
    # Longer than what the client registered for itself: that bounds what it sends.
    payload = bytes(index * 37 % 256 for index in range(size))
    assert rig.receive(rig.builder((7, payload))) == ([(7, payload)], [])
    assert rig.effects == [PayloadReceived(7, payload, OTHER)]


@pytest.mark.req("BP-RXP-03")
@pytest.mark.req("BP-RX-07")
@pytest.mark.parametrize("version", VERSIONS)
def test_blocks_are_delivered_one_after_another(version):
    rig = listening(version)
    assert rig.receive(rig.builder(A, B, (7, b"again"))) == ([A, B, (7, b"again")], [])


@pytest.mark.req("BP-RX-07")
@pytest.mark.parametrize("version", VERSIONS)
def test_the_last_and_only_block_is_delivered(version):
    """Taken literally, the loop of the text would leave it out (X01)."""
    rig = listening(version)
    assert rig.receive(rig.builder((7, b"x" * 24))) == ([(7, b"x" * 24)], [])


@pytest.mark.req("BP-RX-08")
@pytest.mark.parametrize("version", VERSIONS)
def test_blocks_of_others_are_skipped(version):
    rig = listening(version)
    octets = rig.builder((0x7777, b"whatever"), A, (0, b"?"), B)
    delivered, dropped = rig.receive(octets)
    assert delivered == [A, B]
    header = rig.header
    assert dropped == [
        *drop("unregistered-protocol", "BP-RX-08", header),
        *drop("unregistered-protocol", "BP-RX-08", header + 12 + 9),
    ]


@pytest.mark.req("BP-RX-16")
@pytest.mark.req("BP-RX-07")
@pytest.mark.parametrize("version", VERSIONS)
def test_an_empty_payload_is_indicated(version):
    # The steps ask for the protocol only; ignoring it is a reading (X46).
    rig = listening(version)
    delivered, dropped = rig.receive(rig.builder((7, b""), B, (99, b"")))
    assert delivered == [(7, b""), B]
    assert [effect.reason for effect in dropped] == ["unregistered-protocol"]
    rig = listening(version, readings={"X46": "ignore-empty"})
    delivered, dropped = rig.receive(rig.builder((7, b""), B, (99, b"")))
    assert delivered == [B]
    assert [effect.reason for effect in dropped] == ["empty-payload", "unregistered-protocol"]


@pytest.mark.req("BP-RX-12")
@pytest.mark.parametrize("claimed", [1, 3])
@pytest.mark.parametrize("version", VERSIONS)
def test_a_number_of_blocks_that_is_not_the_number_of_payloads(version, claimed):
    for reading, right in (("deliver-blocks", [A, B]), ("discard-beacon", [])):
        rig = listening(version, readings={"X48": reading})
        delivered, dropped = rig.receive(rig.patch(rig.builder(A, B), "numPayloads", claimed))
        counted = version in SINCE_1_2 or claimed > 2
        # Before 1.2 nothing else tells where the blocks end (X47): a number that is too small is not a mismatch.
        assert delivered == (right if counted else [A])
        assert [each.reason for each in dropped] == (["other-count"] if counted and not right else [])


@pytest.mark.req("BP-RX-07")
@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_a_beacon_without_length_ends_with_its_count_or_with_the_frame(version):
    for reading, right in (("counted-blocks", [A]), ("whole-frame", [A, B])):
        rig = listening(version, readings={"X47": reading})
        octets = rig.patch(rig.builder(A, B), "numPayloads", 1)
        assert rig.receive(octets) == (right, [])
        assert rig.receive(rig.patch(octets, "numPayloads", 0))[0] == []
        assert rig.receive(octets[:-1])[0] == [A]


@pytest.mark.req("BP-RXP-01")
def test_a_payload_larger_than_the_receiver_has_registered():
    for reading, right in (("deliver-larger", [(7, b"x" * 101), B]), ("discard-larger", [B])):
        rig = listening(readings={"X49": reading})
        assert rig.receive(rig.builder((7, b"x" * 101), B))[0] == right
        assert rig.receive(rig.builder((7, b"x" * 100)))[0] == [(7, b"x" * 100)]


@pytest.mark.req("BP-RX-09")
@pytest.mark.parametrize("more", [1, 2, 0xFFFF - 6])
@pytest.mark.parametrize("version", VERSIONS)
def test_a_block_that_is_too_long_ends_the_parsing(version, more):
    rig = listening(version)
    octets = bytearray(rig.builder(A, B))
    place = rig.header + 9
    octets[place + 2 : place + 4] = (6 + more).to_bytes(2)
    delivered, dropped = rig.receive(bytes(octets))
    assert delivered == [A]
    assert [(effect.reason, effect.requirement) for effect in dropped] == [("block-overrun", "BP-RX-09")]
    assert rig.receive(rig.builder(B)) == ([B], [])


@pytest.mark.req("BP-RX-09")
@pytest.mark.parametrize("version", SINCE_1_2)
def test_a_block_may_not_reach_into_the_padding(version):
    rig = listening(version)
    octets = bytearray(rig.builder(A, B))
    octets[rig.header + 12] += 3
    delivered, dropped = rig.receive(bytes(octets) + bytes(46))
    assert (delivered, [effect.reason for effect in dropped]) == ([A], ["block-overrun"])


@pytest.mark.req("BP-RX-09")
@pytest.mark.parametrize("rest", [1, 2, 3])
@pytest.mark.parametrize("version", SINCE_1_2)
def test_octets_that_are_not_a_payload_header_end_the_parsing(version, rest):
    rig = listening(version)
    octets = rig.patch(rig.builder(A), "length", 9 + rest) + bytes(rest)
    delivered, dropped = rig.receive(octets)
    assert delivered == [A]
    assert [(effect.reason, effect.requirement) for effect in dropped] == [("truncated", "BP-RX-09")]


# -- the end of a beacon ------------------------------------------------------------------------------------------


@pytest.mark.req("BP-RX-14")
@pytest.mark.parametrize("padding", [b"\0", bytes(46), b"\xff" * 7, bytes(range(60)), b"\0\7\0\1x"])
@pytest.mark.parametrize("version", VERSIONS)
def test_padding_is_ignored(version, padding):
    rig = listening(version)
    assert rig.receive(rig.builder(A, B) + padding) == ([A, B], [])


@pytest.mark.req("BP-RX-15")
@pytest.mark.parametrize("version", SINCE_1_2)
def test_a_length_beyond_the_frame_discards_the_beacon(version):
    rig = listening(version)
    good = rig.builder(A, B)
    place = rig.field("length").start
    for length in (20, 21, 0x7FFF, 0xFFFF):
        assert rig.receive(rig.patch(good, "length", length)) == ([], drop("beacon-overrun", "BP-RX-15", place))
    assert rig.receive(good) == ([A, B], [])


@pytest.mark.req("BP-RX-14")
@pytest.mark.req("BP-RX-15")
@pytest.mark.parametrize("version", SINCE_1_2)
def test_reading_x02_uses_the_size_of_the_frame(version):
    rig = listening(version, readings={"X02": "frame-size"})
    good = rig.builder(A)
    assert rig.receive(rig.patch(good, "length", 0xFFFF)) == ([A], [])
    assert rig.receive(rig.patch(good, "length", 1)) == ([A], [])
    assert rig.receive(good + b"\0\x08\0\1x") == ([A, (8, b"x")], [])
    delivered, dropped = rig.receive(good + bytes(6))
    assert delivered == [A]
    assert [effect.reason for effect in dropped] == ["unregistered-protocol", "truncated"]
    assert rig.reasons(good[: rig.header]) == ["beacon-overrun"]


@pytest.mark.req("BP-RX-12")
@pytest.mark.parametrize("number", [1, 3, 255])
@pytest.mark.parametrize("version", SINCE_1_2)
def test_fewer_blocks_than_announced_are_delivered(version, number):
    rig = listening(version)
    octets = rig.patch(rig.builder(A, B), "numPayloads", number)
    assert rig.receive(octets) == ([A, B], [])
    assert rig.receive(octets + bytes(5)) == ([A, B], [])
    assert rig.bp.counters()["beacons-with-other-count"] == 2


@pytest.mark.req("BP-RX-12")
@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_without_a_length_the_number_distinguishes_blocks_from_padding(version):
    rig = listening(version)
    good = rig.builder(A, B)
    assert rig.receive(rig.patch(good, "numPayloads", 1)) == ([A], [])
    assert "beacons-with-other-count" not in rig.bp.counters()
    assert rig.receive(rig.patch(good, "numPayloads", 200)) == ([A, B], [])
    assert rig.bp.counters()["beacons-with-other-count"] == 1


@pytest.mark.req("BP-RX-16")
@pytest.mark.parametrize("version", VERSIONS)
def test_truncation_at_every_octet(version):
    rig = listening(version)
    good = rig.builder(A, B)
    for end in range(len(good)):
        delivered, dropped = rig.receive(good[:end])
        if end < rig.header:
            assert (delivered, [effect.reason for effect in dropped]) == ([], ["truncated"])
            assert dropped[0].requirement == "BP-RX-16"
            assert 0 <= dropped[0].offset <= end
        elif version >= "1.2":
            assert (delivered, [effect.reason for effect in dropped]) == ([], ["beacon-overrun"])
        else:
            # There is no length to show that something is missing: complete blocks are delivered.
            assert delivered == ([] if end < rig.header + 9 else [A])
            whole = end in (rig.header, rig.header + 9)
            assert len(dropped) == (0 if whole else 1)
    assert rig.receive(good) == ([A, B], [])


@pytest.mark.req("BP-RX-10")
@pytest.mark.parametrize("version", VERSIONS)
def test_beacons_are_accepted_with_any_sequence_number(version):
    rig = listening(version)
    for seqno in (5, 5, 4, 0, 0xFFFFFFFF, 0x80000000, 5):
        assert rig.receive(rig.builder(A, seqno=seqno)) == ([A], [])


@pytest.mark.parametrize(("sender", "receiver"), [("1.2", "2.0"), ("1.3", "2.0"), ("1.1", "1.2"), ("2.0", "1.3")])
def test_beacons_of_other_versions_are_not_accepted(sender, receiver):
    """The version octet is the same in all of them; the fields after it are not (X09)."""
    octets = Rig(sender, node_id=OTHER).builder(A)
    rig = listening(receiver)
    assert len(rig.reasons(octets)) == 1
    assert rig.receive(rig.builder(A)) == ([A], [])


def test_blocks_without_any_header():
    rig = Rig(profile="student-2024", node_id=b"02:00:00:00:00:01")
    rig.register(1, ONCE)
    octets = rig.builder((1, b"A"), (2, b"B"), (1, b"C"))
    delivered, dropped = rig.receive(octets)
    assert delivered == [(1, b"A"), (1, b"C")]
    assert dropped == drop("unregistered-protocol", "BP-RX-08", 1012)
    assert rig.effects[0].sender_id == b""
    assert rig.receive(octets[:-1])[0] == [(1, b"A")]
    assert rig.receive(octets + b"\0")[0] == [(1, b"A"), (1, b"C")]
    assert rig.bp.losses() == ()


# -- loss estimate ------------------------------------------------------------------------------------------------


def losses(*numbers, version="2.0"):
    rig = Rig(version)
    for seqno in numbers:
        rig.receive(rig.builder(A, seqno=seqno))
    (entry,) = rig.bp.losses()
    return entry


@pytest.mark.req("BP-RX-11")
@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ((3,), {"received": 1}),
        ((0, 1, 2), {"received": 3}),
        ((0, 1, 4), {"received": 3, "lost": 2}),
        ((0xFFFFFFFE, 1), {"received": 2, "lost": 2}),
        ((5, 5), {"received": 2, "repeated": 1}),
        ((500, 0, 1), {"received": 3, "restarts": 1}),
        ((0, 1 << 31), {"received": 2, "lost": (1 << 31) - 1}),
        ((0, (1 << 31) + 1), {"received": 2, "restarts": 1}),
    ],
)
def test_counting_losses(numbers, expected):
    entry = losses(*numbers)
    found = {name: getattr(entry, name) for name in ("received", "lost", "repeated", "restarts")}
    assert found == {"received": 0, "lost": 0, "repeated": 0, "restarts": 0} | expected
    assert (entry.node_id, entry.seqno, entry.heard) == (OTHER, numbers[-1], 5 * MS)
    assert 0 <= entry.loss <= 1


@pytest.mark.req("BP-RX-11")
def test_the_estimate_follows_the_share_that_is_lost():
    assert losses(*range(50)).loss == 0
    assert losses(*range(0, 2000, 2)).loss == pytest.approx(0.5, abs=0.05)
    assert losses(*range(0, 4000, 10)).loss == pytest.approx(0.9, abs=0.05)
    assert losses(0, 1 << 31).loss == pytest.approx(SMOOTHING)


def test_only_beacons_that_count_are_counted():
    rig = Rig()
    rig.receive(rig.builder(A, sender=ME))
    rig.receive(rig.builder(A, network=5))
    rig.receive(rig.patch(rig.builder(A), "length", 99))
    assert rig.bp.losses() == ()


def test_the_sender_that_was_silent_for_longest_is_replaced():
    table = LossTable(capacity=3)
    for moment, node_id in enumerate((b"a", b"b", b"c", b"a", b"d")):
        table.record(node_id, moment, moment)
    assert [entry.node_id for entry in table.entries()] == [b"c", b"a", b"d"]
    assert table.get(b"b") is None
    assert table.get(b"a") == NeighbourLoss(b"a", 3, 3, received=2, lost=2, loss=(1 - SMOOTHING**2) * SMOOTHING)


def test_any_number_of_senders_takes_bounded_memory():
    rig = Rig()
    for index in range(5000):
        rig.receive(rig.builder(A, sender=index.to_bytes(6)))
    assert len(rig.bp.losses()) == 4096
    assert rig.bp.losses()[-1].node_id == (4999).to_bytes(6)


# -- counters -----------------------------------------------------------------------------------------------------


@pytest.mark.req("BP-MGT-06")
def test_counters():
    rig = listening()
    rig.bp.register(9, "queue", 10, "BP_QMODE_QUEUE_DROPHEAD", 1, False, now=rig.now, wall=0)
    for protocol in (7, 8, 9, 9):
        rig.submit(b"A", protocol)
    rig.tick()
    rig.tick()
    good = rig.builder(A, (99, b"x"))
    rig.receive(good)
    rig.receive(b"")
    assert rig.bp.counters() == {
        "beacons-left-out": 0,
        "beacons-received": 1,
        "beacons-sent": 1,
        "beacons-without-payload": 1,
        "drops/truncated": 1,
        "drops/unregistered-protocol": 1,
        "frames-received": 2,
        "octets-received": len(good),
        "octets-sent": 18 + 3 * 5,
        "payloads-displaced/9": 1,
        "payloads-received/7": 1,
        "payloads-sent/7": 1,
        "payloads-sent/8": 1,
        "payloads-sent/9": 1,
        "payloads-stored/7": 1,
        "payloads-stored/8": 1,
        "payloads-stored/9": 1,
    }


@pytest.mark.req("BP-MGT-06")
def test_common_counters_exist_from_the_start():
    fresh = Rig().bp.counters()
    assert set(fresh) == {
        "beacons-left-out",
        "beacons-received",
        "beacons-sent",
        "beacons-without-payload",
        "frames-received",
        "octets-received",
        "octets-sent",
    }
    assert not any(fresh.values())


def test_counters_are_copies():
    counters = Counters()
    counters.count("b", 2)
    counters.count("a")
    counters.as_dict()["a"] = 5
    assert list(counters.as_dict().items()) == [("a", 1), ("b", 2)]


@pytest.mark.parametrize("version", SINCE_1_1)
def test_the_snapshot_is_plain_data(version):
    rig = listening(version)
    rig.submit(b"A")
    rig.tick()
    rig.receive(rig.builder(A))
    shown = json.loads(json.dumps(rig.bp.snapshot()))
    assert shown["next_seqno"] == 1
    assert shown["clients"][0]["buffered"] == 0
    assert shown["losses"][0]["node_id"] == "02:00:00:00:00:02"
    assert shown["parameters"]["ownNodeIdentifier"] == "02:00:00:00:00:01"
