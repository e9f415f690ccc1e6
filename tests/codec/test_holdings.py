"""Held values: the content of the databases of nodes, derived from their beacons."""

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
from dcp_codec.analysis.holdings import DELETED, UNKNOWN, Held, History, Holdings
from dcp_codec.capture import open_capture
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
    holdings = Holdings()
    (change,) = holdings.feed(1, 10, ONE, saying(record))
    assert (change.node, change.var_id, change.before) == (ONE, 7, None)
    assert change.now.number == number
    assert holdings.held(ONE, 7) == change.now
    assert holdings.held(TWO, 7) is None


def test_records_with_fields_of_a_profile(tmp_path):
    """Records of containers that the profile adds show nothing."""
    types = codec_of("odd-own", tmp_path).types
    delete, request = types["VarDelete"](7), types["VarReqCreate"](8)
    changes = Holdings().feed(1, 10, ONE, saying(delete, request, types["Ping"](ONE, 1, b"")))
    assert [(each.var_id, each.now.number) for each in changes] == [(7, DELETED), (8, UNKNOWN)]


def test_repeated_records_change_nothing():
    holdings = Holdings()
    holdings.feed(1, 10, ONE, saying(created(0)))
    assert holdings.feed(2, 20, ONE, saying(VarSumm(7, 0), VarUpdate(7, 0, b"v"))) == []
    (change,) = holdings.feed(3, 30, ONE, saying(VarSumm(7, 1)))
    assert change.now == Held(1, (ONE, 5), 30, 3)
    assert change.before == Held(0, (ONE, 5), 10, 1)
    # Another creation with the same number is a change.
    assert len(holdings.feed(4, 40, ONE, saying(created(1, time=6)))) == 1


def test_a_node_differs_from_the_producer():
    holdings = Holdings()
    holdings.feed(1, 10, ONE, saying(created(5)))
    assert not holdings.differs(TWO, 7)
    holdings.feed(2, 20, TWO, saying(VarSumm(7, 9)))
    assert holdings.differs(TWO, 7)
    holdings.feed(3, 30, ONE, saying(VarUpdate(7, 9, b"v")))
    assert not holdings.differs(TWO, 7)
    assert holdings.producers == {7: ONE}


def test_memory_is_bounded():
    holdings = Holdings(most=2)
    assert len(holdings.feed(1, 10, ONE, saying(*(VarSumm(each, 0) for each in range(9))))) == 2
    assert len(holdings.feed(2, 20, ONE, saying(VarSumm(1, 1)))) == 1


def test_a_history_can_be_queried_for_any_moment():
    history = History("mac")
    history.feed(1, 1_000_000_000, ONE, saying(created(0)))
    history.feed(2, 2_000_000_000, TWO, saying(VarSumm(7, 0)))
    history.feed(3, 3_000_000_000, ONE, saying(VarUpdate(7, 1, b"v")))
    one, two = "02:00:00:00:00:01", "02:00:00:00:00:02"
    assert dict_of(history, 1_500_000_000) == {(one, 7): 0}
    assert dict_of(history, 2_000_000_000) == {(one, 7): 0, (two, 7): 0}
    assert dict_of(history, 9_000_000_000) == {(one, 7): 1, (two, 7): 0}
    told = history.as_json()
    assert told["changes"] == [(0, 0, 0, 0), (1000, 1, 0, 0), (1000, 0, 0, 1)]
    assert told["producers"] == [(0, 0, 0)]
    assert json.loads(json.dumps(told))["nodes"] == [one, two]


def test_a_long_history_becomes_coarser_and_ends_the_same():
    exact, coarse = History("mac", most=10_000), History("mac", most=64)
    for number in range(1000):
        for history in (exact, coarse):
            history.feed(number, number * 10_000_000, (ONE, TWO)[number % 2], saying(VarSumm(7, number // 4 % 256)))
    assert exact.interval == 1_000_000
    assert coarse.interval > exact.interval
    assert len(coarse.as_json()["changes"]) <= 64
    end = 1000 * 10_000_000
    assert dict_of(coarse, end) == dict_of(exact, end)


def test_a_recording_ends_with_the_state_of_its_last_summaries():
    codec, history = get_codec("cpp-2.0"), History("mac")
    last: dict[tuple[str, int], int] = {}
    with open_capture(CAPTURES / "b_crud.mcap") as reader:
        for frame in reader:
            framing = locate(frame.data, codec.profile.link)
            assert not isinstance(framing, OtherTraffic)
            beacon = codec.decode(frame.data[framing.start : framing.end])
            assert beacon.bp is not None
            history.feed(frame.number, frame.time_ns, beacon.bp.sender_id, beacon)
            for payload in beacon.payloads:
                for container in payload.vardis or ():
                    for record in container.records:
                        if isinstance(record, VarSumm):
                            last[beacon.bp.sender_id.hex(":"), record.var_id] = record.seqno
    held = dict_of(history, 1 << 62)
    assert last
    assert {key: number for key, number in held.items() if key in last and number >= 0} == {
        key: number for key, number in last.items() if held[key] >= 0
    }


def dict_of(history: History, time_ns: int) -> dict[tuple[str, int], int]:
    return {(node, var_id): number for node, var_id, number in history.states(time_ns)}


def test_a_history_of_too_many_nodes_stays_within_its_bounds():
    history = History("mac", most=64)
    for number in range(500):
        node = number.to_bytes(6, "big")
        history.feed(number, number * 1000, node, saying(*(VarSumm(each, number % 256) for each in range(5))))
    told = history.as_json()
    assert len(told["changes"]) <= 64
    assert len(list(history.states(1 << 62))) == 16
