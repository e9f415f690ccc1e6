"""The ledger: the content of the databases of nodes, derived from their beacons."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dcp_codec import (
    Beacon,
    BPHeader,
    Container,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
    get_codec,
)  # fmt: skip
from dcp_codec.analysis.entry import DELETED, UNKNOWN
from dcp_codec.analysis.ledger import Ledger, part_of
from dcp_codec.capture import open_capture
from dcp_codec.codec import Codec
from dcp_codec.framing.locate import OtherTraffic, locate

from ..odd_profiles import codec_of

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
ONE, TWO = b"\x02\0\0\0\0\1", b"\x02\0\0\0\0\2"


def saying(*records: object) -> Beacon:
    return Beacon(BPHeader(ONE, 0, 0), (Payload(2, tuple(Container(1, (each,)) for each in records)),))


def created(number: int, time: int = 5, node: bytes = ONE) -> VarCreate:
    return VarCreate(VarSpec(7, node, 1, b"x", time, 0), VarUpdate(7, number, b"v"))


@pytest.mark.parametrize(
    ("record", "number"),
    [
        (created(3), 3),
        (VarUpdate(7, 4, b"v"), 4),
        (VarSumm(7, 5), 5),
        (VarReqUpdate(7, 6), 6),
        (VarDelete(7), DELETED),
        (VarReqCreate(7), UNKNOWN),
    ],
)
def test_every_record_shows_a_part_of_its_senders_database(record, number):
    ledger = Ledger()
    (entry,) = ledger.feed(1, 10, ONE, saying(record))
    assert (entry.node, entry.var_id, entry.number) == (ONE, 7, number)
    assert ledger.held(ONE, 7) is entry
    assert ledger.held(TWO, 7) is None


def test_records_with_fields_of_a_profile(tmp_path):
    """Records of containers that the profile adds show nothing."""
    types = codec_of("odd-own", tmp_path).types
    delete, request = types["VarDelete"](7), types["VarReqCreate"](8)
    begun = Ledger().feed(1, 10, ONE, saying(delete, request, types["Ping"](ONE, 1, b"")))
    assert [(each.var_id, each.number) for each in begun] == [(7, DELETED), (8, UNKNOWN)]


def test_repeated_records_extend_a_state():
    ledger = Ledger()
    (first,) = ledger.feed(1, 10, ONE, saying(created(0)))
    assert ledger.feed(2, 20, ONE, saying(VarSumm(7, 0), VarUpdate(7, 0, b"v"))) == []
    (second,) = ledger.feed(3, 30, ONE, saying(VarSumm(7, 1)))
    assert (first.number, first.creation) == (0, (ONE, 5))
    assert (first.frame, first.last, first.time, first.until) == (1, 2, 10, 20)
    assert (first.carried, first.values) == ([(1, 10), (2, 20)], 2)
    assert (second.number, second.creation, second.frame, second.carried) == (1, (ONE, 5), 3, [])
    # Another creation with the same number is another state.
    assert len(ledger.feed(4, 40, ONE, saying(created(1, time=6)))) == 1
    assert [each.frame for each in ledger.entries(7)] == [1, 3, 4]


def test_a_summary_after_a_request_for_a_held_variable_begins_a_state():
    ledger = Ledger()
    for frame, record in enumerate((created(3), VarSumm(7, 3), VarReqCreate(7), VarSumm(7, 3), VarSumm(7, 3)), 1):
        ledger.feed(frame, frame, ONE, saying(record))
    states = [(each.number, each.frame, each.last) for each in ledger.entries()]
    assert states == [(3, 1, 2), (UNKNOWN, 3, 3), (3, 4, 5)]


def test_requests_are_counted():
    ledger = Ledger()
    ledger.feed(1, 10, ONE, saying(VarSumm(7, 3)))
    for frame in range(2, 6):
        ledger.feed(frame, 10 * frame, ONE, saying(VarSumm(7, 3), VarReqUpdate(7, 3)))
    (entry,) = ledger.entries()
    assert (entry.asked, entry.last_asked, entry.last) == (4, (5, 50), 5)


def test_memory_is_bounded():
    ledger = Ledger(pairs=2)
    assert len(ledger.feed(1, 10, ONE, saying(*(VarSumm(each, 0) for each in range(9))))) == 2
    assert len(ledger.feed(2, 20, ONE, saying(VarSumm(1, 1)))) == 1


def test_states_can_be_written_as_json():
    ledger = Ledger()
    ledger.feed(1, 1_000_000_000, ONE, saying(created(0)))
    ledger.feed(2, 2_000_000_000, TWO, saying(VarSumm(7, 0)))
    ledger.feed(3, 3_000_000_000, ONE, saying(VarUpdate(7, 1, b"v")))
    told = ledger.as_json("mac")
    assert [row[:4] for row in told["changes"]] == [(0, 0, 0, 0), (1000, 1, 0, 0), (1000, 0, 0, 1)]
    assert told["producers"] == [(0, 0, 0)]
    assert json.loads(json.dumps(told))["nodes"] == ["02:00:00:00:00:01", "02:00:00:00:00:02"]


def test_a_long_ledger_becomes_coarser_and_ends_the_same():
    exact, coarse = Ledger(), Ledger(entries=64)
    for number in range(1000):
        for ledger in (exact, coarse):
            ledger.feed(number, number * 10_000_000, (ONE, TWO)[number % 2], saying(VarSumm(7, number // 4 % 256)))
    assert exact.interval == 1_000_000
    assert coarse.interval > exact.interval
    assert len(coarse.entries()) <= 66
    for node in (ONE, TWO):
        one, other = exact.held(node, 7), coarse.held(node, 7)
        assert one is not None
        assert other is not None
        assert (one.number, one.frame, one.until) == (other.number, other.frame, other.until)


SECOND = 1_000_000_000


def followed(numbers: int, stuck: int, room: int = 60_000, width: int = 256) -> Ledger:
    """Node 1 produces a value each second. Node 2 follows after 0.2 s, but keeps value ``stuck`` to the end."""
    ledger = Ledger(entries=room)
    frame = 0
    for number in range(numbers):
        for node, after in ((ONE, 0.0), (TWO, 0.2), (ONE, 0.5), (TWO, 0.7)):
            frame += 1
            holds = number if node == ONE else min(number, stuck)
            record = VarSumm(7, holds % width) if number else created(0)
            ledger.feed(frame, round((number + after) * SECOND), node, saying(record))
    return ledger


def test_a_short_lag_is_not_stale():
    ledger = followed(20, 20)
    assert ledger.stale() == []
    assert {each.age for each in ledger.entries() if each.node == TWO} == {0}


@pytest.mark.parametrize("room", [60_000, 64])
def test_a_stale_state_is_found_in_a_recording_of_any_length(room):
    (stale,) = followed(3000, 2000, room, width=1 << 16).stale()
    assert (stale.node, stale.number, stale.time) == (TWO, 2000, round(2000.2 * SECOND))
    assert stale.left is not None
    assert stale.newest is not None
    assert (stale.left.number, stale.left.time) == (2001, 2001 * SECOND)
    assert (stale.newest.number, stale.missed, stale.deleted) == (2999, 999, False)
    assert stale.age == round((2999.7 - 2001) * SECOND)


@pytest.mark.parametrize("later", [10, 3000])
def test_a_node_that_falls_silent_has_the_lag_of_its_last_beacon(later):
    ledger = followed(20, 5)
    for number in range(20, 20 + later):
        ledger.feed(1000 + number, number * SECOND, ONE, saying(VarSumm(7, number % 256)))
    (stale,) = ledger.stale()
    assert stale.newest is not None
    assert (stale.number, stale.newest.number, stale.missed) == (5, 19, 14)
    assert stale.age == round((19.7 - 6) * SECOND)


def test_a_state_is_stale_after_three_seconds_and_ten_beacons():
    ledger = followed(8, 3)
    assert [each.age for each in ledger.stale()] == [round(3.7 * SECOND)]
    assert [each.age for each in ledger.stale(0.37 * SECOND)] == [round(3.7 * SECOND)]
    assert ledger.stale(0.38 * SECOND) == []


def test_a_deletion_that_is_not_followed_is_stale():
    ledger = Ledger()
    ledger.feed(1, 0, ONE, saying(created(0)))
    ledger.feed(2, 1, TWO, saying(VarSumm(7, 0)))
    ledger.feed(3, SECOND, ONE, saying(VarDelete(7)))
    ledger.feed(4, 5 * SECOND, TWO, saying(VarSumm(7, 0)))
    (stale,) = ledger.stale()
    assert (stale.deleted, stale.missed, stale.age) == (True, 0, 4 * SECOND)
    # It ends when the node deletes the variable.
    ledger.feed(5, 6 * SECOND, TWO, saying(VarDelete(7)))
    ledger.feed(6, 9 * SECOND, TWO, saying(VarSumm(8, 0)))
    assert [each.age for each in ledger.stale()] == [4 * SECOND]


def test_a_variable_of_several_producers_has_no_stale_state():
    ledger = followed(20, 5)
    assert ledger.stale()
    ledger.feed(100, 30 * SECOND, TWO, saying(created(0, node=TWO)))
    assert ledger.stale() == []


def test_a_producer_that_becomes_known_late():
    ledger = Ledger()
    for number in range(10):
        ledger.feed(2 * number, number * SECOND, ONE, saying(VarSumm(7, number)))
        ledger.feed(2 * number + 1, number * SECOND + 1, TWO, saying(VarSumm(7, 3 if 3 <= number < 9 else number)))
    assert ledger.stale() == []
    ledger.feed(30, 10 * SECOND, ONE, saying(created(9)))
    assert [(each.number, each.missed, each.age) for each in ledger.stale()] == [(3, 5, 4 * SECOND + 1)]


def test_a_recording_ends_with_the_state_of_its_last_summaries():
    codec, ledger = get_codec("cpp-2.0"), Ledger()
    last: dict[tuple[str, int], int] = {}
    with open_capture(CAPTURES / "b_crud.mcap") as reader:
        for frame in reader:
            framing = locate(frame.data, codec.profile.link)
            assert not isinstance(framing, OtherTraffic)
            beacon = codec.decode(frame.data[framing.start : framing.end])
            assert beacon.bp is not None
            ledger.feed(frame.number, frame.time_ns, beacon.bp.sender_id, beacon)
            for payload in beacon.payloads:
                for container in payload.vardis or ():
                    for record in container.records:
                        if isinstance(record, VarSumm):
                            last[beacon.bp.sender_id.hex(":"), record.var_id] = record.seqno
    held = {(each.node.hex(":"), each.var_id): each.number for each in ledger.entries()}
    assert last
    assert {key: number for key, number in held.items() if key in last and number >= 0} == {
        key: number for key, number in last.items() if held[key] >= 0
    }


def test_equal_summaries_have_one_part_and_those_of_other_profiles_have_their_own(tmp_path: Path):
    octets = bytes([1, 3, 7, 200, 8, 201, 7, 202])
    profile = tmp_path / "turned.toml"
    profile.write_text('extends = "dcp-2.0"\nname = "turned"\n[vardis.records]\nVarSumm = ["seqno", "varId"]\n')
    usual, turned = get_codec("dcp-2.0"), Codec(profile)
    parts = [part_of(codec.decode_containers(octets)[0].records) for codec in (usual, turned, usual, turned)]
    assert [part[2:4] for part in parts if part] == [([7, 8, 7], [200, 201, 202]), ([200, 201, 202], [7, 8, 7])] * 2
    assert parts[0] is parts[2]
    assert parts[0] is not None
    assert parts[0][4] == {7: 202, 8: 201}


def test_a_part_is_that_of_its_records_after_many_others():
    for number in range(3_000):
        records = (VarSumm(number % 256, number // 256),)
        part = part_of(records)
        assert part is not None
        assert (part[1], part[2], part[3]) == (records, [number % 256], [number // 256])
