"""Recordings of what a link carries."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest

from dcp_codec.capture import Frame, open_capture
from dcp_codec.codec import Codec
from dcp_stack.links.base import LinkError
from dcp_stack.links.recording import FLUSH_INTERVAL, Recorder, recording_path
from dcp_stack.links.replay import ReplayLink

CAPTURES = Path(__file__).resolve().parents[3] / "captures"
MAC = bytes.fromhex("020000000001")


@pytest.fixture(scope="module")
def codec() -> Codec:
    return Codec("cpp-2.0")


@pytest.fixture(scope="module")
def beacons() -> list[bytes]:
    with open_capture(CAPTURES / "a_bus3.mcap") as capture:
        return [frame.data[14:] for _, frame in zip(range(40), capture, strict=False)]


def frames_of(path: Path) -> list[Frame]:
    with open_capture(path) as capture:
        frames = list(capture)
        assert capture.problems == []
    return frames


def test_a_folder_gets_a_new_recording_for_each_start(tmp_path):
    # A clock without a battery says the same after each boot.
    wall = 1_700_000_000 * 10**9
    names = []
    for _ in range(3):
        path = recording_path(tmp_path, MAC, wall)
        assert path.parent == tmp_path
        path.touch()
        names.append(path.name)
    stem = "020000000001-20231114T221320Z"
    assert names == [f"{stem}.mcap", f"{stem}-2.mcap", f"{stem}-3.mcap"]
    assert recording_path(tmp_path / "flight.mcap", MAC, wall) == tmp_path / "flight.mcap"
    # Meant as a folder, which the message about what is missing can then say.
    assert recording_path(f"{tmp_path}/none/", MAC, wall).parent == tmp_path / "none"


def test_the_recording_contains_its_profile_and_is_decoded(tmp_path, codec, beacons):
    from mcap.reader import make_reader

    recorder = Recorder(tmp_path / "a.mcap", codec, about={"node": "02:00:00:00:00:01"})
    for octets in beacons:
        recorder.saw(octets, 5, outgoing=False, source=MAC)
    recorder.close()
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert {record.name: record.metadata for record in reader.iter_metadata()}["dcp.recording"] == {
            "node": "02:00:00:00:00:01"
        }
        counts = {
            summary.channels[channel].topic: count
            for channel, count in summary.statistics.channel_message_counts.items()
        }
    assert counts["/dcp/frames"] == counts["/dcp/bp"] == len(beacons)


def test_a_recording_can_be_replayed(tmp_path, codec, beacons):
    with_raw_frames_only = Recorder(tmp_path / "a.mcap", codec, decoded=False)
    for number, octets in enumerate(beacons):
        with_raw_frames_only.saw(octets, number, outgoing=False, source=MAC)
    with_raw_frames_only.close()
    link = ReplayLink(tmp_path / "a.mcap", codec.profile.link, speed=1e9)
    heard = []
    while not link.finished:
        heard += [each.octets for each in link.receive()]
    assert heard == beacons


def test_an_unfinished_recording_can_be_read_after_a_second(tmp_path, codec, beacons):
    now = 0
    recorder = Recorder(tmp_path / "a.mcap", codec, clock=lambda: now)

    def readable() -> int:
        with open_capture(tmp_path / "a.mcap") as capture:
            return len(list(capture))

    recorder.saw(beacons[0], 1, outgoing=True, source=MAC)
    now = FLUSH_INTERVAL - 1
    recorder.tick()
    assert readable() == 0
    now = FLUSH_INTERVAL
    recorder.tick()
    assert readable() == 1
    size = (tmp_path / "a.mcap").stat().st_size
    # Nothing new, nothing written.
    now = 3 * FLUSH_INTERVAL
    recorder.tick()
    assert (tmp_path / "a.mcap").stat().st_size == size
    recorder.close()


def test_a_long_recording_has_fewer_chunks_than_seconds(tmp_path, codec, beacons):
    """The index of chunks stays in memory until the end."""
    now = 0
    recorder = Recorder(tmp_path / "a.mcap", codec, decoded=False, clock=lambda: now)
    chunks: list[int] = []
    for _ in range(4):
        before, size = 0, (tmp_path / "a.mcap").stat().st_size
        for _ in range(3600):
            now += FLUSH_INTERVAL
            recorder.saw(beacons[0], now, outgoing=True, source=MAC)
            recorder.tick()
            before, size = before + ((tmp_path / "a.mcap").stat().st_size != size), (tmp_path / "a.mcap").stat().st_size
        chunks.append(before)
    recorder.close()
    # Each second for half an hour, and at the end of the fourth hour every eighth.
    assert 1800 <= chunks[0] < 3600
    assert chunks[1] < 1800
    assert 3600 / 9 <= chunks[3] < 3600 / 5
    assert len(frames_of(tmp_path / "a.mcap")) == 4 * 3600


@pytest.fixture
def small_disk():
    """Files of this process cannot become longer than 20,000 octets."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path, codec, beacons, caplog, small_disk):
    now = 0
    recorder = Recorder(tmp_path / "a.mcap", codec, clock=lambda: now)
    for _ in range(30):
        now += FLUSH_INTERVAL
        for octets in beacons[:10]:
            recorder.saw(octets, now, outgoing=True, source=MAC)
        recorder.tick()
    assert not recorder.recording
    assert "a.mcap: cannot be written" in recorder.problem
    assert [record.levelname for record in caplog.records if "recording ends" in record.message] == ["ERROR"]
    recorder.close()
    with open_capture(tmp_path / "a.mcap") as capture:
        assert 0 < len(list(capture)) <= recorder.frames


def test_a_disk_that_is_full_at_the_end_is_reported(tmp_path, codec, beacons, small_disk):
    recorder = Recorder(tmp_path / "a.mcap", codec, decoded=True)
    for octets in beacons * 3:
        recorder.saw(octets, 1, outgoing=True, source=MAC)
    recorder.close()
    recorder.close()
    assert "cannot be written" in recorder.problem


def test_recordings_are_not_replaced_by_mistake(tmp_path, codec):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(LinkError, match="exists already"):
        Recorder(path, codec)
    assert path.read_bytes() == b"precious"
    Recorder(path, codec, overwrite=True).close()
    assert frames_of(path) == []
    with pytest.raises(LinkError, match="cannot record to"):
        Recorder(tmp_path / "no" / "a.mcap", codec)


def test_no_frame_raises(tmp_path, codec):
    recorder = Recorder(tmp_path / "a.mcap", codec)
    for octets, wall in [(b"", -1), (bytes(65_600), 2**70), (b"garbage", 0)]:
        recorder.saw(octets, wall, outgoing=False, source=b"")
    assert recorder.frames == 3
    recorder.close()
    assert len(frames_of(tmp_path / "a.mcap")) == 3
