"""Every reason why octets are not a message, with its place; what is kept of such octets; what cannot be encoded."""

from __future__ import annotations

import pickle
from array import array
from typing import Any, NamedTuple

import construct as cs
import msgspec
import pytest
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.reasons import REASONS, WARNINGS
from dcp_spec.wire.combinators import SchemaViolation

from dcp_codec import (
    Beacon,
    BPHeader,
    CodecError,
    Container,
    DecodeError,
    EncodeError,
    Payload,
    Problem,
    VarCreate,
    VarDelete,
    VarSpec,
    VarSumm,
    VarUpdate,
    get_codec,
)

SENDER = bytes.fromhex("0200000000bb")
PRODUCER = bytes.fromhex("020000000001")


def beacon_20(*blocks: str, length: int | None = None, count: int | None = None) -> bytes:
    """A beacon of dcp-2.0 around payload blocks in hex; header 18 octets, the first block's payload at 22."""
    body = bytes.fromhex("".join(blocks))
    length = len(body) if length is None else length
    count = len(blocks) if count is None else count
    return bytes.fromhex(f"01497e0200000000bb1111{length:04x}{count:02x}00000029") + body


def student(payload: str, *, protocol: int = 2, length: int | None = None, rest: int | None = None) -> bytes:
    """A block of student-2024: header 12 octets, payload at 12, area of 1000 octets."""
    octets = bytes.fromhex(payload)
    length = len(octets) if length is None else length
    head = bytes.fromhex(f"{protocol:02x} 64726f6e6531 00 {length:08x}")
    return head + octets + bytes(1000 - len(octets) if rest is None else rest)


class Case(NamedTuple):
    """Octets that are not a message, and the one thing that is wrong with them."""

    profile: str
    octets: bytes
    problem: Problem


_SUMMARY = "00020004 0101 0703"
_SIM_10 = "497e0200000000bb010100000029 0002"

