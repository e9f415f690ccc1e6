"""Cost of a quiet node, compared with programs that only wake up, receive and send.

    python benchmarks/quiet.py [--seconds N] [--json FILE]

Three nodes at 10 Hz on one Ethernet, each with state reports, and with two variables that are updated once a second.
Two of them run with a part changed, so that one run under one load shows the effect of the part:

``node``         unchanged
``no hold``      each frame and each position wakes the node by itself
``early``        VarDis composes each payload right after the beacon before it (X54 ``after-the-beacon``)

In the namespace of the first node run two empty programs on the same frames: ``empty, each frame`` wakes for every
frame and for every beacon, ``empty, at beacons`` reads what has arrived when it sends. They are Python without imports
beyond sockets, and neither decodes nor encodes anything. Needs root, or user namespaces.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from dcp_lab.sim.scenario.definition import Scenario, Tracks
from dcp_lab.sim.testbed.fabric import INTERFACE
from dcp_lab.sim.testbed.processes import NodeProcess
from dcp_lab.sim.testbed.testbed import Testbed

from dcp_codec.codec import get_codec
from dcp_codec.network.namespaces import enter_command

PARTS = {
    "node": "",
    "no hold": "import dcp_stack.runtime.driver as driver; driver.HOLD = -1 << 60",
    "early": """
from dcp_stack.vardis.entity import Vardis
made = Vardis.__init__
def init(self, *args, **more):
    made(self, *args, **more)
    self._composes_ahead = False
Vardis.__init__ = init
""",
}
EMPTY = """
import select, socket, sys, time
interface, kind, lazy = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "lazy"
link = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(kind))
link.bind((interface, kind))
link.setblocking(False)
out = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
out.bind((interface, 0))
frame = bytes(6 * [255]) + bytes(6) + b"\\x88\\xb6" + bytes(120)
poll = select.epoll()
if not lazy:
    poll.register(link, select.EPOLLIN)
due = time.monotonic()
while True:
    if not poll.poll(max(due - time.monotonic(), 0)) or lazy:
        pass
    try:
        while True:
            link.recv(2000)
    except BlockingIOError:
        pass
    if time.monotonic() >= due:
        due += 0.1
        out.send(frame)
"""


class Meter:
    """CPU time and memory of a process."""

    def __init__(self, pid: int) -> None:
        self._proc = Path(f"/proc/{pid}")
        self._begin = (time.monotonic(), self._cpu())

    def _cpu(self) -> float:
        """Seconds on a processor, to the ns."""
        return int((self._proc / "schedstat").read_text().split()[0]) / 1e9

    def found(self) -> dict[str, float]:
        """Share of a core since this meter was made, and memory in MB now."""
        share = (self._cpu() - self._begin[1]) / (time.monotonic() - self._begin[0])
        rollup = (self._proc / "smaps_rollup").read_text()
        resident, proportional = (int(rollup.partition(f"\n{name}:")[2].split()[0]) / 1024 for name in ("Rss", "Pss"))
        return {"cpu_share": share, "rss_mb": resident, "pss_mb": proportional}


def start(node: NodeProcess, part: str, folder: Path) -> None:
    """Start a node with a part of it left out."""
    patch = folder / part.replace(" ", "-")
    patch.mkdir()
    (patch / "sitecustomize.py").write_text(PARTS[part] + "\n")
    os.environ["PYTHONPATH"] = str(patch)
    node.start()


def measure(seconds: float) -> dict[str, dict[str, float]]:
    """CPU and memory of all of them, by name."""
    ether_type = get_codec("dcp-2.0").profile.link.ether_type
    scenario = Scenario(nodes=3, duration_s=seconds, tracks=(Tracks(source="track:walk"),))
    with (
        tempfile.TemporaryDirectory() as folder,
        Testbed(scenario, Path(folder), keep=False, record=False) as bed,
    ):
        for node, part in zip(bed.nodes, PARTS, strict=True):
            start(node, part, Path(folder))
        # The nodes are started already; this waits for their answers.
        bed.start()
        empty = {
            name: subprocess.Popen(
                [
                    *enter_command(bed.nodes[0].namespace),
                    *(sys.executable, "-S", "-c", EMPTY, INTERFACE, str(ether_type), mode),
                ],
                env={},
            )
            for name, mode in (("empty, each frame", "eager"), ("empty, at beacons", "lazy"))
        }
        try:
            for index in (0, 1):
                bed.nodes[index].call("RTDB-Create", varId=index, repCnt=1, descr="counter", value="00000000")
            time.sleep(3)
            pids = {part: node.call("UT-Status")["runtime"]["pid"] for node, part in zip(bed.nodes, PARTS, strict=True)}
            pids |= {name: process.pid for name, process in empty.items()}
            meters = {name: Meter(pid) for name, pid in pids.items()}
            begin, count = time.monotonic(), 0
            while time.monotonic() - begin < seconds:
                count += 1
                for index in (0, 1):
                    bed.nodes[index].call("RTDB-Update", varId=index, value=f"{count:08x}")
                time.sleep(max(begin + count - time.monotonic(), 0))
            return {name: meter.found() for name, meter in meters.items()}
        finally:
            for process in empty.values():
                process.kill()
                process.wait()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60, help="length of the measurement (default: 60)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers there")
    options = parser.parse_args()
    found: dict[str, Any] = measure(options.seconds)
    base = found["empty, at beacons"]["cpu_share"]
    print(f"{'':20} CPU of a core   beside empty    RSS MB  PSS MB")
    for name, each in found.items():
        print(
            f"{name:20} {each['cpu_share']:12.2%} {each['cpu_share'] / base:12.1f} x "
            f"{each['rss_mb']:9.1f} {each['pss_mb']:7.1f}"
        )
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
