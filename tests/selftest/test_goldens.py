"""The recordings of the repository are what their manifest says, and a change to either is noticed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import msgspec
import pytest
from dcp_selftest.goldens import Counts, GoldensError, load_manifest, make, verify

from dcp_codec import get_codec
from dcp_codec.capture import attachments, create_capture, extract_attachment, open_capture

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
MANIFEST = CAPTURES / "manifest.toml"
GOLDENS = load_manifest(MANIFEST).capture


@pytest.fixture
def copy(tmp_path):
    """The manifest and its smallest recording, alone."""
    golden = next(golden for golden in GOLDENS if golden.file == "c_latejoin.mcap")
    shutil.copy(CAPTURES / golden.file, tmp_path)
    return write(tmp_path / "manifest.toml", golden)


def write(path, *goldens):
    from dcp_codec.export.tomltext import toml_text

    path.write_text(toml_text({"made_with": {}, "capture": [msgspec.to_builtins(golden) for golden in goldens]}))
    return path


def checks(manifest):
    return {finding.check for finding in verify(manifest)}


def test_the_recordings_match_the_manifest():
    assert verify(MANIFEST) == []
    assert {golden.file for golden in GOLDENS} == {path.name for path in CAPTURES.glob("*.mcap")}


def test_every_recording_states_its_origin():
    for golden in GOLDENS:
        assert golden.what
        assert golden.origin
        assert golden.command
        assert len(golden.sha256) == len(golden.original_sha256) == 64
        assert golden.expected is not None
        get_codec(golden.profile)


def test_the_recordings_are_small():
    assert sum(path.stat().st_size for path in CAPTURES.iterdir()) < 1_500_000


def test_the_command(dcp_selftest):
    assert dcp_selftest("goldens", "verify", MANIFEST)[:2] == (0, "4 recordings, 0 findings\n")


def test_a_changed_octet_is_noticed(copy, dcp_selftest):
    path = copy.parent / "c_latejoin.mcap"
    octets = path.read_bytes()
    for place in range(0, len(octets), len(octets) // 20):
        changed = bytearray(octets)
        changed[place] ^= 0x10
        path.write_bytes(changed)
        assert "hash" in checks(copy), place
    done = dcp_selftest("goldens", "verify", copy)
    assert done.status == 1
    assert "SHA-256" in done.out


def test_a_file_cut_off_is_noticed(copy):
    path = copy.parent / "c_latejoin.mcap"
    octets = path.read_bytes()
    for length in (0, 7, 100, len(octets) // 2, len(octets) - 1):
        path.write_bytes(octets[:length])
        assert checks(copy) >= {"hash", "capture"}, length


def test_missing_unnamed_and_doubled_files_are_noticed(copy):
    golden = load_manifest(copy).capture[0]
    shutil.copy(copy.parent / golden.file, copy.parent / "other.mcap")
    assert [(found.file, found.check) for found in verify(copy)] == [("other.mcap", "manifest")]
    write(copy, golden, golden)
    assert ("c_latejoin.mcap", "manifest") in [(found.file, found.check) for found in verify(copy)]
    (copy.parent / golden.file).unlink()
    assert "file" in checks(copy)


@pytest.mark.parametrize(
    ("change", "check"),
    [
        ({"sha256": "0" * 64}, "hash"),
        ({"sha256": ""}, "hash"),
        ({"original_sha256": "0" * 64}, "attachment"),
        ({"original": "other.pcap"}, "attachment"),
        ({"frames": 1}, "frames"),
        ({"profile": "dcp-2.0"}, "decode"),
        ({"profile": "cpp-1.3"}, "decode"),
        ({"profile": "sim-2.0"}, "decode"),
        ({"profile": "none"}, "capture"),
        ({"expected": None}, "counts"),
    ],
)
def test_a_changed_manifest_is_noticed(copy, change, check):
    golden = load_manifest(copy).capture[0]
    write(copy, msgspec.structs.replace(golden, **change))
    assert check in checks(copy)


@pytest.mark.part("suite")
def test_every_count_is_compared(copy):
    golden = load_manifest(copy).capture[0]
    counts = json.loads(msgspec.json.encode(golden.expected))

    def numbers(tree, path=()):
        for name, value in tree.items():
            yield from numbers(value, (*path, name)) if isinstance(value, dict) else [(*path, name)]

    paths = list(numbers(counts))
    assert len(paths) > 30
    for path in paths:
        changed = json.loads(json.dumps(counts))
        place = changed
        for name in path[:-1]:
            place = place[name]
        place[path[-1]] = "00" if path[-1] == "value" else place[path[-1]] + 1
        expected = msgspec.convert(changed, Counts)
        write(copy, msgspec.structs.replace(golden, expected=expected))
        (found,) = verify(copy)
        assert found.check == "counts"
        assert found.message.startswith(" / ".join(path))


def test_frames_that_differ_from_the_attachment_are_noticed(copy):
    golden = load_manifest(copy).capture[0]
    path = copy.parent / golden.file
    original = copy.parent / golden.original
    (attachment,) = attachments(path)
    extract_attachment(path, attachment, original)
    with open_capture(original) as reader, create_capture(path, attachment=original) as writer:
        for frame in reader:
            later = msgspec.structs.replace(frame, time_ns=frame.time_ns + (frame.number == 100))
            writer.write(later)
    found = [finding for finding in verify(copy) if finding.check == "attachment"]
    assert [finding.message for finding in found] == ["c_latejoin.pcap and the file differ from frame 100 on"]


def test_a_beacon_that_does_not_decode_is_noticed(copy):
    golden = load_manifest(copy).capture[0]
    path = copy.parent / golden.file
    original = copy.parent / golden.original
    (attachment,) = attachments(path)
    extract_attachment(path, attachment, original)
    with open_capture(original) as reader:
        frames = list(reader)
    broken = [msgspec.structs.replace(frame, data=frame.data[:15] + b"\0" + frame.data[16:]) for frame in frames[:9]]
    with create_capture(original) as writer:
        for frame in broken + frames[9:]:
            writer.write(frame)
    with open_capture(original) as reader, create_capture(path, attachment=original) as writer:
        for frame in reader:
            writer.write(frame)
    found = [finding for finding in verify(copy) if finding.check == "decode"]
    assert len(found) == 6
    assert "frame 1: bp.magicNo at octet 15: bad-magic" in found[0].message
    assert found[-1].message == "and 4 more of this kind"


def test_an_unusable_manifest_is_an_error(tmp_path, dcp_selftest):
    path = tmp_path / "manifest.toml"
    for text in (
        "[[capture]]\n",
        "capture = 7\nmade_with = {}",
        "= nothing",
        'capture = []\nmade_with = {}\nmore = ""',
    ):
        path.write_text(text)
        with pytest.raises(GoldensError, match="manifest"):
            verify(path)
        assert dcp_selftest("goldens", "verify", path).status == 2
    path.unlink()
    done = dcp_selftest("goldens", "verify", path)
    assert done.status == 2
    assert "dcp-selftest: " in done.err
    path.write_text("capture = []\nmade_with = {}\n")
    assert dcp_selftest("goldens", "verify", path).status == 2


# -- building them ------------------------------------------------------------------------------------------------


@pytest.mark.part("tools")
def test_building_twice_gives_the_same_octets(tmp_path):
    built = []
    for name in ("one", "two"):
        folder = tmp_path / name
        shutil.copytree(CAPTURES, folder)
        made = make(folder / "manifest.toml")
        assert verify(folder / "manifest.toml") == []
        built.append([(golden.file, golden.sha256) for golden in made.capture])
        assert [golden.original_sha256 for golden in made.capture] == [golden.original_sha256 for golden in GOLDENS]
        assert [golden.expected for golden in made.capture] == [golden.expected for golden in GOLDENS]
        assert set(made.made_with) == {"dcp-codec", "mcap", "zstandard"}
    assert built[0] == built[1]


def test_building_from_a_folder_takes_the_counts_beside_the_recording(copy, tmp_path, dcp_selftest):
    folder = tmp_path / "originals"
    folder.mkdir()
    golden = load_manifest(copy).capture[0]
    path = copy.parent / golden.file
    (attachment,) = attachments(path)
    extract_attachment(path, attachment, folder / golden.original)
    assert dcp_selftest("goldens", "make", copy, "--originals", folder).status == 0
    expected = golden.expected
    beside = {
        "counts": {"beacons": 271, "srp": expected.srp, "containers UPDATES": 24},
        "senders": {"02:00:00:00:00:01": {"beacons": 106, "first_seqno": 0, "last_seqno": 105}},
        "last_sent_value": {"1": [4, "03040506"]},
    }
    (folder / "c_latejoin.json").write_text(json.dumps(beside))
    assert dcp_selftest("goldens", "make", copy, "--originals", folder).status == 1
    found = [finding.message for finding in verify(copy)]
    assert "beacons is 270, expected 271" in found
    assert "containers / SUMMARIES is 267, expected absent" in found
    assert load_manifest(copy).capture[0].expected.containers == {"UPDATES": 24}
    (folder / "c_latejoin.json").write_text("{}")
    assert dcp_selftest("goldens", "make", copy, "--originals", folder).status == 2


def test_building_from_an_empty_folder_changes_no_files(copy, tmp_path, dcp_selftest):
    path = copy.parent / "c_latejoin.mcap"
    before = path.read_bytes(), copy.read_text()
    done = dcp_selftest("goldens", "make", copy, "--originals", tmp_path / "none")
    assert done.status == 2
    assert "cannot be read: No such file or directory" in done.err
    golden = load_manifest(copy).capture[0]
    write(copy, msgspec.structs.replace(golden, original="other.pcap"))
    assert dcp_selftest("goldens", "make", copy).status == 2
    write(copy, golden)
    assert (path.read_bytes(), copy.read_text()) == before
