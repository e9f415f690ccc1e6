"""Messages as JSON and back: nothing is lost, and errors in a JSON object are reported with their path."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import msgspec
import pytest
from dcp_lab.testing import strategies
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec import (
    Beacon,
    BPHeader,
    Codec,
    Container,
    EncodeError,
    ExtendedSafetyData,
    Payload,
    Problem,
    VarCreate,
    VarSpec,
    VarUpdate,
    get_codec,
)
from dcp_codec.jsonform import (
    beacon_from_json,
    beacon_json,
    node_id_octets,
    node_id_text,
    problem_json,
    value_json,
)

from ..chance import examples

SENDER = bytes.fromhex("0200000000bb")
PRODUCER = bytes.fromhex("020000000001")


def through_text(data: Any) -> Any:
    """Parse our output with a strict JSON reader."""
    return json.loads(json.dumps(data, allow_nan=False))


def plain(value: Any) -> Any:
    """Nested tuples in which every NaN is the same: JSON has one at most."""
    if isinstance(value, msgspec.Struct):
        return (type(value).__name__, *(plain(getattr(value, name)) for name in value.__struct_fields__))
    if isinstance(value, tuple | list):
        return tuple(plain(item) for item in value)
    if isinstance(value, float):
        return "NaN" if math.isnan(value) else struct.pack(">d", value)
    return value


def test_round_trip(codec: Codec) -> None:
    @settings(max_examples=examples(30))
    @given(strategies.beacons(codec))
    def check(beacon: Beacon) -> None:
        data = through_text(value_json(codec, beacon))
        assert plain(beacon_from_json(codec, data)) == plain(beacon)

    check()


def test_damaged_messages_are_valid_json(codec: Codec) -> None:
    @settings(max_examples=examples(30))
    @given(
        st.one_of(
            strategies.mutations(strategies.beacons(codec).map(codec.encode), codec.dissect),
            st.binary(max_size=64),
        )
    )
    def check(octets: bytes) -> None:
        found = codec.dissect(octets)
        data = through_text(beacon_json(codec, found.root))
        assert set(data) <= {"bp", "payloads"}
        for problem in found.problems:
            assert through_text(problem_json(problem))["path"] == problem.path
        if not found.errors:
            assert plain(beacon_from_json(codec, data)) == plain(codec.decode(octets))

    check()


def test_arbitrary_json(codec: Codec) -> None:
    """Any JSON document is a beacon or causes an EncodeError."""
    member = (
        "bp payloads senderId seqno networkId protocolId vardis srp data icType records varId value descr descrHex spec"
    )
    names = st.sampled_from(member.split())
    leaves = st.one_of(
        st.none(), st.booleans(), st.integers(), st.sampled_from([1, 2, 5]), st.floats(), st.text(max_size=6)
    )
    documents = st.recursive(
        leaves,
        lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(names, inner, max_size=6)),
        max_leaves=12,
    )

    @settings(max_examples=examples(60))
    @given(documents)
    def check(document: Any) -> None:
        try:
            beacon = beacon_from_json(codec, document)
        except EncodeError as error:
            text = str(error)
        else:
            assert isinstance(beacon, Beacon)
            return
        assert text

    check()


@settings(max_examples=examples(60))
@given(data=st.data())
def test_one_replaced_member(data: st.DataObject) -> None:
    """A good object with one member replaced or removed is encoded, or refused by a path near that member."""
    codec = get_codec(data.draw(st.sampled_from(["cpp-2.0", "dcp-1.0", "student-2024"])))
    document = value_json(codec, data.draw(strategies.beacons(codec)))
    where = document
    steps: list[Any] = []
    while isinstance(where, dict | list) and where and (not steps or data.draw(st.booleans())):
        steps.append(data.draw(st.sampled_from(list(where) if isinstance(where, dict) else list(range(len(where))))))
        parent, where = where, where[steps[-1]]
    if data.draw(st.booleans()):
        del parent[steps[-1]]
    else:
        parent[steps[-1]] = data.draw(st.sampled_from([None, True, -1, 1 << 70, 1.5, "", "zz", "00", [], {}, [{}]]))
    try:
        octets = codec.encode(beacon_from_json(codec, document))
    except EncodeError as error:
        path = error.path
    else:
        assert codec.encode(codec.decode(octets)) == octets
        return
    assert path.split(".")[0].split("[")[0] in ("bp", "payloads")


# -- single members -----------------------------------------------------------------------------------------------


def document() -> dict[str, Any]:
    """A beacon of cpp-2.0 with a payload of each kind."""
    codec = get_codec("cpp-2.0")
    report = ExtendedSafetyData(codec.safety_data_type(1.0, 2.0, 3.0), SENDER, 5, 6)
    create = VarCreate(VarSpec(7, PRODUCER, 2, b"pos", 1, 0), VarUpdate(7, 3, b"AB"))
    beacon = Beacon(
        BPHeader(SENDER, 41, 0x1111),
        (Payload(1, report), Payload(2, (Container(5, (create,)),)), Payload(0x7777, b"\xca\xfe")),
    )
    found: dict[str, Any] = through_text(value_json(codec, beacon))
    return found


_SPEC = ("payloads", 1, "vardis", 0, "records", 0, "spec")
_UPD = (*_SPEC[:-1], "upd")
_SRP = ("payloads", 0, "srp")
_RECORDS = "payloads[1].vardis[0].records"


def at(path: tuple[Any, ...], data: Any) -> Any:
    for step in path:
        data = data[step]
    return data


def refused(data: Any, profile: str = "cpp-2.0") -> EncodeError:
    with pytest.raises(EncodeError) as caught:
        beacon_from_json(get_codec(profile), data)
    return caught.value


def test_the_document_of_these_tests() -> None:
    data = document()
    assert data["payloads"][2] == {"protocolId": 0x7777, "length": 2, "data": "cafe"}
    assert at(_SPEC, data)["descr"] == "pos"
    codec = get_codec("cpp-2.0")
    assert value_json(codec, beacon_from_json(codec, data)) == data


@pytest.mark.parametrize(
    ("steps", "path"),
    [
        (("bp",), "bp"),
        (("payloads",), "payloads"),
        (("bp", "senderId"), "bp.senderId"),
        (("bp", "networkId"), "bp.networkId"),
        (("payloads", 0, "protocolId"), "payloads[0].protocolId"),
        (_SRP, "payloads[0].srp"),
        ((*_SRP, "sData"), "payloads[0].srp.sData"),
        ((*_SRP, "sData", "y"), "payloads[0].srp.sData.y"),
        ((*_SRP, "opaque38"), "payloads[0].srp.opaque38"),
        (("payloads", 1, "vardis"), "payloads[1].vardis"),
        (("payloads", 1, "vardis", 0, "icType"), "payloads[1].vardis[0].icType"),
        (("payloads", 1, "vardis", 0, "records"), "payloads[1].vardis[0].records"),
        (_SPEC, "payloads[1].vardis[0].records[0].spec"),
        ((*_SPEC, "descr"), "payloads[1].vardis[0].records[0].spec.descr"),
        ((*_SPEC, "creationTime"), "payloads[1].vardis[0].records[0].spec.creationTime"),
        ((*_UPD, "value"), "payloads[1].vardis[0].records[0].upd.value"),
        (("payloads", 2, "data"), "payloads[2].data"),
    ],
)
def test_missing(steps: tuple[Any, ...], path: str) -> None:
    data = document()
    del at(steps[:-1], data)[steps[-1]]
    error = refused(data)
    assert error.path == path
    assert error.why.startswith("is missing")


@pytest.mark.parametrize(
    ("steps", "value", "message"),
    [
        ((), [], ": needs an object, not a list"),
        (("bp",), 5, "bp: needs an object, not a number"),
        (("payloads",), {}, "payloads: needs a list, not an object"),
        (("payloads", 0), None, "payloads[0]: needs an object, not null"),
        (("bp", "seqno"), "41", "bp.seqno: needs an integer, not a string"),
        (("bp", "seqno"), 41.0, "bp.seqno: needs an integer, not a number"),
        (("bp", "seqno"), True, "bp.seqno: needs an integer, not a boolean"),
        (("bp", "senderId"), 5, "bp.senderId: needs octets as a hex string, not a number"),
        (("bp", "senderId"), "02:00:00:00:00:zz", "bp.senderId: '02:00:00:00:00:zz' is not hex"),
        (("bp", "senderId"), "020", "bp.senderId: '020' is not hex"),
        ((*_SRP, "sData", "x"), "far", "payloads[0].srp.sData.x: needs a number, not a string"),
        ((*_SRP, "sData", "x"), None, "payloads[0].srp.sData.x: needs a number, not null"),
        ((*_SRP, "opaque24"), 0, "payloads[0].srp.opaque24: needs octets as a hex string, not a number"),
        ((*_SPEC, "descr"), 5, "payloads[1].vardis[0].records[0].spec.descr: needs a string, not a number"),
        (
            (*_SPEC, "descr"),
            "\ud800",
            "payloads[1].vardis[0].records[0].spec.descr: contains a character that UTF-8 cannot encode",
        ),
        ((*_SPEC, "descrHex"), "c3 2", "payloads[1].vardis[0].records[0].spec.descrHex: 'c3 2' is not hex"),
        ((*_UPD, "value"), "ABC", "payloads[1].vardis[0].records[0].upd.value: 'ABC' is not hex"),
        (("payloads", 2, "data"), None, "payloads[2].data: needs octets as a hex string, not null"),
        (
            ("payloads", 1, "vardis", 0, "icType"),
            9,
            "payloads[1].vardis[0].records: icType 9 is not one of 1, 2, 3, 4, 5, 6",
        ),
        (("payloads", 2, "protocolId"), 2, "payloads[2].vardis: is missing"),
    ],
)
def test_wrong(steps: tuple[Any, ...], value: Any, message: str) -> None:
    data = document()
    if steps:
        at(steps[:-1], data)[steps[-1]] = value
    else:
        data = value
    error = refused(data)
    assert str(error).removeprefix("beacon") == message


def test_extra_fields_are_all_given_or_none() -> None:
    codec = get_codec("cpp-2.0")
    data = document()
    for name in ("opaque24", "opaque38", "opaque40", "opaque60"):
        del data["payloads"][0]["srp"][name]
    beacon = beacon_from_json(codec, data)
    assert beacon.payloads[0].srp is not None
    assert beacon.payloads[0].srp.extra == ()
    assert value_json(codec, beacon) == document()


def test_values_that_fit_no_field_are_found_by_the_encoder() -> None:
    codec = get_codec("cpp-2.0")
    for steps, value, path in (
        (("bp", "seqno"), 1 << 32, "bp.seqno"),
        (("bp", "senderId"), "0200", "bp.senderId"),
        ((*_UPD, "value"), "00" * 256, "payloads[1].vardis[0].records[0].upd.value"),
        ((*_SRP, "sData", "x"), 10**400, "payloads[0].srp.sData.x"),
    ):
        data = document()
        at(steps[:-1], data)[steps[-1]] = value
        with pytest.raises(EncodeError) as caught:
            codec.encode(beacon_from_json(codec, data))
        assert caught.value.path == path


# -- what JSON has no form of its own for ------------------------------------------------------------------------


@pytest.mark.req("DATA-08")
@pytest.mark.parametrize("descr", [b"\xc3\x28", b"\xff", b"pos\xed\xa0\x80", b"\x80abc"])
def test_description_that_is_not_utf8(descr: bytes) -> None:
    codec = get_codec("dcp-2.0")
    create = VarCreate(VarSpec(7, PRODUCER, 2, descr, 1, 0), VarUpdate(7, 3, b"AB"))
    beacon = Beacon(BPHeader(SENDER, 41, 0x1111), (Payload(2, (Container(5, (create,)),)),))
    data = through_text(value_json(codec, beacon))
    spec = data["payloads"][0]["vardis"][0]["records"][0]["spec"]
    assert "descr" not in spec
    assert spec["descrHex"] == descr.hex()
    assert beacon_from_json(codec, data) == beacon


@pytest.mark.parametrize(
    ("descr", "text"), [(b"", ""), (b"a\0b", "a\0b"), ("µm ☃ 𝄞".encode(), "µm ☃ 𝄞"), (b"\\xff", "\\xff")]
)
def test_description_that_is_utf8(descr: bytes, text: str) -> None:
    codec = get_codec("dcp-2.0")
    create = VarCreate(VarSpec(7, PRODUCER, 2, descr, 1, 0), VarUpdate(7, 3, b"AB"))
    beacon = Beacon(BPHeader(SENDER, 41, 0x1111), (Payload(2, (Container(5, (create,)),)),))
    data = through_text(value_json(codec, beacon))
    spec = data["payloads"][0]["vardis"][0]["records"][0]["spec"]
    assert spec["descr"] == text
    assert "descrHex" not in spec
    assert beacon_from_json(codec, data) == beacon


@pytest.mark.parametrize(("x", "text"), [(math.nan, "NaN"), (math.inf, "Infinity"), (-math.inf, "-Infinity")])
def test_floats_that_json_cannot_express(x: float, text: str) -> None:
    codec = get_codec("dcp-2.0")
    report = ExtendedSafetyData(codec.safety_data_type(x, -0.0, 1e300), SENDER, 5, 6)
    beacon = Beacon(BPHeader(SENDER, 41, 0x1111), (Payload(1, report),))
    data = through_text(value_json(codec, beacon))
    assert data["payloads"][0]["srp"]["sData"] == {"x": text, "y": -0.0, "z": 1e300}
    assert plain(beacon_from_json(codec, data)) == plain(beacon)


def test_an_integer_is_a_number_for_a_float() -> None:
    codec = get_codec("dcp-2.0")
    report = ExtendedSafetyData(codec.safety_data_type(1.0, 2.0, 3.0), SENDER, 5, 6)
    data = value_json(codec, Beacon(BPHeader(SENDER, 41, 0x1111), (Payload(1, report),)))
    data["payloads"][0]["srp"]["sData"]["x"] = 1
    assert codec.encode(beacon_from_json(codec, data))[22:30] == struct.pack(">d", 1.0)


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        (b"aa:bb:cc:dd:ee:ff", "aa:bb:cc:dd:ee:ff"),
        (b"", ""),
        ("Drohne ä".encode(), "Drohne ä"),
        (b"a\xffb", "a\\xffb"),
        (b"C:\\dir", "C:\\dir"),
        (b"a\\xffb", "a\\x5cxffb"),
        (b"\\\xff", "\\\\xff"),
        (b"\\x5\xff", "\\x5\\xff"),
    ],
)
def test_node_identifiers_as_text(octets: bytes, text: str) -> None:
    assert node_id_text(octets, "text") == text
    assert node_id_octets(text, "text") == octets


@settings(max_examples=examples(100))
@given(st.one_of(st.binary(max_size=12), st.text("\\x5cf0\xff", max_size=12).map(lambda text: text.encode("latin-1"))))
def test_node_identifiers_lose_nothing(octets: bytes) -> None:
    for representation in ("text", "mac", "hex"):
        assert node_id_octets(node_id_text(octets, representation), representation) == octets


def test_node_identifiers_of_varying_length_as_hex(tmp_path: Any) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('extends = "student-2024"\n[types.node_id]\nrepresentation = "hex"\n', encoding="utf-8")
    codec = Codec(path)
    create = VarCreate(VarSpec(7, b"\x00\xff\x41", 2, b"pos"), VarUpdate(7, 3, b"AB"))
    beacon = Beacon(None, (Payload(2, (Container(0, (create,), extra=(1, 2)),), extra=(b"drone1", b"\0", b"")),))
    data = through_text(value_json(codec, beacon))
    assert data["payloads"][0]["vardis"][0]["records"][0]["spec"]["prodId"] == "00ff41"
    assert plain(codec.decode(codec.encode(beacon_from_json(codec, data))).payloads[0].content) == plain(
        beacon.payloads[0].content
    )


def test_problems() -> None:
    problem = Problem("truncated", "bp.seqno", 14, 4, 1, "BP-HDR-08")
    assert problem_json(problem) == {
        "reason": "truncated",
        "path": "bp.seqno",
        "offset": 14,
        "needed": 4,
        "available": 1,
        "requirement": "BP-HDR-08",
    }
