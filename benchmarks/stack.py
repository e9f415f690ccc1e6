"""Measure the stack: simulation speed, what a received beacon costs, and a real node, quiet and under a flood.

    python benchmarks/stack.py [--flood] [--quiet-node] [--seconds N] [--json FILE]

Without options: 100 nodes on a grid for 60 virtual seconds, twice (the digests have to be equal), and the CPU time of a
node core for each received beacon: of neighbours with continuous updates, and of repeated beacons, which are most of
the traffic; beside that the time for only decoding the same beacons.

--flood and --quiet-node start nodes in network namespaces (root, or user namespaces): 10,000 frames a second for 30 s
at one of two neighbours, and three nodes at 10 Hz for 60 s.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import platform
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dcp_lab.sim.scenario.defaults import default_scenario
from dcp_lab.sim.scenario.definition import Converged, Create, Scenario, Topology, Tracks, Update
from dcp_lab.sim.testbed.processes import NodeProcess
from dcp_lab.sim.testbed.testbed import Testbed
from dcp_lab.sim.virtual.player import Simulation

from dcp_codec.codec import Codec, get_codec
from dcp_codec.network.namespaces import enter_command
from dcp_codec.values import Beacon, BPHeader, Payload
from dcp_stack.config import NodeConfig
from dcp_stack.control.server import ControlServer
from dcp_stack.node import Node

CODEC = get_codec("dcp-2.0")
SECOND = 1_000_000_000
FLOOD_RATE = 10_000


# -- simulation -------------------------------------------------------------------------------------------------------


def simulation() -> dict[str, Any]:
    """100 nodes at 10 Hz, twice; and once with every receiver decoding for itself."""
    scenario = default_scenario(100, topology=Topology(kind="grid"), duration_s=60.0)
    found = []
    for shared in (True, True, False):
        report = Simulation(scenario, share_decoding=shared).run()
        found.append(report)
        received = sum(each.beacons_received for each in report.traffic)
        print(
            f"  {'shared decoding' if shared else 'decoding apart':15}  {report.speed_up:5.2f} times real time, "
            f"{scenario.duration_s / report.cpu_s:5.2f} by CPU time  ({received} receptions)  {report.digest[:16]}"
        )
    if len({report.digest for report in found}) != 1:
        sys.exit("the digests differ")
    return {
        "digest": found[0].digest,
        "speed_up": [report.speed_up for report in found],
        "speed_up_by_cpu": [scenario.duration_s / report.cpu_s for report in found],
    }


# -- the cost of a beacon ---------------------------------------------------------------------------------------------


def heard_by_one(neighbours: int, variables: int, seconds: float) -> tuple[list[tuple[int, bytes]], NodeConfig]:
    """Beacons that node 0 receives from its neighbours, each of which updates all its variables every second."""
    events: list[Create | Update] = []
    for number in range(variables):
        node = 1 + number % neighbours
        events.append(Create(at_s=0.5, node=node, variable=number, value="00" * 8))
        events.append(Update(at_s=1.0 + number / variables, every_s=1.0, node=node, variable=number, text="{n}......."))
    scenario = Scenario(
        nodes=neighbours + 1, duration_s=seconds, tracks=(Tracks(source="track:walk,rate=20"),), events=tuple(events)
    )
    played = Simulation(scenario)
    heard: list[tuple[int, bytes]] = []

    class Ear:
        def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:  # noqa: ARG002
            if not outgoing:
                heard.append((played.network.now, octets))

    station = played.network.stations[0]
    station.watchers.append(Ear())
    played.run()
    config = NodeConfig(
        node_id=station.config.node_id, codec=CODEC, srp=station.config.srp, vardis=station.config.vardis
    )
    return heard, config


def cost_of_a_beacon(seconds: float) -> dict[str, Any]:
    """CPU time of a node core for each received beacon, its own beacons and timers included.

    The ratios are to decoding the same beacons, taken in turn with it, so that they say the same on a busy machine.
    """
    found = {}
    for variables in (0, 2, 20):
        heard, config = heard_by_one(10, variables, seconds)
        tries = [(process_all(heard, config), process_again(heard, config), decode_all(heard)) for _ in range(7)]
        living, known, bare = (min(times) / len(heard) * 1e6 for times in zip(*tries, strict=True))
        size = sum(len(octets) for _, octets in heard) / len(heard)
        print(
            f"  {variables:2} variables  {size:5.0f} octets  {living:6.1f} us a beacon ({living / bare:4.1f} times its "
            f"decoding)  -> {int(1e5 / living):5} neighbours at 10 Hz on one core; known ones in a row {known:5.1f} us "
            f"({known / bare:4.1f} times) -> {1e6 / known:,.0f} beacons/s"
        )
        found[str(variables)] = {
            "us_per_beacon": living,
            "us_per_known_beacon": known,
            "us_to_decode": bare,
            "times_decoding": living / bare,
            "known_times_decoding": known / bare,
            "neighbours": int(1e5 / living),
            "octets": size,
        }
    return found


def decode_all(heard: list[tuple[int, bytes]]) -> float:
    """The CPU seconds of the codec alone."""
    begin = time.process_time()
    for _, octets in heard:
        CODEC.decode(octets)
    return time.process_time() - begin


def process_again(heard: list[tuple[int, bytes]], config: NodeConfig) -> float:
    """The CPU seconds of a node that hears all of it again at one moment; drops are counted, as by a driver."""
    node = Node(config, rng=random.Random(1), now=0, wall=SECOND)
    node.start(0, SECOND)
    server = ControlServer(node)
    for now, octets in heard:
        while (due := node.poll_timeout()) is not None and due <= now:
            node.handle_timeout(due, SECOND + due)
        node.handle_frame(octets, now=now, wall=SECOND + now)
    node.take_effects()
    now = heard[-1][0]
    last = heard[-len(heard) // 10 :]
    begin = time.process_time()
    for _ in range(10):
        for _, octets in last:
            node.handle_frame(octets, now=now, wall=SECOND + now)
            server.indicate(node.take_effects(), now=now, wall=SECOND + now)
    return (time.process_time() - begin) * len(heard) / (10 * len(last))


def process_all(heard: list[tuple[int, bytes]], config: NodeConfig) -> float:
    """CPU seconds of a fresh node for processing these beacons."""
    node = Node(config, rng=random.Random(1), now=0, wall=SECOND)
    node.start(0, SECOND)
    begin = time.process_time()
    for now, octets in heard:
        while (due := node.poll_timeout()) is not None and due <= now:
            node.handle_timeout(due, SECOND + due)
            node.take_effects()
        node.handle_frame(octets, now=now, wall=SECOND + now)
        node.take_effects()
    taken = time.process_time() - begin
    assert node.srp is not None
    assert len(node.srp.neighbours) == 10
    return taken


# -- real nodes -------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def testbed(scenario: Scenario) -> Iterator[Testbed]:
    """Nodes that run."""
    with (
        tempfile.TemporaryDirectory() as directory,
        Testbed(scenario, Path(directory), keep=True, record=False) as made,
    ):
        made.start()
        yield made


class Meter:
    """CPU time and memory of a node process."""

    def __init__(self, node: NodeProcess) -> None:
        self._pid = node.call("UT-Status")["runtime"]["pid"]
        self._begin = (time.monotonic(), self._cpu())

    def _cpu(self) -> float:
        fields = Path(f"/proc/{self._pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / 100

    def share(self) -> float:
        """Of one core, since this meter was made."""
        return (self._cpu() - self._begin[1]) / (time.monotonic() - self._begin[0])

    def resident_mb(self) -> float:
        """Resident memory now."""
        status = Path(f"/proc/{self._pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def quiet_node(seconds: float) -> dict[str, Any]:
    """One of three nodes at 10 Hz, with state reports and two variables that are updated once a second."""
    scenario = Scenario(
        nodes=3, duration_s=seconds, tracks=(Tracks(source="track:walk"),), expect=(Converged(within_s=2),)
    )
    with testbed(scenario) as bed:
        for node in (0, 1):
            bed.nodes[node].call("RTDB-Create", varId=node, repCnt=1, descr="counter", value="00000000")
        time.sleep(2)
        meter = Meter(bed.nodes[2])
        first = bed.nodes[2].look()
        begin, count = time.monotonic(), 0
        while time.monotonic() - begin < seconds:
            count += 1
            for node in (0, 1):
                bed.nodes[node].call("RTDB-Update", varId=node, value=f"{count:08x}")
            time.sleep(max(begin + count - time.monotonic(), 0))
        share, resident = meter.share(), meter.resident_mb()
        last = bed.nodes[2].look()
        assert last.known[0].value == count.to_bytes(4, "big")
    rate = (last.beacons_sent - first.beacons_sent) / seconds
    heard = (last.beacons_received - first.beacons_received) / seconds
    print(f"  {share:.2%} of a core, {resident:.1f} MB resident; {rate:.2f} beacons/s sent, {heard:.2f} received")
    return {"cpu_share": share, "resident_mb": resident, "beacons_per_s": rate, "received_per_s": heard}


def flood(seconds: float) -> dict[str, Any]:
    """A node among two neighbours, one of which is a flood of valid, foreign and malformed frames."""
    track = (Tracks(source="track:walk,rate=20", nodes=(0, 1)),)
    scenario = Scenario(nodes=3, duration_s=seconds, tracks=track, down_at_start=(2,))
    with testbed(scenario) as bed, tempfile.TemporaryDirectory() as directory:
        node = bed.nodes[0]
        node.call("RTDB-Create", varId=0, repCnt=1, descr="own", value="01")
        time.sleep(2)
        quiet = Meter(node).resident_mb()
        frames = Path(directory, "frames")
        frames.write_text("\n".join(octets.hex() for octets in flood_frames(CODEC)))
        program = [sys.executable, __file__, "--be-the-flood", str(frames), "--seconds", str(seconds)]
        flooder = subprocess.Popen(
            [*enter_command(bed.nodes[2].namespace), *program], stdout=subprocess.PIPE, text=True
        )
        try:
            time.sleep(1)
            meter, first, answers, resident = Meter(node), node.look(), [], []
            begin = time.monotonic()
            while time.monotonic() - begin < seconds - 2:
                asked = time.monotonic()
                node.call("UT-Hello")
                answers.append((time.monotonic() - asked) * 1000)
                resident.append(meter.resident_mb())
                time.sleep(0.2)
            share, last = meter.share(), node.look()
            link = node.call("UT-Status")["runtime"]["link"]
            sent = int(flooder.communicate(timeout=60)[0])
        finally:
            flooder.kill()
            flooder.wait()
    rate = (last.beacons_sent - first.beacons_sent) / ((last.now - first.now) / SECOND)
    found = {
        "frames_per_s": sent / seconds,
        "read_per_s": link["received"] / seconds,
        "kernel_drops": link["kernel_drops"],
        "own_beacons_per_s": rate,
        "cpu_share": share,
        "resident_mb": {"before": quiet, "after_10_s": resident[len(resident) // 3], "end": resident[-1]},
        "answer_ms": {"median": statistics.median(answers), "worst": max(answers)},
    }
    print(f"  {found['frames_per_s']:.0f} frames/s, of which {found['read_per_s']:.0f} read and ", end="")
    print(f"{link['kernel_drops']} lost in the kernel, {share:.0%} of a core")
    print(f"  own beacons {rate:.2f}/s; control socket answers in {found['answer_ms']['median']:.1f} ms, ", end="")
    print(f"{found['answer_ms']['worst']:.1f} ms at worst; ", end="")
    print(
        f"{quiet:.1f} MB before, {resident[len(resident) // 3]:.1f} MB after a third, {resident[-1]:.1f} MB at the end"
    )
    return found


def flood_frames(codec: Codec) -> list[bytes]:
    """A third each: beacons of a thousand nodes with 250 variables, beacons of another network, and broken ones."""
    generator = random.Random(1)
    heard, _ = heard_by_one(10, 20, 5.0)
    frames = []
    for number in range(3000):
        octets = generator.choice(heard)[1]
        beacon, _end = codec.decode_envelope(octets)
        assert beacon.bp is not None
        sender = b"\x02\xff" + (number % 1000).to_bytes(4, "big")
        payloads = tuple(
            Payload(each.protocol_id, (each.data or b"").replace(beacon.bp.sender_id, sender))
            for each in beacon.payloads
        )
        network = beacon.bp.network_id if number % 3 else 0x2222
        octets = codec.encode_envelope(Beacon(BPHeader(sender, number, network), payloads))
        if number % 3 == 2:
            cut = generator.randrange(len(octets))
            octets = octets[:cut] + generator.randbytes(generator.randrange(1, 40)) + octets[cut + 1 :]
        frames.append(octets)
    return frames


def be_the_flood(path: str, seconds: float) -> None:
    """Send what is in a file, over and over, at the rate of the flood; says how many frames that were."""
    import socket

    link = CODEC.profile.link
    assert link.ether_type is not None
    header = b"\xff" * 6 + bytes.fromhex("020000000002") + link.ether_type.to_bytes(2, "big")
    frames = [header + bytes.fromhex(line) for line in Path(path).read_text().split()]
    out = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
    out.bind(("dcp0", 0))
    begin, sent = time.monotonic(), 0
    while (now := time.monotonic() - begin) < seconds:
        while sent < now * FLOOD_RATE:
            out.send(frames[sent % len(frames)])
            sent += 1
        time.sleep(0.001)
    print(sent)


def main() -> None:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flood", action="store_true", help="flood a real node, too")
    parser.add_argument("--quiet-node", action="store_true", help="measure a quiet real node, too")
    parser.add_argument("--seconds", type=float, help="length of --flood (30) and --quiet-node (60)")
    parser.add_argument("--only", action="store_true", help="only what was asked for by options")
    parser.add_argument("--json", metavar="FILE", help="write the numbers there")
    parser.add_argument("--be-the-flood", metavar="FILE", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.be_the_flood:
        be_the_flood(given.be_the_flood, given.seconds)
        return
    found: dict[str, Any] = {"python": platform.python_version(), "machine": platform.machine()}
    if not given.only:
        print("100 nodes on a grid at 10 Hz, 60 s of virtual time")
        found["simulation"] = simulation()
        print("CPU time of a node core for each received beacon, of ten neighbours with state reports")
        found["beacon"] = cost_of_a_beacon(20.0)
    if given.quiet_node:
        print("a quiet node among three at 10 Hz, with state reports and two updated variables")
        found["quiet_node"] = quiet_node(given.seconds or 60.0)
    if given.flood:
        print(f"a node under {FLOOD_RATE} frames/s, a third of them valid")
        found["flood"] = flood(given.seconds or 30.0)
    if given.json:
        Path(given.json).write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
