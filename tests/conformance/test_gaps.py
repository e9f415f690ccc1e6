"""The tester's own losses: what was not heard, and what was heard and is no beacon."""

from __future__ import annotations

from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.model.case import all_cases
from dcp_conformance.model.pics import Pics
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.bench import Bench, Session

from dcp_codec import Beacon, BPHeader, Codec, Payload

CODEC = Codec("dcp-2.0")
SENDER = bytes.fromhex("020000000001")


def bench_that_heard(*frames: bytes) -> Bench:
    sut = InProcess(reference_config(CODEC))
    bench = Bench(Session(CODEC, sut.lower_tester(), None, Pics()), all_cases()["TC_DCP_SANITY_BV_01"])
    bench.heard = [ReceivedBeacon(CODEC, number, 0, 0, octets, SENDER) for number, octets in enumerate(frames, 1)]
    return bench


def beacon(seqno: int) -> bytes:
    return CODEC.encode_envelope(Beacon(BPHeader(SENDER, seqno, 0x1111), (Payload(0x7000, b"x"),)))


def test_nothing_is_missing():
    assert bench_that_heard(beacon(1), beacon(2), beacon(3)).gaps() == ""


def test_a_beacon_that_was_not_heard_is_missing():
    assert bench_that_heard(beacon(1), beacon(3)).gaps() == "sequence number 3 follows 1"


def test_a_frame_that_is_no_beacon_was_heard():
    """Otherwise an implementation that sends garbage would be let off for losses of the tester's."""
    assert bench_that_heard(beacon(1), beacon(2)[:-1] + b"", beacon(3)).gaps() == ""
    assert bench_that_heard(beacon(1), b"\x01", beacon(4)).gaps() == "sequence number 4 follows 1"
