"""Octets and what they mean, written out: the vectors of section A.5 and A.6 of the protocol reference.

The same message in every layout: beacon 41 of 02:00:00:00:00:bb with one VarDis payload that creates variable 7 of
02:00:00:00:00:01 (two repetitions, description "pos", value "ABCD" with sequence number 3; in 2.0 created at
1700000000123456789 ns, timeout 5 s) and summarises variables 7 (number 3) and 9 (number 0).
"""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from dcp_codec import (
    Beacon,
    BPHeader,
    Container,
    DecodeError,
    ExtendedSafetyData,
    OwnRecord,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
    get_codec,
)
from dcp_codec.jsonform import beacon_from_json, beacon_json, value_json

SENDER = bytes.fromhex("0200000000bb")
PRODUCER = bytes.fromhex("020000000001")
CREATED = 1700000000123456789

_HEADER_10 = "497e0200000000bb010100000029"
_HEADER_11 = "01497e0200000000bb0100000029"
_HEADER_12 = "01497e0200000000bb001f0100000029"
_HEADER_20 = "01497e0200000000bb111100290100000029"
_BLOCK_1X = "0002001b 0501070200000000010203706f7307030441424344010207030900"

#: profile -> octets.
VECTORS = {
    "dcp-1.0": f"{_HEADER_10} 0002001b 050107020000000001 02 706f7300 0703 04 41424344 0102 0703 0900",
    "sim-1.0": f"{_HEADER_10} 0002001c 0501070200000000010204706f730007030441424344010207030900",
    "dcp-1.1": f"{_HEADER_11} {_BLOCK_1X}",
    "dcp-1.2": f"{_HEADER_12} {_BLOCK_1X}",
    "dcp-1.3": f"{_HEADER_12} {_BLOCK_1X}",
    "cpp-1.2": f"{_HEADER_12} {_BLOCK_1X}",
    "cpp-1.3": f"{_HEADER_12} {_BLOCK_1X}",
    "cpp-2.0": f"{_HEADER_20} 00020025 0501070200000000010215cd853dfe9c9717138803706f7307030441424344010207030900",
    "dcp-2.0": f"{_HEADER_20} 00020025 0501070200000000010217979cfe3d85cd15138803706f7307030441424344010207030900",
}


def beacon_of(profile: str) -> Beacon:
    """The values in the vector of a profile."""
    since_2_0 = profile.endswith("2.0")
    return Beacon(
        bp=BPHeader(sender_id=SENDER, seqno=41, network_id=0x1111 if since_2_0 else None),
        payloads=(
            Payload(
                protocol_id=2,
                content=(
                    Container(
                        ic_type=5,
                        records=(
                            VarCreate(
                                spec=VarSpec(
                                    var_id=7,
                                    prod_id=PRODUCER,
                                    rep_cnt=2,
                                    descr=b"pos",
                                    creation_time=CREATED if since_2_0 else None,
                                    timeout=5000 if since_2_0 else None,
                                ),
                                upd=VarUpdate(var_id=7, seqno=3, value=b"ABCD"),
                            ),
                        ),
                    ),
                    Container(ic_type=1, records=(VarSumm(var_id=7, seqno=3), VarSumm(var_id=9, seqno=0))),
                ),
            ),
        ),
    )


def json_of(profile: str) -> dict[str, Any]:
    """The same as JSON, with everything that is on the wire under its name in the specification."""
    since_1_2 = profile not in ("dcp-1.0", "sim-1.0", "dcp-1.1")
    since_2_0 = profile.endswith("2.0")
    size = 37 if since_2_0 else 28 if profile == "sim-1.0" else 27
    return {
        "bp": {
            "version": 1,
            "magicNo": 0x497E,
            "senderId": "02:00:00:00:00:bb",
            **({"networkId": 0x1111} if since_2_0 else {}),
            **({"length": size + 4} if since_1_2 else {}),
            "numPayloads": 1,
            "seqno": 41,
        },
        "payloads": [
            {
                "protocolId": 2,
                "length": size,
                "vardis": [
                    {
                        "icType": 5,
                        "icName": "CREATE-VARIABLES",
                        "icNumRecords": 1,
                        "records": [
                            {
                                "spec": {
                                    "varId": 7,
                                    "prodId": "02:00:00:00:00:01",
                                    "repCnt": 2,
                                    **({"creationTime": CREATED, "timeout": 5000} if since_2_0 else {}),
                                    "descr": "pos",
                                },
                                "upd": {"varId": 7, "seqno": 3, "value": "41424344"},
                            }
                        ],
                    },
                    {
                        "icType": 1,
                        "icName": "SUMMARIES",
                        "icNumRecords": 2,
                        "records": [{"varId": 7, "seqno": 3}, {"varId": 9, "seqno": 0}],
                    },
                ],
            }
        ],
    }


