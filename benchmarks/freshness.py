"""Measure how fresh the information is that a network spreads, beside its closed form.

    python benchmarks/freshness.py [--testbed] [--updates N] [--json FILE]

Values: the mean time that an update takes per hop on a line of nodes without losses, in beacon periods. Each node waits
for its next beacon, which comes after half a period on average, so the closed form is 0.5. Nodes that compose a payload
right after the beacon before it (X54 ``after-the-beacon``) take one period more.

State reports: the mean age of the newest report of a neighbour, by its tStamp, as a receiver has it. With beacon period
B, jitter j (each interval is uniform in B (1 - j) .. B (1 + j)) and loss p, the time between two receptions is a
geometric number of intervals, and the mean age is B / 2 * ((1 + p) / (1 - p) + j**2 / 3).

--testbed measures a line of five real nodes, too (root, or user namespaces): each in a network namespace of its own.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from dcp_lab.sim.scenario.definition import Scenario, Topology
from dcp_lab.sim.testbed.testbed import Testbed
from dcp_lab.sim.virtual.network import Network

from dcp_codec.codec import get_codec
from dcp_stack.config import BPConfig, SRPConfig, VardisConfig
from dcp_stack.effects import NeighbourSeen, VariableChanged
from dcp_stack.node import Node
from dcp_stack.virtual.quality import Quality
from dcp_stack.virtual.topology import Full, Line

CODEC = get_codec("dcp-2.0")
MS = 1_000_000
SECOND = 1000 * MS
PERIOD = 100 * MS
HOPS = 8


# -- values -----------------------------------------------------------------------------------------------------------


def simulated(jitter: float, summaries: int, compose: str, updates: int) -> float:
    """Beacon periods per hop on lines of nine simulated nodes that begin at random times."""
    delays: list[int] = []
    lines = max(updates // 3, 1)
    for seed in range(lines):
        net = Network(
            HOPS + 1,
            CODEC,
            seed=seed,
            topology=Line(),
            bp=BPConfig(jitter=jitter),
            vardis=VardisConfig(max_summaries=summaries, max_repetitions=1),
            readings={"X54": compose},
        )
        rng = random.Random(seed)
        for index in range(HOPS + 1):
            net.at(rng.randrange(PERIOD), lambda net=net, index=index: net.start(index))
        net.run_until(2 * PERIOD)
        net.call(0, lambda node, now, wall: node.vardis.create(1, None, 1, b"value", b"0", now=now, wall=wall))
        net.run_until(4 * SECOND)
        born: dict[bytes, int] = {}

        def changed(now: int, index: int, effect: VariableChanged, born: dict[bytes, int] = born) -> None:
            if index == HOPS:
                delays.append(now - born[effect.value])

        net.listen(VariableChanged, changed)
        for number in range(3):
            net.run_until(net.now + 2 * SECOND + rng.randrange(PERIOD))
            value = str(number).encode()
            born[value] = net.now
            net.call(0, lambda node, now, wall, value=value: node.vardis.update(1, value, now=now, wall=wall))
        net.run_until(net.now + 3 * SECOND)
    if len(delays) != 3 * lines:
        sys.exit(f"{3 * lines - len(delays)} of {3 * lines} updates have not arrived")
    return statistics.fmean(delays) / PERIOD / HOPS


def real(jitter: float, summaries: int, compose: str, updates: int) -> float:
    """Beacon periods per hop on lines of five nodes, each a process in a network namespace."""
    scenario = Scenario(
        nodes=5,
        duration_s=3600,
        topology=Topology(kind="line"),
        bp=BPConfig(jitter=jitter),
        vardis=VardisConfig(max_summaries=summaries, max_repetitions=1),
        readings={"X54": compose},
    )
    rng = random.Random(1)
    delays: list[float] = []
    # Without jitter the phases of the nodes do not change after the start.
    for _ in range(1 if jitter else 10):
        with tempfile.TemporaryDirectory() as folder, Testbed(scenario, Path(folder), keep=False, record=False) as bed:
            bed.start()
            first, last = bed.nodes[0], bed.nodes[-1]
            # The first creation may be sent before the new network carries frames; it is in one beacon only.
            while True:
                first.call("RTDB-Create", varId=1, repCnt=1, descr="value", value="30")
                if _await(last, lambda entry: entry is not None, 2) is not None:
                    break
            for number in range(updates if jitter else max(updates // 10, 1)):
                time.sleep(0.7 + rng.random() * 0.1)
                value = f"{number:04x}"
                first.call("RTDB-Update", varId=1, value=value)
                born = _entry(first)["tStamp"]
                entry = _await(last, lambda entry, value=value: entry is not None and entry["value"] == value, 10)
                if entry is None:
                    sys.exit("a value has not arrived within 10 s")
                delays.append((entry["tStamp"] - born) / PERIOD / 4)
    return statistics.fmean(delays)


def _entry(node: Any) -> Any:
    return node.call("RTDB-DescribeVariable", varId=1).get("variable")


def _await(node: Any, wanted: Any, seconds: float) -> Any:
    """Return the entry of the variable at a node when it is ``wanted``; None if it is not within ``seconds`` s."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        entry = _entry(node)
        if wanted(entry):
            return entry
        time.sleep(0.05)
    return None


