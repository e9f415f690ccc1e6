"""Captures are longer than memory."""

import os
import struct
import threading
import tracemalloc

import pytest

from dcp_codec.capture import FORMATS, Frame, convert, create_capture, open_capture

COUNT = 200_000
LIMIT = 12 * 1024 * 1024


@pytest.fixture
def peak():
    """Octets that were in use at most, since the test began."""
    tracemalloc.start()
    try:
        yield lambda: tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.part("tools")
def test_a_pipe_of_many_frames(peak):
    receiving, sending = os.pipe()
    record = struct.pack("<IIII", 1, 2, 100, 100) + bytes(100)
    header = struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 1)

    def feed() -> None:
        with os.fdopen(sending, "wb", buffering=0) as pipe:
            pipe.write(header)
            for _ in range(COUNT // 1000):
                pipe.write(record * 1000)

    feeder = threading.Thread(target=feed)
    feeder.start()
    with os.fdopen(receiving, "rb") as pipe, open_capture(pipe) as reader:
        assert sum(1 for _ in reader) == COUNT
    feeder.join()
    assert reader.problems == []
    assert peak() < LIMIT


@pytest.mark.part("tools")
@pytest.mark.parametrize("format", FORMATS)
def test_files_of_any_length(tmp_path, format, peak):
    source, target = tmp_path / f"a.{format}", tmp_path / "b.mcap"
    with create_capture(source, compression="none") as writer:
        for number in range(1, 10_001):
            writer.write(Frame(number, number, number.to_bytes(4, "big") * 600, 2400))
    assert source.stat().st_size > 1.9 * LIMIT
    report = convert(source, target, attach_source=True, compression="none")
    assert (report.frames, report.problems) == (10_000, ())
    assert target.stat().st_size > source.stat().st_size
    assert peak() < LIMIT
