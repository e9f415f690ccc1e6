"""Recordings repeated until they are long enough to be measured, in every format."""

from __future__ import annotations

import struct
from itertools import islice
from pathlib import Path

from dcp_tables.table.job import resolve
from mcap.reader import make_reader

from dcp_codec.capture import convert, open_capture
from dcp_codec.framing.locate import Framing, locate

#: Beacons that contenders get which need microseconds, and tens of microseconds, for each.
QUICK, SLOW = 200_000, 100_000
#: Offset of the repeated part in a file with a magic number.
PCAP_HEADER = 24


class Material:
    """A recording repeated, as a pcap file, and its first beacons as octets and values."""

    def __init__(self, recording: Path, beacons: int, folder: Path) -> None:
        self.name = recording.stem
        self.codec, self.link, _ = resolve(recording, "auto", None)
        once = folder / f"{self.name}_once.pcap"
        convert(recording, once, lossy=True)
        self.once = once.read_bytes()
        with open_capture(once) as reader:
            self.frames = sum(isinstance(locate(frame.data, self.link), Framing) for frame in reader)
        self.beacons = self.frames * -(-beacons // self.frames)
        self.pcap = _repeated(self.once, self.beacons // self.frames, folder / f"{self.name}.pcap")
        self.size = self.pcap.stat().st_size
        self.octets: list[bytes] = []
        with open_capture(self.pcap) as reader:
            for frame in islice(reader, SLOW):
                framing = locate(frame.data, self.link)
                if isinstance(framing, Framing):
                    self.octets.append(frame.data[framing.start : framing.end])
        self.values = [self.codec.decode(octets) for octets in self.octets]


class Formats:
    """The first part of a recording in every format, and as MCAP the whole of it."""

    def __init__(self, material: Material, folder: Path) -> None:
        times = -(-QUICK // material.frames)
        self.beacons = material.frames * times
        self.pcap = _repeated(material.once, times, folder / "part.pcap")
        self.pcapng = folder / "part.pcapng"
        convert(self.pcap, self.pcapng)
        self.mcap = folder / "part.mcap"
        convert(self.pcap, self.mcap)
        plain = folder / "plain.mcap"
        convert(self.pcap, plain, compression="none")
        again = -(-material.beacons // self.beacons)
        self.whole_beacons = self.beacons * again
        self.whole_mcap = _repeated_chunks(self.mcap, again, folder / "whole.mcap")
        self.whole_plain = _repeated_chunks(plain, again, folder / "whole_plain.mcap")


def _repeated(octets: bytes, times: int, path: Path) -> Path:
    with path.open("wb") as file:
        file.write(octets[:PCAP_HEADER])
        for _ in range(times):
            file.write(octets[PCAP_HEADER:])
    return path


def _repeated_chunks(path: Path, times: int, target: Path) -> Path:
    """An MCAP file with all chunks so many times, ended as one without a summary is."""
    octets = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    first, last = summary.chunk_indexes[0], summary.chunk_indexes[-1]
    begin, end = first.chunk_start_offset, last.chunk_start_offset + last.chunk_length
    ends = struct.pack("<BQI", 15, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + octets[:8]
    with target.open("wb") as out:
        out.write(octets[:begin])
        for _ in range(times):
            out.write(octets[begin:end])
        out.write(ends)
    return target
