"""Files that are not captures are refused with a helpful message, and yield no frames."""

import io
import os
import struct
import subprocess
import sys

import pytest

from dcp_codec.capture import CaptureError, open_capture

PCAP = struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, 1)
RECORD = struct.pack("<IIII", 1, 2, 3, 60) + b"abc"


@pytest.mark.parametrize(
    ("contents", "message"),
    [
        (b"", "is empty"),
        (b"\x1f\x8b\x08rest", "its gzip data is damaged"),
        (b"\x28\xb5\x2f\xfdrest", "its zstd data is"),
        (b"\xfd7zXZ\x00", "xz-compressed"),
        (b"BZh91", "bzip2-compressed"),
        (b"PK\x03\x04", "zip archive"),
        (b"\x89MCAP1\r\n", "MCAP of a version other than 0"),
        (b"#ROSBAG V2.0", "ROS 1 bag"),
        (b"Hello, world", r"starts with 48 65 6c 6c 6f .*'Hello, world'"),
        (b"\x00\x01", r"starts with 00 01 \('\.\.'\)"),
    ],
)
def test_the_error_names_the_actual_kind_of_file(tmp_path, contents, message):
    path = tmp_path / "some.pcap"
    path.write_bytes(contents)
    with pytest.raises(CaptureError, match=message) as caught:
        open_capture(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_missing_files_directories_and_impossible_names(tmp_path):
    for path, message in [
        (tmp_path / "none.pcap", "cannot be read: No such file"),
        (tmp_path, "Is a directory"),
        (tmp_path / ("x" * 5000), "too long"),
        ("a\0b", "null"),
    ]:
        with pytest.raises(CaptureError, match=message):
            open_capture(path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission(tmp_path):
    path = tmp_path / "secret.pcap"
    path.write_bytes(PCAP)
    path.chmod(0)
    with pytest.raises(CaptureError, match="Permission denied"):
        open_capture(path)


def test_the_name_of_the_file_does_not_matter(tmp_path):
    path = tmp_path / "capture.mcap"
    path.write_bytes(PCAP + RECORD)
    with open_capture(str(path)) as reader:
        assert (reader.format, reader.name, len(list(reader))) == ("pcap", str(path), 1)


def test_a_pipe_gives_frames_as_they_arrive():
    receiving, sending = os.pipe()
    with os.fdopen(receiving, "rb") as pipe, os.fdopen(sending, "wb", buffering=0) as other:
        other.write(PCAP)
        with open_capture(pipe) as reader:
            assert reader.size is None
            for number in range(1, 4):
                # Were the reader to wait for a full buffer, this would never end.
                other.write(RECORD)
                assert next(reader).number == number
            other.write(RECORD[:10])
            other.close()
            assert list(reader) == []
            assert [problem.reason for problem in reader.problems] == ["truncated-header"]
        assert not pipe.closed


def test_standard_input():
    code = "from dcp_codec.capture import open_capture; r = open_capture('-'); print(len(list(r)), r.name, r.size)"
    done = subprocess.run([sys.executable, "-c", code], input=PCAP + RECORD * 3, capture_output=True, check=True)
    assert done.stdout.split() == [b"3", b"standard", b"input", b"None"]


class Failing(io.RawIOBase):
    """A device that gives some octets and then an error."""

    def __init__(self, octets: bytes, error: Exception) -> None:
        self.octets = io.BytesIO(octets)
        self.error = error

    def readable(self) -> bool:
        return True

    def read(self, size: int = -1) -> bytes:
        piece = self.octets.read(min(size, 10))
        if not piece:
            raise self.error
        return piece


@pytest.mark.parametrize("cut", [0, 5])
@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), EOFError("compressed data ended")])
def test_errors_while_reading_are_problems(cut, error):
    octets = PCAP + RECORD * 3
    with open_capture(Failing(octets[: len(octets) - cut], error)) as reader:
        assert len(list(reader)) == (2 if cut else 3)
    (problem,) = reader.problems
    assert problem.reason == "read-error"
    assert "ended" in problem.message or "Input/output error" in problem.message


def test_errors_before_the_first_octet():
    with pytest.raises(CaptureError, match="Input/output error"):
        open_capture(Failing(b"", OSError(5, "Input/output error")))


def test_an_empty_stream():
    class Silent(io.RawIOBase):
        def read(self, size: int = -1) -> None:
            return None

    with pytest.raises(CaptureError, match="non-blocking"):
        open_capture(Silent())


def test_a_loop_can_be_left_and_resumed():
    with open_capture(io.BytesIO(PCAP + RECORD * 5)) as reader:
        for frame in reader:
            if frame.number == 2:
                break
        assert [frame.number for frame in reader] == [3, 4, 5]
    assert list(reader) == []


def test_closing_ends_reading_and_may_be_repeated():
    reader = open_capture(io.BytesIO(PCAP + RECORD * 5))
    next(reader)
    reader.close()
    reader.close()
    assert list(reader) == []
    assert reader.problems == []


def test_the_mcap_library_is_imported_for_mcap_files_only():
    code = (
        "import sys, dcp_codec.capture;"
        "print(sorted({'mcap', 'zstandard', 'lz4', 'scapy', 'socket', 'asyncio'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert done.stdout.strip() == "[]"
