"""How fast ``dcp-conformance check`` judges, beside decoding alone, and how much memory it needs.

``python benchmarks/check.py [--beacons N ...] [--attack]``: recordings of a made-up bus of 30 nodes with 50 variables
(``flights.py``) are judged in a process of their own each, and from a file in two processes, as ``check`` does. Speeds
are those of free processors: beacons for each processor second, of two processes for each second of the slower one.
Compare ratios within one run.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from dcp_conformance.check.judge import Judge
from dcp_conformance.check.recording import judge_versions
from dcp_conformance.model.pics import Pics
from flights import Attack, Flight
from rich.console import Console
from rich.table import Table

from dcp_codec.capture import Frame, create_capture
from dcp_codec.codec import Codec
from dcp_codec.common.garbage import few_collections
from dcp_codec.common.workers import completed
from dcp_codec.framing.locate import OtherTraffic, locate

PROFILE = "dcp-2.0"
#: Beacon periods between two values of a variable: 5 s, as in ``dcp-node simulate``.
_EVERY = 50
#: Frames that are made, and then judged: making them is not measured.
_CHUNK = 2_000


def chunks(flight: Flight, beacons: int) -> Iterator[list[Frame]]:
    """The frames of a flight, some thousand at a time."""
    frames: list[Frame] = []
    for frame in flight.frames(beacons):
        frames.append(frame)
        if len(frames) >= _CHUNK:
            yield frames
            frames = []
    if frames:
        yield frames


def measure(beacons: int, attack: bool) -> tuple[float, float, float, int]:
    """Processor seconds for decoding and for judging, peak memory in MB, and findings."""
    codec = Codec(PROFILE)
    judge = Judge(codec, Pics(), recording="made up", period_known=False)
    decoding = judging = 0.0
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    flight = (Attack if attack else Flight)(codec, every=_EVERY)
    for frames in chunks(flight, beacons):
        with few_collections():
            begin = time.process_time()
            for frame in frames:
                framing = locate(frame.data, codec.profile.link)
                assert not isinstance(framing, OtherTraffic)
                codec.decode(frame.data[framing.start : framing.end])
            middle = time.process_time()
            for frame in frames:
                judge.feed(frame)
            judging += time.process_time() - middle
            decoding += middle - begin
    begin = time.process_time()
    run = judge.result()
    judging += time.process_time() - begin
    found = sum(check.verdict == "fail" for case in run.cases for check in case.checks)
    return decoding, judging, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base) / 1024, found


def measure_two(beacons: int, attack: bool) -> tuple[float, float]:
    """Processor seconds of the two processes that judge a file."""
    flight = (Attack if attack else Flight)(Codec(PROFILE), every=_EVERY)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "flight.pcap")
        with create_capture(path) as writer:
            for frame in flight.frames(beacons):
                writer.write(frame)
        before = time.process_time()
        judge_versions(path, PROFILE, Pics(), jobs=2)
        first = time.process_time() - before
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return first, used.ru_utime + used.ru_stime


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beacons", type=int, nargs="+", default=[20_000, 100_000])
    parser.add_argument("--attack", action="store_true", help="with a station that forges creations and requests")
    options = parser.parse_args()
    table = Table(box=None, pad_edge=False, header_style="bold")
    headings = ("beacons", "decode/s", "check/s", "check : decode", "memory MB", "findings", "two processes: check/s")
    for heading in headings:
        table.add_column(heading, justify="right")
    for beacons in options.beacons:
        # In a process of its own, whose memory is measured.
        measured = completed(partial(measure, beacons), [options.attack], 1, start="spawn")
        _, (decoding, judging, memory, found) = next(measured)
        _, (first, second) = next(completed(partial(measure_two, beacons), [options.attack], 1, start="spawn"))
        rates = (f"{beacons / decoding:,.0f}", f"{beacons / judging:,.0f}", f"{judging / decoding:.1f}")
        two = f"{beacons / max(first, second):,.0f}"
        table.add_row(f"{beacons:,}", *rates, f"{memory:.0f}", str(found), two)
    Console().print(table)


if __name__ == "__main__":
    main()
