"""``dcp-codec`` beside decode: stats, guess, convert, encode, export, profiles; input that cannot be used."""

from __future__ import annotations

import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
import tomllib
from pathlib import Path

import msgspec
import pytest
from dcp_spec.profile.loading import load_profile, profile_names

from dcp_codec.capture import Frame, create_capture, open_capture

from .conftest import ETHERNET, START_NS, beacon, write


@pytest.fixture
def capture(tmp_path, good) -> Path:
    return write(tmp_path / "a.pcap", *good)


def frames_in(path: Path) -> list[tuple[int, bytes, int]]:
    with open_capture(path) as reader:
        return [(frame.time_ns, frame.data, frame.orig_len) for frame in reader]


# -- stats ------------------------------------------------------------------------------------------------------


def test_stats_json(run, capture):
    result = run("stats", "-f", "json", capture)
    data = json.loads(result.out)
    assert result.status == 0
    assert data["beacons"] == 5
    assert data["senders"]["02:00:00:00:00:01"]["beacons"] == 3
    assert data["senders"]["02:00:00:00:00:02"]["first_seqno"] == 40
    assert data["senders"]["02:00:00:00:00:02"]["last_seqno"] == 41
    assert data["senders"]["02:00:00:00:00:01"]["lost"] == 0
    assert data["senders"]["02:00:00:00:00:01"]["interval"] == {
        "count": 2,
        "mean_ms": 100.0,
        "stddev_ms": 0.0,
        "min_ms": 100.0,
        "max_ms": 100.0,
    }
    assert (data["srp"], data["vardis"], data["padded"], data["errors"]) == (0, 5, 1, 0)
    assert data["containers"] == {"CREATE-VARIABLES": 5, "SUMMARIES": 5}
    assert data["records"] == {"CREATE-VARIABLES": 5, "SUMMARIES": 10}
    assert data["last_sent_value"] == {"7": {"seqno": 3, "value": "41424344"}}


def test_stats_of_variables_come_from_the_ledger(run):
    path = Path(__file__).resolve().parents[2] / "captures" / "b_crud.mcap"
    result = run("stats", "-f", "json", path)
    variables = json.loads(result.out)["variables"]
    assert variables["12"] == {
        "producer": "02:00:00:00:00:01", "nodes": 3, "current": 3, "stale": 0, "longest_lag_s": 0.0,
    }  # fmt: skip
    # Two nodes do not follow the deletion of variable 11.
    assert (variables["11"]["nodes"], variables["11"]["current"], variables["11"]["stale"]) == (3, 1, 2)
    assert variables["11"]["longest_lag_s"] > 6
    row = next(line for line in run("stats", path).out.splitlines() if line.startswith("11 "))
    assert row.split()[:7] == ["11", "1", "1", "of", "3", "2", f"{variables['11']['longest_lag_s']:.1f}"]


def test_stats_count_loss_restart_and_duplicates(run, tmp_path, codec):
    seqnos = [10, 11, 14, 14, 15, 0, 1]
    frames = [ETHERNET + codec.encode(beacon(seqno)) for seqno in seqnos]
    result = run("stats", "-f", "json", "-p", "cpp-2.0", write(tmp_path / "a.pcap", *frames))
    one = json.loads(result.out)["senders"]["02:00:00:00:00:01"]
    assert (one["lost"], one["duplicates"], one["restarts"]) == (2, 1, 1)
    assert (one["first_seqno"], one["last_seqno"]) == (10, 1)
    shown = run("stats", "-p", "cpp-2.0", tmp_path / "a.pcap").out
    assert "1 beacon repeats the number of its sender's last one (merged recordings of several nodes?)" in shown


def test_stats_name_the_beacons_that_a_merged_recording_has_twice(run, tmp_path, codec):
    frames = [ETHERNET + codec.encode(beacon(seqno)) for seqno in range(5)]
    one, two, both = tmp_path / "1.pcap", tmp_path / "2.pcap", tmp_path / "both.pcapng"
    write(one, *frames)
    write(two, *frames)
    assert "last one" not in run("stats", "-p", "cpp-2.0", one).out
    assert run("merge", one, two, "-o", both).status == 0
    assert "5 beacons repeat the number" in run("stats", "-p", "cpp-2.0", both).out