CASES = {
    "cut off in the header": Case(
        "dcp-2.0", beacon_20(_SUMMARY)[:10], Problem("truncated", "bp.networkId", 9, 2, 1, "BP-HDR-04")
    ),
    "nothing at all": Case("dcp-2.0", b"", Problem("truncated", "bp.version", 0, 1, 0, "BP-HDR-01")),
    "cut off in a payload header": Case(
        "dcp-2.0",
        beacon_20(_SUMMARY, "0002 00"),
        Problem("truncated", "payloads[1].length", 28, 2, 1, "BP-HDR-11"),
    ),
    "cut off in a container header": Case(
        "dcp-2.0",
        beacon_20("00020005 0101 0703 02"),
        Problem("truncated", "payloads[0].vardis[1].icNumRecords", 27, 1, 0, "VD-IC-01"),
    ),
    "cut off in a list of small records": Case(
        "dcp-2.0",
        beacon_20("00020005 0102 0703 09"),
        Problem("truncated", "payloads[0].vardis[0].records[1].seqno", 27, 1, 0, "VD-TYP-03"),
    ),
    "cut off in a value": Case(
        "dcp-2.0",
        beacon_20("00020007 0201 070305 4142"),
        Problem("truncated", "payloads[0].vardis[0].records[0].value.data", 27, 5, 2, "VD-TYP-02"),
    ),
    "cut off in the length of a value": Case(
        "dcp-2.0",
        beacon_20("00020004 0201 0703"),
        Problem("truncated", "payloads[0].vardis[0].records[0].value.length", 26, 1, 0, "VD-TYP-02"),
    ),
    "a string without its end": Case(
        "dcp-1.0",
        bytes.fromhex("497e0200000000bb010100000029 0002000d 0501 07 020000000001 02 706f73"),
        Problem("truncated", "payloads[0].vardis[0].records[0].spec.descr", 31, 1, 0, "DATA-07"),
    ),
    "cut off in an area": Case(
        "student-2024", student("", rest=999), Problem("truncated", "payloads[0].area", 12, 1000, 999, "BP-RX-09")
    ),
    "another version": Case(
        "dcp-2.0", b"\2" + beacon_20(_SUMMARY)[1:], Problem("bad-version", "bp.version", 0, 1, 2, "BP-RX-01")
    ),
    "another magic number": Case(
        "dcp-2.0",
        beacon_20(_SUMMARY).replace(b"\x49\x7e", b"\x7e\x49"),
        Problem("bad-magic", "bp.magicNo", 1, 0x497E, 0x7E49, "BP-RX-02"),
    ),
    "magic number first": Case(
        "dcp-1.0",
        beacon_20(_SUMMARY),
        Problem("bad-magic", "bp.magicNo", 0, 0x497E, 0x0149, "BP-RX-02"),
    ),
    "a length that is not the size of the header": Case(
        "sim-2.0", beacon_20(_SUMMARY, length=19), Problem("bad-length", "bp.length", 11, 18, 19, "BP-HDR-06")
    ),
    "a beacon of length zero": Case(
        "dcp-2.0", beacon_20(_SUMMARY, length=0), Problem("zero-length", "bp.length", 11, 1, 0, "BP-RX-03")
    ),
    "a beacon without payloads": Case(
        "dcp-2.0", beacon_20(_SUMMARY, count=0), Problem("zero-count", "bp.numPayloads", 13, 1, 0, "BP-RX-04")
    ),
    "a container without records": Case(
        "dcp-2.0",
        beacon_20("00020002 0100"),
        Problem("zero-count", "payloads[0].vardis[0].icNumRecords", 23, 1, 0, "VD-RX-06"),
    ),
    "longer than the frame": Case(
        "dcp-2.0", beacon_20(_SUMMARY, length=9), Problem("beacon-overrun", "bp.length", 11, 9, 8, "BP-RX-15")
    ),
    "a block longer than the beacon": Case(
        "dcp-2.0",
        beacon_20("00020005 0101 0703") + b"padding",
        Problem("block-overrun", "payloads[0].length", 20, 5, 4, "BP-RX-09"),
    ),
    "a list longer than its payload": Case(
        "student-2024",
        student("03 01 0000000000000000 05 03000000 0703"),
        Problem("list-overrun", "payloads[0].vardis[0].listLength", 23, 3, 2, "VD-RX-07"),
    ),
    "a payload longer than its area": Case(
        "student-2024",
        student("", protocol=9, length=1001, rest=2000),
        Problem("area-overrun", "payloads[0].length", 8, 1001, 1000, "BP-RX-09"),
    ),
    "a state report one octet short": Case(
        "dcp-2.0",
        beacon_20("00010029" + 41 * "00"),
        Problem("wrong-length", "payloads[0].srp", 22, 42, 41, "SRP-RX-01"),
    ),
    "a state report one octet long": Case(
        "cpp-2.0",
        beacon_20("00010041" + 65 * "00"),
        Problem("wrong-length", "payloads[0].srp", 22, 64, 65, "SRP-RX-01"),
    ),
    "octets after a list": Case(
        "student-2024",
        student("03 01 0000000000000000 05 03000000 0703 ff"),
        Problem("leftover", "payloads[0].vardis[0].records", 29, 0, 1, "VD-RX-07"),
    ),
    "octets after a state report": Case(
        "student-2024",
        student(19 * "00" + "00000000" + 12 * "00" + "ff", protocol=1),
        Problem("leftover", "payloads[0].srp", 47, 0, 1, "BP-RX-09"),
    ),
    "more payloads than counted": Case(
        "dcp-2.0",
        beacon_20(_SUMMARY, _SUMMARY, count=1),
        Problem("count-mismatch", "bp.numPayloads", 13, 1, 2, "BP-HDR-07"),
    ),
    "fewer payloads than counted": Case(
        "dcp-2.0",
        beacon_20(_SUMMARY, count=255),
        Problem("count-mismatch", "bp.numPayloads", 13, 255, 1, "BP-HDR-07"),
    ),
    "an unknown container": Case(
        "dcp-2.0",
        beacon_20("00020008 0101 0703 0701 0703"),
        Problem("unknown-type", "payloads[0].vardis[1].icType", 26, None, 7, "VD-RX-05"),
    ),
    "two lengths that differ": Case(
        "student-2024",
        student("02 01 0000000000000000 00 09000000 07 03 02 03000000 4142"),
        Problem("length-mismatch", "payloads[0].vardis[0].records[0].value.length2", 30, 2, 3, "DATA-06"),
    ),
    "a string that ends too late": Case(
        "sim-1.0",
        bytes.fromhex(f"{_SIM_10} 0012 0501 07 020000000001 02 04 706f0000 0703 00"),
        Problem("bad-terminator", "payloads[0].vardis[0].records[0].spec.descr.data", 29, None, None, "DATA-07"),
    ),
    "a string that does not end": Case(
        "sim-1.0",
        bytes.fromhex(f"{_SIM_10} 0012 0501 07 020000000001 02 04 706f7373 0703 00"),
        Problem("bad-terminator", "payloads[0].vardis[0].records[0].spec.descr.data", 29, None, None, "DATA-07"),
    ),
    "a string without room for its end": Case(
        "sim-1.0",
        bytes.fromhex(f"{_SIM_10} 000e 0501 07 020000000001 02 00 0703 00"),
        Problem("bad-terminator", "payloads[0].vardis[0].records[0].spec.descr.data", 29, None, None, "DATA-07"),
    ),
}


