"""Frames that are read of damaged recordings, beside the mcap library and tshark.

``python benchmarks/damaged.py [--flips N]``: a bundled recording as MCAP, pcap and pcapng; in each of N files (300) one
random bit is inverted. MCAP files are read beside the mcap library (without checksums; with the index, and from start
to end), pcap and pcapng files beside tshark. Exit status: 1 if another reader gets more frames of a file.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from mcap.reader import NonSeekingReader, make_reader
from rich.console import Console
from rich.table import Table

from dcp_codec.capture import CaptureError, create_capture, open_capture
from dcp_codec.capture.mcap import raw_frame
from dcp_codec.capture.mcap.reader import DECODERS

RECORDING = Path(__file__).parents[1] / "captures" / "c_latejoin.mcap"


def ours(path: Path) -> int:
    """Return the number of frames that we read."""
    try:
        with open_capture(path) as reader:
            return sum(1 for _ in reader)
    except CaptureError:
        return 0


def of_library(path: Path) -> int:
    """Return the number of raw frames that can be decoded of what the mcap library reads, in its better way."""

    def seeking(file: IO[bytes]) -> int:
        return count(make_reader(file))

    def from_the_start(file: IO[bytes]) -> int:
        return count(NonSeekingReader(file))

    def count(reader: object) -> int:
        found = 0
        # The library raises its own classes, those of struct, and others.
        with contextlib.suppress(Exception):
            for schema, channel, message in reader.iter_messages():  # type: ignore[attr-defined]
                decode = DECODERS.get(channel.message_encoding)
                if schema is not None and schema.name == raw_frame.SCHEMA_NAME and decode is not None:
                    # The library also returns messages that cannot be decoded.
                    with contextlib.suppress(ValueError):
                        decode(message.data)
                        found += 1
        return found

    most = 0
    for way in (seeking, from_the_start):
        with path.open("rb") as file, contextlib.suppress(Exception):
            most = max(most, way(file))
    return most


def of_tshark(path: Path) -> int:
    """Return the number of frames that tshark reads."""
    command = ["tshark", "-r", str(path), "-T", "fields", "-e", "frame.number"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return len(done.stdout.splitlines())


def files(folder: Path) -> dict[str, bytes]:
    """Return the recording in each format: MCAP as bundled, MCAP without the attached original, pcap, and pcapng."""
    with open_capture(RECORDING) as reader:
        frames = list(reader)
    found = {"MCAP with its original": RECORDING.read_bytes()}
    for kind, suffix in (("MCAP", "mcap"), ("pcap", "pcap"), ("pcapng", "pcapng")):
        path = folder / f"good.{suffix}"
        with create_capture(path) as writer:
            for frame in frames:
                writer.write(frame)
        found[kind] = path.read_bytes()
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flips", type=int, default=300, metavar="N", help="number of damaged files")
    options = parser.parse_args(arguments)
    rng, worse = random.Random(1), 0
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("format", "files", "of frames", "we read", "others", "reader", "fewer", "as many", "more"):
        table.add_column(heading, justify="left" if heading in ("format", "reader") else "right", no_wrap=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kinds = files(folder)
        if shutil.which("tshark") is None:
            kinds = {kind: octets for kind, octets in kinds.items() if kind.startswith("MCAP")}
        for place, (kind, octets) in enumerate(kinds.items()):
            many = (options.flips + place) // len(kinds)
            other = of_library if kind.startswith("MCAP") else of_tshark
            path = folder / f"damaged.{kind.split()[0].lower()}"
            path.write_bytes(octets)
            whole = ours(path)
            pairs = []
            for _ in range(many):
                data = bytearray(octets)
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
                path.write_bytes(data)
                pairs.append((ours(path), other(path)))
            fewer, more = sum(a < b for a, b in pairs), sum(a > b for a, b in pairs)
            worse += fewer
            sums = [f"{sum(each):,}" for each in zip(*pairs, strict=True)]
            name_of = "mcap library" if other is of_library else "tshark"
            table.add_row(kind, str(many), str(whole), *sums, name_of, *map(str, (fewer, many - fewer - more, more)))
    Console(width=110).print(table)
    return 1 if worse else 0


if __name__ == "__main__":
    raise SystemExit(main())