def test_stats_wrap_of_the_sequence_number_is_not_a_loss(run, tmp_path, codec):
    frames = [ETHERNET + codec.encode(beacon(seqno)) for seqno in (0xFFFFFFFE, 0xFFFFFFFF, 0, 1)]
    result = run("stats", "-f", "json", "-p", "cpp-2.0", write(tmp_path / "a.pcap", *frames))
    one = json.loads(result.out)["senders"]["02:00:00:00:00:01"]
    assert (one["lost"], one["restarts"]) == (0, 0)


def on_a_terminal(columns: int, *arguments: str) -> str:
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, (25, columns))
    command = [sys.executable, "-c", "from dcp_codec.cli import main; main()", *arguments]
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"} | {"TERM": "xterm"}
    subprocess.run(command, stdin=slave, stdout=slave, stderr=subprocess.DEVNULL, env=environment, check=True)
    os.close(slave)
    shown = os.read(master, 1 << 16).decode()
    os.close(master)
    return shown


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_stats_show_complete_senders_on_any_terminal(tmp_path, good, columns):
    shown = on_a_terminal(columns, "stats", "-p", "cpp-2.0", str(write(tmp_path / "a.pcap", *good)))
    row = next(line for line in shown.splitlines() if line.startswith("02:00:00:00:00:01"))
    assert row.split()[1:4] == ["3", "0", "2"]


def test_stats_text_names_senders_containers_and_malformed_frames(run, tmp_path, good):
    capture = write(tmp_path / "a.pcap", *good, good[0][:30])
    result = run("stats", "-p", "cpp-2.0", capture)
    assert result.status == 1
    assert "5 beacons in 6 frames" in result.out
    assert "02:00:00:00:00:02" in result.out
    assert "frame 6: bp.seqno at octet 28: truncated" in result.out


def test_stats_state_the_number_of_hidden_malformed_frames(run, tmp_path, good):
    shown = run("stats", "-p", "cpp-2.0", write(tmp_path / "a.pcap", *good, *[good[0][:30]] * 12)).out
    assert shown.count(": truncated") == 10
    assert "... and 2 more, see dcp-codec decode --errors-only" in shown
    shown = run("stats", "-p", "cpp-2.0", write(tmp_path / "b.pcap", *good, *[good[0][:30]] * 10)).out
    assert "more, see" not in shown


def test_stats_of_a_clock_that_was_set_back(run, tmp_path, codec):
    path = tmp_path / "a.pcap"
    with create_capture(path) as writer:
        for number, seconds in enumerate((3600, 3601, 3602, 0, 1)):
            data = ETHERNET + codec.encode(beacon(number))
            writer.write(Frame(number + 1, START_NS + seconds * 1_000_000_000, data, len(data)))
    data = json.loads(run("stats", "-f", "json", "-p", "cpp-2.0", path).out)
    one = data["senders"]["02:00:00:00:00:01"]
    assert (one["interval"]["count"], one["interval"]["mean_ms"], one["backwards"]) == (3, 1000.0, 1)
    assert data["duration_s"] == 3602
    assert "time goes back before 1 beacons" in run("stats", "-p", "cpp-2.0", path).out


def test_headings_of_stats_are_whole_beside_long_values(tmp_path, codec):
    octets = bytearray(codec.encode(beacon(0)))
    at = octets.index(b"\x04ABCD")
    octets[at : at + 5] = b"\x40" + bytes(64)
    for place in (11, 20):  # the lengths of the beacon and of the payload
        octets[place : place + 2] = (int.from_bytes(octets[place : place + 2], "big") + 60).to_bytes(2, "big")
    shown = on_a_terminal(80, "stats", "-p", "cpp-2.0", str(write(tmp_path / "a.pcap", ETHERNET + bytes(octets))))
    assert "variable" in shown
    assert sum(map(len, re.findall(r"(?<= )0{2,}", shown))) == 2 * 64


def test_stats_of_several_files_is_a_list(run, capture):
    assert [row["beacons"] for row in json.loads(run("stats", "-f", "json", capture, capture).out)] == [5, 5]


@pytest.mark.parametrize("command", ["stats", "guess", "decode"])
def test_a_file_that_cannot_be_read_does_not_hide_the_next(run, tmp_path, capture, command):
    (tmp_path / "empty.pcap").write_bytes(b"")
    result = run(command, tmp_path / "empty.pcap", capture, tmp_path / "none.pcap")
    assert result.status == 2
    assert "empty.pcap: is empty" in result.err
    assert "none.pcap: cannot be read: No such file" in result.err
    assert "a.pcap: profile cpp-2.0" in result.err or "a.pcap: cpp-2.0" in result.out
    result = run("stats", "-f", "json", tmp_path / "empty.pcap", capture)
    assert [each["beacons"] for each in json.loads(result.out)] == [5]
    assert run("stats", "-f", "json", tmp_path / "empty.pcap").out == ""


