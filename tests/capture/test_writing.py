"""Guarantees of the writers: no frame is lost, no file is half written, and no other file is changed."""

import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from dcp_codec.capture import (
    FORMATS,
    MAX_FRAME_LENGTH,
    MAX_TIME_NS,
    CaptureError,
    Frame,
    convert,
    create_capture,
    open_capture,
)

FRAMES = [
    Frame(1, 1_700_000_000_123_456_789, b"abc", 60),
    Frame(2, 1_700_000_000_123_456_790, b"", 14),
    Frame(3, 0, bytes(range(256)), 256),
]


def plain(frames):
    return [(each.number, each.time_ns, each.data, each.orig_len, each.interface) for each in frames]


def read(source):
    with open_capture(source) as reader:
        return plain(reader), reader


@pytest.mark.parametrize("format", FORMATS)
def test_path_stream_and_standard_output_give_the_same(tmp_path, format):
    path = tmp_path / f"a.{format}"
    with create_capture(path) as writer:
        for frame in FRAMES:
            writer.write(frame)
    assert (writer.format, writer.name, writer.frames_written) == (format, str(path), 3)
    assert writer.position == path.stat().st_size

    stream = io.BytesIO()
    with create_capture(stream, format=format) as writer:
        for frame in FRAMES:
            writer.write(frame)
    assert stream.getvalue() == path.read_bytes()

    code = "import sys; from dcp_codec.capture import convert; convert('-', '-', format=sys.argv[1])"
    done = subprocess.run(
        [sys.executable, "-c", code, format], input=path.read_bytes(), capture_output=True, check=True
    )
    assert done.stdout == path.read_bytes()

    frames, reader = read(path)
    assert (frames, reader.problems) == (plain(FRAMES), [])


@pytest.mark.parametrize("format", FORMATS)
def test_the_same_frames_give_the_same_octets(format):
    streams = [io.BytesIO(), io.BytesIO()]
    for stream in streams:
        with create_capture(stream, format=format) as writer:
            for frame in FRAMES:
                writer.write(frame)
    assert streams[0].getvalue() == streams[1].getvalue()


@pytest.mark.parametrize("format", FORMATS)
def test_an_empty_capture_is_valid(tmp_path, format):
    path = tmp_path / f"a.{format}"
    create_capture(path).close()
    frames, reader = read(path)
    assert (frames, reader.problems) == ([], [])


@pytest.mark.parametrize("format", FORMATS)
def test_an_exception_leaves_a_whole_file(tmp_path, format):
    path = tmp_path / f"a.{format}"

    def record() -> None:
        with create_capture(path) as writer:
            writer.write(FRAMES[0])
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        record()
    frames, reader = read(path)
    assert (frames, reader.problems) == (plain(FRAMES[:1]), [])


@pytest.mark.parametrize("format", FORMATS)
def test_close_may_be_repeated_and_ends_writing(format):
    stream = io.BytesIO()
    writer = create_capture(stream, format=format)
    writer.close()
    once = stream.getvalue()
    writer.close()
    assert stream.getvalue() == once
    with pytest.raises(ValueError, match="is closed"):
        writer.write(FRAMES[0])


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize(
    ("frame", "message"),
    [
        (Frame(7, -1, b"a", 1), "frame 7 .* 1970"),
        (Frame(7, MAX_TIME_NS + 1, b"a", 1), "frame 7 .* 1970"),
        (Frame(7, 0, b"abc", 2), "length on the wire"),
        (Frame(7, 0, b"abc", 2**32), "length on the wire"),
        (Frame(7, 0, bytes(MAX_FRAME_LENGTH + 1), MAX_FRAME_LENGTH + 1), "262144"),
        (Frame(7, 0, b"a", 1, interface=-1), "interface"),
        (Frame(7, 0, b"a", 1, interface=2**32), "interface"),
    ],
)
def test_frames_that_do_not_fit_are_refused_and_writing_continues(format, frame, message):
    stream = io.BytesIO()
    with create_capture(stream, format=format) as writer:
        writer.write(FRAMES[0])
        with pytest.raises(CaptureError, match=rf"^<stream>: .*{message}"):
            writer.write(frame)
        writer.write(FRAMES[1])
    stream.seek(0)
    frames, reader = read(stream)
    assert (frames, reader.problems) == (plain(FRAMES[:2]), [])


