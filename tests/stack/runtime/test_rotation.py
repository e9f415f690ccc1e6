"""Recordings that continue: in a new file, and after the disk was full."""

from __future__ import annotations

import errno
import os
import random
from pathlib import Path

import pytest

from dcp_codec.capture import CaptureError, open_capture
from dcp_codec.codec import get_codec
from dcp_stack.links import rotation
from dcp_stack.links.base import LinkError
from dcp_stack.links.recording import Recorder, recording_path
from dcp_stack.links.rotation import Limits, RotatingRecorder, numbered_after, recordings_of

CODEC = get_codec("dcp-2.0")
NODE = bytes.fromhex("020000000001")
SECOND = 1_000_000_000


class Disk:
    """Files in a folder, by a clock of its own, on a disk that may be full."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.now = 0
        # Recordings are compressed, so zeros would take no room.
        self.chance = random.Random(1)
        self.full = False
        monkeypatch.setattr(rotation, "LEAST_FREE", 0)

    def make(self, path: Path) -> Recorder:
        if self.full:
            raise LinkError(f"cannot record to {path}: no space")
        recorder = Recorder(path, CODEC, decoded=False, clock=lambda: self.now)
        writer, disk = recorder._writer, self

        class Writer:
            def write(self, frame):
                if disk.full:
                    raise CaptureError("no space", os.strerror(errno.ENOSPC))
                writer.write(frame)

            def flush(self):
                writer.flush()

            def close(self):
                writer.close()

        recorder._writer = Writer()
        return recorder

    def following(self) -> Path:
        return recording_path(self.folder, NODE, self.now)

    def recorder(self, **limits) -> RotatingRecorder:
        return RotatingRecorder(
            self.make,
            self.following(),
            self.following,
            limits=Limits(**limits),
            siblings=lambda: recordings_of(self.folder, NODE),
            clock=lambda: self.now,
        )

    def frames(self) -> list[int]:
        """Frames in each file, the oldest first."""
        counts = []
        for path in recordings_of(self.folder, NODE):
            with open_capture(path) as capture:
                counts.append(sum(1 for _ in capture))
        return counts

    def see(self, recorder: RotatingRecorder, seconds: int, size: int = 100) -> None:
        """Ten frames a second, and a tick after each."""
        for _ in range(10 * seconds):
            self.now += SECOND // 10
            recorder.saw(self.chance.randbytes(size), self.now, outgoing=True, source=NODE)
            recorder.tick()


@pytest.fixture
def disk(tmp_path, monkeypatch) -> Disk:
    return Disk(tmp_path, monkeypatch)


def test_a_new_file_after_some_time(disk):
    recorder = disk.recorder(seconds=10)
    disk.see(recorder, 35)
    recorder.close()
    assert disk.frames() == [100, 100, 100, 50]
    assert recorder.frames == 350


def test_a_new_file_when_it_is_large(disk):
    recorder = disk.recorder(octets=200_000)
    disk.see(recorder, 30, size=1400)
    recorder.close()
    sizes = [path.stat().st_size for path in recordings_of(disk.folder, NODE)]
    # 14 KB each second, checked each second: none is larger than that and a chunk, and only the last is smaller.
    assert all(200_000 <= size < 200_000 + 160_000 for size in sizes[:-1])
    assert len(sizes) == 3
    assert sum(disk.frames()) == 300


def test_only_the_last_files_of_this_node_are_kept(disk):
    strange = disk.folder / "0200000000ff-20260101T000000Z.mcap"
    strange.write_bytes(b"of another node")
    recorder = disk.recorder(seconds=5, files=2)
    disk.see(recorder, 28)
    recorder.close()
    assert disk.frames() == [50, 30]
    assert strange.exists()


def test_recording_continues_after_the_disk_was_full(disk):
    recorder = disk.recorder()
    disk.see(recorder, 5)
    disk.full = True
    disk.see(recorder, 30)
    assert not recorder.recording
    assert "no space" in recorder.problem
    disk.full = False
    disk.see(recorder, 20)
    assert recorder.recording
    assert recorder.problem == ""
    assert recorder.interruptions == 1
    recorder.close()
    # It looks every ten seconds.
    assert disk.frames()[0] == 50
    assert 100 <= disk.frames()[1] <= 200
    assert sum(disk.frames()) + recorder.frames_lost == 550
    assert recorder.frames == sum(disk.frames())


def test_a_nearly_full_disk_is_not_filled_with_empty_recordings(disk, monkeypatch):
    recorder = disk.recorder()
    disk.see(recorder, 1)
    disk.full = True
    disk.see(recorder, 1)
    disk.full = False
    monkeypatch.setattr(rotation, "LEAST_FREE", 1 << 62)
    disk.see(recorder, 40)
    recorder.close()
    assert len(disk.frames()) == 1


def test_names_of_single_files(tmp_path):
    first = tmp_path / "flight.mcap"
    assert numbered_after(first) == tmp_path / "flight-2.mcap"
    (tmp_path / "flight-2.mcap").touch()
    assert numbered_after(first) == tmp_path / "flight-3.mcap"


@pytest.mark.parametrize("limits", [{"octets": 0}, {"seconds": 0.0}, {"files": 0}])
def test_invalid_limits(limits):
    with pytest.raises(ValueError, match="must be greater than 0"):
        Limits(**limits)