@pytest.mark.req("BP-HDR-01", "BP-HDR-02", "BP-HDR-03", "BP-HDR-06", "BP-HDR-10", "BP-HDR-11", "DATA-01", "DATA-06")
@pytest.mark.parametrize("profile", VECTORS)
def test_octets_to_values(profile: str) -> None:
    octets = bytes.fromhex(VECTORS[profile])
    assert get_codec(profile).decode_from(octets) == (beacon_of(profile), len(octets))
    found = get_codec(profile).dissect(octets)
    assert found.problems == []
    assert found.padding == b""


@pytest.mark.req("DATA-01", "DATA-02", "BP-HDR-06", "BP-HDR-07", "BP-FMT-01", "VD-IC-01", "VD-TYP-05", "VD-TYP-07")
@pytest.mark.parametrize("profile", VECTORS)
def test_values_to_octets(profile: str) -> None:
    assert get_codec(profile).encode(beacon_of(profile)).hex() == VECTORS[profile].replace(" ", "")


@pytest.mark.parametrize("profile", VECTORS)
def test_octets_to_json(profile: str) -> None:
    codec = get_codec(profile)
    found = codec.dissect(bytes.fromhex(VECTORS[profile]))
    assert beacon_json(codec, found.root) == json_of(profile)
    assert value_json(codec, beacon_of(profile)) == json_of(profile)
    # Members have the order of the wire.
    assert list(beacon_json(codec, found.root)["bp"]) == list(codec.profile.bp.header)


@pytest.mark.parametrize("profile", VECTORS)
def test_json_to_octets(profile: str) -> None:
    codec = get_codec(profile)
    assert beacon_from_json(codec, json_of(profile)) == beacon_of(profile)
    # Derived members can be left out, and are ignored.
    bare = json_of(profile)
    for name in ("version", "magicNo", "length", "numPayloads"):
        bare["bp"].pop(name, None)
    bare["payloads"][0]["length"] = "nonsense"
    bare["payloads"][0]["vardis"][0].pop("icNumRecords")
    bare["payloads"][0]["vardis"][0]["icName"] = "SUMMARIES"
    assert codec.encode(beacon_from_json(codec, bare)).hex() == VECTORS[profile].replace(" ", "")


def test_every_vector_has_a_different_layout() -> None:
    """The vectors of the reference are six; profiles that share one have the same layout of beacons."""
    assert len({vector.replace(" ", "") for vector in VECTORS.values()}) == 6


# -- the other layouts ------------------------------------------------------------------------------------------


@pytest.mark.req("BP-HDR-04", "BP-HDR-06")
def test_simulator_states_the_size_of_its_header() -> None:
    codec = get_codec("sim-2.0")
    beacon = Beacon(
        BPHeader(SENDER, 41, 0x1111),
        (Payload(2, (Container(6, (VarDelete(7),)),)), Payload(0x7777, b"\xca\xfe")),
    )
    octets = bytes.fromhex("01497e0200000000bb1111 0012 02 00000029 00020003 060107 77770002 cafe")
    assert codec.encode(beacon) == octets
    assert codec.decode(octets + b"padding") == beacon


