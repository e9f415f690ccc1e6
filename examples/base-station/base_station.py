"""A drone tells its battery level and whom it hears; a base station four hops away shows both.

    base_station.py drone --control PATH       publish at the node with this control socket, once a second
    base_station.py monitor --control PATH     show at another node what arrives there
    base_station.py simulate                   both, at the two ends of scenario.toml, in virtual time
    base_station.py testbed                    the same with real processes (needs root, or user namespaces)

Battery level and neighbours are variables of VarDis. What is in them is for the applications to agree on; here it is

    1  battery      percent (u8), voltage in mV (u16)
    2  neighbours   for each: last two octets of its identifier, age of its last report in units of 10 ms (u8)
"""

from __future__ import annotations

import argparse
import functools
import math
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from dcp_lab.sim.scenario.loading import load_scenario
from dcp_lab.sim.virtual.player import Simulation

from dcp_stack import ControlClient, ControlError, ServiceError

SCENARIO = Path(__file__).with_name("scenario.toml")
DRONE, BASE = 0, 4
BATTERY, NEIGHBOURS = 1, 2
#: VARDISPAR_MAX_VALUE_LENGTH is 32 octets by default.
MOST_NEIGHBOURS = 10
NS = 1_000_000_000

Call = Callable[..., dict[str, Any]]
"""``ControlClient.call``, or the same of a simulated node: method and parameters of the control interface."""


class Drone:
    """Publishes two variables at its node."""

    def __init__(self, call: Call) -> None:
        self._call = call

    def step(self, seconds: float) -> None:
        """Publish how things are so many seconds after take-off."""
        percent = max(0, round(100 - seconds))
        # A sensor would be asked here.
        millivolt = round(14_000 + 2_800 * percent / 100 + 50 * math.sin(seconds))
        self._publish(BATTERY, "battery: percent, mV", struct.pack(">BH", percent, millivolt))
        table = self._call("SRP-NeighbourTable").get("neighbours", [])
        freshest = sorted(table, key=lambda each: each["age"])[:MOST_NEIGHBOURS]
        heard = b"".join(
            bytes.fromhex(each["nodeId"].replace(":", ""))[-2:] + bytes([min(round(each["age"] / 10), 255)])
            for each in freshest
        )
        # A value must not be empty, and the absence of neighbours has to be published, too.
        self._publish(NEIGHBOURS, "neighbours: id, age", heard or b"\0")

    def _publish(self, variable: int, descr: str, value: bytes) -> None:
        answer = self._call("RTDB-Update", varId=variable, value=value.hex())
        if answer["status"] != "VARDIS-STATUS-OK":
            # Not there yet, or forgotten in a restart.
            self._call("RTDB-Create", varId=variable, repCnt=1, descr=descr, value=value.hex())


class Monitor:
    """Reads the variables at another node, and has a line of text when something is new."""

    def __init__(self, call: Call) -> None:
        self._call = call
        self._seen: dict[int, Any] = {}

    def step(self) -> Iterator[str]:
        """Yield a line for each change."""
        for variable, show in ((BATTERY, self._battery), (NEIGHBOURS, self._neighbours)):
            found = self._call("RTDB-Read", varId=variable)
            # The time stamp is the local time of the last update.
            if found["status"] == "VARDIS-STATUS-OK" and self._seen.get(variable) != found["tStamp"]:
                self._seen[variable] = found["tStamp"]
                yield show(bytes.fromhex(found["value"]))

    def _battery(self, value: bytes) -> str:
        percent, millivolt = struct.unpack(">BH", value)
        return f"battery    {'#' * (percent // 5):<20} {percent:3} %  {millivolt / 1000:.2f} V"

    def _neighbours(self, value: bytes) -> str:
        heard = [f"..{value[i : i + 2].hex(':')} {value[i + 2] * 10:4} ms ago" for i in range(0, len(value) - 2, 3)]
        return f"hears      {', '.join(heard) or 'nobody'}"


def simulate() -> int:
    """Both ends in virtual time."""
    simulation = Simulation(load_scenario(SCENARIO))
    network = simulation.network
    drone = Drone(functools.partial(network.request, DRONE))
    monitor = Monitor(functools.partial(network.request, BASE))

    def publish() -> None:
        drone.step(network.now / NS)
        network.at(network.now + NS, publish)

    def watch() -> None:
        for line in monitor.step():
            print(f"{network.now / NS:6.2f} s  {line}")
        network.at(network.now + NS // 10, watch)

    network.at(NS, publish)
    network.at(NS, watch)
    report = simulation.run()
    print(f"{report.duration_s:g} s in {report.elapsed_s:.2f} s, digest {report.digest[:16]}...")
    return 0 if report.met else 1


def testbed() -> int:
    """Both ends at nodes that are processes."""
    with tempfile.TemporaryDirectory() as directory:
        arguments = ["testbed", "--scenario", str(SCENARIO), "--keep", directory]
        bed = subprocess.Popen([sys.executable, "-m", "dcp_stack.cli", *arguments])  # noqa: S603 - our own program
        try:
            sockets = [Path(directory, f"node-{node}.sock") for node in (DRONE, BASE)]
            while not all(path.exists() for path in sockets) and bed.poll() is None:
                time.sleep(0.1)
            if bed.poll() is None:
                time.sleep(0.5)
                with ControlClient(sockets[0]) as one, ControlClient(sockets[1]) as other:
                    run(Drone(one.call), Monitor(other.call))
        except ControlError:
            # The scenario has ended, and the nodes with it.
            pass
        finally:
            if bed.poll() is None and not sys.exc_info()[0]:
                bed.wait(60)
            bed.terminate()
            bed.wait(60)
        return bed.returncode


def run(drone: Drone | None, monitor: Monitor | None) -> None:
    """Publish and watch until the node is gone."""
    start = time.monotonic()
    published = start
    while True:
        now = time.monotonic()
        if drone is not None and now >= published:
            published += 1
            drone.step(now - start)
        if monitor is not None:
            for line in monitor.step():
                print(f"{now - start:6.2f} s  {line}", flush=True)
        time.sleep(0.1)


def main() -> int:
    """Run one of the four."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["drone", "monitor", "simulate", "testbed"])
    parser.add_argument("--control", metavar="PATH", help="control socket of the node (drone, monitor)")
    given = parser.parse_args()
    if given.what == "simulate":
        return simulate()
    if given.what == "testbed":
        return testbed()
    if given.control is None:
        parser.error(f"{given.what} needs --control PATH")
    try:
        with ControlClient(given.control) as client:
            run(
                Drone(client.call) if given.what == "drone" else None,
                Monitor(client.call) if given.what == "monitor" else None,
            )
    except (ControlError, ServiceError) as error:
        print(f"base_station.py: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
