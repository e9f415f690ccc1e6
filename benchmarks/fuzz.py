"""Measure the fuzzer: beacons through the codec, sequences through the stack, and how much a live node takes.

    python benchmarks/fuzz.py [--profile NAME] [--seconds N] [--live] [--jobs N] [--json FILE]

Without options: mutated beacons a second through dissect and decode, and sequences a second against the node in
process, both on one core, by CPU time. --live: frames a second that the fuzzer sends to our node as a process, beside
what that node takes at most. --jobs: tests a second by so many workers, beside one process and beside as many by
themselves.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.target import Target
from dcp_conformance.reference.process import reference_process
from dcp_conformance.test_system.bench import Session
from dcp_lab.fuzz.campaign import read_state
from dcp_lab.fuzz.execute.live import LiveTarget
from dcp_lab.fuzz.execute.stack import StackTarget
from dcp_lab.fuzz.generate.sequences import Sequences
from dcp_lab.fuzz.steps import Frame
from dcp_lab.testing.mutation import Mutator, drawn_pool
from dcp_selftest.fuzz.lifetimes import Lifetimes

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError

SEED = 1


def mutator_of(codec: Codec) -> Mutator:
    rng = random.Random(SEED)
    return Mutator(codec, rng, drawn_pool(codec, rng))


def codec_rate(codec: Codec, seconds: float) -> dict[str, Any]:
    """Mutate, dissect, decode: all three are in the time."""
    mutator, count, octets = mutator_of(codec), 0, 0
    parts = dict.fromkeys(("mutate", "dissect", "decode"), 0.0)
    clock = time.process_time
    begun = clock()
    while clock() - begun < seconds:
        # In batches: asking for the time costs as much as a decoded beacon.
        t0 = clock()
        batch = [mutator.mutate().octets for _ in range(500)]
        t1 = clock()
        for made in batch:
            codec.dissect(made)
        t2 = clock()
        for made in batch:
            try:
                codec.decode(made)
            except DecodeError:
                continue
        parts["mutate"] += t1 - t0
        parts["dissect"] += t2 - t1
        parts["decode"] += clock() - t2
        count += len(batch)
        octets += sum(map(len, batch))
    rate = count / (clock() - begun)
    each = ", ".join(f"{name} {1e6 * spent / count:.1f} us" for name, spent in parts.items())
    print(f"  {rate:,.0f} mutated beacons/s through dissect and decode ({octets / count:.0f} octets each; {each})")
    return {"beacons_per_second": rate, "octets": octets / count}


def stack_rate(codec: Codec, seconds: float) -> dict[str, Any]:
    """Draw sequences, run them on fresh nodes as ``fuzz stack`` does, probe."""
    target = StackTarget(codec)
    lives = Lifetimes(Sequences(codec, random.Random(SEED), target.own_id, mutator_of(codec)))
    nodes, count, begun = 0, 0, time.process_time()
    while time.process_time() - begun < seconds:
        effect = target.run(lives.draw())
        if effect is not None:
            sys.exit(f"our own node: {effect}")
        nodes += 1
        count += len(lives.kinds)
    spent = time.process_time() - begun
    print(
        f"  {count / spent:,.0f} sequences/s against the stack in process, {count / nodes:.0f} in the life of a node "
        f"({target.frames / spent:,.0f} frames/s)"
    )
    return {
        "sequences_per_second": count / spent,
        "frames_per_second": target.frames / spent,
    }


def workers_rate(profile: str, jobs: int, seconds: float) -> dict[str, Any]:
    """Campaigns of one process, of several that know nothing of each other, and of workers, as the command runs them.

    By the clock, and by CPU time: what workers cost is what they take more than the several do, since processes that
    share a machine make each other slower.
    """
    one = Campaigns(profile)
    share = round(one.run(500).per_second * seconds)
    alone, apart = one.run(share), Campaigns(profile, copies=jobs).run(share)
    workers = Campaigns(profile, jobs=jobs)
    together = workers.run(jobs * share)
    found = {
        "jobs": jobs,
        "one": alone._asdict(),
        "apart": apart._asdict(),
        "together": together._asdict(),
        "ratio": together.per_second / alone.per_second,
        "ratio_apart": apart.per_second / alone.per_second,
        "extra_cpu": together.cpu_ms / apart.cpu_ms - 1,
        "load": os.getloadavg()[0],
    }
    print(
        f"  {jobs} workers: {together.per_second:,.0f} tests/s, {found['ratio']:.2f} times the "
        f"{alone.per_second:,.0f}/s of one process; {jobs} processes by themselves: {found['ratio_apart']:.2f} times "
        f"(load {found['load']:.1f})"
    )
    print(
        f"  CPU time for each of {jobs * share}: {together.cpu_ms:.3f} ms by workers, {apart.cpu_ms:.3f} ms by "
        f"processes by themselves ({100 * found['extra_cpu']:+.1f} %), {alone.cpu_ms:.3f} ms by one alone; to begin "
        f"{workers.beginning:.2f} s, one alone {one.beginning:.2f} s"
    )
    return found


class Rate(NamedTuple):
    """How fast campaigns were, without their beginning. ``cpu_ms``: of all processes, for each test."""

    per_second: float
    cpu_ms: float


class Campaigns:
    """Campaigns against the stack in process, each by a command of its own; ``copies`` at a time."""

    def __init__(self, profile: str, *, jobs: int = 1, copies: int = 1) -> None:
        code = "from dcp_selftest.cli import main; main()"
        words = ["fuzz", "stack", "--profile", profile, "--jobs", str(jobs), "--quiet", "--max-cases"]
        self._command = [sys.executable, "-c", code, *words]
        self._copies = copies
        self.beginning = 0.0
        """Seconds of CPU time until the first test."""
        self.beginning = self._spent(jobs)[1]

    def run(self, cases: int) -> Rate:
        """So many tests, by each copy."""
        seconds, cpu = self._spent(cases)
        cases *= self._copies
        return Rate(cases / seconds, 1e3 * cpu / cases)

    def _spent(self, cases: int) -> tuple[float, float]:
        """Seconds by the clock, and of CPU time of all processes, without those to begin."""
        with tempfile.TemporaryDirectory() as name:
            folders = [Path(name) / str(number) for number in range(self._copies)]
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            running = [
                subprocess.Popen(
                    [*self._command, str(cases), "--seed", str(SEED + number), "--artefacts", str(folder)],
                    stdout=subprocess.DEVNULL,
                )
                for number, folder in enumerate(folders)
            ]
            statuses = [process.wait() for process in running]
            if any(statuses):
                sys.exit("our own node: a campaign has found something, or was ended")
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            seconds = max(read_state(folder).seconds for folder in folders)
        return seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime - self.beginning


def live_rate(profile: str, seconds: float) -> dict[str, Any]:
    """Rate of the fuzzer against our node as a process, with a health check after each 2000 frames, and the limit."""
    return {kind: live_rate_on(kind, profile, seconds) for kind in ("ethernet", "udp")}


def live_rate_on(kind: Any, profile: str, seconds: float) -> dict[str, Any]:
    """On one kind of link. Costs are CPU time, since tester and node share the machine with others."""
    codec = Codec(profile)
    with reference_process(codec, beacon_period_ms=20, link=kind) as node:
        pixit = Testing(beacon_period_ms=20)
        runner = Runner(Session(codec, node.lower, node.upper, Pics(pixit=pixit)), node.control)
        runner.prepare()
        mutator = mutator_of(codec)
        target = LiveTarget(Target(codec, runner.session.pics, runner, []), rate=1e9)
        batches = [[Frame(mutator.mutate().octets) for _ in range(2000)] for _ in range(5)]
        status = lambda: node.upper.call("UT-Status", {}).result["runtime"]  # noqa: E731 - short
        begun, tester, before, sent = time.monotonic(), time.process_time(), status(), 0
        while time.monotonic() - begun < seconds:
            for batch in batches:
                effect = target.run([*batch])
                if effect is not None:
                    sys.exit(f"our own node: {effect}")
                sent += len(batch)
        spent, tester, after = time.monotonic() - begun, time.process_time() - tester, status()
        found = _taken(before, after) | {"frames": sent, "per_second": sent / spent, "tester_us": 1e6 * tester / sent}
        flood = _flood(node, [frame.octets[:1400] for frame in batches[0]], seconds, status)
    print(
        f"  {kind}: {found['per_second']:,.0f} frames/s with looks; the tester needs {found['tester_us']:.0f} us for a "
        f"frame, the node {found['node_us']:.0f} us; {found['dropped']} of {sent} lost in the node's kernel"
    )
    print(
        f"  {kind}, flood of {flood['per_second']:,.0f}/s: the node took {flood['taken_per_second']:,.0f}/s at "
        f"{flood['node_us']:.0f} us each, which is {1e6 / flood['node_us']:,.0f}/s at most; {flood['dropped']} lost"
    )
    return {"looked_at": found, "flood": flood}


def _flood(node: Any, octets: list[bytes], seconds: float, status: Any) -> dict[str, Any]:
    before, begun, sent = status(), time.monotonic(), 0
    while time.monotonic() - begun < seconds:
        for each in octets:
            node.lower.send(each, b"\x02\xdc\x90\0\0\1")
        sent += len(octets)
    spent = time.monotonic() - begun
    # Frames in the socket of the node are still processed.
    time.sleep(1.0)
    found = _taken(before, status())
    return found | {"per_second": sent / spent, "taken_per_second": found["taken"] / spent}


def _taken(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Frames received by the node, frames dropped by its kernel, and CPU time per received frame."""
    taken = after["link"]["received"] - before["link"]["received"]
    dropped = after["link"]["kernel_drops"] - before["link"]["kernel_drops"]
    return {"taken": taken, "dropped": dropped, "node_us": 1e3 * (after["cpu_ms"] - before["cpu_ms"]) / max(1, taken)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", default="dcp-2.0")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--jobs", type=int, metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    codec = Codec(options.profile)
    found: dict[str, Any] = {"profile": options.profile}
    if options.jobs:
        found["workers"] = workers_rate(options.profile, options.jobs, options.seconds)
    elif options.live:
        found["live"] = live_rate(options.profile, options.seconds)
    else:
        found["codec"] = codec_rate(codec, options.seconds)
        found["stack"] = stack_rate(codec, options.seconds)
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
