"""``dcp-codec decode``: what it shows, and to whom it says that something is wrong."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
from pathlib import Path

import pytest

from dcp_codec import Codec
from dcp_codec.values import Beacon, BPHeader, Container, Payload, VarCreate, VarSpec, VarUpdate

from .conftest import ETHERNET, NODE, START_NS, beacon, write


def test_jsonl_has_the_documented_members(run, tmp_path, good):
    result = run("decode", "-p", "cpp-2.0", "-f", "jsonl", write(tmp_path / "a.pcap", *good))
    rows = [json.loads(line) for line in result.out.splitlines()]
    assert result.status == 0
    assert [row["frame"] for row in rows] == [1, 2, 3, 4, 5]
    assert rows[1]["time_ns"] == START_NS + 100_000_000
    assert rows[0] == {
        "frame": 1,
        "time_ns": START_NS,
        "src": "02:00:00:00:00:01",
        "dst": "ff:ff:ff:ff:ff:ff",
        "etherType": 0x4953,
        "bp": {
            "version": 1,
            "magicNo": 0x497E,
            "senderId": "02:00:00:00:00:01",
            "networkId": 0x1111,
            "length": 41,
            "numPayloads": 1,
            "seqno": 0,
        },
        "payloads": [
            {
                "protocolId": 2,
                "length": 37,
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
                                    "creationTime": START_NS,
                                    "timeout": 5000,
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
        "padding": 0,
        "errors": [],
        "warnings": [],
    }
    assert rows[4]["padding"] == 9


def test_tree_shows_offset_length_name_value_and_octets(run, tmp_path, good):
    result = run("decode", "-p", "cpp-2.0", "--frames", "1", write(tmp_path / "a.pcap", *good))
    rows = [line.split() for line in result.out.splitlines()]
    assert ["23", "2", "networkId", "0x1111", "11", "11"] in rows
    assert ["36", "1", "icType", "5", "CREATE-VARIABLES", "05"] in rows
    assert ["56", "4", "descr", '"pos"', "03", "70", "6f", "73"] in rows
    assert next(row for row in rows if row[:1] == ["0000"])[:3] == ["0000", "ff", "ff"]


def test_list_has_one_line_per_frame(run, tmp_path, good):
    result = run("decode", "-f", "list", "--time", "relative", write(tmp_path / "a.mcap", *good))
    lines = result.out.splitlines()
    assert len(lines) == 5
    assert 'CREATE-VARIABLES(7"pos":3=41424344) SUMMARIES(7:3 9:0)' in lines[0]
    assert lines[4].split()[:4] == ["5", "0.400000", "02:00:00:00:00:02", "#41"]
    assert "+9 padding" in lines[4]
    # Relative to the recording, not to what is shown of it.
    only = run("decode", "-f", "list", "--time", "relative", "--frames", "5", tmp_path / "a.mcap").out.split()
    assert only[:2] == ["5", "0.400000"]
    assert "profile cpp-2.0" in result.err


def test_csv_has_one_row_per_record(run, tmp_path, good):
    result = run("decode", "-p", "cpp-2.0", "-f", "csv", write(tmp_path / "a.pcapng", good[0]))
    rows = list(csv.DictReader(io.StringIO(result.out)))
    assert [(row["kind"], row["varId"], row["seqno"]) for row in rows] == [
        ("CREATE-VARIABLES", "7", "3"),
        ("SUMMARIES", "7", "3"),
        ("SUMMARIES", "9", "0"),
    ]
    assert rows[0]["value"] == "41424344"


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--where", "senderId == 02:00:00:00:00:02"), [4, 5]),
        (("-w", "vardis"), [1, 2, 3, 4, 5]),
        (("-w", "srp"), []),
        (("-w", 'icName == "SUMMARIES" and varId == 9'), [1, 2, 3, 4, 5]),
        (("-w", 'icName == "UPDATES"'), []),
        (("-w", "varId == 8"), []),
        (("-w", "senderId == 02:00:00:00:00:02", "--frames", "5-"), [5]),
        (("--frames", "2-3"), [2, 3]),
        (("--frames", "4-"), [4, 5]),
        (("--from", "+0.2"), [3, 4, 5]),
        (("--to", "+0.1"), [1, 2]),
        (("--from", f"{START_NS // 10**9}.1", "--to", f"{START_NS // 10**9}.3"), [2, 3]),
        (("--from", "2026-11-21T01:39:11.100000124"), [3, 4, 5]),
        (("--count", "2"), [1, 2]),
        (("--errors-only",), []),
    ],
)
def test_filters(run, tmp_path, good, options, expected):
    result = run("decode", "-p", "cpp-2.0", "-f", "jsonl", *options, write(tmp_path / "a.pcap", *good))
    assert [json.loads(line)["frame"] for line in result.out.splitlines()] == expected
    assert result.status == 0
    assert ("none of 5 DCP frames matches the options" in result.err) == (not expected)


def test_count_is_for_all_files_together(run, tmp_path, good):
    files = [write(tmp_path / f"{name}.pcap", *good[:2]) for name in "abc"]
    result = run("decode", "-p", "cpp-2.0", "-f", "jsonl", "--count", "3", *files)
    assert [json.loads(line)["frame"] for line in result.out.splitlines()] == [1, 2, 1]


def test_hex_distinguishes_a_frame_from_a_bare_beacon(run, good):
    framed = run("decode", "--hex", good[0].hex(), "-f", "jsonl")
    bare = run("decode", "--hex", good[0][14:].hex(":"), "-f", "jsonl")
    assert "whole Ethernet frame" in framed.err
    assert "bare beacon" in bare.err
    assert (framed.status, bare.status) == (0, 0)
    whole, naked = json.loads(framed.out), json.loads(bare.out)
    assert whole["payloads"] == naked["payloads"]
    assert (whole["src"], naked["src"]) == ("02:00:00:00:00:01", None)


@pytest.mark.parametrize("text", ["", "xyz", "0x"])
def test_invalid_hex(run, text):
    result = run("decode", "--hex", text)
    assert result.status == 2
    assert "--hex" in result.err


def test_hex_of_another_ether_type(run, good):
    result = run("decode", "-p", "cpp-2.0", "--hex", "ff" * 12 + "0800" + "45" * 40)
    assert result.status == 2
    assert "EtherType 0x0800 at octet 12" in result.err


def test_an_unknown_field_in_a_condition_is_refused(run, tmp_path, good):
    result = run("decode", "--where", "varID2 == 1", write(tmp_path / "a.pcap", *good))
    assert result.status == 2
    assert "'varID2' is not the name of a field" in " ".join(result.err.split())


# -- what is wrong with frames ----------------------------------------------------------------------------------


def malformed(codec) -> dict[str, tuple[bytes, str, str, int]]:
    """name -> (frame, reason, path, offset in the frame)."""
    whole = ETHERNET + codec.encode(beacon(5))

    def patched(offset: int, *octets: int) -> bytes:
        data = bytearray(whole)
        data[offset : offset + len(octets)] = bytes(octets)
        return bytes(data)

    return {
        "14 octets": (whole[:14], "truncated", "bp.version", 14),
        "header cut off": (whole[:20], "truncated", "bp.senderId", 17),
        "length beyond the frame": (patched(25, 0xFF, 0xFF), "beacon-overrun", "bp.length", 25),
        "length zero": (patched(25, 0, 0), "zero-length", "bp.length", 25),
        "no payloads": (patched(27, 0), "zero-count", "bp.numPayloads", 27),
        "block length beyond the beacon": (patched(34, 0, 200), "block-overrun", "payloads[0].length", 34),
        "no records": (patched(37, 0), "zero-count", "payloads[0].vardis[0].icNumRecords", 37),
        "unknown container type": (patched(36, 77), "unknown-type", "payloads[0].vardis[0].icType", 36),
        "value beyond the payload": (
            patched(62, 255),
            "truncated",
            "payloads[0].vardis[0].records[0].upd.value.data",
            63,
        ),
    }


def names() -> list[str]:
    from dcp_codec import Codec

    return list(malformed(Codec("cpp-2.0")))


@pytest.mark.req("BP-RX-16")
@pytest.mark.parametrize("form", ["tree", "list", "csv", "jsonl"])
@pytest.mark.parametrize("name", names())
def test_malformed_frames_are_named_and_the_rest_is_shown(run, tmp_path, codec, good, name, form):
    frame, reason, path, offset = malformed(codec)[name]
    capture = write(tmp_path / "bad.pcap", good[0], frame, good[1])
    result = run("decode", "-p", "cpp-2.0", "-f", form, capture)
    assert result.status == 1
    assert f"{capture}: frame 2: {path} at octet {offset}: {reason}" in result.err
    assert f"{capture}: 1 of 3 DCP frames are malformed" in result.err
    if form == "jsonl":
        rows = [json.loads(line) for line in result.out.splitlines()]
        assert [bool(row["errors"]) for row in rows] == [False, True, False]
        first = rows[1]["errors"][0]
        assert (first["reason"], first["path"], first["offset"]) == (reason, path, offset)
        assert first["requirement"]
    else:
        assert reason in result.out
        assert len(result.out.splitlines()) > 2


def test_errors_only_shows_only_malformed_frames(run, tmp_path, codec, good):
    frame = malformed(codec)["no payloads"][0]
    result = run("decode", "-p", "cpp-2.0", "-f", "jsonl", "--errors-only", write(tmp_path / "a.pcap", good[0], frame))
    assert [json.loads(line)["frame"] for line in result.out.splitlines()] == [2]
    assert result.status == 1


def test_octets_at_fault_are_marked_in_the_dump(run, codec):
    frame = malformed(codec)["unknown container type"][0]
    result = run("decode", "-p", "cpp-2.0", "--hex", frame.hex())
    lines = result.out.splitlines()
    row = next(index for index, line in enumerate(lines) if line.startswith("  0020"))
    assert lines[row + 1].index("^^") == lines[row].index("4d")


def test_a_recording_without_beacons_is_reported(run, tmp_path):
    capture = write(tmp_path / "ip.pcap", b"\xff" * 12 + b"\x08\0" + b"\x45" * 40, b"\0" * 9)
    result = run("decode", capture, "-p", "cpp-2.0")
    assert result.status == 0
    assert "no DCP frames under EtherType 0x4953" in result.err
    assert "0x0800 (1)" in result.err


def test_ether_type_option(run, tmp_path, codec):
    frame = b"\xff" * 12 + bytes.fromhex("606f") + codec.encode(beacon(1))
    capture = write(tmp_path / "a.pcap", frame)
    assert run("decode", "-p", "cpp-2.0", capture).out == ""
    assert "seqno" in run("decode", "-p", "cpp-2.0", "--ether-type", "0x606f", capture).out
    # With auto the type is found by the magic number.
    assert json.loads(run("decode", "-f", "jsonl", capture).out)["etherType"] == 0x606F


# -- usage ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((), "give recordings"),
        (("a.pcap", "--hex", "00"), "exactly one"),
        (("a.pcap", "--frames", "x"), "is not a frame number"),
        (("a.pcap", "--from", "yesterday"), "is not an ISO 8601 time"),
        (("a.pcap", "--ether-type", "0x12345"), "not within 0x0600 to 0xffff"),
        (("a.pcap", "--ether-type", "beacon"), "is not an EtherType; write it in hex"),
        (
            (
                "a.pcap",
                "--no-such-option",
            ),
            "--no-such-option",
        ),
        (("a.pcap", "--profile", "cpp-20"), "cpp-2.0"),
    ],
)
def test_wrong_usage_is_explained(run, tmp_path, monkeypatch, good, args, message):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a.pcap", *good)
    result = run("decode", *args)
    assert result.status == 2
    assert message in result.err
    assert result.out == ""


def test_piping_into_head_is_not_a_failure(tmp_path, good):
    capture = write(tmp_path / "long.pcap", *good * 2000)
    command = f"{sys.executable} -c 'from dcp_codec.cli import main; main()' decode -p cpp-2.0 {capture} | head -1"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout.startswith("Frame 1")
    assert done.stderr == ""
    assert done.returncode == 0


def test_standard_input_is_read(tmp_path, good):
    capture = write(tmp_path / "a.pcapng", *good)
    command = [sys.executable, "-c", "from dcp_codec.cli import main; main()", "decode", "-f", "list", "-"]
    with capture.open("rb") as stream:
        done = subprocess.run(command, stdin=stream, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 5


def test_nothing_slow_is_imported_for_help():
    code = (
        "import sys\nfrom dcp_codec.cli import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "slow = {'scapy', 'mcap', 'rich', 'hypothesis', 'yaml'} & set(sys.modules)\n"
        "sys.exit(f'imported: {slow}' if slow else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_control_characters_in_a_description_do_not_reach_the_terminal(run, codec):
    from dcp_codec.values import Beacon, BPHeader, Container, Payload, VarCreate, VarSpec, VarUpdate

    node = bytes(6)
    create = VarCreate(VarSpec(1, node, 1, b"\x1b[2Jevil\n\xff", 0, 0), VarUpdate(1, 0, b"x"))
    octets = codec.encode(Beacon(BPHeader(node, 0, 0x1111), (Payload(2, (Container(5, (create,)),)),)))
    for form in ("tree", "list"):
        result = run("decode", "-p", "cpp-2.0", "-f", form, "--hex", octets.hex())
        assert "\x1b" not in result.out
        assert "evil" in result.out


def test_captures_of_the_repository_decode(run):
    captures = sorted((Path(__file__).parents[2] / "captures").glob("*.mcap"))
    assert captures
    for capture in captures:
        result = run("decode", "-f", "list", capture)
        assert result.status == 0, result.err
        assert "ERROR" not in result.out


def test_jsonl_escapes_what_a_terminal_would_interpret(run, tmp_path):
    name = "a\x9b31m\u202eb\u00e9"
    spec = VarSpec(7, NODE, 2, name.encode(), creation_time=START_NS, timeout=5000)
    payload = Payload(2, (Container(5, (VarCreate(spec, VarUpdate(7, 3, b"ABCD")),)),))
    frame = ETHERNET + Codec("cpp-2.0").encode(Beacon(BPHeader(NODE, 0, network_id=0x1111), (payload,)))
    shown = run("decode", "-p", "cpp-2.0", "-f", "jsonl", write(tmp_path / "a.pcap", frame)).out
    assert shown.rstrip("\n").isprintable()
    assert json.loads(shown)["payloads"][0]["vardis"][0]["records"][0]["spec"]["descr"] == name
