"""The view for people: what is there is shown, whatever is wrong with it, and nothing is judged twice."""

from __future__ import annotations

import pytest

from dcp_codec import Dissection, Field, Problem, get_codec
from dcp_codec.views.dissect import dissect

BEACON = bytes.fromhex(
    "01497e0200000000bb1111 0031 02 00000029"
    "00020025 0501 07 020000000001 02 17979cfe3d85cd15 1388 03706f73 07030441424344 0102 0703 0900"
    "77770004 cafebabe"
)


def of(octets: bytes, profile: str = "dcp-2.0") -> Dissection:
    return get_codec(profile).dissect(octets)


def field(found: Dissection, path: str) -> Field:
    here = found.root.find(path)
    assert here is not None, path
    return here


def reasons(found: Dissection) -> list[tuple[str, str]]:
    return [(problem.reason, problem.path) for problem in found.problems]


def test_every_field_with_its_place() -> None:
    found = of(BEACON)
    assert found.problems == []
    assert [(each.path, each.offset, each.length) for each in found.root.walk()] == [
        ("", 0, 67),
        ("bp", 0, 18),
        ("bp.version", 0, 1),
        ("bp.magicNo", 1, 2),
        ("bp.senderId", 3, 6),
        ("bp.networkId", 9, 2),
        ("bp.length", 11, 2),
        ("bp.numPayloads", 13, 1),
        ("bp.seqno", 14, 4),
        ("payloads", 18, 49),
        ("payloads[0]", 18, 41),
        ("payloads[0].protocolId", 18, 2),
        ("payloads[0].length", 20, 2),
        ("payloads[0].vardis", 22, 37),
        ("payloads[0].vardis[0]", 22, 31),
        ("payloads[0].vardis[0].icType", 22, 1),
        ("payloads[0].vardis[0].icNumRecords", 23, 1),
        ("payloads[0].vardis[0].records", 24, 29),
        ("payloads[0].vardis[0].records[0]", 24, 29),
        ("payloads[0].vardis[0].records[0].spec", 24, 22),
        ("payloads[0].vardis[0].records[0].spec.varId", 24, 1),
        ("payloads[0].vardis[0].records[0].spec.prodId", 25, 6),
        ("payloads[0].vardis[0].records[0].spec.repCnt", 31, 1),
        ("payloads[0].vardis[0].records[0].spec.creationTime", 32, 8),
        ("payloads[0].vardis[0].records[0].spec.timeout", 40, 2),
        ("payloads[0].vardis[0].records[0].spec.descr", 42, 4),
        ("payloads[0].vardis[0].records[0].spec.descr.length", 42, 1),
        ("payloads[0].vardis[0].records[0].spec.descr.data", 43, 3),
        ("payloads[0].vardis[0].records[0].upd", 46, 7),
        ("payloads[0].vardis[0].records[0].upd.varId", 46, 1),
        ("payloads[0].vardis[0].records[0].upd.seqno", 47, 1),
        ("payloads[0].vardis[0].records[0].upd.value", 48, 5),
        ("payloads[0].vardis[0].records[0].upd.value.length", 48, 1),
        ("payloads[0].vardis[0].records[0].upd.value.data", 49, 4),
        ("payloads[0].vardis[1]", 53, 6),
        ("payloads[0].vardis[1].icType", 53, 1),
        ("payloads[0].vardis[1].icNumRecords", 54, 1),
        ("payloads[0].vardis[1].records", 55, 4),
        ("payloads[0].vardis[1].records[0]", 55, 2),
        ("payloads[0].vardis[1].records[0].varId", 55, 1),
        ("payloads[0].vardis[1].records[0].seqno", 56, 1),
        ("payloads[0].vardis[1].records[1]", 57, 2),
        ("payloads[0].vardis[1].records[1].varId", 57, 1),
        ("payloads[0].vardis[1].records[1].seqno", 58, 1),
        ("payloads[1]", 59, 8),
        ("payloads[1].protocolId", 59, 2),
        ("payloads[1].length", 61, 2),
        ("payloads[1].data", 63, 4),
    ]