# -- state reports ----------------------------------------------------------------------------------------------------


def report_age(loss: float, jitter: float, seconds: int) -> float:
    """Mean age in ms at one node of the newest report of another that submits it just before each beacon."""
    net = Network(
        2,
        CODEC,
        seed=7,
        topology=Full(),
        quality=Quality(loss=loss),
        bp=BPConfig(jitter=jitter),
        srp=SRPConfig(neighbour_table_timeout_ms=60_000),
        vardis=None,
    )
    stamped: list[int] = []
    received: list[tuple[int, int]] = []
    data = {"x": 0.0, "y": 0.0, "z": 0.0}

    def submit() -> None:
        def update(node: Node, now: int, wall: int) -> int | None:
            node.srp.update_safety_data(data, now=now, wall=wall)
            return node.bp.poll_timeout()

        due = net.call(0, update)
        stamped.append(net.now)
        net.at(due + 1, lambda: net.at(net.node(0).bp.poll_timeout() - 1, submit))

    net.start(0)
    net.start(1)
    net.at(net.node(0).bp.poll_timeout() - 1, submit)
    net.listen(NeighbourSeen, lambda now, index, _: received.append((now, stamped[-1])) if index == 1 else None)
    net.run_until(seconds * SECOND)
    area = 0.0
    for (begin, stamp), (end, _) in itertools.pairwise(received):
        area += (begin + end - 2 * stamp) / 2 * (end - begin)
    return area / (received[-1][0] - received[0][0]) / MS


def closed_form_age(loss: float, jitter: float) -> float:
    """The same in ms, as calculated."""
    return PERIOD / MS / 2 * ((1 + loss) / (1 - loss) + jitter**2 / 3)


def main() -> None:
    """Print all of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--testbed", action="store_true", help="also with real nodes (root or user namespaces)")
    parser.add_argument("--updates", type=int, default=120, help="updates for each line (default: 120)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers there")
    options = parser.parse_args()
    found: dict[str, Any] = {"values": [], "reports": []}
    grounds = {"simulate": simulated} | ({"testbed": real} if options.testbed else {})
    print("Beacon periods per hop on a line without losses")
    print("  ground    compose            jitter  summaries  measured  closed form")
    for ground, measure in grounds.items():
        for compose, closed in (("before-the-beacon", 0.5), ("after-the-beacon", 1.5)):
            for jitter in (0.0, 0.1):
                for summaries in (0, 20):
                    # Idle nodes that compose after a beacon have nothing to compose: the buffer check decides.
                    if compose == "after-the-beacon" and (not summaries or ground == "testbed"):
                        continue
                    updates = options.updates if ground == "simulate" else max(options.updates // 4, 1)
                    value = measure(jitter, summaries, compose, updates)
                    print(f"  {ground:9} {compose:18} {jitter:6} {summaries:10} {value:9.3f} {closed:12}")
                    found["values"].append(
                        {
                            "ground": ground,
                            "compose": compose,
                            "jitter": jitter,
                            "summaries": summaries,
                            "periods_per_hop": value,
                            "closed_form": closed,
                        }
                    )
    print("Mean age of state reports in ms")
    print("  loss  measured  closed form  ratio")
    for loss in (0.0, 0.2, 0.5):
        age, closed = report_age(loss, 0.1, 6000), closed_form_age(loss, 0.1)
        print(f"  {loss:4} {age:9.2f} {closed:12.2f} {age / closed:6.3f}")
        found["reports"].append({"loss": loss, "age_ms": age, "closed_form_ms": closed})
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