def test_pcap_refuses_values_that_it_cannot_express():
    writer = create_capture(io.BytesIO(), format="pcap")
    for frame, message in [
        (Frame(1, 2**32 * 10**9, b"a", 1), "2106"),
        (Frame(1, 1, b"a", 1, interface=1), "interface number, 1; use pcapng"),
        (Frame(1, 0, b"", 0), "zeroed end"),
    ]:
        with pytest.raises(CaptureError, match=message):
            writer.write(frame)


def test_pcapng_refuses_interfaces_that_would_fill_the_file():
    with pytest.raises(CaptureError, match=r"0\.\.4095"):
        create_capture(io.BytesIO(), format="pcapng").write(Frame(1, 1, b"a", 1, interface=4096))


@pytest.mark.parametrize("format", ["pcap", "pcapng"])
def test_nanoseconds_are_only_lost_when_allowed(format):
    frame = Frame(1, 1_000_001_999, b"a", 1)
    with (
        create_capture(io.BytesIO(), format=format, resolution="us") as writer,
        pytest.raises(CaptureError, match="last 999 ns would be lost"),
    ):
        writer.write(frame)
    stream = io.BytesIO()
    with create_capture(stream, format=format, resolution="us", lossy=True) as writer:
        writer.write(frame)
    stream.seek(0)
    with open_capture(stream) as reader:
        assert [each.time_ns for each in reader] == [1_000_001_000]


def test_the_interface_is_lost_in_pcap_when_allowed():
    stream = io.BytesIO()
    with create_capture(stream, format="pcap", lossy=True) as writer:
        writer.write(Frame(1, 1, b"a", 1, interface=3))
    stream.seek(0)
    assert read(stream)[0] == [(1, 1, b"a", 1, 0)]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"format": "tar"}, "'tar' is not a format"),
        ({"format": "mcap", "resolution": "us"}, "nanoseconds and nothing else"),
        ({"format": "pcap", "messages": object()}, "only MCAP"),
        ({"format": "pcapng", "attachment": Path(__file__)}, "only MCAP"),
        ({"format": "mcap", "attachment": Path("/nowhere/at/all")}, "No such file"),
        ({"format": "mcap", "attachment": Path("/")}, "Is a directory"),
    ],
)
def test_a_refused_conversion_leaves_an_existing_file_unchanged(tmp_path, options, message):
    path = tmp_path / "a.pcap"
    path.write_bytes(b"precious")
    with pytest.raises(CaptureError, match=message):
        create_capture(path, **options)
    assert path.read_bytes() == b"precious"


@pytest.mark.parametrize("options", [{"resolution": "ps"}, {"format": "mcap", "compression": "rar"}])
def test_misuse_is_distinguished_from_errors_of_users(tmp_path, options):
    with pytest.raises(ValueError, match=r"ps|rar"):
        create_capture(tmp_path / "a.pcap", **options)
    assert list(tmp_path.iterdir()) == []


def test_impossible_targets(tmp_path):
    for target, message in [
        (tmp_path / "a.txt", "suffix"),
        (tmp_path / "none" / "a.pcap", "there is no folder .*none"),
        ("-", "standard output"),
        (io.BytesIO(), "stream"),
    ]:
        with pytest.raises(CaptureError, match=message):
            create_capture(target)
    with pytest.raises(CaptureError, match="Is a directory"):
        create_capture(tmp_path, format="pcap")


def test_the_source_is_never_the_target(tmp_path):
    path = tmp_path / "a.pcap"
    with create_capture(path) as writer:
        writer.write(FRAMES[0])
    before = path.read_bytes()
    link, other = tmp_path / "link.pcap", tmp_path / "other.mcap"
    link.symlink_to(path)
    other.hardlink_to(path)
    for target in (path, str(path), link, other):
        with pytest.raises(CaptureError, match="source and target are the same file"):
            convert(path, target)
        with path.open("rb") as stream, pytest.raises(CaptureError, match="source and target are the same file"):
            convert(stream, target)
    # Also where the shell opened it.
    code = "import sys; from dcp_codec.capture import convert; convert('-', sys.argv[1])"
    with path.open("rb") as stream:
        done = subprocess.run(
            [sys.executable, "-c", code, str(path)], stdin=stream, stderr=subprocess.PIPE, check=False
        )
    assert b"source and target are the same file" in done.stderr
    with pytest.raises(CaptureError, match="to itself"):
        create_capture(other, attachment=path)
    assert path.read_bytes() == before