def test_attributes_of_a_field() -> None:
    found = of(BEACON)
    record = "payloads[0].vardis[0].records[0]"
    assert field(found, f"{record}.spec.creationTime").value == 0x17979CFE3D85CD15
    assert field(found, f"{record}.spec.descr").value == b"pos"
    assert field(found, f"{record}.spec.descr").raw == b"\3pos"
    assert field(found, f"{record}.spec.descr.length").value == 3
    assert field(found, f"{record}.upd").value is None
    assert field(found, f"{record}.upd").raw == BEACON[46:53]
    assert field(found, "bp.senderId").value == bytes.fromhex("0200000000bb")
    assert field(found, "payloads[0].vardis[0].icType").label == "CREATE-VARIABLES"
    assert field(found, "payloads[0].vardis[1].icType").label == "SUMMARIES"
    assert field(found, "bp.seqno").label is None
    assert repr(field(found, "bp.seqno")) == "<bp.seqno at 14+4 = 41>"
    header = field(found, "bp")
    assert header.child("seqno") is field(found, "bp.seqno")
    assert header.child("nonsense") is None
    assert found.root.find("bp.nonsense") is None
    assert found.end == 67


@pytest.mark.req("BP-RX-14")
def test_padding() -> None:
    found = of(BEACON + b"\0\1\2")
    assert found.problems == []
    assert (found.end, found.padding) == (67, b"\0\1\2")


def test_base_and_start() -> None:
    found = get_codec("dcp-2.0").dissect(b"\xee" * 14 + BEACON + b"pad", start=14, base=100)
    assert field(found, "bp.seqno").offset == 114
    assert field(found, "bp.seqno").raw == bytes.fromhex("00000029")
    assert (found.end, found.padding) == (167, b"pad")


def test_octets_may_be_any_buffer() -> None:
    assert of(bytearray(BEACON)).problems == []
    assert of(memoryview(BEACON)).problems == []  # type: ignore[arg-type]


# -- continuing after an error --------------------------------------------------------------------------------------


@pytest.mark.req("BP-RX-01", "BP-RX-02")
def test_dissection_continues_after_wrong_constants() -> None:
    found = of(b"\2\0\0" + BEACON[3:])
    assert reasons(found) == [("bad-version", "bp.version"), ("bad-magic", "bp.magicNo")]
    assert field(found, "bp.seqno").value == 41
    assert field(found, "payloads[0].vardis[1].records[1].varId").value == 9
    assert found.padding == b""


@pytest.mark.req("BP-RX-15")
def test_a_length_beyond_the_frame() -> None:
    found = of(BEACON[:-1])
    assert reasons(found) == [("beacon-overrun", "bp.length"), ("block-overrun", "payloads[1].length")]
    assert field(found, "payloads[1].data").raw == b"\xca\xfe\xba"


def test_dissection_continues_after_a_wrong_payload() -> None:
    """A payload of known length is stepped over, so that the next one is seen."""
    octets = BEACON.replace(bytes.fromhex("0102 0703"), bytes.fromhex("0902 0703"))
    found = of(octets)
    assert reasons(found) == [("unknown-type", "payloads[0].vardis[1].icType")]
    assert field(found, "payloads[0].vardis[1].data").raw == bytes.fromhex("07030900")
    assert field(found, "payloads[1].data").value == bytes.fromhex("cafebabe")
    assert field(found, "payloads[0].vardis[0].records[0].upd.value").value == b"ABCD"


def test_dissection_continues_after_a_truncated_payload() -> None:
    octets = bytearray(BEACON)
    octets[54] = 9  # records announced, two there
    found = of(bytes(octets))
    assert found.problems == [
        Problem("truncated", "payloads[0].vardis[1].records[2].varId", 59, 1, 0, "VD-TYP-01"),
    ]
    assert field(found, "payloads[1].data").value == bytes.fromhex("cafebabe")


def test_a_truncated_field_shows_its_octets() -> None:
    found = of(BEACON[:16])
    seqno = field(found, "bp.seqno")
    assert (seqno.raw, seqno.value) == (b"\0\0", None)
    assert found.root.find("payloads") is None
    assert found.padding == b""
    # A value of 4 octets of which 2 are there.
    found = dissect(get_codec("dcp-2.0").containers_plan, bytes.fromhex("0201 0703 04 4142"))
    value = field(found, "[0].records[0].value")
    assert (value.value, value.raw) == (None, bytes.fromhex("044142"))
    assert field(found, "[0].records[0].value.data").raw == b"AB"


@pytest.mark.req("SRP-RX-01")
@pytest.mark.parametrize("size", [0, 1, 24, 41, 43, 64])
def test_a_report_of_another_size_is_one_mistake(size: int) -> None:
    octets = bytes.fromhex("01497e0200000000bb1111") + (size + 4).to_bytes(2, "big") + bytes.fromhex("0100000029 0001")
    octets += size.to_bytes(2, "big") + bytes(size)
    found = of(octets)
    assert found.errors == [Problem("wrong-length", "payloads[0].srp", 22, 42, size, "SRP-RX-01")]
    assert field(found, "payloads[0]").length == 4 + size
    assert (found.end, found.padding) == (len(octets), b"")


