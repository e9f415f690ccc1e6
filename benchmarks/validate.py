"""Simulations beside closed forms: ``python benchmarks/validate.py`` writes the table of ``docs/validation.md``.

``--short`` takes a few seconds and prints the table. Both fail if a result is more than five standard errors and a
tenth away from theory. Results are means over seeds, with the standard error of these means; z is the difference from
theory in standard errors. B is the mean beacon period, p the loss of a connection, r the repetition count, h the
distance in hops.
"""

from __future__ import annotations

import math
import re
import statistics
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
from dcp_lab.sim.measuring.values import DelayRow
from dcp_lab.sim.scenario.definition import Create, LinkQuality, Scenario, Topology, Tracks, Update
from dcp_lab.sim.scenario.radio import RadioTable
from dcp_lab.sim.scenario.report import Report
from dcp_lab.sim.virtual.player import Simulation, simulate
from dcp_spec.markdown import table

from dcp_stack.config import BPConfig, SRPConfig, VardisConfig

PAGE = Path(__file__).parents[1] / "docs" / "validation.md"
BEGIN, END = "<!-- table: made by benchmarks/validate.py -->", "<!-- end of table -->"
PERIOD_MS, JITTER = 100.0, 0.1
#: Time between two updates in s: long enough for all repetitions over all hops.
EVERY_S = 3.0
#: Mean and variance of the time from an event to the next beacon, in ms: the residual life of a renewal process whose
#: intervals are uniform in B (1 - jitter) .. B (1 + jitter).
WAIT = PERIOD_MS / 2 * (1 + JITTER**2 / 3)
_CUBE = ((1 + JITTER) ** 4 - (1 - JITTER) ** 4) / (8 * JITTER)
WAIT_VARIANCE = PERIOD_MS**2 * _CUBE / 3 - WAIT**2


@dataclass(frozen=True)
class Row:
    """One comparison."""

    what: str
    theory: float
    values: list[float]
    digits: int = 1
    sigma: float | None = None
    """Standard error of the mean according to theory; None: that of the values."""

    @property
    def mean(self) -> float:
        return statistics.fmean(self.values)

    @property
    def error(self) -> float:
        if self.sigma is not None:
            return self.sigma
        return statistics.stdev(self.values) / math.sqrt(len(self.values))

    @property
    def z(self) -> float:
        difference = self.mean - self.theory
        return difference / self.error if self.error else (0.0 if abs(difference) < 1e-9 else math.inf)

    @property
    def is_far(self) -> bool:
        """Whether the difference is large. With few seeds the standard error alone is too uncertain for that."""
        return abs(self.z) > 5 and abs(self.mean - self.theory) > self.theory / 10

    def cells(self) -> list[str]:
        numbers = [f"{each:.{self.digits}f}" for each in (self.theory, self.mean, self.error)]
        return [self.what, *numbers, f"{self.z:+.1f}"]


def line(
    nodes: int,
    loss: float,
    repetitions: int,
    seed: int,
    updates: int,
    summaries: int = 0,
    intervals: Literal["uniform", "exponential"] = "uniform",
    **link: float,
) -> Report:
    """Simulate a line whose first node updates a variable."""
    return simulate(
        Scenario(
            nodes=nodes,
            duration_s=2 + EVERY_S * (updates + 1),
            topology=Topology(kind="line"),
            seed=seed,
            srp=False,
            bp=BPConfig(beacon_period_ms=round(PERIOD_MS), jitter=JITTER, intervals=intervals),
            # While it has nothing to send VarDis looks for new records once in this period. Only exponential intervals
            # can be shorter than the default, 50 ms.
            vardis=VardisConfig(
                max_summaries=summaries, buffer_check_period_ms=1 if intervals == "exponential" else 50
            ),
            link=LinkQuality(loss=loss, **link),
            events=(
                Create(at_s=1.0, node=0, variable=1, text="0", repetitions=repetitions),
                # Not a multiple of the beacon period: updates come at all phases of it.
                Update(at_s=1.0 + EVERY_S, every_s=EVERY_S + 0.0137, times=updates, node=0, variable=1, text="{n}"),
            ),
        )
    )


