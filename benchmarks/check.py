"""How fast ``dcp-conformance check`` judges, beside decoding alone, and how much memory it needs.

``python benchmarks/check.py [--beacons N ...] [--attack]``: recordings of a made-up bus of 30 nodes with 50 variables
(``flights.py``) are judged in a process of their own each. From a file, ``check`` judges in two or three processes;
each of their tasks is measured apart, with reading the file. Speeds are those of free processors: beacons for each
processor second, of several processes for each second of the slowest one. Compare ratios within one run.
"""

from __future__ import annotations

import argparse
import pickle
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TypeVar

from dcp_conformance.check.judge import Judge, tasks
from dcp_conformance.definitions.pics import Pics
from flights import Attack, Flight
from rich.console import Console
from rich.table import Table

from dcp_codec.capture import Frame, create_capture, open_capture
from dcp_codec.codec import Codec
from dcp_codec.common.garbage import few_collections
from dcp_codec.common.workers import completed
from dcp_codec.framing.locate import OtherTraffic, locate

Result = TypeVar("Result")

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


def measure_task(beacons: int, attack: bool, jobs: int, place: int) -> float:
    """Processor seconds of one of ``jobs`` processes that judge a file."""
    codec = Codec(PROFILE)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "flight.pcap")
        with create_capture(path) as writer:
            for frame in (Attack if attack else Flight)(codec, every=_EVERY).frames(beacons):
                writer.write(frame)
        judge = Judge(codec, Pics(), recording="made up", period_known=False, task=tasks(jobs)[place])
        before = time.process_time()
        with open_capture(path) as reader, few_collections():
            for frame in reader:
                judge.feed(frame)
            if place:
                pickle.dumps(judge.share())
            else:
                judge.result()
        return time.process_time() - before


def measured(work: Callable[[], Result]) -> Result:
    """Call ``work`` in a process of its own, so that its memory can be measured."""
    return next(completed(_call, [work], 1, start="spawn"))[1]


def _call(work: Callable[[], Result]) -> Result:
    return work()


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beacons", type=int, nargs="+", default=[20_000, 100_000])
    parser.add_argument("--attack", action="store_true", help="with a station that forges creations and requests")
    options = parser.parse_args()
    table = Table(box=None, pad_edge=False, header_style="bold")
    headings = ("beacons", "decode/s", "check/s", "check : decode", "memory MB", "findings")
    for heading in (*headings, "in 2 processes", "in 3"):
        table.add_column(heading, justify="right")
    for beacons in options.beacons:
        decoding, judging, memory, found = measured(partial(measure, beacons, options.attack))
        rates = [f"{beacons / decoding:,.0f}", f"{beacons / judging:,.0f}", f"{judging / decoding:.1f}"]
        shared = []
        for jobs in (2, 3):
            parts = [measured(partial(measure_task, beacons, options.attack, jobs, place)) for place in range(jobs)]
            shared.append(f"{beacons / max(parts):,.0f}")
        table.add_row(f"{beacons:,}", *rates, f"{memory:.0f}", str(found), *shared)
    Console().print(table)


if __name__ == "__main__":
    main()
