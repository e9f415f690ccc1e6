"""Wireshark's programs and scapy, as judges that have not seen our code."""

import io
import json
import subprocess
from pathlib import Path

import pytest

from dcp_codec.capture import CaptureError, Frame, create_capture, open_capture

pytestmark = pytest.mark.part("tools")

FRAMES = [
    Frame(
        n,
        1_700_000_000_000_000_000 + n * 1_234_567_891,
        bytes.fromhex("ffffffffffff 020000000001 4953".replace(" ", "")) + n.to_bytes(2, "big") * n,
        14 + 2 * n + (n % 2) * 100,
        n % 3,
    )
    for n in range(1, 40)
]


def run(*arguments: object) -> str:
    done = subprocess.run([str(each) for each in arguments], capture_output=True, text=True, check=True)
    return done.stdout


def write(path: Path, frames: list[Frame] = FRAMES, **options) -> Path:
    with create_capture(path, **options) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def tshark(path: Path) -> list[tuple]:
    fields = ["frame.number", "frame.time_epoch", "frame.len", "frame.cap_len", "frame.interface_id", "eth.dst"]
    listing = run("tshark", "-n", "-r", path, "-T", "fields", *(part for each in fields for part in ("-e", each)))
    found = []
    for line in listing.splitlines():
        number, time, length, captured, interface, destination = line.split("\t")
        seconds, nanoseconds = time.split(".")
        assert len(nanoseconds) == 9
        assert destination == "ff:ff:ff:ff:ff:ff"
        found.append((int(number), int(seconds + nanoseconds), int(length), int(captured), int(interface or 0)))
    return found


def seen(frames: list[Frame], *, interfaces: bool = True) -> list[tuple]:
    return [
        (each.number, each.time_ns, each.orig_len, len(each.data), each.interface if interfaces else 0)
        for each in frames
    ]


def plain(frames) -> list[tuple]:
    return [(each.number, each.time_ns, each.data, each.orig_len, each.interface) for each in frames]