@pytest.mark.req(
    "BP-RX-01", "BP-RX-02", "BP-RX-03", "BP-RX-04", "BP-RX-09", "BP-RX-15", "BP-RX-16", "SRP-RX-01", "VD-RX-05"
)
@pytest.mark.req("VD-RX-06", "VD-RX-07", "DATA-06", "DATA-07")
@pytest.mark.parametrize("name", CASES)
def test_reason(name: str) -> None:
    profile, octets, problem = CASES[name]
    codec = get_codec(profile)
    with pytest.raises(DecodeError) as caught:
        codec.decode(octets)
    assert caught.value.problem == problem
    assert codec.dissect(octets).errors[0] == problem
    assert problem.requirement in requirements()
    with pytest.raises(cs.ConstructError) as refused:
        codec.schema.beacon.parse(octets)
    if isinstance(refused.value, SchemaViolation):
        assert (refused.value.reason, refused.value.requirement) == (problem.reason, problem.requirement)
    else:
        assert problem.reason == "truncated"


def test_every_reason_has_a_case() -> None:
    assert {case.problem.reason for case in CASES.values()} == set(REASONS)


def test_errors_have_messages() -> None:
    with pytest.raises(DecodeError) as caught:
        get_codec("dcp-2.0").decode(beacon_20(_SUMMARY, length=9))
    text = str(caught.value)
    assert text.startswith("bp.length at octet 11: beacon-overrun")
    assert "9" in text
    assert "8" in text
    assert text.endswith("[BP-RX-15]")
    assert isinstance(caught.value, CodecError)
    assert isinstance(caught.value, ValueError)


# -- warnings ---------------------------------------------------------------------------------------------------


def create_20(descr: str = "706f73", *, rep_cnt: int = 2, upd_id: int = 7, value: str = "41") -> str:
    """A block with one VarCreate of dcp-2.0; its spec starts at octet 24 of the beacon, descr at 42."""
    record = (
        f"07 020000000001 {rep_cnt:02x} 0000000000000001 0000 {len(descr) // 2:02x}{descr}"
        f"{upd_id:02x} 03 {len(value) // 2:02x}{value}"
    ).replace(" ", "")
    return f"0002{len(record) // 2 + 2:04x}0501{record}"


_REPORT = 24 * "00" + "020000000001" + 12 * "00"