@pytest.mark.parametrize("command", ["stats", "decode"])
def test_another_profile_is_suggested_if_nothing_decodes(run, tmp_path, capture, good, command):
    told = "5 of 5 DCP frames are malformed; another --profile? dcp-codec guess "
    assert told in run(command, "-p", "dcp-1.0", capture).err
    some = run(command, "-p", "cpp-2.0", write(tmp_path / "b.pcap", *good, good[0][:30])).err
    assert some.endswith("b.pcap: 1 of 6 DCP frames are malformed\n")


# -- guess ------------------------------------------------------------------------------------------------------

VECTORS = {
    "dcp-1.0": "497e0200000000bb0101000000290002001b05010702000000000102706f73000703044142434401020703 0900",
    "sim-1.0": "497e0200000000bb0101000000290002001c0501070200000000010204706f730007030441424344010207030900",
    "dcp-1.1": "01497e0200000000bb01000000290002001b0501070200000000010203706f7307030441424344010207030900",
    "dcp-1.2": "01497e0200000000bb001f01000000290002001b0501070200000000010203706f7307030441424344010207030900",
    "cpp-2.0": "01497e0200000000bb11110029010000002900020025"
    "0501070200000000010215cd853dfe9c9717138803706f7307030441424344010207030900",
    "dcp-2.0": "01497e0200000000bb11110029010000002900020025"
    "0501070200000000010217979cfe3d85cd15138803706f7307030441424344010207030900",
}
SAME = {"dcp-1.2": {"dcp-1.2", "dcp-1.3", "cpp-1.2", "cpp-1.3"}}


@pytest.mark.parametrize("name", VECTORS)
def test_guess_distinguishes_the_test_vectors(run, tmp_path, name):
    octets = b"\xff" * 12 + bytes.fromhex("4953" + VECTORS[name])
    result = run("guess", "-f", "json", write(tmp_path / "a.pcap", octets))
    data = json.loads(result.out)
    assert set(data["tied"]) == SAME.get(name, {name})
    assert data["profile"] in SAME.get(name, {name})


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[2] / "captures").glob("*.mcap")), ids=lambda p: p.name)
def test_guess_is_certain_of_recordings(run, path):
    data = json.loads(run("guess", "-f", "json", path).out)
    assert data["profile"] == ("cpp-1.3" if "1.3" in path.name else "cpp-2.0")
    assert data["tied"] == [data["profile"]]
    best, second = data["ranking"][:2]
    assert best["score"] == 1.0
    assert second["score"] < 0.5


def test_guess_without_frames_is_reported(run, tmp_path):
    result = run("guess", write(tmp_path / "a.pcap"))
    assert result.status == 0
    assert "no frames to decide by" in result.out


OTHER = bytes.fromhex("ffffffffffff0200000000aa0800") + bytes(46)


@pytest.mark.parametrize("command", ["stats", "guess", "decode"])
def test_the_profile_is_found_after_much_other_traffic(run, tmp_path, command):
    beacons = [ETHERNET + bytes.fromhex(VECTORS["dcp-2.0"])] * 3
    result = run(command, write(tmp_path / "a.pcap", *[OTHER] * 500, *beacons))
    told = result.out + result.err
    assert "dcp-2.0 (" in told
    assert "3 of 3 sampled frames decode)" in told
    assert result.status == 0


def test_a_given_ether_type_is_found_after_other_traffic(run, tmp_path):
    bare = bytes.fromhex("ffffffffffff0200000000aa9999") + bytes.fromhex(VECTORS["dcp-2.0"])
    path = write(tmp_path / "a.pcap", *[OTHER] * 500, bare)
    assert "profile dcp-2.0 (" in run("stats", "--ether-type", "0x9999", path).err


def test_several_versions_in_one_recording_are_named(run, tmp_path):
    new, old = (ETHERNET + bytes.fromhex(VECTORS[name]) for name in ("dcp-2.0", "dcp-1.1"))
    result = run("stats", write(tmp_path / "a.pcap", new, old, new, old, new))
    assert "3 of 5 sampled frames decode; 2 others decode as dcp-1.1: decode each version with --profile" in result.err


def test_damage_is_not_reported_as_another_version(run, tmp_path, good):
    damaged = good[1][:36] + b"\x09" + good[1][37:]
    result = run("stats", write(tmp_path / "a.pcap", *good, damaged))
    assert "5 of 6 sampled frames decode)" in result.err