def test_student_blocks_have_areas() -> None:
    codec = get_codec("student-2024")
    container = Container(3, (VarSumm(7, 3), VarSumm(9, 0)), extra=(0x0102, 5))
    update = Container(2, (VarUpdate(7, 3, b"AB"),), extra=(-1, 6))
    beacon = Beacon(
        None,
        (
            Payload(2, (container, update), extra=(b"drone1", b"\0", b"\xee" * 957)),
            Payload(9, b"xyz", extra=(b"drone1", b"\1", bytes(997))),
        ),
    )
    octets = (
        bytes.fromhex(
            "02 64726f6e6531 00 0000002b"
            "03 02 0201000000000000 05 04000000 0703 0900"
            "02 01 ffffffffffffffff 06 09000000 07 03 02 02000000 4142"
        )
        + b"\xee" * 957
        + bytes.fromhex("09 64726f6e6531 01 00000003 78797a")
        + bytes(997)
    )
    assert len(octets) == 2 * 1012
    assert codec.encode(beacon) == octets
    assert codec.decode(octets) == beacon


def test_student_report() -> None:
    codec = get_codec("student-2024")
    s_data = codec.safety_data_type(1, -2, 3, 200, -4, 5, -6, 7, -8, 9)
    report = ExtendedSafetyData(s_data, b"aa:bb:cc:dd:ee:ff", -2, 0x01020304)
    octets = bytes.fromhex(
        "0100feff0300 c8 fcff0500faff 0700f8ff090011000000 61613a62623a63633a64643a65653a6666 feffffffffffffff 04030201"
    )
    assert len(octets) == 52
    assert codec.encode_report(report) == octets
    assert codec.decode_report(octets) == report


# -- state reports ----------------------------------------------------------------------------------------------

#: Captured from the C++ implementation: the image of an object in memory.
CAPTURED = bytes.fromhex(
    "000000000000f03f 0000000000000040 0000000000000840 4025ec6ae5550000"
    "0200000000aa 0000 6825ec6ae5550000 ca37be62aeebe918 00000000 00000000"
)


@pytest.mark.req("SRP-TYP-02", "SRP-TYP-03", "SRP-TYP-04", "SRP-TYP-05", "SRP-RX-01")
@pytest.mark.parametrize("profile", ["cpp-1.3", "cpp-2.0"])
def test_captured_report(profile: str) -> None:
    codec = get_codec(profile)
    report = ExtendedSafetyData(
        s_data=codec.safety_data_type(x=1.0, y=2.0, z=3.0),
        node_id=bytes.fromhex("0200000000aa"),
        t_stamp=0x18E9EBAE62BE37CA,
        seqno=0,
        extra=(bytes.fromhex("4025ec6ae5550000"), bytes(2), bytes.fromhex("6825ec6ae5550000"), bytes(4)),
    )
    assert report.t_stamp == 1795225060697323466
    assert codec.decode_report(CAPTURED) == report
    assert codec.encode_report(report) == CAPTURED
    beacon = Beacon(BPHeader(SENDER, 0, 0x1111 if profile == "cpp-2.0" else None), (Payload(1, report),))
    octets = codec.encode(beacon)
    assert octets[-68:] == bytes.fromhex("00010040") + CAPTURED
    assert codec.decode(octets).payloads[0].srp == report
    assert value_json(codec, beacon)["payloads"][0]["srp"] == {
        "sData": {"x": 1.0, "y": 2.0, "z": 3.0},
        "opaque24": "4025ec6ae5550000",
        "nodeId": "02:00:00:00:00:aa",
        "opaque38": "0000",
        "opaque40": "6825ec6ae5550000",
        "tStamp": 1795225060697323466,
        "seqno": 0,
        "opaque60": "00000000",
    }
    # Where there is nothing to say about the opaque regions, zeros are sent.
    octets = codec.encode_report(msgspec.structs.replace(report, extra=()))
    assert octets == CAPTURED[:24] + bytes(8) + CAPTURED[32:38] + bytes(10) + CAPTURED[48:60] + bytes(4)


@pytest.mark.req("SRP-TYP-01", "SRP-TYP-03", "DATA-01")
@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0"])
def test_packed_report(profile: str) -> None:
    codec = get_codec(profile)
    report = ExtendedSafetyData(codec.safety_data_type(x=1.0, y=-2.5, z=0.0), PRODUCER, 2**64 - 1, 2**32 - 1)
    octets = bytes.fromhex("3ff0000000000000 c004000000000000 0000000000000000 020000000001 ffffffffffffffff ffffffff")
    assert codec.encode_report(report) == octets
    assert codec.decode_report(octets) == report