def report_age(loss: float, seed: int, seconds: float) -> float:
    """Simulate two nodes with SRP; returns the mean age of their reports in ms."""
    simulation = Simulation(
        Scenario(
            nodes=2,
            duration_s=seconds,
            warm_up_s=2.0,
            seed=seed,
            vardis=False,
            bp=BPConfig(beacon_period_ms=round(PERIOD_MS), jitter=JITTER),
            # Loss bursts of a whole timeout are rare, but would end the measurement.
            srp=SRPConfig(neighbour_table_timeout_ms=10_000),
            link=LinkQuality(loss=loss),
            tracks=(Tracks(source="track:circle"),),
        )
    )
    simulation.measure_ages()
    return statistics.fmean(each.mean_ms for each in simulation.run().ages)


def delivery(loss: float, repetitions: int, hops: int) -> float:
    """Share of updates that arrive over ``hops`` hops without summaries: each hop has r independent attempts."""
    return (1 - loss**repetitions) ** hops


def delay(loss: float, repetitions: int, hops: int) -> float:
    """Mean delay of the updates that arrive, in ms: a residual wait and the failed attempts of each hop."""
    failed = sum(count * loss**count * (1 - loss) for count in range(repetitions)) / (1 - loss**repetitions)
    return hops * (WAIT + failed * PERIOD_MS)


def spread(loss: float, repetitions: int, hops: int) -> float:
    """Standard deviation of the delay of the updates that arrive, in ms."""
    weights = [loss**count * (1 - loss) / (1 - loss**repetitions) for count in range(repetitions)]
    mean = sum(count * weight for count, weight in enumerate(weights))
    variance = sum((count - mean) ** 2 * weight for count, weight in enumerate(weights))
    return math.sqrt(hops * (WAIT_VARIANCE + PERIOD_MS**2 * variance))


def rows(seeds: int, updates: int) -> Iterator[Row]:
    """Yield all comparisons."""
    numbers = range(1, seeds + 1)
    perfect = [line(17, 0.0, 1, seed, updates) for seed in numbers]
    summarised = [line(5, 0.0, 1, seed, updates, summaries=10) for seed in numbers]
    for name, reports, distances in (("", perfect, (1, 4, 16)), (", with summaries", summarised, (1, 4))):
        for hops in distances:
            found = [at(each, hops) for each in reports]
            what = f"no loss{name}, h = {hops}"
            sd, count = spread(0.0, 1, hops), updates * seeds
            means, sds = [each.mean_ms or 0 for each in found], [each.sd_ms or 0 for each in found]
            yield Row(f"mean delay (ms), {what}", hops * WAIT, means, sigma=sd / math.sqrt(count))
            yield Row(f"its standard deviation (ms), {what}", sd, sds, sigma=sd / math.sqrt(2 * count))
    for group, (loss, repetitions) in enumerate(((0.1, 1), (0.2, 1), (0.2, 2), (0.5, 2), (0.5, 3)), 1):
        # Seeds of their own: with common random numbers the differences of all rows would have the same sign.
        reports = [line(5, loss, repetitions, 100 * group + seed, updates) for seed in numbers]
        for hops in (1, 2, 4):
            found = [at(each, hops) for each in reports]
            what = f"p = {loss}, r = {repetitions}, h = {hops}"
            share = delivery(loss, repetitions, hops)
            sigma = math.sqrt(share * (1 - share) / (updates * seeds))
            yield Row(f"share received, {what}", share, [each.share for each in found], 3, sigma)
            means = [each.mean_ms for each in found if each.mean_ms is not None]
            sigma = spread(loss, repetitions, hops) / math.sqrt(share * updates * seeds)
            yield Row(f"mean delay (ms), {what}", delay(loss, repetitions, hops), means, sigma=sigma)
    bursts = [line(2, 0.3, 1, seed, 10 * updates, summaries=10, burst=5.0) for seed in numbers]
    yield Row("share lost in bursts of 5, p = 0.3", 0.3, [each.shares.get("lost", 0.0) for each in bursts], 3)
    sent = [line(4, 0.0, 3, seed, updates) for seed in numbers]
    beacons = [sum(node.beacons_sent for node in each.traffic) / (updates + 1) for each in sent]
    yield Row("beacons for each value, r = 3, 4 nodes", 12, beacons, 2)
    for loss in (0.0, 0.2, 0.5):
        found = [report_age(loss, 200 + seed, 4.0 * updates) for seed in numbers]
        # A report that is lost leaves the one before it, which is a period older.
        yield Row(f"age of state reports (ms), p = {loss}", WAIT + PERIOD_MS * loss / (1 - loss), found)
    yield from radio_rows(numbers, updates)