# -- convert ----------------------------------------------------------------------------------------------------


def test_convert_there_and_back(run, tmp_path, capture, good):
    before = frames_in(capture)
    assert before[1][0] == START_NS + 100_000_000
    for step in ("b.mcap", "c.pcapng", "d.mcap", "e.pcap"):
        source, capture = capture, tmp_path / step
        result = run("convert", source, capture)
        assert result.status == 0, result.err
        assert f"{len(good)} frames" in result.err
        assert frames_in(capture) == before


def test_converted_mcap_restores_the_original(run, tmp_path, capture):
    run("convert", capture, tmp_path / "b.mcap")
    result = run("convert", "--extract", tmp_path / "b.mcap", tmp_path / "back.pcap")
    assert result.status == 0, result.err
    assert (tmp_path / "back.pcap").read_bytes() == capture.read_bytes()


def test_convert_refuses_to_overwrite_its_source(run, capture):
    before = capture.read_bytes()
    result = run("convert", capture, capture)
    assert result.status == 2
    assert capture.read_bytes() == before


def test_convert_to_an_unknown_suffix(run, tmp_path, capture):
    result = run("convert", capture, tmp_path / "a.xyz")
    assert result.status == 2
    assert not (tmp_path / "a.xyz").exists()


# -- encode -----------------------------------------------------------------------------------------------------


def test_encode_is_the_inverse_of_decode(run, tmp_path, capture, good):
    lines = run("decode", "-p", "cpp-2.0", "-f", "jsonl", capture).out
    (tmp_path / "a.jsonl").write_text(lines)
    result = run("encode", "-p", "cpp-2.0", tmp_path / "a.jsonl")
    assert [bytes.fromhex(line) for line in result.out.splitlines()] == [*good[:4], good[4][:-9]]
    result = run("encode", "-p", "cpp-2.0", tmp_path / "a.jsonl", "-o", tmp_path / "b.pcapng")
    assert result.status == 0
    assert [time_ns for time_ns, _, _ in frames_in(tmp_path / "b.pcapng")] == [t for t, _, _ in frames_in(capture)]


def test_encode_takes_one_object_a_list_or_lines(run, tmp_path, capture):
    row = json.loads(run("decode", "-p", "cpp-2.0", "-f", "jsonl", "-c", "1", capture).out)
    outputs = set()
    for text in (json.dumps(row), json.dumps([row]), json.dumps(row, indent=2), json.dumps([row], indent=2)):
        (tmp_path / "a.json").write_text(text)
        outputs.add(run("encode", "--bare", "-p", "cpp-2.0", tmp_path / "a.json").out)
    assert len(outputs) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda row: row["bp"].pop("seqno"), "bp.seqno: is missing"),
        (lambda row: row["bp"].update(seqno=1 << 32), "bp.seqno: 4294967296 is not in 0..4294967295"),
        (lambda row: row["bp"].update(senderId="02:00"), "bp.senderId: needs 6 octets, not 2"),
        (lambda row: row["payloads"].clear(), "payloads: 0 "),
        (lambda row: row["payloads"][0]["vardis"][0].update(icType=9), "icType 9 is not one of"),
        (lambda row: row.update(time_ns=-1), "time_ns"),
        (lambda row: row.update(dst="x"), "dst: 'x' is not a MAC address"),
    ],
)
def test_encode_names_the_wrong_member_and_continues(run, tmp_path, capture, change, message):
    lines = run("decode", "-p", "cpp-2.0", "-f", "jsonl", "-c", "2", capture).out.splitlines()
    row = json.loads(lines[0])
    change(row)
    (tmp_path / "a.jsonl").write_text(json.dumps(row) + "\n" + lines[1])
    result = run("encode", "-p", "cpp-2.0", tmp_path / "a.jsonl")
    assert result.status == 1
    assert "object 1: " in result.err
    assert message in result.err
    assert len(result.out.splitlines()) == 1