def test_packed_report_of_the_simulator() -> None:
    codec = get_codec("sim-2.0")
    report = ExtendedSafetyData(codec.safety_data_type(1.0, 0.0, 0.0, 0.0, 0.0, -2.5), PRODUCER, -2, 3)
    octets = bytes.fromhex(
        "000000000000f03f 0000000000000000 0000000000000000 0000000000000000 0000000000000000 00000000000004c0"
        "020000000001 feffffffffffffff 03000000"
    )
    assert codec.encode_report(report) == octets
    assert codec.decode_report(octets) == report


def test_pattern_of_cpp_1_2() -> None:
    """That release sends 40 octets that count up, which is not a state report."""
    codec = get_codec("cpp-1.2")
    octets = bytes(range(200, 240))
    report = codec.decode_srp(octets)
    assert isinstance(report, OwnRecord)
    assert report.as_dict() == {"pattern": octets}
    assert codec.encode_report(report) == octets
    with pytest.raises(ValueError, match=r"cpp-1\.2 has no state reports"):
        codec.decode_report(octets)
    with pytest.raises(DecodeError, match="40"):
        codec.decode_srp(octets[1:])
    payload = Payload(1, report)
    assert payload.own_report == report
    assert payload.srp is payload.vardis is payload.data is None


# -- one golden per record type ---------------------------------------------------------------------------------

#: container name -> (its records, its octets in the layout of specification 1.1 to 1.3).
RECORDS = {
    "SUMMARIES": ((VarSumm(7, 3), VarSumm(255, 0)), "0102 0703 ff00"),
    "UPDATES": ((VarUpdate(7, 3, b"AB"), VarUpdate(0, 255, b"")), "0202 0703 02 4142 00ff 00"),
    "REQUEST-VARUPDATES": ((VarReqUpdate(7, 2),), "0301 0702"),
    "REQUEST-VARCREATES": ((VarReqCreate(7), VarReqCreate(8), VarReqCreate(9)), "0403 07 08 09"),
    "CREATE-VARIABLES": (
        (VarCreate(VarSpec(7, PRODUCER, 2, b"\xc3\xa9"), VarUpdate(7, 3, b"A")),),
        "0501 07 020000000001 02 02 c3a9 07 03 01 41",
    ),
    "DELETE-VARIABLES": ((VarDelete(7), VarDelete(0)), "0602 07 00"),
}
_CREATE_20 = "0501 07 020000000001 02 {} 1388 02 c3a9 07 03 01 41"


@pytest.mark.req("VD-IC-01", "VD-IC-02", "VD-TYP-01", "VD-TYP-02", "VD-TYP-03", "VD-TYP-07", "DATA-08")
@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.parametrize(
    "profile", ["dcp-1.1", "dcp-1.2", "dcp-1.3", "cpp-1.2", "cpp-1.3", "dcp-2.0", "cpp-2.0", "sim-2.0"]
)
def test_records(profile: str, name: str) -> None:
    codec = get_codec(profile)
    records, text = RECORDS[name]
    if name == "CREATE-VARIABLES" and profile.endswith("2.0"):
        create = records[0]
        assert isinstance(create, VarCreate)
        spec = msgspec.structs.replace(create.spec, creation_time=CREATED, timeout=5000)
        records = (msgspec.structs.replace(create, spec=spec),)
        text = _CREATE_20.format("17979cfe3d85cd15" if profile == "dcp-2.0" else "15cd853dfe9c9717")
    number = codec.profile.vardis.container_types.by_name()[name]
    containers = (Container(number, records),)
    assert codec.encode_containers(containers) == bytes.fromhex(text)
    assert codec.decode_containers(bytes.fromhex(text)) == containers


def test_no_record_type_is_forgotten() -> None:
    assert list(RECORDS) == list(get_codec("dcp-2.0").profile.vardis.container_types.by_name())


@pytest.mark.req("VD-TYP-04")
@pytest.mark.parametrize(("timeout", "octets"), [(0, "0000"), (1, "0001"), (65535, "ffff")])
def test_timeout_is_in_network_order(timeout: int, octets: str) -> None:
    codec = get_codec("cpp-2.0")
    create = VarCreate(VarSpec(7, PRODUCER, 2, b"", 0, timeout), VarUpdate(7, 3, b"A"))
    assert codec.encode_containers((Container(5, (create,)),)).hex()[36:40] == octets