@pytest.mark.parametrize("there", [0, 1, 41])
@pytest.mark.parametrize("announced", [42, 43])
def test_a_report_that_is_cut_off_is_one_mistake(there: int, announced: int) -> None:
    octets = bytes.fromhex("01497e0200000000bb1111") + (there + 4).to_bytes(2, "big") + bytes.fromhex("0100000029 0001")
    octets += announced.to_bytes(2, "big") + bytes(there)
    found = of(octets)
    assert found.errors == [Problem("block-overrun", "payloads[0].length", 20, announced, there, "BP-RX-09")]
    assert field(found, "payloads[0].srp").length == there


@pytest.mark.req("SRP-RX-01")
def test_a_whole_report_of_another_size_in_a_beacon_that_is_cut_off_is_two() -> None:
    octets = bytes.fromhex("01497e0200000000bb1111 00ff 01 00000029 0001 0029") + bytes(41)
    found = [(problem.reason, problem.path) for problem in of(octets).errors]
    assert found == [("beacon-overrun", "bp.length"), ("wrong-length", "payloads[0].srp")]


def test_a_number_of_payloads_that_is_wrong() -> None:
    octets = bytearray(BEACON)
    octets[13] = 5
    assert of(bytes(octets)).problems == [Problem("count-mismatch", "bp.numPayloads", 13, 5, 2, "BP-HDR-07")]


def test_both_lengths_of_a_value_are_shown() -> None:
    plan = get_codec("student-2024").containers_plan
    found = dissect(plan, bytes.fromhex("02 01 0000000000000000 00 09000000 07 03 02 03000000 4142"))
    assert reasons(found) == [("length-mismatch", "[0].records[0].value.length2")]
    assert field(found, "[0].records[0].value").value == b"AB"
    assert field(found, "[0].records[0].value.length2").value == 3


def test_a_string_without_its_end_is_shown_whole() -> None:
    plan = get_codec("sim-1.0").containers_plan
    found = dissect(plan, bytes.fromhex("0501 07 020000000001 02 03 706f73 07 03 00"))
    assert reasons(found) == [("bad-terminator", "[0].records[0].spec.descr.data")]
    assert field(found, "[0].records[0].spec.descr").value == b"pos"


def test_text_with_its_end() -> None:
    found = dissect(get_codec("dcp-1.0").containers_plan, bytes.fromhex("0501 07 020000000001 02 706f7300 07 03 00"))
    descr = field(found, "[0].records[0].spec.descr")
    assert (descr.value, descr.raw, descr.children) == (b"pos", b"pos\0", ())


def test_an_area_that_is_too_small_ends_the_walk() -> None:
    octets = bytes.fromhex("09 64726f6e6531 00 000003e9") + bytes(3000)
    found = of(octets, "student-2024")
    assert reasons(found)[0] == ("area-overrun", "payloads[0].length")
    assert field(found, "payloads[0].data").length == 1001
    # Octets after the end are not known to be padding, but they are shown.
    assert (found.end, found.padding) == (len(octets), b"")
    area = field(found, "payloads[0].area")
    assert (area.offset, area.length, area.value) == (12 + 1001, len(octets) - 1013, None)
    assert field(found, "payloads[0]").length == len(octets)


def test_an_empty_frame() -> None:
    found = of(b"")
    assert found.errors == [Problem("truncated", "bp.version", 0, 1, 0, "BP-HDR-01")]
    assert found.root.length == 0


@pytest.mark.req("BP-FMT-03")
def test_a_beacon_without_header_has_a_block() -> None:
    empty = of(b"", "student-2024")
    assert empty.problems == [Problem("truncated", "payloads[0].protocolId", 0, 1, 0, "BP-HDR-11")]
    assert (empty.end, empty.root.length) == (0, 0)


@pytest.mark.req("BP-RX-16")
@pytest.mark.parametrize("octets", [b"\0" * 2000, b"\xff" * 2000, bytes(range(256)) * 8])
def test_garbage(octets: bytes) -> None:
    for profile in ("dcp-1.0", "dcp-2.0", "cpp-2.0", "sim-2.0", "student-2024"):
        found = of(octets, profile)
        assert found.errors
        assert found.root.length <= len(octets)


def test_the_largest_numbers_end() -> None:
    """255 payloads of 255 records each are announced in a few octets; what is not there costs nothing."""
    found = of(bytes.fromhex("01497e0200000000bb01ff00000000") + b"\0\2\xff\xff\1\xff", "dcp-1.1")
    assert len(list(found.root.walk())) < 40