def test_an_invalid_source_leaves_the_target_unchanged(tmp_path):
    source, target = tmp_path / "a.pcap", tmp_path / "b.pcap"
    source.write_bytes(b"this is not a capture")
    target.write_bytes(b"precious")
    with pytest.raises(CaptureError, match="is not a pcap"):
        convert(source, target)
    assert target.read_bytes() == b"precious"


@pytest.mark.parametrize("format", FORMATS)
def test_conversion_keeps_metadata_of_the_source(tmp_path, format):
    source, target = tmp_path / "a.pcapng", tmp_path / f"b.{format}"
    about = {"interface.0": {"name": "veth0"}, "interface.1": {"name": "veth1", "description": "the other"}}
    with create_capture(source, metadata=about) as writer:
        for frame in FRAMES:
            writer.write(frame)
    calls = []
    report = convert(source, target, progress=lambda done, size: calls.append((done, size)), metadata={"x": {"y": "z"}})
    assert (report.frames, report.problems, report.source_format, report.target_format) == (3, (), "pcapng", format)
    assert calls[-1] == (source.stat().st_size,) * 2
    frames, reader = read(target)
    assert frames == plain(FRAMES)
    if format != "pcap":
        assert reader.metadata["interface.0"]["name"] == "veth0"
    if format == "mcap":
        assert reader.metadata["x"] == {"y": "z"}


def test_conversion_of_a_truncated_file_reports_it(tmp_path):
    source, target = tmp_path / "a.pcap", tmp_path / "b.mcap"
    with create_capture(source) as writer:
        for frame in FRAMES:
            writer.write(frame)
    source.write_bytes(source.read_bytes()[:-1])
    report = convert(source, target)
    assert (report.frames, [problem.reason for problem in report.problems]) == (2, ["truncated-record"])
    assert read(target)[0] == plain(FRAMES[:2])


class Full(io.RawIOBase):
    """A device with room for some octets only."""

    def __init__(self, room: int) -> None:
        self.room = room

    def writable(self) -> bool:
        return True

    def write(self, octets) -> int:
        if not self.room:
            raise OSError(28, "No space left on device")
        # As a pipe does, it takes what it can.
        taken = min(len(octets), self.room)
        self.room -= taken
        return taken


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("room", [0, 10, 200, 70_000, 300_000])
def test_a_full_disk_is_reported_once(format, room):
    def record() -> None:
        with create_capture(Full(room), format=format) as writer:
            for _ in range(1000):
                writer.write(Frame(1, 1, os.urandom(1000), 1000))

    with pytest.raises(CaptureError, match="<stream>: cannot be written: No space"):
        record()


def test_the_first_error_is_the_one_that_is_raised():
    def record() -> None:
        with create_capture(Full(24), format="pcap") as writer:
            writer.write(FRAMES[0])
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError) as caught:
        record()
    assert caught.value.__notes__ == ["<stream>: cannot be written: No space left on device"]


def test_a_closed_pipe_is_reported():
    receiving, sending = os.pipe()
    os.close(receiving)
    with os.fdopen(sending, "wb", buffering=0) as pipe:
        with pytest.raises(CaptureError, match="Broken pipe") as caught:
            create_capture(pipe, format="pcapng")
        assert isinstance(caught.value.__cause__, BrokenPipeError)


RECORDER = """
import sys
from dcp_codec.capture import Frame, create_capture
writer = create_capture(sys.argv[1])
for number in range(1, 4101):
    writer.write(Frame(number, number, number.to_bytes(4, "big") * 25, 100))
    if number in (10, 4000):
        writer.flush()
    if number in (10, 4100):
        print(number, flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("format", FORMATS)
def test_flushed_frames_of_a_killed_recorder_can_be_read(tmp_path, format):
    path = tmp_path / f"a.{format}"
    with subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as recorder:
        assert recorder.stdout.readline() == b"10\n"
        assert len(read(path)[0]) >= 10
        assert recorder.stdout.readline() == b"4100\n"
        recorder.send_signal(signal.SIGKILL)
        recorder.wait()
    frames, reader = read(path)
    assert 4000 <= len(frames) <= 4100
    assert frames == [(n, n, n.to_bytes(4, "big") * 25, 100, 0) for n in range(1, len(frames) + 1)]
    assert [problem.reason for problem in reader.problems] == (["unfinished"] if format == "mcap" else [])
