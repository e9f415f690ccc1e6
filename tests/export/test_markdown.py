"""The tables render as such, and their bit offsets are those of the codec."""

from __future__ import annotations

import re

import pytest
from dcp_spec.profile.loading import load_profile, profile_names
from markdown_it import MarkdownIt

from dcp_codec import Codec, get_codec
from dcp_codec.export.example import annotated, example_beacon
from dcp_codec.export.markdown import format_tables
from dcp_codec.plan.tree import Group


def sections(text):
    """Heading -> the tables below it, each a list of rows, as a Markdown renderer sees them."""
    found: dict[str, list[list[list[str]]]] = {}
    heading, rows, tokens = "", [], MarkdownIt("commonmark").enable("table").parse(text)
    for index, token in enumerate(tokens):
        match token.type:
            case "heading_open":
                heading = tokens[index + 1].content
                found[heading] = []
            case "table_open":
                rows = []
                found[heading].append(rows)
            case "tr_open":
                rows.append([])
            case "inline" if rows and tokens[index - 1].type in ("td_open", "th_open"):
                rows[-1].append(token.content)
    return found


def record_tables(text):
    """Record -> field -> row, of the tables with bit offsets."""
    tables = {}
    for heading, (*_, table) in ((heading, found) for heading, found in sections(text).items() if found):
        if table[0][0] == "Field":
            tables[heading] = {row[0].strip("`"): dict(zip(table[0], row, strict=True)) for row in table[1:]}
    return tables


def test_members_that_are_records_have_a_requirement_and_a_meaning():
    tables = record_tables(format_tables(get_codec("dcp-2.0")))
    assert tables["VarCreate"]["spec"]["Requirement"] == "VD-TYP-07"
    assert tables["Payload"]["srp"]["Meaning"] == "if protocolId is 1: payload of the client protocol"
    assert tables["Container"]["records"]["Requirement"] == "VD-IC-01"


@pytest.mark.parametrize("profile", profile_names())
def test_every_line_of_a_table_is_rendered_as_one(profile):
    text = format_tables(get_codec(profile))
    found = sections(text)
    rows = [row for tables in found.values() for table in tables for row in table]
    assert len(rows) == sum(line.startswith("| ") for line in text.splitlines())
    for tables in found.values():
        for table in tables:
            assert {len(row) for row in table} == {len(table[0])}
    anchors = {heading.lower().replace(" ", "-") for heading in found}
    assert set(re.findall(r"\]\(#([^)]*)\)", text)) <= anchors
    assert text.endswith("\n")
    assert "\n\n\n" not in text


@pytest.mark.parametrize("profile", profile_names())
def test_columns_are_aligned_for_terminals(profile):
    for block in format_tables(get_codec(profile)).split("\n\n"):
        lines = block.splitlines()
        if lines[0].startswith("| Field"):
            assert len({len(line) for line in lines}) == 1


@pytest.mark.parametrize("profile", profile_names())
def test_bit_offsets_are_those_of_a_dissected_beacon(profile):
    codec = get_codec(profile)
    tables = record_tables(format_tables(codec))
    root = codec.dissect(codec.encode(example_beacon(codec))).root
    compared = 0
    for record in root.walk():
        if not isinstance(record.layout, Group):
            continue
        parts = {}
        for child in record.children:
            parts[child.name] = child
            parts |= {f"{child.name}.{part.name}": part for part in child.children}
        for name, row in tables[record.layout.type_name].items():
            if name not in parts:
                continue
            part = parts[name]
            place = re.fullmatch(r"(?:after (?P<previous>[^ ]+)(?: \+ )?)?(?P<bits>[0-9]*)", row["Bit offset"])
            start = record.offset
            if place["previous"]:
                before = next(parts[each] for each in place["previous"].split("/") if each in parts)
                start = before.offset + before.length
            assert part.offset == start + int(place["bits"] or 0) / 8, (record.path, name)
            if row["Bits"].isdigit():
                assert part.length * 8 == int(row["Bits"]), (record.path, name)
            compared += 1
    assert compared > 15
    assert set(tables) >= {"Beacon", "Payload", "Container", "VarSpec", "VarSumm", "VarDelete"}


def offsets(table):
    return [(name, row["Bit offset"], row["Bits"]) for name, row in table.items()]