WARNED = {
    "a payload of nothing": (
        beacon_20("77770000"),
        Problem("empty-payload", "payloads[0].length", 20, 1, 0, "BP-TXP-03", "warning"),
    ),
    "a VarDis payload of nothing": (
        beacon_20("00020000"),
        Problem("empty-payload", "payloads[0].length", 20, 1, 0, "BP-TXP-03", "warning"),
    ),
    "an update to nothing": (
        beacon_20("00020005 0201 070300"),
        Problem("empty-value", "payloads[0].vardis[0].records[0].value", 26, 1, 0, "VD-TYP-02", "warning"),
    ),
    "created with nothing": (
        beacon_20(create_20(value="")),
        Problem("empty-value", "payloads[0].vardis[0].records[0].upd.value", 48, 1, 0, "VD-TYP-02", "warning"),
    ),
    "no description": (
        beacon_20(create_20("")),
        Problem("empty-description", "payloads[0].vardis[0].records[0].spec.descr", 42, 1, 0, "VD-PC-05", "warning"),
    ),
    "no repetition": (
        beacon_20(create_20(rep_cnt=0)),
        Problem("zero-repetitions", "payloads[0].vardis[0].records[0].spec.repCnt", 31, 1, 0, "VD-PC-06", "warning"),
    ),
    "two identifiers": (
        beacon_20(create_20(upd_id=8)),
        Problem("id-mismatch", "payloads[0].vardis[0].records[0].upd.varId", 46, 7, 8, "VD-TYP-07", "warning"),
    ),
    "a report about another": (
        beacon_20(f"0001002a{_REPORT}"),
        Problem("foreign-node-id", "payloads[0].srp.nodeId", 46, None, None, "SRP-TYP-04", "warning"),
    ),
    "the same variable twice": (
        beacon_20("00020008 0103 0703 0803 0704"),
        Problem("duplicate-variable", "payloads[0].vardis[0].records[2].varId", 28, None, 7, "VD-PAY-03", "warning"),
    ),
    "a description that is not text": (
        beacon_20(create_20("c328")),
        Problem("invalid-utf8", "payloads[0].vardis[0].records[0].spec.descr", 42, None, None, "DATA-08", "warning"),
    ),
}


@pytest.mark.req("BP-TXP-03", "VD-PC-04", "VD-PC-05", "VD-PC-06", "SRP-TYP-04", "DATA-08")
@pytest.mark.parametrize("name", WARNED)
def test_warning(name: str) -> None:
    octets, problem = WARNED[name]
    found = get_codec("dcp-2.0").dissect(octets)
    assert found.problems == [problem]
    assert found.errors == []
    assert found.warnings == [problem]
    assert problem.requirement in requirements()
    # A message that violates such a rule can be decoded: receivers see it and decide.
    codec = get_codec("dcp-2.0")
    assert codec.encode(codec.decode(octets)) == octets


def test_every_warning_has_a_case() -> None:
    assert {problem.reason for _, problem in WARNED.values()} == set(WARNINGS)


def test_nothing_to_warn_about() -> None:
    own = _REPORT.replace("020000000001", SENDER.hex())
    blocks = (create_20(), f"0001002a{own}", "00020008 0102 0703 0803 0601 07".replace("0008", "0009"))
    assert get_codec("dcp-2.0").dissect(beacon_20(*blocks)).problems == []


def test_warnings_come_in_wire_order_after_errors() -> None:
    octets = beacon_20("00020005 0201 070300", "77770000", _SUMMARY, count=2)
    found = get_codec("dcp-2.0").dissect(octets)
    assert [problem.reason for problem in found.problems] == ["count-mismatch", "empty-value", "empty-payload"]


# -- what is complete before the fault --------------------------------------------------------------------------


HEADER = BPHeader(SENDER, 41, 0x1111)
SUMMARY = Payload(2, (Container(1, (VarSumm(7, 3),)),))


def partial_of(profile: str, octets: bytes) -> Any:
    with pytest.raises(DecodeError) as caught:
        get_codec(profile).decode(octets)
    return caught.value.partial


@pytest.mark.req("BP-RX-09", "BP-RX-08")
def test_blocks_before_an_overrun_are_kept() -> None:
    octets = beacon_20(_SUMMARY, "77770002 cafe", "00020009 0101 0703")
    assert partial_of("dcp-2.0", octets) == Beacon(HEADER, (SUMMARY, Payload(0x7777, b"\xca\xfe")))


@pytest.mark.req("BP-RX-12")
def test_all_blocks_are_kept_if_only_their_number_is_wrong() -> None:
    assert partial_of("dcp-2.0", beacon_20(_SUMMARY, _SUMMARY, count=3)) == Beacon(HEADER, (SUMMARY, SUMMARY))


def test_blocks_before_a_wrong_payload_are_kept() -> None:
    assert partial_of("dcp-2.0", beacon_20(_SUMMARY, "00020004 0101 0703 0901".replace("0004", "0006"))) == Beacon(
        HEADER, (SUMMARY,)
    )
    assert partial_of("dcp-2.0", beacon_20(_SUMMARY, "00010000")) == Beacon(HEADER, (SUMMARY,))


