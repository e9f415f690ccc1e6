"""Profiles: the built-in ones, files that extend them, and everything that can be wrong with a file."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from dcp_spec.profile.definition import IntType, NodeIdType, Profile
from dcp_spec.profile.loading import ProfileError, load_profile, profile_names
from dcp_spec.profile.rules import header_size, srp_record_size
from dcp_spec.wire.schema import build_schema
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ..chance import examples

WriteProfile = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> WriteProfile:
    def write_profile(text: str) -> Path:
        path = tmp_path / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write_profile


def refusal(name_or_path: str | Path) -> str:
    """Why a profile is refused."""
    with pytest.raises(ProfileError) as caught:
        load_profile(name_or_path)
    return str(caught.value)


# -- the built-in profiles ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", profile_names())
def test_builtin(name: str) -> None:
    profile = load_profile(name)
    assert profile.name == name
    assert profile.title
    assert load_profile(name) is profile
    assert build_schema(profile).profile is profile


def test_names_lists_all_profiles() -> None:
    assert profile_names() == (
        *("dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0"),
        *("cpp-1.2", "cpp-1.3", "cpp-2.0", "sim-1.0", "sim-2.0", "student-2024"),
    )


@pytest.mark.req("BP-HDR-10", "BP-HDR-05")
@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("dcp-1.0", 14),
        ("dcp-1.1", 14),
        ("dcp-1.2", 16),
        ("dcp-1.3", 16),
        ("dcp-2.0", 18),
        ("cpp-1.2", 16),
        ("cpp-1.3", 16),
        ("cpp-2.0", 18),
        ("sim-1.0", 14),
        ("sim-2.0", 18),
        ("student-2024", 0),
    ],
)
def test_header_sizes(name: str, size: int) -> None:
    assert header_size(load_profile(name)) == size


@pytest.mark.req("SRP-TYP-02", "SRP-TYP-03")
@pytest.mark.parametrize(
    ("name", "size"),
    [("dcp-2.0", 42), ("cpp-1.2", 40), ("cpp-1.3", 64), ("cpp-2.0", 64), ("sim-2.0", 66), ("student-2024", None)],
)
def test_report_sizes(name: str, size: int | None) -> None:
    assert srp_record_size(load_profile(name)) == size


def test_header_fields() -> None:
    assert load_profile("dcp-2.0").has_header_field("networkId")
    assert not load_profile("dcp-1.3").has_header_field("networkId")
    assert not load_profile("dcp-1.1").has_header_field("length")


# -- files of one's own -------------------------------------------------------------------------------------------


def test_extending_inherits_missing_keys(write: WriteProfile) -> None:
    path = write('extends = "cpp-2.0"\nname = "mine"\n[types]\nvar_id = { width = 2 }\n[bp]\nnetwork_id = 7\n')
    mine, base = load_profile(path), load_profile("cpp-2.0")
    assert mine.name == "mine"
    assert mine.types == msgspec.structs.replace(base.types, var_id=IntType(width=2))
    assert mine.bp == msgspec.structs.replace(base.bp, network_id=7)
    assert (mine.srp, mine.vardis, mine.limits) == (base.srp, base.vardis, base.limits)
    assert load_profile(str(path)) == mine


def test_extending_a_file_beside_it(tmp_path: Path, write: WriteProfile) -> None:
    (tmp_path / "base.toml").write_text('extends = "dcp-1.3"\nname = "base"\n[bp]\nnetwork_id = 5\n', encoding="utf-8")
    profile = load_profile(write('extends = "base.toml"\ntitle = "Mine"\n'))
    assert (profile.name, profile.title, profile.bp.network_id) == ("base", "Mine", 5)
    assert profile.bp.header == load_profile("dcp-1.3").bp.header


def test_a_table_inside_a_table_is_merged_key_by_key(write: WriteProfile) -> None:
    profile = load_profile(write('extends = "dcp-2.0"\n[types.timestamp]\nbyte_order = "little"\n'))
    assert profile.types.timestamp.byte_order == "little"
    assert profile.types.timestamp.unit == "ns"
    # A list is replaced as a whole.
    profile = load_profile(write('extends = "dcp-2.0"\n[srp]\nsafety_data = [{ name = "a", type = "u8" }]\n'))
    assert [member.name for member in profile.srp.safety_data] == ["a"]


def test_extending_does_not_change_the_base(write: WriteProfile) -> None:
    before = load_profile("dcp-2.0")
    load_profile(write('extends = "dcp-2.0"\n[types]\nvar_id = { width = 4 }\n'))
    assert load_profile("dcp-2.0") == before
    assert load_profile("dcp-2.0").types.var_id.width == 1


def test_a_full_profile_survives_a_round_trip(write: WriteProfile) -> None:
    """A profile written out in full is read back unchanged."""
    for name in profile_names():
        profile = load_profile(name)
        data = msgspec.to_builtins(profile)
        assert msgspec.convert(data, Profile) == profile
    assert load_profile(write(_FULL)).types.node_id == NodeIdType(width=4, representation="hex")


_FULL = """
name = "full"
title = "Without a base"
spec_version = "1.1"
[link]
ether_type = 0x88B5
[types]
node_id = { width = 4, representation = "hex" }
[bp]
header = ["version", "magicNo", "senderId", "numPayloads", "seqno"]
[srp]
safety_data = [{ name = "x", type = "u8" }]
[vardis]
var_spec = ["varId", "prodId", "repCnt", "descr"]
[vardis.container_types]
SUMMARIES = 1
UPDATES = 2
REQUEST-VARUPDATES = 3
REQUEST-VARCREATES = 4
CREATE-VARIABLES = 5
DELETE-VARIABLES = 6
"""


# -- profiles that are not there, files that are none ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "meant"), [("cpp2.0", "cpp-2.0"), ("dcp_2.0", "dcp-2.0"), ("student", "student-2024")]
)
def test_unknown_name_with_suggestion(name: str, meant: str) -> None:
    message = refusal(name)
    assert f"unknown profile {name!r}: did you mean " in message
    assert meant in message


def test_unknown_name_without_suggestion() -> None:
    message = refusal("zzz")
    assert message.startswith("unknown profile 'zzz': the built-in ones are: dcp-1.0, ")
    assert "path to a .toml file" in message


def test_no_such_file(tmp_path: Path) -> None:
    path = tmp_path / "missing.toml"
    assert refusal(path) == f"{path}: cannot be read: No such file or directory"


@pytest.mark.parametrize("name", ["folder", "folder.toml"])
def test_directory(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.mkdir()
    assert refusal(path) == f"{path}: cannot be read: Is a directory"


def test_file_in_a_file(write: WriteProfile) -> None:
    path = write("") / "below.toml"
    assert refusal(path) == f"{path}: cannot be read: Not a directory"


@pytest.mark.parametrize("name", ["a\0b.toml", "a\ud800.toml"])
def test_names_that_no_file_can_have(name: str) -> None:
    assert refusal(name).startswith(f"{name!r}: cannot be read: ")


@pytest.mark.parametrize("name", ["x" * 5000, "x" * 5000 + ".toml", "\0", ""])
def test_other_strange_names(name: str) -> None:
    assert refusal(name)


@pytest.mark.parametrize(
    "octets",
    [
        b"name = ",
        b"\xff\xfe",
        b"\x89MCAP0\r\n",
        b"= 1",
        b"[types",
        b'name = "a"\nname = "b"',
        b"a = " + b"[" * 5000 + b"]" * 5000,
        b"a = " + b"9" * 5000,
        b"a = 1979-13-41",
    ],
)
def test_not_toml(tmp_path: Path, octets: bytes) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(octets)
    assert refusal(path).startswith(f"{path}: this is not a TOML file: ")


def test_extends_in_a_circle(tmp_path: Path) -> None:
    for name, other in (("a", "b"), ("b", "a")):
        (tmp_path / f"{name}.toml").write_text(f'extends = "{other}.toml"\n', encoding="utf-8")
    assert "extends goes round in a circle or deeper than 8 files" in refusal(tmp_path / "a.toml")


def test_extends_itself(write: WriteProfile) -> None:
    assert "mine.toml: extends goes round in a circle" in refusal(write('extends = "mine.toml"'))


@pytest.mark.parametrize("value", ["5", "true", '["dcp-2.0"]', "{ name = 1 }"])
def test_extends_of_a_wrong_type(write: WriteProfile, value: str) -> None:
    path = write(f"extends = {value}")
    assert refusal(path).startswith(f"{path}: extends must be the name of a profile or the path of a file, not ")


def test_extends_a_missing_profile(write: WriteProfile, tmp_path: Path) -> None:
    path = write('extends = "dcp-9.9"')
    assert refusal(path).startswith(
        f"{path}: extends = 'dcp-9.9' is neither a built-in profile nor a .toml file; expected one of dcp-1.0, "
    )
    path = write('extends = "other.toml"')
    assert refusal(path) == f"{tmp_path / 'other.toml'}: cannot be read: No such file or directory"


# -- keys and types ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("typo = 1", "Object contains unknown field `typo`; remove it or correct its name"),
        ("[types]\nvarid = 1", "Object contains unknown field `varid` in [types]; remove it or correct its name"),
        (
            "[types.var_id]\nwidht = 1",
            "Object contains unknown field `widht` in [types.var_id]; remove it or correct its name",
        ),
        ("[types]\nvar_id = { width = 0 }", "types.var_id.width: Expected `int` >= 1"),
        ("[types]\nvar_id = { width = 9 }", "types.var_id.width: Expected `int` <= 8"),
        ('[types]\nvar_id = { width = "1" }', "types.var_id.width: Expected `int`, got `str`"),
        ("[types]\nvar_id = 1", "types.var_id: Expected `object`, got `int`"),
        (
            '[types]\nvar_id = { width = 1, byte_order = "middle" }',
            "types.var_id.byte_order: Invalid enum value 'middle'",
        ),
        ("types = []", "types: Expected `object`, got `array`"),
        (
            'spec_version = "3.0"',
            "spec_version = '3.0' is not a known version of the specification; expected one of 1.0, 1.1, 1.2, 1.3, 2.0",
        ),
        ("spec_version = 2.0", 'spec_version = 2.0 is not a known version of the specification; write "2.0"'),
        (
            "spec_version = 2.1",
            "spec_version = 2.1 is not a known version of the specification; expected one of 1.0, 1.1, 1.2, 1.3, 2.0",
        ),
        ("name = 1", "name: Expected `str`, got `int`"),
        ('[bp]\nheader = "version"', "bp.header: Expected `array`, got `str`"),
        ("[bp]\npayload_area = 65536", "bp.payload_area: Expected `int` <= 65535"),
        ("[bp]\nnetwork_id = -1", "bp.network_id: Expected `int` >= 0"),
        ("[link]\nether_type = 100", "link.ether_type: Expected `int` >= 1536"),
        ("[vardis.container_types]\nSUMMARIES = 256", "vardis.container_types.SUMMARIES: Expected `int` <= 255"),
        ("[limits]\nmax_variables = 0", "limits.max_variables: Expected `int` >= 1"),
        (
            '[srp]\nrecord = ["sData", "nodeId", "tStamp", "seqno", { opaque = 65536, name = "gap" }]',
            "srp.record[4].opaque: Expected `int` <= 65535",
        ),
    ],
)
def test_keys_and_types(write: WriteProfile, text: str, message: str) -> None:
    path = write(f'extends = "dcp-2.0"\n{text}\n')
    assert refusal(path) == f"{path}: {message}"


@pytest.mark.parametrize("key", ["name", "title", "spec_version", "bp", "vardis"])
def test_required_keys(write: WriteProfile, key: str) -> None:
    data = tomllib.loads(_FULL)
    del data[key]
    with pytest.raises(ProfileError, match=f"missing required field `{key}`"):
        load_profile(write(toml(data)))


# -- contradictions ---------------------------------------------------------------------------------------------------

_HEADER_20 = '["version", "magicNo", "senderId", "networkId", "length", "numPayloads", "seqno"]'


def _record(more: str) -> str:
    return f'[srp]\nrecord = ["sData", "nodeId", "tStamp", "seqno", {more}]'


@pytest.mark.parametrize(
    ("base", "text", "message"),
    [
        ("dcp-2.0", 'name = ""', "name = '': needs characters"),
        ("dcp-2.0", 'name = "a\\u0000b"', "name = 'a\\x00b': needs characters"),
        (
            "dcp-2.0",
            '[bp]\nheader = ["version", "magicNo", "sender"]',
            "bp.header has 'sender'; expected one of version, magicNo, senderId, networkId",
        ),
        ("dcp-2.0", f'[bp]\nheader = {_HEADER_20[:-1]}, "seqno"]', "bp.header lists 'seqno' twice"),
        ("dcp-2.0", '[bp]\nheader = ["version"]', "bp.header lacks magicNo (BP-HDR-10)"),
        (
            "dcp-1.2",
            '[bp]\nheader = ["version", "magicNo", "senderId", "numPayloads", "seqno"]',
            "bp.header lacks length, which specification 1.2 has (BP-HDR-06)",
        ),
        (
            "dcp-2.0",
            '[bp]\nheader = ["version", "magicNo", "senderId", "length", "numPayloads", "seqno"]',
            "bp.header lacks networkId, which specification 2.0 has (BP-HDR-04)",
        ),
        (
            "dcp-2.0",
            '[types]\nnode_id = { width = 0, representation = "text", length = { width = 1 } }',
            "types.node_id.length: a sender identifier in the header has a fixed width (DATA-04)",
        ),
        (
            "dcp-2.0",
            "[types]\nnetwork_id = { width = 1 }\n[bp]\nnetwork_id = 1",
            "types.network_id.width = 1: at least 2 octets are required (BP-HDR-05)",
        ),
        (
            "dcp-2.0",
            "[bp]\nnetwork_id = 65536",
            "bp.network_id = 0x10000 does not fit types.network_id.width = 2 octets",
        ),
        (
            "dcp-2.0",
            '[bp]\npayload_header = ["protocolId"]',
            "bp.payload_header needs protocolId and length (BP-HDR-11)",
        ),
        ("dcp-2.0", '[bp]\npayload_header = ["protocolId", "size"]', "bp.payload_header has 'size'; expected one of"),
        ("dcp-1.1", '[bp]\nlength_means = "header-size"', "bp.length_means is set but bp.header has no length"),
        (
            "sim-2.0",
            '[types]\nbp_length = { width = 1 }\nnode_id = { width = 245, representation = "hex" }',
            "types.bp_length.width = 1: cannot state a header of 256 octets",
        ),
        (
            "dcp-2.0",
            "[types]\nmagic_no = { width = 1 }",
            "types.magic_no.width = 1: the magic number 0x497e needs 2 octets",
        ),
        ("dcp-2.0", "[srp]\nrecord = []\nrecord_size = 5", "srp.record_size = 5 but srp.record lists no field"),
        ("dcp-2.0", '[srp]\nrecord = ["sData", "nodeId", "seqno"]', "srp.record lacks tStamp (SRP-TYP-03)"),
        ("dcp-2.0", _record('"sData"'), "srp.record lists 'sData' twice"),
        ("dcp-2.0", _record('"time"'), "srp.record has 'time'; expected one of sData, nodeId, tStamp, seqno"),
        ("dcp-2.0", "[srp]\nsafety_data = []", "srp.safety_data lists no field"),
        ("dcp-2.0", "[srp]\nrecord_size = 43", "srp.record_size = 43 but the listed fields add up to 42 octets"),
        ("student-2024", "[srp]\nrecord_size = 43", "srp.record_size is set but a field of srp.record has"),
        (
            "dcp-2.0",
            '[srp]\nsafety_data = [{ name = "x", type = "opaque" }]',
            "srp.safety_data: octets belongs to the type opaque, and only there (field 'x')",
        ),
        (
            "dcp-2.0",
            '[srp]\nsafety_data = [{ name = "x", type = "u8", octets = 2 }]',
            "srp.safety_data: octets belongs to the type opaque, and only there (field 'x')",
        ),
        (
            "dcp-2.0",
            '[srp]\nsafety_data = [{ name = "x", type = "u8", role = "position.x" },'
            ' { name = "y", type = "u8", role = "position.x" }]',
            "srp.safety_data: two fields have the role position.x",
        ),
        ("dcp-2.0", '[srp]\nsafety_data = [{ name = "class", type = "u8" }]', "field name 'class' is not a plain name"),
        ("dcp-2.0", '[srp]\nsafety_data = [{ name = "a b", type = "u8" }]', "field name 'a b' is not a plain name"),
        ("dcp-2.0", '[srp]\nsafety_data = [{ name = "_x", type = "u8" }]', "field name '_x' is not a plain name"),
        ("dcp-2.0", '[srp]\nsafety_data = [{ name = "\\ufb01", type = "u8" }]', "field name 'ﬁ' is not a plain name"),
        (
            "dcp-2.0",
            '[srp]\nsafety_data = [{ name = "extra", type = "u8" }]',
            "srp.safety_data: field name 'extra' is taken",
        ),
        (
            "dcp-2.0",
            '[srp]\nsafety_data = [{ name = "x", type = "u8" }, { name = "x", type = "u8" }]',
            "srp.safety_data: field name 'x' is used twice",
        ),
        ("dcp-2.0", _record('{ opaque = 2, name = "x" }'), "srp: field name 'x' is used twice"),
        ("dcp-2.0", _record('{ opaque = 2, name = "seqno" }'), "srp.record: field name 'seqno' is taken (seqno)"),
        ("dcp-2.0", _record('{ opaque = 2, name = "s_data" }'), "srp.record: field name 's_data' is taken (sData)"),
        (
            "dcp-2.0",
            '[bp]\npayload_header = ["protocolId", { opaque = 2, name = "content" }, "length"]',
            "bp.payload_header: field name 'content' is taken (content)",
        ),
        (
            "dcp-2.0",
            '[vardis]\ncontainer_extra = [{ extra = { width = 1 }, name = "records" }]',
            "vardis.container_extra: field name 'records' is taken (records)",
        ),
        (
            "dcp-2.0",
            "[vardis]\ncontainer_extra = ["
            '{ extra = { width = 1 }, name = "a" }, { extra = { width = 1 }, name = "a" }]',
            "vardis.container_extra: field name 'a' is used twice",
        ),
        ("dcp-2.0", '[vardis]\nvar_spec = ["varId", "prodId", "repCnt"]', "vardis.var_spec lacks descr (VD-TYP-05)"),
        ("dcp-2.0", '[vardis]\nvar_spec = ["id"]', "vardis.var_spec has 'id'; expected one of varId, prodId"),
        (
            "dcp-2.0",
            '[vardis]\nvar_spec = ["varId", "prodId", "repCnt", "descr"]',
            "vardis.var_spec lacks creationTime, which specification 2.0 has (VD-TYP-05)",
        ),
        (
            "dcp-1.3",
            '[vardis]\nvar_spec = ["varId", "prodId", "repCnt", "timeout", "descr"]',
            "vardis.var_spec has timeout, which came with specification 2.0, not 1.3",
        ),
        ("dcp-2.0", "[vardis.container_types]\nUPDATES = 1", "vardis.container_types uses the number 1 twice"),
        (
            "dcp-2.0",
            '[types]\nnode_id = { width = 0, representation = "hex" }',
            "types.node_id.width = 0: give a width of at least one octet or a length (DATA-04)",
        ),
        ("dcp-2.0", "[types]\nnode_id = { width = 8 }", "types.node_id: representation mac has 6 octets, not 8"),
        (
            "student-2024",
            '[types]\nnode_id = { width = 6, representation = "mac" }',
            "types.node_id: representation mac has 6 octets and therefore no length",
        ),
        (
            "dcp-2.0",
            '[types]\nnode_id = { representation = "text" }',
            "types.node_id: representation text needs a length",
        ),
        ("dcp-2.0", "[types]\nstring = { lengths = [] }", "types.string: needs a length or a terminator"),
        (
            "dcp-2.0",
            "[types]\nvalue = { lengths = [], terminated = true }",
            "types.value: a value may hold any octet and therefore needs a length, not a terminator (DATA-06)",
        ),
        ("dcp-2.0", "[types]\nbp_length = { width = 2, signed = true }", "types.bp_length: a length cannot be signed"),
        (
            "dcp-2.0",
            "[types]\nstring = { lengths = [{ width = 2 }, { width = 1, signed = true }] }",
            "types.string.lengths: a length cannot be signed",
        ),
        (
            "dcp-2.0",
            "[types]\nvalue = { lengths = [{ width = 1, signed = true }] }",
            "types.value.lengths: a length cannot be signed",
        ),
        (
            "student-2024",
            "[vardis]\nlist_length = { width = 4, signed = true }",
            "vardis.list_length: a length cannot be signed",
        ),
        (
            "student-2024",
            "[types.node_id]\nlength = { width = 4, signed = true }",
            "types.node_id.length: a length cannot be signed",
        ),
        (
            "dcp-2.0",
            "[limits]\nmax_value_length = 256",
            "limits.max_value_length = 256 but the length field of that type can say 255 at most",
        ),
        (
            "sim-1.0",
            "[limits]\nmax_description_length = 255",
            "limits.max_description_length = 255 but the length field of that type can say 254 at most",
        ),
        ("dcp-2.0", '[link]\ntransport = "udp"', "link.udp_port is missing; UDP needs one (UWB-02)"),
        ("student-2024", '[link]\ntransport = "ethernet"', "link.ether_type is missing; Ethernet needs one (UWB-02)"),
        (
            "dcp-2.0",
            "[limits]\nuwb_max_packet = 255\nmax_beacon_size = 255",
            "limits.uwb_max_packet = 255: at least 256 octets are required (UWB-03)",
        ),
        (
            "dcp-2.0",
            "[limits]\nmax_beacon_size = 1501",
            "limits.max_beacon_size is larger than limits.uwb_max_packet (BP-PAR-04)",
        ),
    ],
)
def test_contradictions(write: WriteProfile, base: str, text: str, message: str) -> None:
    path = write(f'extends = "{base}"\n{text}\n')
    found = refusal(path)
    assert found.startswith(f"{path}: ")
    assert message in found


def test_all_contradictions_are_reported_at_once(write: WriteProfile) -> None:
    found = refusal(
        write('extends = "dcp-2.0"\n[types]\nnetwork_id = { width = 1 }\n[bp]\npayload_header = ["length"]\n')
    )
    assert found.count("; ") >= 2
    assert "types.network_id.width = 1" in found
    assert "bp.network_id = 0x1111 does not fit" in found
    assert "bp.payload_header needs protocolId and length" in found


# -- no other exception than ProfileError -----------------------------------------------------------------------------


def toml(data: dict[str, Any]) -> str:
    """``data`` as TOML, every member on a line of its own."""
    return "".join(f"{json.dumps(key)} = {_inline(value)}\n" for key, value in data.items())


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_inline(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return repr(value) if isinstance(value, int | float) and not isinstance(value, bool) else json.dumps(value)


_KEYS = st.sampled_from(
    [
        "name",
        "title",
        "spec_version",
        "extends",
        "link",
        "types",
        "bp",
        "srp",
        "vardis",
        "limits",
        "behaviour",
        "width",
        "node_id",
        "timestamp",
        "string",
        "lengths",
        "header",
        "payload_header",
        "record",
        "safety_data",
        "var_spec",
        "container_types",
        "length",
        "opaque",
        "extra",
        "type",
        "role",
        "transport",
        "zzz",
    ]
)
_SCALARS = st.one_of(
    st.integers(-(1 << 70), 1 << 70),
    st.integers(-1, 10),
    st.booleans(),
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from(["", "big", "u8", "2.0", "1.1", "varId", "nodeId", "sData", "length", "protocolId", "f64", "udp"]),
)
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(_KEYS, inner, max_size=4)),
    max_leaves=8,
)


def load(folder: Path, octets: bytes) -> Profile | None:
    """The profile in a file of ``octets``, None if it is refused; anything but ProfileError fails the test."""
    path = folder / "mine.toml"
    path.write_bytes(octets)
    try:
        return load_profile(path)
    except ProfileError as error:
        message = str(error)
    assert message.startswith(f"{folder}/")
    return None


_OCTETS = st.one_of(st.binary(max_size=60), st.text(max_size=60).map(lambda text: text.encode(errors="replace")))


def test_arbitrary_octets(tmp_path: Path) -> None:
    """Octets are refused, or they are TOML that extends a profile: they are too few to define a whole one."""

    @settings(max_examples=examples(100))
    @given(st.sampled_from([b"", *(f'extends="{name}"\n'.encode() for name in profile_names())]), _OCTETS)
    @example(b'extends="dcp-1.0"', b"")
    @example(b'extends="dcp-1.0"\n', b"# and nothing else")
    def check(start: bytes, rest: bytes) -> None:
        found = load(tmp_path, start + rest)
        if found is not None:
            table = tomllib.loads((start + rest).decode())
            assert table.keys() >= {"extends"}
            assert build_schema(found).profile is found
            if table.keys() == {"extends"}:
                assert msgspec.structs.replace(found, name="") == msgspec.structs.replace(
                    load_profile(table["extends"]), name=""
                )

    check()
    assert load(tmp_path, b'extends="dcp-1.0"') is not None


def test_arbitrary_tables(tmp_path: Path) -> None:
    @settings(max_examples=examples(200))
    @given(st.dictionaries(_KEYS, _VALUES, max_size=6), st.sampled_from([{}, {"extends": "dcp-2.0"}]))
    def check(data: dict[str, Any], base: dict[str, Any]) -> None:
        load(tmp_path, toml({**data, **base}).encode())

    check()


def places(data: Any, steps: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The ways to everything inside of ``data``."""
    found: list[tuple[Any, ...]] = []
    inside = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in inside:
        found.append((*steps, key))
        found.extend(places(value, (*steps, key)))
    return found


