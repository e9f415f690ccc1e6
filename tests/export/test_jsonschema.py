"""The schemas take everything that is printed, and nothing that is not."""

from __future__ import annotations

import copy
import json
import math
import random
import tomllib
from pathlib import Path

import jsonschema
import msgspec
import pytest
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.profile.loading import load_profile

from dcp_codec import Codec, get_codec
from dcp_codec.capture import Frame, open_capture
from dcp_codec.export.example import example_beacon
from dcp_codec.export.jsonschema import (
    beacon_schema,
    container_group,
    frame_schema,
    record_group,
    record_schema,
    schema_octets,
)
from dcp_codec.framing.frames import FrameDissector
from dcp_codec.jsonform import value_json
from dcp_codec.values import (
    Beacon,
    Container,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)

from ..odd_profiles import BUILT_IN
from ..parts import every

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
RECORDINGS = tomllib.loads((CAPTURES / "manifest.toml").read_text())["capture"]


def validator(schema):
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def assert_valid(check, instance):
    """Check ``instance`` after printing and reading it again."""
    found = next(check.iter_errors(json.loads(json.dumps(instance, allow_nan=False))), None)
    assert found is None, f"{found.json_path}: {found.message}"


def report_schema(codec: Codec):
    plan = codec.srp_plan
    return None if plan is None else record_schema(codec, record_group(plan), "One SRP payload.")


def container_schema(codec: Codec):
    return record_schema(codec, container_group(codec), "One instruction container.")


# -- random beacons ---------------------------------------------------------------------------------------------


def random_beacon(codec: Codec, seed: int) -> Beacon:
    rnd = random.Random(seed)
    base = example_beacon(codec)
    payloads = [payload for payload in base.payloads if payload.srp is None]
    if codec.report_plan is not None:
        payloads.append(Payload(BP_PROTID_SRP, random_report(codec, rnd, base.payloads[0].srp)))
    payloads.append(Payload(BP_PROTID_VARDIS, tuple(random_container(codec, rnd, name) for name in RECORDS)))
    payloads.append(Payload(0xC8, rnd.randbytes(rnd.randrange(20))))
    rnd.shuffle(payloads)
    return msgspec.structs.replace(base, payloads=tuple(payloads))


def random_report(codec: Codec, rnd: random.Random, like: ExtendedSafetyData) -> ExtendedSafetyData:
    values = {}
    for member in codec.profile.srp.safety_data:
        if member.type.startswith("f"):
            values[member.name] = rnd.choice([math.nan, math.inf, -math.inf, 0.0, -1.5, rnd.random()])
        else:
            values[member.name] = rnd.randrange(128)
    return msgspec.structs.replace(like, s_data=codec.safety_data_type(**values), seqno=rnd.randrange(2**32))


def random_spec(codec: Codec, rnd: random.Random) -> VarSpec:
    like = next(p for p in example_beacon(codec).payloads if p.vardis).vardis[0].records[0].spec
    descr = rnd.choice([b"", b"height", "Höhe".encode(), b"\xff\xfe", b"x" * 100])
    return msgspec.structs.replace(like, var_id=rnd.randrange(256), descr=descr)


RECORDS = {
    "CREATE-VARIABLES": lambda codec, rnd: VarCreate(random_spec(codec, rnd), RECORDS["UPDATES"](codec, rnd)),
    "DELETE-VARIABLES": lambda codec, rnd: VarDelete(rnd.randrange(256)),
    "UPDATES": lambda codec, rnd: VarUpdate(rnd.randrange(256), rnd.randrange(256), rnd.randbytes(rnd.randrange(9))),
    "SUMMARIES": lambda codec, rnd: VarSumm(rnd.randrange(256), rnd.randrange(256)),
    "REQUEST-VARUPDATES": lambda codec, rnd: VarReqUpdate(rnd.randrange(256), rnd.randrange(256)),
    "REQUEST-VARCREATES": lambda codec, rnd: VarReqCreate(rnd.randrange(256)),
}


def random_container(codec: Codec, rnd: random.Random, name: str) -> Container:
    number = codec.profile.vardis.container_types.by_name()[name]
    return Container(number, tuple(RECORDS[name](codec, rnd) for _ in range(rnd.randrange(1, 3))))


# -- what is printed fits -----------------------------------------------------------------------------------------


@pytest.mark.part("suite")
@pytest.mark.parametrize("recording", every(4, RECORDINGS), ids=lambda recording: recording["file"])
def test_every_frame_of_the_recordings_fits(recording):
    codec = get_codec(recording["profile"])
    check, dissector = validator(frame_schema(codec)), FrameDissector(codec)
    beacon = validator(beacon_schema(codec))
    with open_capture(CAPTURES / recording["file"]) as reader:
        for number, frame in enumerate(reader):
            printed = dissector.dissect(frame).as_json()
            assert_valid(check, printed)
            if number % 20 == 0:
                assert_valid(beacon, {"bp": printed["bp"], "payloads": printed["payloads"]})
    assert number + 1 == recording["frames"]