@pytest.mark.parametrize("profile", ["dcp-1.1", "sim-2.0"])
def test_blocks_are_kept_without_a_stated_length(profile: str) -> None:
    header = "01497e0200000000bb0200000029" if profile == "dcp-1.1" else "01497e0200000000bb111100120200000029"
    octets = bytes.fromhex(f"{header} {_SUMMARY} 00020009 0101")
    header_value = BPHeader(SENDER, 41, None if profile == "dcp-1.1" else 0x1111)
    assert partial_of(profile, octets) == Beacon(header_value, (SUMMARY,))


def test_nothing_is_kept_of_a_wrong_header() -> None:
    assert partial_of("dcp-2.0", beacon_20(_SUMMARY, length=0)) is None
    assert partial_of("dcp-2.0", beacon_20(_SUMMARY)[:17]) is None
    assert partial_of("dcp-2.0", beacon_20(_SUMMARY, length=100)) is None


def test_no_block_is_kept_if_the_first_one_is_wrong() -> None:
    assert partial_of("dcp-2.0", beacon_20("00020009 0101 0703")) == Beacon(HEADER, ())


def test_blocks_of_an_envelope_are_kept() -> None:
    octets = beacon_20(_SUMMARY, "00020009 0101 0703")
    with pytest.raises(DecodeError) as caught:
        get_codec("dcp-2.0").decode_envelope(octets)
    assert caught.value.partial == Beacon(HEADER, (Payload(2, bytes.fromhex("01010703")),))
    # BP does not read the payload for VarDis.
    octets = beacon_20("00020004 0901 0703", "00010000")
    assert get_codec("dcp-2.0").decode_envelope(octets)[0].payloads == (
        Payload(2, bytes.fromhex("09010703")),
        Payload(1, b""),
    )


@pytest.mark.req("VD-RX-05", "VD-RX-06", "VD-RX-07")
@pytest.mark.parametrize(
    ("behind", "reason", "path", "offset"),
    [
        ("0901 07", "unknown-type", "[2].icType", 9),
        ("0100", "zero-count", "[2].icNumRecords", 10),
        ("01", "truncated", "[2].icNumRecords", 10),
        ("0102 0703 08", "truncated", "[2].records[1].seqno", 14),
        ("0201 0703 09 41", "truncated", "[2].records[0].value.data", 14),
    ],
)
def test_containers_before_a_fault_are_kept(behind: str, reason: str, path: str, offset: int) -> None:
    with pytest.raises(DecodeError) as caught:
        get_codec("dcp-2.0").decode_containers(bytes.fromhex("0102 0703 0900 0601 07" + behind))
    assert caught.value.partial == (Container(1, (VarSumm(7, 3), VarSumm(9, 0))), Container(6, (VarDelete(7),)))
    problem = caught.value.problem
    assert (problem.reason, problem.path, problem.offset) == (reason, path, offset)


def test_octets_after_a_report_of_variable_size() -> None:
    codec = get_codec("student-2024")
    report = bytes(19) + bytes(4) + bytes(12)
    with pytest.raises(DecodeError) as caught:
        codec.decode_report(report + b"\xff\xff")
    assert caught.value.problem == Problem("leftover", "", 35, 0, 2, "SRP-RX-01")
    assert caught.value.partial == codec.decode_report(report)


# -- where offsets count from -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_offsets_count_from_the_first_octet_of_the_argument(name: str) -> None:
    profile, octets, problem = CASES[name]
    codec = get_codec(profile)
    framed = b"\xee" * 14 + octets
    with pytest.raises(DecodeError) as caught:
        codec.decode_from(framed, 14)
    assert caught.value.problem == problem.moved(14)
    assert codec.dissect(framed, start=14, base=14).errors[0] == problem.moved(14)
    # The base is only what the first octet is called.
    assert codec.dissect(framed, start=14).errors[0] == problem
    assert codec.dissect(octets, base=1000).errors[0] == problem.moved(1000)


def test_moved() -> None:
    problem = Problem("truncated", "bp", 5, 1, 0, "BP-HDR-01")
    assert problem.moved(0) is problem
    assert problem.moved(14) == msgspec.structs.replace(problem, offset=19)


