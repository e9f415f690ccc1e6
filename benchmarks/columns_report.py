"""The contenders of ``columns.py`` and what it prints: rates, and how many times as fast columnar decoding is."""

from __future__ import annotations

import gc
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from repeated import Material
from rich.console import Console
from rich.table import Table

COLUMNAR = "columnar, pcap"


@dataclass
class Contender:
    """One way to do it: ``run`` handles ``beacons`` beacons and returns how many it found, or seconds it took."""

    name: str
    what: str
    beacons: int
    run: Callable[[], int]
    #: The recording.
    of: str = ""
    seconds: list[float] = field(default_factory=list)

    def turn(self) -> None:
        """Run once, and note how long it took."""
        gc.collect()
        gc.disable()
        begin = cpu_seconds()
        found = self.run()
        self.seconds.append(cpu_seconds() - begin)
        gc.enable()
        if found != self.beacons:
            raise SystemExit(f"{self.name}: found {found} beacons instead of {self.beacons}")

    @property
    def rate(self) -> float:
        """Beacons per second in the best round."""
        return self.beacons / min(self.seconds)


def cpu_seconds() -> float:
    """CPU seconds of this process and of its children that have ended; independent of other processes."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def figures(found: Sequence[Contender]) -> list[dict[str, Any]]:
    """Rates of all, and how many times faster columnar decoding is."""
    columnar_rates = {one.of: one.rate for one in found if one.name == COLUMNAR}
    start = next((one for one in found if one.name == "tshark, one frame"), None)
    rows = []
    for one in found:
        if one is start:
            continue
        rate = one.rate
        if one.name == "tshark" and start is not None:
            rate = (one.beacons - 1) / (min(one.seconds) - min(start.seconds))
        rows.append(
            {
                "recording": one.of,
                "contender": one.name,
                "what": one.what,
                "beacons": one.beacons,
                "per_second": rate,
                "us": 1e6 / rate,
                "columnar_is_times_faster": columnar_rates[one.of] / rate,
                "rounds": len(one.seconds),
            }
        )
    return rows


def show(
    materials: Sequence[Material],
    rows: Sequence[dict[str, Any]],
    cores: dict[str, float] | None,
    waits: dict[str, float],
) -> None:
    """Print everything as one table."""
    console = Console(width=130)
    for material in materials:
        average = material.size / material.beacons
        console.print(
            f"{material.name} repeated: {material.beacons} beacons, {material.size / 1e6:.0f} MB ({average:.0f} octets "
            f"for each), profile {material.codec.profile.name}; one core"
        )
    table = Table("recording", "contender", "what")
    for heading in ("beacons", "beacons/s", "µs/beacon", "columnar is × faster"):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(
            row["recording"],
            row["contender"],
            row["what"],
            str(row["beacons"]),
            f"{row['per_second']:,.0f}",
            f"{row['us']:.3f}",
            f"{row['columnar_is_times_faster']:.2f}",
        )
    console.print(table)
    rate = {row["contender"]: row["per_second"] for row in rows if row["recording"] == materials[0].name}
    for ours, theirs in (("scalar decode", "struct by hand, values"), ("scalar encode", "struct by hand, encode")):
        if theirs in rate:
            console.print(f"{ours}: {rate[theirs] / rate[ours]:.2f} times the time of {theirs}")
    if cores is not None:
        listed = ", ".join(f"{name} {ratio:.2f}" for name, ratio in cores.items())
        console.print(f"two cores: times as fast as one (two files, two processes): {listed}")
    listed = ", ".join(f"{name} {ratio:.2f}" for name, ratio in waits.items())
    console.print(f"all cores: times the wall time of {COLUMNAR} (one file, one process): {listed}")