def chatter(nodes: int, seed: int, seconds: float, topology: Topology | None = None, **radio: Any) -> Report:
    """Simulate nodes that send a beacon at the times of a Poisson process with the rate 1 / B, each with summaries."""
    return simulate(
        Scenario(
            nodes=nodes,
            duration_s=seconds,
            topology=topology or Topology(),
            seed=seed,
            srp=False,
            bp=BPConfig(beacon_period_ms=round(PERIOD_MS), intervals="exponential"),
            radio=RadioTable(**radio),
            events=tuple(Create(at_s=0.2, node=node, variable=node, text="x") for node in range(nodes)),
        )
    )


def radio_rows(numbers: Sequence[int], updates: int) -> Iterator[Row]:
    """Yield the comparisons of radio, exponential intervals and random workloads."""
    for nodes, airtime_ms in ((5, 1.0), (10, 1.0), (20, 2.0)):
        reports = [chatter(nodes, 1000 + seed, 2.0 * updates, preamble_us=airtime_ms * 1000) for seed in numbers]
        share = math.exp(-2 * (nodes - 1) * airtime_ms / PERIOD_MS)
        what = f"share without overlap, N = {nodes}, a = {airtime_ms:g} ms"
        yield Row(what, share, [each.shares["delivered"] for each in reports], 3)
    for rate in (1e-4, 1e-3):
        reports = [chatter(2, 1100 + seed, 2.0 * updates, bit_error_rate=rate) for seed in numbers]
        # All beacons have two summaries, once both nodes have both variables.
        sent = [node for each in reports for node in each.traffic]
        octets = sum(node.octets_sent for node in sent) / sum(node.beacons_sent for node in sent)
        share = (1 - rate) ** (8 * octets)
        sigma = math.sqrt(share * (1 - share) / sum(each.expected for each in reports))
        what = f"share received, bit error rate {rate:g}, {octets:.1f} octets"
        yield Row(what, share, [each.shares["delivered"] for each in reports], 3, sigma)
    table = ((0.0, 0.0), (50.0, 0.2), (150.0, 1.0))
    for distance, loss in ((25.0, 0.1), (100.0, 0.6)):
        place = Topology(kind="positions", range_m=200.0, positions=((0.0, 0.0, 0.0), (distance, 0.0, 0.0)))
        reports = [chatter(2, 1200 + seed, 2.0 * updates, place, loss=table) for seed in numbers]
        sigma = math.sqrt(loss * (1 - loss) / statistics.fmean(each.expected for each in reports) / len(reports))
        yield Row(f"share lost at {distance:g} m", loss, [each.shares["lost"] for each in reports], 3, sigma)
    reports = [line(5, 0.0, 1, 1300 + seed, 4 * updates, intervals="exponential") for seed in numbers]
    for hops in (1, 4):
        means = [at(each, hops).mean_ms or 0 for each in reports]
        sigma = PERIOD_MS * math.sqrt(hops / (4 * updates * len(reports)))
        yield Row(f"mean delay (ms), exponential intervals, h = {hops}", hops * PERIOD_MS, means, sigma=sigma)
    workload = Update(at_s=0.0, every_s=2.0, intervals="exponential", node=0, variable=1, text="{n}")
    random = Scenario(nodes=1, duration_s=3600.0, events=(workload,))
    # The first one is at the start. Only the times are drawn, so there can be many seeds.
    counts = [len(msgspec.structs.replace(random, seed=seed).timeline()) - 1.0 for seed in range(100)]
    yield Row("random updates in an hour, one in 2 s", 1800, counts, 0, math.sqrt(1800 / len(counts)))


def at(report: Report, hops: int) -> DelayRow:
    """Return the delays of updates at a distance."""
    return next(each for each in report.delays if (each.kind, each.hops) == ("update", hops))


def main(arguments: list[str]) -> int:
    short = "--short" in arguments
    found = list(rows(4, 12) if short else rows(4, 50))
    text = table(["", "theory", "simulated", "s.e.", "z"], [each.cells() for each in found], "lrrrr")
    print(text)
    if not short:
        page = PAGE.read_text(encoding="utf-8")
        block = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
        PAGE.write_text(block.sub(lambda _: f"{BEGIN}\n\n{text}\n\n{END}", page), encoding="utf-8")
    far = [each for each in found if each.is_far]
    for each in far:
        print(f"too far from theory: {each.what}", file=sys.stderr)
    return 1 if far else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