def test_start_of_an_envelope() -> None:
    codec = get_codec("dcp-2.0")
    octets = beacon_20(_SUMMARY)
    beacon, end = codec.decode_envelope(b"\xee" * 14 + octets + b"pad", 14)
    assert end == 14 + len(octets)
    assert beacon.payloads[0].data == bytes.fromhex("01010703")


# -- values that cannot be encoded ------------------------------------------------------------------------------


def beacon(*payloads: Payload) -> Beacon:
    return Beacon(HEADER, payloads)


def updates(*records: Any) -> Beacon:
    return beacon(Payload(2, (Container(2, records),)))


def created(**changes: Any) -> Beacon:
    spec = msgspec.structs.replace(VarSpec(7, PRODUCER, 2, b"pos", 1, 0), **changes)
    return beacon(Payload(2, (Container(5, (VarCreate(spec, VarUpdate(7, 3, b"A")),)),)))


_BIG = Payload(0x7777, bytes(0xFFFF - 4))

UNENCODABLE = {
    "too many octets in a value": (updates(VarUpdate(7, 3, bytes(256))), "payloads[0].vardis[0].records[0].value"),
    "a value that is text": (updates(VarUpdate(7, 3, "ABCD")), "payloads[0].vardis[0].records[0].value"),  # type: ignore[arg-type]
    "a number too large": (updates(VarUpdate(256, 3, b"A")), "payloads[0].vardis[0].records[0].varId"),
    "a number too small": (updates(VarUpdate(7, -1, b"A")), "payloads[0].vardis[0].records[0].seqno"),
    "no number": (updates(VarUpdate(7, None, b"A")), "payloads[0].vardis[0].records[0].seqno"),  # type: ignore[arg-type]
    "a record of another type": (updates(VarUpdate(1, 1, b"A"), VarSumm(7, 3)), "payloads[0].vardis[0].records[1]"),
    "a record that has all fields of the type": (
        beacon(Payload(2, (Container(1, (VarSumm(7, 3), VarUpdate(7, 3, b"A"))),))),
        "payloads[0].vardis[0].records[1]",
    ),
    "no records": (updates(), "payloads[0].vardis[0].records"),
    "too many records": (
        beacon(Payload(2, (Container(1, (VarSumm(7, 3),) * 256),))),
        "payloads[0].vardis[0].records",
    ),
    "an unknown container": (beacon(Payload(2, (Container(9, (VarSumm(7, 3),)),))), "payloads[0].vardis[0].icType"),
    "no container": (beacon(Payload(2, (VarSumm(7, 3),))), "payloads[0].vardis[0]"),  # type: ignore[arg-type]
    "octets for containers": (beacon(Payload(2, b"octets")), "payloads[0].vardis"),
    "containers for octets": (beacon(Payload(0x7777, (Container(1, (VarSumm(7, 3),)),))), "payloads[0].data"),
    "octets for a report": (beacon(Payload(1, bytes(42))), "payloads[0].srp"),
    "no payloads": (beacon(), "payloads"),
    "too many payloads": (beacon(*[Payload(0x7777, b"")] * 256), "payloads"),
    "too much for one payload": (beacon(Payload(0x7777, bytes(0x10000))), "payloads[0].data"),
    "too much for one beacon": (beacon(_BIG, Payload(0x7777, b"")), "payloads"),
    "a short sender": (Beacon(BPHeader(SENDER[:5], 41, 0x1111), (SUMMARY,)), "bp.senderId"),
    "a sender that is text": (Beacon(BPHeader("02:00:00", 41, 0x1111), (SUMMARY,)), "bp.senderId"),  # type: ignore[arg-type]
    "no network": (Beacon(BPHeader(SENDER, 41), (SUMMARY,)), "bp.networkId"),
    "no header": (Beacon(None, (SUMMARY,)), "bp"),
    "a long producer": (created(prod_id=bytes(7)), "payloads[0].vardis[0].records[0].spec.prodId"),
    "no creation time": (created(creation_time=None), "payloads[0].vardis[0].records[0].spec.creationTime"),
    "a long description": (created(descr=bytes(256)), "payloads[0].vardis[0].records[0].spec.descr"),
}


