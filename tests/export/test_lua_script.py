"""The Wireshark dissector as its user meets it: names, labels, the Info column, Decode As, profiles it must refuse."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from dcp_spec.profile.definition import Link, OwnField

from dcp_codec import Codec, get_codec
from dcp_codec.export.lua import wireshark_dissector
from dcp_codec.export.lua_text import literal, quoted

from .beacons import everything
from .wireshark import compare, tshark, write

pytestmark = pytest.mark.part("tools")

needs_tshark = pytest.mark.tool("tshark")


def show(codec: Codec, payload: bytes, tmp_path: Path, *arguments: str, link: Link | None = None) -> str:
    """Return the output of tshark for one beacon."""
    capture = write(tmp_path / "c.pcap", link or codec.profile.link, [payload])
    return tshark(wireshark_dissector(codec), capture, *arguments)


@pytest.fixture
def codec() -> Codec:
    return get_codec("cpp-2.0")


@pytest.fixture
def beacon(codec: Codec) -> bytes:
    return codec.encode(everything(codec))


@needs_tshark
def test_the_comparison_notices_errors_by_one(codec: Codec, beacon: bytes, tmp_path: Path) -> None:
    script = wireshark_dissector(codec)
    capture = write(tmp_path / "c.pcap", codec.profile.link, [beacon + bytes(9), beacon[:-1]])
    assert compare(codec, script, capture)[1] == []
    for line, wrong in (
        ("local range = s.buf(start, node.size)", "local range = s.buf(start + 1, node.size)"),
        ("local range = s.buf(start, #octets)", "local range = s.buf(start - 1, #octets)"),
        ("item:set_len(s.pos - start)", "item:set_len(s.pos - start + 1)"),
        ("range, s.base + found.offset", "range, found.offset"),
        ('node.order == "little" and tree.add_le or tree.add', "tree.add"),
    ):
        assert line in script
        assert compare(codec, script.replace(line, wrong), capture)[1] != [], wrong


@needs_tshark
def test_the_info_column_summarises_the_beacon(codec: Codec, beacon: bytes, tmp_path: Path) -> None:
    columns = ["-T", "fields", "-e", "_ws.col.Protocol", "-e", "_ws.col.Info"]
    said = "BP seqno 41 from 02:00:00:00:00:bb: SRP, VarDis [CREATE-VARIABLES 2, SUMMARIES 2, UPDATES 1, "
    said += "REQUEST-VARUPDATES 1, REQUEST-VARCREATES 3, DELETE-VARIABLES 1], protocol 99"
    assert show(codec, beacon, tmp_path, *columns) == f"DCP\t{said}\n"
    assert show(codec, beacon[:40], tmp_path, *columns).endswith(" SRP [beacon-overrun]\n")


@needs_tshark
def test_fields_can_be_filtered(codec: Codec, beacon: bytes, tmp_path: Path) -> None:
    filters = (
        "dcp.bp.seqno == 41",
        "dcp.bp.senderId == 02:00:00:00:00:bb",
        "dcp.payloads.protocolId == 99",
        "dcp.payloads.srp.sData.x == 0.125",
        "dcp.payloads.srp.tStamp.date > 2023-11-14",
        "dcp.payloads.vardis.icType == 6",
        'dcp.payloads.vardis.records.spec.descr == "pos"',
        "dcp.payloads.vardis.records.upd.value == 41:42:43:44",
        "dcp.payloads.vardis.records.upd.value.length == 4",
        "dcp.payloads.data == 00:ff:3f",
        "dcp.padding == 5",
        "!dcp.errors",
    )
    assert show(codec, beacon + bytes(5), tmp_path, "-Y", " && ".join(filters)) != ""
    inverted = " || ".join(f"!({each})" for each in filters)
    assert show(codec, beacon + bytes(5), tmp_path, "-Y", inverted) == ""


@needs_tshark
def test_errors_can_be_filtered(codec: Codec, beacon: bytes, tmp_path: Path) -> None:
    filters = ('dcp.errors.reason == "bad-version"', "dcp.errors.offset == 14", "dcp.expert.bad-version")
    assert show(codec, b"\x02" + beacon[1:], tmp_path, "-Y", " && ".join(filters)) != ""
    assert show(codec, beacon, tmp_path, "-Y", " || ".join(filters)) == ""


@needs_tshark
def test_the_tree_names_the_protocols_and_reads_time_stamps(codec: Codec, beacon: bytes, tmp_path: Path) -> None:
    tree = show(codec, beacon, tmp_path, "-V")
    for label in (
        "Drone Coordination Protocol, BP seqno 41",
        "Beaconing Protocol: seqno 41 from 02:00:00:00:00:bb",
        "State Reporting Protocol: report 77 of 02:00:00:00:00:bb",
        "VarDis container 2: SUMMARIES, 2 records",
        "Record 1: VarCreate, varId 7",
        "descr: Höhe °",
        "icType: SUMMARIES (1)",
        "protocolId: SRP (1)",
        "creationTime: 1700000000123456789 ns",
        "[date: Nov 14, 2023 22:13:20.123456789 UTC]",
        "creationTime: -5 ns",
    ):
        assert label in tree


@needs_tshark
def test_another_ether_type_is_decoded_as_dcp(codec: Codec, beacon: bytes, tmp_path: Path) -> None:
    link = Link(ether_type=0x606F)
    assert "DCP" not in show(codec, beacon, tmp_path, link=link)
    assert "BP seqno 41" in show(codec, beacon, tmp_path, "-d", "ethertype==0x606f,dcp", link=link)


@needs_tshark
def test_beacons_in_datagrams_are_decoded_as_dcp(codec: Codec, beacon: bytes, tmp_path: Path) -> None:
    link = Link(transport="udp", udp_port=4953)
    assert "BP seqno 41" in show(codec, beacon, tmp_path, "-d", "udp.port==4953,dcp", link=link)


@needs_tshark
def test_the_destination_port_makes_a_datagram_a_beacon(tmp_path: Path) -> None:
    codec = get_codec("student-2024")
    beacon = codec.encode(everything(codec))
    assert "VarDis [CREATE-VARIABLES 2" in show(codec, beacon, tmp_path)
    # The harness sends from port 5950.
    assert "DCP" not in show(codec, beacon, tmp_path, link=Link(transport="udp", udp_port=6000))


@needs_tshark
def test_names_and_titles_of_a_profile_are_not_executed_as_lua(tmp_path: Path) -> None:
    members = '{ name = "end", type = "i8", unit = "\\u00b5m" }, { name = "local", type = "u8" }'
    path = tmp_path / "own.toml"
    path.write_text(
        f'extends = "dcp-2.0"\nname = "own"\ntitle = "a\\nb --[[ ]]"\n[srp]\nsafety_data = [{members}]',
        encoding="utf-8",
    )
    codec = Codec(path)
    tree = show(codec, codec.encode(everything(codec)), tmp_path, "-V", "-Y", "dcp.payloads.srp.sData.local == 1")
    assert "end: 0 µm" in tree


def test_two_fields_with_one_name_are_refused(codec: Codec) -> None:
    # No profile file gets so far, but a profile made by a program can.
    header = ("protocolId", OwnField(name="srp", opaque=2), "length")
    profile = codec.profile
    own = msgspec.structs.replace(profile, bp=msgspec.structs.replace(profile.bp, payload_header=header))
    with pytest.raises(ValueError, match=r"dcp\.payloads\.srp: rename one in the profile"):
        wireshark_dissector(Codec(own))


def test_lua_literals() -> None:
    assert quoted('a"b\\c\n\té\0' + "7") == r'"a\"b\\c\n\009\195\169\0007"'
    assert (
        literal({"a": 1, "b c": True, 7: [], "end": None, "not": "x"})
        == '{ a = 1, ["b c"] = true, [7] = {}, ["not"] = "x" }'
    )
    assert literal([{"name": "n" * 60}, {"name": "m" * 60}]).count("\n") == 3
    with pytest.raises(TypeError, match="no Lua literal for float"):
        literal(1.5)
