"""Measure the generated C codec beside hand-written C: speed of decoding and encoding, code size, stack.

    python benchmarks/ccodec.py [--seconds N] [--json FILE]

All decode and encode every beacon of the recordings in profile cpp-2.0, into the same values, and take turns in one
process; the best pass of each counts. A ratio above 1 means that the generated codec is faster. There are two codecs by
hand, with a function for each part as the generated one has; both report no reason, offset or requirement, and know one
layout:

- by field: every field is read and written by a checked function, as serialisation is usually written and as the public
  implementation does (ccodec_handwritten.c with -DBY_FIELD);
- by record: the bounds of a whole record are checked at once.
"""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

from dcp_codec import DecodeError, get_codec
from dcp_codec.capture import open_capture
from dcp_codec.export.c.files import codec_files

HERE = Path(__file__).resolve().parent
CAPTURES = HERE.parent / "captures"
PROFILE = "cpp-2.0"


def beacons() -> list[bytes]:
    """Return the valid beacons of the recordings."""
    codec = get_codec(PROFILE)
    found = []
    for path in sorted(each for each in CAPTURES.rglob("*") if each.suffix in (".mcap", ".pcap", ".pcapng")):
        with open_capture(path) as capture:
            for frame in capture:
                octets = bytes(frame.data[14:])
                try:
                    beacon, end = codec.decode_from(octets)
                except DecodeError:
                    continue
                if codec.encode(beacon) == octets[:end]:
                    found.append(octets[:end])
    return found


def run(command: list[str], folder: Path, data: bytes | None = None) -> str:
    """Return the output of a command."""
    return subprocess.run(command, cwd=folder, input=data, check=True, capture_output=True).stdout.decode()


def sizes(folder: Path, profile: str) -> dict[str, dict[str, int]]:
    """Return code size and largest stack frame of the codec of a profile, by processor."""
    for name, text in codec_files(get_codec(profile)).items():
        (folder / name).write_text(text)
    found = {}
    for processor, compiler, extra in (
        ("x86-64", "gcc", []),
        ("arm thumb", "arm-linux-gnueabihf-gcc", ["-mthumb"]),
        ("powerpc", "powerpc-linux-gnu-gcc", []),
    ):
        command = [compiler, "-std=c99", "-Os", "-ffreestanding", "-fstack-usage", *extra, "-c", "dcp_codec.c"]
        try:
            run(command, folder)
        except (OSError, subprocess.CalledProcessError):
            continue
        text, data, bss = (int(each) for each in run(["size", "dcp_codec.o"], folder).splitlines()[1].split()[:3])
        frames = [int(line.split("\t")[1]) for line in (folder / "dcp_codec.su").read_text().splitlines()]
        found[processor] = {"text": text, "data": data, "bss": bss, "largest frame": max(frames)}
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=1.0, help="time for each of the four contenders [%(default)s]")
    parser.add_argument("--json", type=Path, help="also write the results to this file")
    options = parser.parse_args()
    octets = beacons()
    results: dict[str, object] = {"beacons": len(octets), "octets": sum(map(len, octets))}
    request = b"".join(struct.pack("<I", len(each)) + each for each in octets)
    for compiler in ("gcc", "clang"):
        for style, define in (("by field", ["-DBY_FIELD"]), ("by record", [])):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                for file, text in codec_files(get_codec(PROFILE)).items():
                    (folder / file).write_text(text)
                source = [str(HERE / "ccodec_speed.c"), str(HERE / "ccodec_handwritten.c"), "dcp_codec.c"]
                flags = ["-std=gnu99", "-O2", "-Wall", f"-I{HERE}", "-I."]
                run([compiler, *flags, *define, *source, "-o", "speed"], folder)
                found = json.loads(run(["./speed", str(options.seconds)], folder, request))
            for what in ("decode", "encode"):
                ours, theirs = found[f"{what} generated"], found[f"{what} handwritten"]
                found[f"{what} ratio"] = round(theirs / ours, 2)
                print(
                    f"{compiler:6} {what}: generated {ours:7.1f} ns, hand-written {style:9} {theirs:7.1f} ns a beacon, "
                    f"ratio {theirs / ours:.2f}"
                )
            results[f"{compiler}, {style}"] = found
    for profile in ("dcp-2.0", "cpp-2.0", "student-2024"):
        with tempfile.TemporaryDirectory() as name:
            results[profile] = sizes(Path(name), profile)
        for processor, each in sizes_of(results[profile]):
            print(
                f"{profile:12} {processor:10} -Os: {each['text']:6} octets of code and constants, "
                f"{each['data'] + each['bss']} of data, largest stack frame {each['largest frame']} octets"
            )
    if options.json:
        options.json.write_text(json.dumps(results, indent=1))
    return 0


def sizes_of(result: object) -> list[tuple[str, dict[str, int]]]:
    """Return the sizes of a profile by processor."""
    assert isinstance(result, dict)
    return list(result.items())


if __name__ == "__main__":
    sys.exit(main())