@pytest.mark.parametrize("name", UNENCODABLE)
def test_unencodable(name: str) -> None:
    value, path = UNENCODABLE[name]
    with pytest.raises(EncodeError) as caught:
        get_codec("dcp-2.0").encode(value)
    assert caught.value.path == path
    assert str(caught.value) == f"{path}: {caught.value.why}"


@pytest.mark.req("BP-HDR-06", "BP-FMT-01", "BP-TX-08")
def test_the_largest_that_fit() -> None:
    codec = get_codec("dcp-2.0")
    octets = codec.encode(beacon(_BIG))
    assert octets[11:13] == b"\xff\xff"
    assert codec.decode(octets) == beacon(_BIG)
    many = beacon(*[Payload(0x7777, b"")] * 255)
    assert codec.encode(many)[13] == 255
    assert codec.decode(codec.encode(many)) == many
    records = beacon(Payload(2, (Container(2, (VarUpdate(255, 255, bytes(255)),) * 253),)))
    assert codec.decode(codec.encode(records)) == records


def test_strings_that_end_with_nul_must_not_contain_nul() -> None:
    for profile, room in (("dcp-1.0", None), ("sim-1.0", 254)):
        codec = get_codec(profile)
        spec = VarSpec(7, PRODUCER, 2, b"a\0b")
        containers = (Container(5, (VarCreate(spec, VarUpdate(7, 3, b"A")),)),)
        with pytest.raises(EncodeError, match="NUL") as caught:
            codec.encode_containers(containers)
        assert caught.value.path == "[0].records[0].spec.descr"
        if room is not None:
            for size in (room, room + 1):
                spec = msgspec.structs.replace(spec, descr=b"a" * size)
                containers = (Container(5, (VarCreate(spec, VarUpdate(7, 3, b"A")),)),)
                if size <= room:
                    assert codec.decode_containers(codec.encode_containers(containers)) == containers
                else:
                    with pytest.raises(EncodeError, match="at most 254 can be announced"):
                        codec.encode_containers(containers)


@pytest.mark.parametrize(
    "buffer",
    [array("I", [1, 2]), memoryview(array("I", [1, 2])), memoryview(b"ab"), array("B", b"ab"), "ab", None, [1, 2]],
    ids=lambda buffer: f"{type(buffer).__name__}",
)
@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-2.0", "student-2024"])
def test_only_octets_are_octets(profile: str, buffer: Any) -> None:
    codec = get_codec(profile)
    update = Container(codec.profile.vardis.container_types.by_name()["UPDATES"], (VarUpdate(1, 2, buffer),))
    with pytest.raises(EncodeError, match=r"\[0\]\.records\[0\]\.value: needs bytes, not "):
        codec.encode_containers((update,))
    header = BPHeader(PRODUCER, 1, *([0x1111] if profile == "dcp-2.0" else [])) if codec.profile.bp.header else None
    with pytest.raises(EncodeError, match=r"payloads\[0\]\.data: needs bytes, not "):
        codec.encode(Beacon(header, (Payload(9, buffer),)))
    if profile == "student-2024":
        with pytest.raises(EncodeError, match=r"payloads\[0\]\.area: needs bytes, not "):
            codec.encode(Beacon(None, (Payload(9, b"x", extra=(bytes(6), b"\0", buffer or array("I", [1]))),)))


@pytest.mark.req("BP-FMT-03")
def test_a_beacon_without_a_block_is_refused() -> None:
    codec = get_codec("student-2024")
    with pytest.raises(DecodeError) as caught:
        codec.decode(b"")
    assert caught.value.problem == Problem("truncated", "payloads[0].protocolId", 0, 1, 0, "BP-HDR-11")
    with pytest.raises(EncodeError, match="payloads: needs at least one Payload"):
        codec.encode(Beacon(None, ()))
    with pytest.raises(cs.ConstructError):
        codec.schema.beacon.parse(b"")
    with pytest.raises(SchemaViolation):
        codec.schema.beacon.build({"payloads": []})


def test_encoding_does_not_change_the_value() -> None:
    descr = bytearray(b"pos")
    spec = VarSpec(7, PRODUCER, 2, descr)  # type: ignore[arg-type]
    octets = get_codec("dcp-1.0").encode_containers((Container(5, (VarCreate(spec, VarUpdate(7, 3, b"A")),)),))
    assert b"pos\0" in octets
    assert descr == b"pos"