def put(data: Any, steps: tuple[Any, ...], value: Any) -> None:
    """Replace what ``steps`` lead to."""
    for step in steps[:-1]:
        data = data[step]
    data[steps[-1]] = value


def without_none(data: Any) -> Any:
    """TOML has no null; what is None is left out."""
    if isinstance(data, dict):
        return {key: without_none(value) for key, value in data.items() if value is not None}
    return [without_none(value) for value in data] if isinstance(data, list | tuple) else data


def test_one_changed_value(tmp_path: Path) -> None:
    """A good profile with one value replaced is a profile with a schema, or a ProfileError."""

    @settings(max_examples=examples(300))
    @given(st.sampled_from(profile_names()), st.data(), _VALUES)
    def check(name: str, data: st.DataObject, value: Any) -> None:
        profile = without_none(msgspec.to_builtins(load_profile(name)))
        put(profile, data.draw(st.sampled_from(places(profile))), value)
        found = load(tmp_path, toml(profile).encode())
        if found is not None:
            assert build_schema(found).profile is found

    check()


def test_the_writer_of_these_tests(tmp_path: Path) -> None:
    """Profiles written by these tests are read back unchanged."""
    for name in profile_names():
        text = toml(without_none(msgspec.to_builtins(load_profile(name))))
        assert load(tmp_path, text.encode()) == load_profile(name)
