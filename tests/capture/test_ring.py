"""Recordings in several files, the oldest of which are deleted."""

from __future__ import annotations

from pathlib import Path

import pytest

from dcp_codec.capture import CaptureError, Frame, open_capture
from dcp_codec.capture.ring import RingWriter


def frames(count: int) -> list[Frame]:
    return [Frame(n + 1, 10**18 + n * 100_000_000, bytes([n % 256]) * 1000, 1000) for n in range(count)]


def times(path: Path) -> list[int]:
    with open_capture(path) as reader:
        assert reader.problems == []
        return [frame.time_ns for frame in reader]


def test_a_new_file_begins_after_a_time(tmp_path: Path) -> None:
    with RingWriter(tmp_path / "day.pcapng", max_ns=1_000_000_000) as ring:
        for frame in frames(25):
            ring.write(frame)
    assert [path.name for path in ring.files] == ["day-00001.pcapng", "day-00002.pcapng", "day-00003.pcapng"]
    assert [len(times(path)) for path in ring.files] == [10, 10, 5]
    assert (ring.frames, ring.count) == (25, 3)


@pytest.mark.parametrize("suffix", [".pcap", ".pcapng", ".mcap", ".pcap.gz", ".pcapng.zst"])
def test_the_last_files_are_kept(suffix: str, tmp_path: Path) -> None:
    with RingWriter(tmp_path / f"day{suffix}", max_ns=500_000_000, keep=2) as ring:
        for frame in frames(23):
            ring.write(frame)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"day-0000{n}{suffix}" for n in (4, 5)]
    assert [time for path in ring.files for time in times(path)] == [frame.time_ns for frame in frames(23)[15:]]


def test_a_new_file_begins_after_a_size(tmp_path: Path) -> None:
    with RingWriter(tmp_path / "day.pcap", max_octets=100_000) as ring:
        for frame in frames(400):
            ring.write(frame)
    sizes = [path.stat().st_size for path in ring.files]
    # Frames are handed over in batches, and a file ends after the batch that fills it.
    assert all(100_000 <= size < 180_000 for size in sizes[:-1])
    assert sum(len(times(path)) for path in ring.files) == 400


def test_without_limits_there_is_one_file(tmp_path: Path) -> None:
    with RingWriter(tmp_path / "day.pcap") as ring:
        for frame in frames(30):
            ring.write(frame)
        # Another process, also after a crash, finds everything except the last second.
        assert len(times(tmp_path / "day.pcap")) >= 20
    assert [path.name for path in tmp_path.iterdir()] == ["day.pcap"]


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="there is no folder"):
        RingWriter(tmp_path / "nowhere" / "day.pcap")