@pytest.mark.parametrize("profile", every(11, BUILT_IN))
def test_beacons_of_every_profile_fit(profile):
    codec = get_codec(profile)
    check = validator(beacon_schema(codec))
    report, container = report_schema(codec), validator(container_schema(codec))
    assert (report is None) == (codec.srp_plan is None)
    frame = validator(frame_schema(codec))
    dissector = FrameDissector(codec)
    for beacon in (example_beacon(codec), *(random_beacon(codec, seed) for seed in range(20))):
        printed = value_json(codec, beacon)
        assert_valid(check, printed)
        for payload in printed["payloads"]:
            if "srp" in payload:
                assert_valid(validator(report), payload["srp"])
            for each in payload.get("vardis", ()):
                assert_valid(container, each)
        octets = codec.encode(beacon)
        assert_valid(frame, dissector.dissect_bare(Frame(1, 0, octets, len(octets))).as_json())


@pytest.mark.parametrize("profile", every(11, BUILT_IN))
def test_malformed_frames_fit_too(profile):
    codec = get_codec(profile)
    check, dissector, rnd = validator(frame_schema(codec)), FrameDissector(codec), random.Random(1)
    malformed = 0
    for seed in range(60):
        octets = bytearray(codec.encode(random_beacon(codec, seed)))
        for _ in range(rnd.randrange(1, 5)):
            octets[rnd.randrange(len(octets))] = rnd.randrange(256)
        cut = bytes(octets[: rnd.randrange(len(octets) + 1)])
        printed = dissector.dissect_bare(Frame(1, 0, cut, len(cut))).as_json()
        malformed += bool(printed["errors"])
        assert_valid(check, printed)
    assert malformed > 20


def test_random_octets_fit():
    rnd = random.Random(2)
    for profile in ("cpp-2.0", "student-2024", "dcp-1.0"):
        check, dissector = validator(frame_schema(get_codec(profile))), FrameDissector(get_codec(profile))
        for _ in range(100):
            octets = rnd.randbytes(rnd.randrange(80))
            assert_valid(check, dissector.dissect_bare(Frame(1, 0, octets, len(octets))).as_json())


# -- what is not printed does not fit -----------------------------------------------------------------------------


def places(value, path=()):
    """Every member of every object below ``value``, with its path."""
    if isinstance(value, dict):
        for name, below in value.items():
            yield (*path, name), below
            yield from places(below, (*path, name))
    elif isinstance(value, list):
        for index, below in enumerate(value):
            yield from places(below, (*path, index))


def changed(whole, path, value):
    """A copy of ``whole`` with another value at ``path``; the member removed for Ellipsis."""
    whole = copy.deepcopy(whole)
    place = whole
    for step in path[:-1]:
        place = place[step]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return whole


#: Members that may be null, and numbers without an upper bound.
NULLABLE = {"src", "dst", "etherType"}
UNBOUNDED = {"frame", "padding"}
SIGNED = {"tStamp", "creationTime", "ieTimestamp"}


def wrong(name, value):
    """Values that must not stand where ``value`` does."""
    yield ...
    yield {"a": 1}
    if name not in NULLABLE:
        yield None
    if value in ("NaN", "Infinity", "-Infinity"):
        yield from ("nan", "1", [value], True)
        return
    if isinstance(value, (int, float)):
        yield from ("1", [1], True)
    if isinstance(value, int):
        yield 1.5
        if name not in SIGNED and not name.startswith(("position", "direction", "rotation")):
            yield -1
        if name not in UNBOUNDED:
            yield 2**70
    elif isinstance(value, str):
        yield from (7, [value])
        if name not in ("descr", "nodeId", "prodId"):
            yield from ("zz", value + "0", value.upper() + "AB")
    elif isinstance(value, list):
        yield from ("x", [7], [{}], {})
    elif isinstance(value, dict):
        yield from ([], 7, {**value, "more": 1})


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["cpp-2.0", "dcp-1.0", "sim-2.0", "student-2024"])
def test_every_change_to_a_frame_is_refused(profile):
    codec = get_codec(profile)
    check = validator(frame_schema(codec))
    octets = codec.encode(random_beacon(codec, 3))
    whole = FrameDissector(codec).dissect_bare(Frame(1, 5, octets, len(octets))).as_json()
    whole |= {"src": "02:00:00:00:00:01", "dst": "ff:ff:ff:ff:ff:ff", "etherType": 0x4953, "warnings": []}
    assert_valid(check, whole)
    tried = 0
    for path, value in places(whole):
        if "records" in path and path[path.index("records") + 1 :][:1] > (0,):
            continue  # as the first record of the list
        for other in wrong(path[-1], value):
            if path == ("errors",) and other == {"a": 1}:
                continue
            tried += 1
            assert not check.is_valid(changed(whole, path, other)), f"{path} = {other!r} was taken"
    assert tried > 300
    assert not check.is_valid({**whole, "more": 1})