def test_layout_of_the_cpp_implementation():
    tables = record_tables(format_tables(get_codec("cpp-2.0")))
    assert offsets(tables["BPHeader"]) == [
        ("version", "0", "8"),
        ("magicNo", "8", "16"),
        ("senderId", "24", "48"),
        ("networkId", "72", "16"),
        ("length", "88", "16"),
        ("numPayloads", "104", "8"),
        ("seqno", "112", "32"),
    ]
    assert offsets(tables["ExtendedSafetyData"]) == [
        ("sData", "0", "192"),
        ("opaque24", "192", "64"),
        ("nodeId", "256", "48"),
        ("opaque38", "304", "16"),
        ("opaque40", "320", "64"),
        ("tStamp", "384", "64"),
        ("seqno", "448", "32"),
        ("opaque60", "480", "32"),
    ]
    assert tables["ExtendedSafetyData"]["tStamp"]["Byte order"] == "little-endian"
    assert tables["ExtendedSafetyData"]["tStamp"]["Unit"] == "ns since 1970-01-01T00:00:00Z"
    assert tables["VarSpec"]["timeout"]["Unit"] == "ms"
    assert tables["BPHeader"]["magicNo"]["Meaning"].endswith("always 0x497E")
    assert tables["VarUpdate"]["value.data"]["Bits"] == "8 × value.length"


def test_offsets_after_variable_fields():
    tables = record_tables(format_tables(get_codec("student-2024")))
    assert offsets(tables["VarSpec"]) == [
        ("varId", "0", "8"),
        ("prodId.length", "8", "32"),
        ("prodId.data", "40", "8 × prodId.length"),
        ("repCnt", "after prodId", "8"),
        ("descr.length", "after prodId + 8", "32"),
        ("descr.data", "after prodId + 40", "8 × descr.length"),
    ]
    assert tables["Payload"]["area"]["Bit offset"] == "after vardis/srp/data"
    assert tables["Payload"]["area"]["Bits"] == "8 × (1000 - length)"


def test_the_document_names_numbers_limits_and_opaque_octets():
    text = format_tables(get_codec("student-2024"))
    found = sections(text)
    assert ["0", "CREATE-VARIABLES", "[VarCreate](#varcreate)"] in found["Containers"][0]
    assert ["`limits.max_repetitions`", "5"] in found["Limits and behaviour"][0]
    assert [row[1] for row in found["Octets without meaning"][0][1:]] == ["`droneName`", "`opaque7`", "`area`"]
    assert ["bearer", "UDP broadcast, port 5950"] in found["At a glance"][0]
    assert "Octets without meaning" not in sections(format_tables(get_codec("dcp-2.0")))
    assert ["bearer", "Ethernet II broadcast, EtherType 0x4953"] in sections(format_tables(get_codec("dcp-2.0")))[
        "At a glance"
    ][0]


def test_every_requirement_that_a_table_names_is_explained():
    text = format_tables(get_codec("cpp-2.0"))
    found = sections(text)
    named = {row["Requirement"] for table in record_tables(text).values() for row in table.values()} - {""}
    assert named <= {row[0] for row in found["Requirements"][0]}


@pytest.mark.parametrize("profile", profile_names())
def test_the_example_shows_every_octet_once(profile):
    codec = get_codec(profile)
    octets = codec.encode(example_beacon(codec))
    assert codec.decode(octets) == example_beacon(codec) or codec.encode(codec.decode(octets)) == octets
    assert not codec.dissect(octets).problems
    lines = list(annotated(codec, octets))[1:]
    offset = 0
    for line in lines:
        assert int(line.split()[0], 16) == offset
        shown = line[8:31].strip()
        path = line[33:].split()[0]
        field = codec.dissect(octets).root.find(path)
        if ".." not in shown:
            assert bytes.fromhex(shown) == field.raw == octets[offset : offset + field.length]
        offset += field.length
    assert offset == len(octets)
    text = format_tables(codec)
    assert "\n".join(lines) in text


def test_truncated_octets_are_annotated_to_their_end():
    codec = get_codec("cpp-2.0")
    octets = codec.encode(example_beacon(codec))
    for length in range(len(octets)):
        assert len(list(annotated(codec, octets[:length]))) >= 1


def test_a_bar_in_a_note_does_not_end_its_cell(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        'extends = "dcp-2.0"\nname = "own"\ntitle = "Own"\nnotes = ""\n'
        '[srp]\nrecord = ["sData", { opaque = 2, name = "gap", note = "this | that" }, "nodeId", "tStamp", "seqno"]\n'
        "safety_data = [{ name = 'x', type = 'u8' }]\n"
    )
    text = format_tables(Codec(load_profile(path)))
    assert "this \\| that" in text
    found = sections(text)
    assert found["Octets without meaning"][0][1][3] == "this | that"
