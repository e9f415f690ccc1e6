"""A bad payload is one bad payload: the tables have the beacon, its header, and everything else that it says."""

from __future__ import annotations

import numpy as np
import pytest
from dcp_tables.table.decoding import ColumnDecoder
from dcp_tables.table.input.sources import packed

from dcp_codec import Beacon, BPHeader, Container, Payload, VarSumm, get_codec
from dcp_codec.capture import Frame
from dcp_codec.framing.envelope import Envelope

pytestmark = pytest.mark.part("tables")

SENDER = bytes.fromhex("020000000001")
CODEC = get_codec("cpp-1.3")
#: A container of two summaries, then one of a type that does not exist.
BAD_END = bytes.fromhex("0102 0103 0204 0901 05")


def frame_of(number: int, *blocks: tuple[int, bytes], counted: int | None = None) -> Frame:
    payloads = tuple(Payload(number, octets) for number, octets in blocks)
    octets = bytearray(CODEC.encode_envelope(Beacon(BPHeader(SENDER, number), payloads)))
    if counted is not None:
        octets[11] = counted
    data = Envelope(CODEC.profile.link).frame(bytes(octets).ljust(46, b"\0"), SENDER)
    return Frame(number, 1_750_000_000_000_000_000 + number * 100_000_000, data, len(data))


def summaries(*numbers: int) -> tuple[int, bytes]:
    return 2, CODEC.encode_containers((Container(1, tuple(VarSumm(each, 9) for each in numbers)),))


@pytest.fixture(params=[True, False], ids=["interpreted", "compiled"])
def tables(request, rows):
    decoder = ColumnDecoder(CODEC, interpret=request.param)

    def make(*frames: Frame):
        with np.errstate(over="ignore"):
            (batch,) = decoder.batches(packed(list(frames), 0))
        for table in batch.tables.values():
            table.validate(full=True)
        return {name: rows(table) for name, table in batch.tables.items()}, batch

    return make


def test_the_other_payloads_of_a_beacon_with_a_bad_one(tables):
    """As release 1.2.0 sends it: a test pattern in place of the report that the profile describes."""
    pattern = (1, bytes(range(0x20, 0x48)))
    found, batch = tables(
        frame_of(1, summaries(1)),
        frame_of(2, pattern, summaries(2, 3)),
        frame_of(3, summaries(4)),
        frame_of(4, pattern),
    )
    assert (batch.frames, batch.malformed, batch.other) == (4, 2, 0)
    assert [(row["frame"], row["seqno"]) for row in found["beacons"]] == [(1, 1), (2, 2), (3, 3), (4, 4)]
    assert [(row["frame"], row["payload"], row["content"], row["length"]) for row in found["payloads"]] == [
        (1, 0, "vardis", 4),
        (2, 0, "srp", 40),
        (2, 1, "vardis", 6),
        (3, 0, "vardis", 4),
        (4, 0, "srp", 40),
    ]
    assert [(row["frame"], row["payload"], row["varId"]) for row in found["summaries"]] == [
        (1, 0, 1),
        (2, 1, 2),
        (2, 1, 3),
        (3, 0, 4),
    ]
    assert found["srp"] == []
    assert [(row["frame"], row["payload"], row["reason"], row["offset"]) for row in found["errors"]] == [
        (2, 0, "wrong-length", 34),
        (4, 0, "wrong-length", 34),
    ]


def test_each_bad_payload_is_one_row_of_errors(tables):
    found, _ = tables(frame_of(1, (1, b"short"), (2, BAD_END), (7, b"other"), (1, b"long" * 20), summaries(6)))
    assert [(row["payload"], row["reason"]) for row in found["errors"]] == [
        (0, "wrong-length"),
        (1, "unknown-type"),
        (3, "wrong-length"),
    ]
    assert [row["content"] for row in found["payloads"]] == ["srp", "vardis", "data", "srp", "vardis"]
    assert [row["data"] for row in found["payloads"]] == [None, None, b"other".hex(), None, None]
    # The container before the bad one is there.
    assert [(row["payload"], row["container"], row["varId"], row["seqno"]) for row in found["summaries"]] == [
        (1, 0, 1, 3),
        (1, 0, 2, 4),
        (4, 0, 6, 9),
    ]


def test_a_header_with_wrong_counts(tables):
    found, batch = tables(frame_of(1, summaries(1), summaries(2), counted=3))
    assert batch.malformed == 1
    (beacon,) = found["beacons"]
    assert (beacon["numPayloads"], beacon["length"]) == (3, 16)
    assert [row["varId"] for row in found["summaries"]] == [1, 2]
    (error,) = found["errors"]
    assert (error["payload"], error["reason"]) == (None, "count-mismatch")


def test_a_frame_that_is_not_a_beacon_is_one_row_of_errors(tables):
    data = Envelope(CODEC.profile.link).frame(b"nonsense" * 8, SENDER)
    found, batch = tables(Frame(1, 0, data, len(data)), frame_of(2, summaries(1)))
    assert batch.malformed == 1
    assert [row["frame"] for row in found["beacons"]] == [2]
    assert [(row["frame"], row["reason"]) for row in found["errors"]] == [(1, "bad-version")]
