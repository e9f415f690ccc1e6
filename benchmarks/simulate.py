"""Measure the simulator: virtual seconds in a CPU second, for nodes on a grid and in a full mesh.

    python benchmarks/simulate.py [--quick] [--json FILE]

Each network is played with nodes that take in known beacons cheaply and, for a shorter time, with plain ones that
handle each beacon by themselves; the two take turns, and both have to give the same digest. 10 Hz, a position for each
beacon; two variables that hardly change, and in ``updates-100`` 20 variables, each updated every second. The first half
of each run is not counted: in it nodes meet.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import sys
import time
from pathlib import Path
from typing import Any

from dcp_lab.sim.scenario.defaults import default_scenario
from dcp_lab.sim.scenario.definition import NS_PER_S, Create, Scenario, Topology, Tracks, Update
from dcp_lab.sim.virtual.player import Simulation

#: Name -> nodes, topology, virtual seconds with cheap and with plain nodes.
NETWORKS = {
    "grid-100": (100, "grid", 10.0, 4.0),
    "full-100": (100, "full", 8.0, 2.0),
    "full-400": (400, "full", 4.0, 0.5),
    "updates-100": (100, "grid", 10.0, 4.0),
}
#: Variables of ``updates-100``.
VARIABLES = 20
ROUNDS = 3


def scenario_of(name: str, seconds: float) -> Scenario:
    """The scenario of a network."""
    nodes, kind, *_ = NETWORKS[name]
    topology = Topology(kind=kind)  # type: ignore[arg-type]
    if not name.startswith("updates"):
        return default_scenario(nodes, topology=topology, duration_s=seconds)
    created = [Create(at_s=1.0, node=each * nodes // VARIABLES, variable=each, text="0") for each in range(VARIABLES)]
    # Spread over the second.
    updated = [
        Update(at_s=2.0 + each.variable / VARIABLES, every_s=1.0, node=each.node, variable=each.variable, text="{n}")
        for each in created
    ]
    tracks = (Tracks(source="track:walk,extent=200"),)
    return Scenario(nodes=nodes, duration_s=seconds, topology=topology, tracks=tracks, events=(*created, *updated))


def played(name: str, seconds: float, *, shared: bool) -> tuple[float, float, str]:
    """Virtual seconds in a CPU second, and CPU microseconds for each delivery, of the second half; and the digest."""
    scenario = scenario_of(name, seconds)
    simulation = Simulation(scenario, share_decoding=shared)
    network, half = simulation.network, round(seconds / 2 * NS_PER_S)
    network.run_until(half)
    before, begin = network.medium.counters.delivered, time.process_time()
    network.run_until(2 * half)
    took, delivered = time.process_time() - begin, network.medium.counters.delivered - before
    return seconds / 2 / took, took / delivered * 1e6, network.digest.hexdigest()


def measure(name: str, rounds: int) -> dict[str, Any]:
    """Medians of rounds in which both take turns."""
    *_, long, short = NETWORKS[name]
    cheap, plain = [], []
    for _ in range(rounds):
        cheap.append(played(name, long, shared=True))
        plain.append(played(name, short, shared=False))
    same = played(name, short, shared=True)[2] == plain[0][2]
    if not same or len({each[2] for each in cheap}) != 1:
        sys.exit(f"{name}: the digests differ")
    speed, each = (statistics.median(column) for column in list(zip(*cheap, strict=True))[:2])
    ratio = statistics.median(a[0] / b[0] for a, b in zip(cheap, plain, strict=True))
    print(
        f"  {name:11}  {speed:7.2f} times real time on one core, {each:6.2f} us a delivery; "
        f"{ratio:5.2f} times as fast as with plain nodes"
    )
    return {"speed_up": speed, "us_per_delivery": each, "ratio": ratio, "digest": cheap[0][2]}


def main() -> None:
    """Measure all networks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one round, without the 400 nodes")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    print(f"{platform.python_implementation()} {platform.python_version()}, {platform.machine()}")
    names = [name for name in NETWORKS if not (options.quick and name == "full-400")]
    found = {name: measure(name, 1 if options.quick else ROUNDS) for name in names}
    if options.json:
        options.json.write_text(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
