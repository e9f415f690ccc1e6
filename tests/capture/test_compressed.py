"""Captures that are compressed as a whole, and files that appear when they are complete."""

from __future__ import annotations

import gzip
import tracemalloc
from pathlib import Path

import pytest
import zstandard

from dcp_codec.capture import CaptureError, Frame, convert, create_capture, open_capture

FRAMES = [Frame(n + 1, 1_700_000_000_000_000_000 + n, bytes([n % 256]) * 60, 60) for n in range(5000)]
SAME = [(frame.time_ns, frame.data) for frame in FRAMES]


def written(path: Path) -> Path:
    with create_capture(path) as file:
        for frame in FRAMES:
            file.write(frame)
    return path


def read(path: Path) -> tuple[list[tuple[int, bytes]], list[str]]:
    with open_capture(path) as reader:
        return [(frame.time_ns, frame.data) for frame in reader], [problem.message for problem in reader.problems]


@pytest.mark.parametrize("compression", ["gz", "zst"])
@pytest.mark.parametrize("kind", ["pcap", "pcapng", "mcap"])
def test_compressed_files_are_read_back(kind: str, compression: str, tmp_path: Path) -> None:
    plain, packed = written(tmp_path / f"a.{kind}"), written(tmp_path / f"b.{kind}.{compression}")
    assert packed.read_bytes()[:2] in (b"\x1f\x8b", b"\x28\xb5")
    # The chunks of an MCAP are compressed already.
    assert kind == "mcap" or packed.stat().st_size < plain.stat().st_size // 4
    assert read(packed) == read(plain) == (SAME, [])


@pytest.mark.parametrize("compression", ["gz", "zst"])
def test_concatenated_compressed_parts_are_one_file(compression: str, tmp_path: Path) -> None:
    octets = written(tmp_path / "a.pcap").read_bytes()
    pack = gzip.compress if compression == "gz" else zstandard.ZstdCompressor().compress
    path = tmp_path / "any name"
    path.write_bytes(pack(octets[:1000]) + pack(octets[1000:]))
    assert read(path) == (SAME, [])


@pytest.mark.parametrize("compression", ["gz", "zst"])
def test_frames_of_a_cut_off_file_are_read_with_a_problem(compression: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"a.pcap.{compression}")
    path.write_bytes(path.read_bytes()[:-200])
    frames, problems = read(path)
    assert frames == SAME[: len(frames)]
    assert len(frames) < len(FRAMES)
    assert "data is cut off" in " ".join(problems)


@pytest.mark.parametrize("compression", ["gz", "zst"])
def test_damage_is_reported(compression: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"a.pcap.{compression}")
    octets = bytearray(path.read_bytes())
    octets[20:40] = bytes(20)
    path.write_bytes(octets)
    with pytest.raises(CaptureError, match="damaged") if compression == "zst" else _reported(path):
        read(path)


class _reported:  # noqa: N801 - replaces pytest.raises
    """Damage in the middle of gzip data shows after some octets: as an error or as a problem."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> bool:
        if error is None:
            assert any("damaged" in problem for problem in read(self.path)[1])
        return isinstance(error, CaptureError) and "damaged" in str(error)


@pytest.mark.part("tools")
@pytest.mark.parametrize("compression", ["gz", "zst"])
def test_memory_does_not_grow_with_what_is_decompressed(compression: str, tmp_path: Path) -> None:
    head = written(tmp_path / "a.pcap").read_bytes()
    pack = gzip.compress if compression == "gz" else zstandard.ZstdCompressor().compress
    path = tmp_path / "bomb"
    # 200 MB of zeros after the frames: an absurd record, which ends the reading.
    path.write_bytes(pack(head + bytes(200_000_000)))
    tracemalloc.start()
    try:
        frames, problems = read(path)
        assert tracemalloc.get_traced_memory()[1] < 120_000_000
    finally:
        tracemalloc.stop()
    assert frames[: len(SAME)] == SAME
    assert isinstance(problems, list)


def test_a_failed_conversion_leaves_the_target_unchanged(tmp_path: Path) -> None:
    source = tmp_path / "a.pcapng"
    with create_capture(source) as file:
        file.write(FRAMES[0])
        file.write(Frame(2, 1_700_000_000_000_000_001, b"x" * 60, 60, 3))
    target = tmp_path / "b.pcap"
    target.write_bytes(b"precious")
    with pytest.raises(CaptureError, match=r"b\.pcap"):
        convert(source, target)
    assert target.read_bytes() == b"precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.pcapng", "b.pcap"]


def test_an_interrupted_conversion_leaves_nothing(tmp_path: Path) -> None:
    source = written(tmp_path / "a.pcap")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        convert(source, tmp_path / "b.mcap", progress=interrupt)
    assert [path.name for path in tmp_path.iterdir()] == ["a.pcap"]