def test_areas() -> None:
    codec = get_codec("student-2024")
    name = (b"drone1", b"\0")
    full = Beacon(None, (Payload(9, bytes(1000), extra=(*name, b"")),))
    assert codec.decode(codec.encode(full)) == full
    for content, area, path in (
        (bytes(1001), b"", "payloads[0].data"),
        (bytes(1001), None, "payloads[0].data"),
        (bytes(999), bytes(2), "payloads[0].area"),
        (b"", bytes(999), "payloads[0].area"),
    ):
        with pytest.raises(EncodeError) as caught:
            codec.encode(Beacon(None, (Payload(9, content, extra=(*name, area)),)))
        assert caught.value.path == path


@pytest.mark.parametrize("extra", [5, "text", (1,), (b"drone1", b"\0"), {"a": 1, "b": 2, "c": 3}, object()])
def test_extra_of_a_wrong_form(extra: Any) -> None:
    with pytest.raises(EncodeError) as caught:
        get_codec("student-2024").encode(Beacon(None, (Payload(9, b"x", extra=extra),)))
    assert caught.value.path == "payloads[0].extra"


def test_sequences_must_be_tuples_or_lists() -> None:
    codec = get_codec("dcp-2.0")
    as_list: Any = [Container(1, [VarSumm(7, 3)])]  # type: ignore[arg-type]
    assert codec.encode_containers(as_list) == bytes.fromhex("01010703")
    wrong: list[Any] = [{}, {1: 2}, set(), iter(as_list), "", b""]
    for containers in wrong:
        with pytest.raises(EncodeError):
            codec.encode_containers(containers)


# -- values that a layout cannot carry ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "path"),
    [
        (lambda b: msgspec.structs.replace(b, bp=msgspec.structs.replace(b.bp, network_id=0x1111)), "bp.network_id"),
        (lambda b: msgspec.structs.replace(b, bp=msgspec.structs.replace(b.bp, extra=(1,))), "bp.extra"),
        (lambda b: _with_spec(b, creation_time=1), "payloads[0].vardis[0].records[0].spec.creation_time"),
        (lambda b: _with_spec(b, timeout=0), "payloads[0].vardis[0].records[0].spec.timeout"),
    ],
)
def test_values_that_a_layout_cannot_express_are_refused(change, path):
    """Specification 1.3 has no network identifier, creation time or timeout: encoding must not drop them silently."""
    codec = get_codec("dcp-1.3")
    node = bytes(6)
    create = VarCreate(VarSpec(1, node, 1, b"d"), VarUpdate(1, 0, b"v"))
    beacon = Beacon(BPHeader(node, 0), (Payload(2, (Container(5, (create,)),)),))
    codec.encode(beacon)
    with pytest.raises(EncodeError) as error:
        codec.encode(change(beacon))
    assert error.value.path == path
    assert "no place" in error.value.why


def _with_spec(beacon, **changes):
    create = beacon.payloads[0].content[0].records[0]
    changed = msgspec.structs.replace(create, spec=msgspec.structs.replace(create.spec, **changes))
    return msgspec.structs.replace(beacon, payloads=(Payload(2, (Container(5, (changed,)),)),))


@pytest.mark.parametrize(
    ("payload", "indices", "records"),
    [
        # Two VarSumms, then a VarUpdate whose value is cut off after a complete one.
        ("010207010802 0202 07030141 080402", (1, 1), 1),
        ("0202 07030141 07", (0, 1), 1),
        ("0201 0703", (0, 0), 0),
        ("0701 01", (0,), None),
        ("01", (0,), None),
    ],
)
def test_an_error_names_its_container_and_record(payload: str, indices: tuple[int, ...], records: int | None) -> None:
    codec, octets = get_codec("dcp-2.0"), bytes.fromhex(payload)
    with pytest.raises(DecodeError) as caught:
        codec.decode_containers(octets)
    assert caught.value.indices == indices
    assert pickle.loads(pickle.dumps(caught.value)).indices == indices
    start = len(codec.encode_containers(caught.value.partial or ()))
    most = indices[1] if len(indices) > 1 else 0
    found = codec.decode_leading_records(octets, start, most)
    assert (None if found is None else len(found.records)) == records
