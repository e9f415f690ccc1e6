"""Compare the generated C codec with the Python codec on recordings and mutated frames.

    python -m tests.ccodec [--frames N] [--seed N] [--profile NAME]... [--compiler NAME] [--plain]
                           [--captures FOLDER]...

Every frame of the recordings goes to the codec of every profile; then N mutated frames are divided among the profiles.
Without --plain the C program is built with AddressSanitizer and UndefinedBehaviorSanitizer. Status 1: they differ.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from dcp_lab.testing.mutation import Mutator, drawn_pool
from dcp_spec.profile.loading import profile_names

from dcp_codec.capture import open_capture
from tests.odd_profiles import ODD_PROFILES, codec_of

from .peer import SANITIZED, Comparison, Peer, build

CAPTURES = Path(__file__).resolve().parent.parent.parent / "captures"
SUFFIXES = (".mcap", ".pcap", ".pcapng")
#: Offsets of a bearer payload in a frame: payloads alone, Ethernet, Ethernet with VLAN, IPv4 and UDP.
STARTS = (0, 14, 18, 42)
BATCH = 20_000


def recorded(folders: list[Path]) -> Iterator[bytes]:
    """Yield distinct tails of all recorded frames, beacons or not."""
    seen: set[bytes] = set()
    for folder in folders:
        for path in sorted(each for each in folder.rglob("*") if each.suffix in SUFFIXES):
            try:
                with open_capture(path) as capture:
                    for frame in capture:
                        for start in STARTS:
                            octets = bytes(frame.data[start:])
                            if octets not in seen:
                                seen.add(octets)
                                yield octets
            except (OSError, ValueError) as error:
                print(f"{path}: {error}", file=sys.stderr)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.ccodec", description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=100_000, help="number of mutated frames [%(default)s]")
    parser.add_argument("--seed", type=int, default=1, help="seed of the mutations [%(default)s]")
    parser.add_argument("--profile", action="append", choices=[*profile_names(), *ODD_PROFILES], help="only this one")
    parser.add_argument("--captures", action="append", type=Path, help="folder with recordings [captures]")
    parser.add_argument("--compiler", default="gcc", help="with --plain any, else one with sanitizers [%(default)s]")
    parser.add_argument("--plain", action="store_true", help="build with -O2 and without sanitizers")
    options = parser.parse_args()
    compiler = shutil.which(options.compiler)
    if compiler is None:
        parser.error(f"{options.compiler} is not on PATH: --compiler NAME")
    names = options.profile or [*profile_names(), *ODD_PROFILES]
    frames = list(recorded(options.captures or [CAPTURES]))
    print(f"{len(frames)} distinct recorded octet strings, {compiler}", flush=True)
    bad = False
    total = Comparison()
    with tempfile.TemporaryDirectory() as folder:
        for number, name in enumerate(names):
            place = Path(folder) / name
            place.mkdir()
            codec = codec_of(name, place)
            peer = Peer(codec, build(codec, place, compiler, ("-O2",) if options.plain else SANITIZED))
            begun = time.process_time()
            found = Comparison()
            for start in range(0, len(frames), BATCH):
                peer.compare(frames[start : start + BATCH], found)
            rng = random.Random(f"{options.seed} {name}")
            own = [frame for frame in frames if len(frame) < 1600][:: max(1, len(frames) // 300)]
            mutator = Mutator(codec, rng, drawn_pool(codec, rng, 300, own))
            left = options.frames * (number + 1) // len(names) - options.frames * number // len(names)
            while left and not found.differences:
                size = min(left, BATCH)
                peer.compare([mutator.mutate().octets for _ in range(size)], found)
                left -= size
            took = time.process_time() - begun
            print(
                f"{name:18} {found.frames:9} frames, {found.valid:8} valid, {len(found.reasons):2} reasons, "
                f"{len(found.differences)} differences, {took:.0f} CPU s",
                flush=True,
            )
            for each in found.differences[:5]:
                print(f"  {each}")
            bad = bad or bool(found.differences)
            total.frames += found.frames
            total.valid += found.valid
            total.reasons += found.reasons
    print(f"{'all':18} {total.frames:9} frames, {total.valid:8} valid, reasons: {dict(total.reasons.most_common())}")
    return int(bad)


if __name__ == "__main__":
    sys.exit(main())