@pytest.mark.tool("tshark")
@pytest.mark.parametrize("format", ["pcap", "pcapng"])
@pytest.mark.parametrize("resolution", ["ns", "us"])
def test_tshark_reads_our_files(tmp_path, format, resolution):
    path = write(tmp_path / f"a.{format}", resolution=resolution, lossy=True)
    expected = seen(FRAMES, interfaces=format == "pcapng")
    if resolution == "us":
        expected = [(number, time // 1000 * 1000, *rest) for number, time, *rest in expected]
    assert tshark(path) == expected


@pytest.mark.tool("tshark")
def test_tshark_sees_the_names_of_interfaces(tmp_path):
    about = {f"interface.{n}": {"name": f"veth{n}", "description": "a cable"} for n in range(3)}
    path = write(tmp_path / "a.pcapng", metadata=about)
    listing = run("tshark", "-n", "-r", path, "-T", "fields", "-e", "frame.interface_name")
    assert listing.split() == [f"veth{each.interface}" for each in FRAMES]


@pytest.mark.tool("capinfos")
@pytest.mark.parametrize(
    ("format", "options", "kind", "precision"),
    [
        ("pcap", {}, "nsecpcap", "nanoseconds"),
        ("pcap", {"resolution": "us"}, "pcap", "microseconds"),
        ("pcapng", {}, "pcapng", "nanoseconds"),
    ],
)
def test_capinfos_recognises_our_files(tmp_path, format, options, kind, precision):
    path = write(tmp_path / f"a.{format}", lossy=True, **options)
    name, what, link_type, count = run("capinfos", "-T", "-B", "-r", "-t", "-E", "-c", path).strip().split("\t")
    assert (name, link_type, count) == (str(path), "ether", str(len(FRAMES)))
    assert kind in what
    assert precision in run("capinfos", path)


@pytest.mark.tool("editcap")
@pytest.mark.tool("tshark")
@pytest.mark.parametrize("kind", ["pcap", "nsecpcap", "pcapng"])
@pytest.mark.parametrize("format", ["pcap", "pcapng"])
def test_files_of_editcap_are_read(tmp_path, kind, format):
    source = write(tmp_path / f"a.{format}", lossy=True)
    made = tmp_path / f"made.{kind}"
    run("editcap", "-F", kind, source, made)
    with open_capture(made) as reader:
        frames = list(reader)
    assert reader.problems == []
    assert reader.format == ("pcapng" if kind == "pcapng" else "pcap")
    assert [each.data for each in frames] == [each.data for each in FRAMES]
    assert seen(frames, interfaces=kind == "pcapng") == tshark(made)


@pytest.mark.tool("editcap")
def test_frames_truncated_by_editcap(tmp_path):
    made = tmp_path / "made.pcap"
    run("editcap", "-s", "20", write(tmp_path / "a.pcapng"), made)
    with open_capture(made) as reader:
        assert [(each.data, each.orig_len) for each in reader] == [(each.data[:20], each.orig_len) for each in FRAMES]


@pytest.mark.tool("editcap")
def test_modified_pcap_of_editcap_is_named(tmp_path):
    made = tmp_path / "made.pcap"
    run("editcap", "-F", "modpcap", write(tmp_path / "a.pcapng"), made)
    with pytest.raises(CaptureError, match="Kuznetzov"):
        open_capture(made)


@pytest.mark.tool("editcap")
@pytest.mark.parametrize("kind", ["snoop", "nettl", "k12text"])
def test_other_formats_of_editcap_are_refused(tmp_path, kind):
    made = tmp_path / "made.pcap"
    run("editcap", "-F", kind, write(tmp_path / "a.pcap", lossy=True), made)
    with pytest.raises(CaptureError, match=r"made\.pcap: is "):
        open_capture(made)


@pytest.mark.tool("mergecap")
@pytest.mark.tool("tshark")
def test_files_of_mergecap_are_read(tmp_path):
    first = write(tmp_path / "a.pcap", FRAMES[::2], lossy=True)
    second = write(tmp_path / "b.pcapng", FRAMES[1::2])
    made = tmp_path / "made.pcapng"
    run("mergecap", "-w", made, first, second)
    with open_capture(made) as reader:
        frames = list(reader)
    assert reader.problems == []
    assert [(each.time_ns, each.data) for each in frames] == [(each.time_ns, each.data) for each in FRAMES]
    assert seen(frames) == tshark(made)


def test_files_are_exchanged_with_scapy(tmp_path):
    utils = pytest.importorskip("scapy.utils")
    made, ours = tmp_path / "made.pcap", tmp_path / "ours.pcap"
    with utils.RawPcapWriter(str(made), linktype=1, nano=True, endianness=">") as writer:
        writer.write_header(None)
        for frame in FRAMES:
            sec, nsec = divmod(frame.time_ns, 10**9)
            writer.write_packet(frame.data, sec=sec, usec=nsec, caplen=len(frame.data), wirelen=frame.orig_len)
    assert made.read_bytes()[:4] == b"\xa1\xb2\x3c\x4d"
    with open_capture(made) as reader:
        assert [each[:4] for each in plain(reader)] == [each[:4] for each in plain(FRAMES)]
    write(ours, lossy=True)
    with utils.RawPcapReader(str(ours)) as packets:
        found = [(data, about.sec * 10**9 + about.usec, about.wirelen) for data, about in packets]
    assert found == [(each.data, each.time_ns, each.orig_len) for each in FRAMES]


BUNDLED = sorted((Path(__file__).resolve().parents[2] / "captures").glob("*.mcap"))


@pytest.mark.parametrize("path", BUNDLED, ids=lambda path: path.name)
def test_bundled_recordings_are_whole(path):
    stream = io.BytesIO()
    with open_capture(path) as reader:
        count = sum(1 for _ in reader)
    assert count > 0
    assert reader.problems == []
    with open_capture(path) as again, create_capture(stream, format="pcapng") as writer:
        for frame in again:
            writer.write(frame)
    stream.seek(0)
    with open_capture(path) as first, open_capture(stream) as second:
        assert [each[1:] for each in plain(first)] == [each[1:] for each in plain(second)]
    assert json.dumps(dict(reader.metadata))