def test_numbers_outside_their_field_are_refused():
    codec = get_codec("cpp-2.0")
    check = validator(beacon_schema(codec))
    beacon = value_json(codec, example_beacon(codec))
    for path, good, bad in [
        (("bp", "version"), 1, 2),
        (("bp", "magicNo"), 0x497E, 0x497F),
        (("bp", "networkId"), 0xFFFF, 0x10000),
        (("bp", "seqno"), 2**32 - 1, 2**32),
        (("bp", "numPayloads"), 255, 256),
        (("bp", "numPayloads"), 1, 0),
        (("bp", "length"), 1, 0),
        (("bp", "senderId"), "ff:ff:ff:ff:ff:ff", "ff:ff:ff:ff:ff"),
        (("payloads", 0, "srp", "opaque24"), "00" * 8, "00" * 7),
        (("payloads", 0, "srp", "tStamp"), -(2**63), 2**63),
        (("payloads", 0, "srp", "sData", "x"), "NaN", "nan"),
        (("payloads", 1, "vardis", 0, "records", 0, "upd", "value"), "00" * 255, "00" * 256),
        (("payloads", 1, "vardis", 0, "records", 0, "spec", "descr"), "x" * 255, "x" * 256),
    ]:
        assert_valid(check, changed(beacon, path, good))
        assert not check.is_valid(changed(beacon, path, bad)), path


def test_the_content_must_match_its_type():
    codec = get_codec("cpp-2.0")
    check = validator(beacon_schema(codec))
    beacon = value_json(codec, example_beacon(codec))
    srp, vardis = beacon["payloads"]
    for payload in (
        {**srp, "protocolId": 2},
        {**srp, "protocolId": 99},
        {**srp, "data": "00"},
        {**vardis, "protocolId": 1},
        {**vardis, "vardis": [{**vardis["vardis"][0], "icType": 1}]},
        {**vardis, "vardis": [{**vardis["vardis"][0], "icName": "UPDATES"}]},
        {**vardis, "vardis": [{**vardis["vardis"][0], "icType": 1, "icName": "SUMMARIES"}]},
        {**vardis, "vardis": [{**vardis["vardis"][0], "icType": 7, "icName": "OTHER"}]},
    ):
        assert not check.is_valid({**beacon, "payloads": [payload]}), payload
    assert_valid(check, {**beacon, "payloads": [{"protocolId": 99, "length": 1, "data": "00"}]})


def test_a_description_occurs_once():
    codec = get_codec("dcp-2.0")
    check = validator(container_schema(codec))
    container = value_json(codec, example_beacon(codec))["payloads"][1]["vardis"][0]
    spec = container["records"][0]["spec"]
    assert_valid(check, container)
    del spec["descr"]
    assert not check.is_valid(container)
    spec["descrHex"] = "ff"
    assert_valid(check, container)
    spec["descr"] = "ÿ"
    assert not check.is_valid(container)


# -- the documents themselves -------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", every(11, BUILT_IN))
def test_schemas_are_self_contained_and_documented(profile):
    codec = get_codec(profile)
    for schema in (frame_schema(codec), beacon_schema(codec), container_schema(codec), report_schema(codec)):
        if schema is None:
            continue
        assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
        assert schema["type"] == "object"
        assert schema["title"].startswith("dcp.")
        assert profile in schema["description"]
        text = schema_octets(schema).decode()
        assert json.loads(text) == schema
        for reference in text.split('"$ref":"')[1:]:
            assert reference.startswith("#/$defs/")
            assert reference.split('"')[0].removeprefix("#/$defs/") in schema["$defs"]
        for record in schema.get("$defs", {}).values():
            assert record["title"]
            assert all(member["description"] for member in record["properties"].values())


def test_descriptions_have_units_and_requirements():
    definitions = beacon_schema(get_codec("cpp-2.0"))["$defs"]
    spec = definitions["VarSpec"]["properties"]
    assert spec["timeout"]["description"].endswith(", in ms [VD-TYP-04]")
    assert spec["creationTime"]["description"].endswith(", in ns since 1970-01-01T00:00:00Z [VD-TYP-05]")
    assert definitions["SafetyData"]["properties"]["x"]["description"] == "position x, in m [SRP-TYP-02]"


def test_a_custom_profile(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        'extends = "dcp-2.0"\nname = "own"\ntitle = "Own"\n'
        '[types]\nnode_id = { width = 2, representation = "hex" }\nvar_id = { width = 3 }\n'
        "[srp]\nsafety_data = [{ name = 'h', type = 'f32' }, { name = 'rest', type = 'opaque', octets = 3 }]\n"
    )
    codec = Codec(load_profile(path))
    printed = value_json(codec, example_beacon(codec))
    check = validator(beacon_schema(codec))
    assert_valid(check, printed)
    for path, bad in [
        (("bp", "senderId"), "02:01"),
        (("payloads", 0, "srp", "sData", "h"), 1e39),
        (("payloads", 0, "srp", "sData", "rest"), "0000"),
        (("payloads", 1, "vardis", 0, "records", 0, "spec", "varId"), 2**24),
    ]:
        assert not check.is_valid(changed(printed, path, bad)), path