@pytest.mark.parametrize("text", ["", "{", "nonsense", "[" * 100_000, '{"a": 1}\n{'])
def test_encode_of_invalid_json(run, tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    result = run("encode", "-p", "cpp-2.0", tmp_path / "a.json")
    assert result.status in (1, 2)
    assert "a.json" in result.err


# -- export, profiles -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["lua", "ksy", "jsonschema", "markdown", "scapy"])
@pytest.mark.parametrize("profile", profile_names())
def test_every_profile_exports_to_every_kind(run, tmp_path, kind, profile):
    result = run("export", kind, "-p", profile, "-o", tmp_path / "out")
    assert result.status == 0, result.err
    assert len((tmp_path / "out").read_text()) > 200 or kind == "scapy"


def test_export_that_cannot_be_written(run, tmp_path):
    result = run("export", "markdown", "-p", "cpp-2.0", "-o", tmp_path / "no" / "such" / "folder")
    assert result.status == 2
    assert "cannot be written" in result.err


def test_profiles_lists_all(run):
    result = run("profiles")
    assert [line.split()[0] for line in result.out.splitlines()] == list(profile_names())


@pytest.mark.parametrize("name", profile_names())
def test_profile_as_toml_loads_to_the_same_profile(run, tmp_path, name):
    text = run("profiles", name, "-f", "toml").out
    tomllib.loads(text)
    (tmp_path / "own.toml").write_text(text)
    assert load_profile(tmp_path / "own.toml") == load_profile(name)


def test_profile_as_json(run):
    shown = msgspec.json.decode(run("profiles", "cpp-1.3", "-f", "json").out)
    assert shown["types"]["timestamp"]["byte_order"] == "little"


def test_own_profile_file(run, tmp_path, capture):
    (tmp_path / "mine.toml").write_text(
        'extends = "cpp-2.0"\nname = "mine"\ntitle = "Mine"\n[limits]\nmax_summaries = 5\n'
    )
    result = run("decode", "-p", tmp_path / "mine.toml", "-f", "jsonl", capture)
    assert result.status == 0
    assert len(result.out.splitlines()) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('extends = "cpp-2.0"\n[types]\nnetwork_id = { width = 1 }\n', "types.network_id.width = 1"),
        ('extends = "cpp-2.0"\n[srp]\nrecord_size = 60\n', "the listed fields add up to 64"),
        ('extends = "cpp-2.0"\n[types]\nvar_id = { width = "1" }\n', "types.var_id.width: Expected `int`"),
        ('extends = "cpp-2.0"\n[types]\nvarid = 3\n', "varid"),
        ("extends = ", "not a TOML file"),
    ],
)
def test_contradictory_profile_names_file_and_key(run, tmp_path, capture, text, message):
    (tmp_path / "mine.toml").write_text(text)
    result = run("decode", "-p", tmp_path / "mine.toml", capture)
    assert result.status == 2
    assert "mine.toml" in result.err
    assert message in result.err


# -- input that cannot be used --------------------------------------------------------------------------------------


def _link_type(tmp_path: Path, number: int) -> Path:
    path = tmp_path / "other.pcap"
    path.write_bytes(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, number))
    return path


@pytest.mark.parametrize("command", ["decode", "stats", "guess"])
def test_unreadable_input(run, tmp_path, command):
    (tmp_path / "text").write_text("this is not a recording at all\n")
    (tmp_path / "empty").write_bytes(b"")
    for path, message in (
        (tmp_path / "missing.pcap", "missing.pcap"),
        (tmp_path / "text", "text"),
        (tmp_path / "empty", "empty"),
        (tmp_path, str(tmp_path)),
        (_link_type(tmp_path, 113), "Linux cooked"),
    ):
        result = run(command, path)
        assert result.status == 2, path
        assert message in result.err
        assert result.out == ""


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_input_without_permission(run, capture):
    capture.chmod(0)
    assert run("decode", capture).status == 2


@pytest.mark.parametrize("suffix", ["pcap", "pcapng", "mcap"])
def test_truncated_recordings_are_read_to_their_end(run, tmp_path, good, suffix):
    whole = write(tmp_path / f"a.{suffix}", *good * 400)
    cut = tmp_path / f"cut.{suffix}"
    data = whole.read_bytes()
    # An MCAP ends with its summary; cutting into the data means cutting deeper.
    cut.write_bytes(data[: len(data) * 9 // 10 if suffix != "mcap" else len(data) // 2])
    result = run("decode", "-p", "cpp-2.0", "-f", "jsonl", cut)
    assert result.status == 2
    assert str(cut) in result.err
    rows = result.out.splitlines()
    assert len(rows) < 2000
    if suffix != "mcap":
        assert len(rows) > 1500
    expected = run("decode", "-p", "cpp-2.0", "-f", "jsonl", whole).out.splitlines()[: len(rows)]
    # Compared outside of the assertion: drawing the difference of two long lists takes minutes.
    same = rows == expected
    assert same
