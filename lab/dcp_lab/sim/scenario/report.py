"""The report of a run as text and as JSON, common to simulations and testbeds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from dcp_lab.sim.measuring.ages import AgeRow
from dcp_lab.sim.measuring.consistency import VariableConsistency
from dcp_lab.sim.measuring.values import DelayRow, ValueTotals

from .agreement import Convergence
from .definition import NS_PER_S
from .provenance import Provenance


class Finding(msgspec.Struct, frozen=True):
    """An expectation and whether it was met. ``found``: the deviating observation, or details."""

    what: str
    met: bool
    found: str = ""


class NodeTraffic(msgspec.Struct, frozen=True):
    """The traffic of one node.

    ``beacons_per_s`` is None for a node that was not switched on during the whole run. ``left_out_per_s``: beacons per
    s that the node additionally left out because the machine was too busy.
    """

    node: int
    beacons_sent: int
    octets_sent: int
    beacons_received: int
    beacons_per_s: float | None
    left_out_per_s: float = 0.0


class Report(msgspec.Struct):
    """The result of a run. Times of convergences are in ns; other names end with their unit."""

    title: str
    ground: str
    """``simulate`` or ``testbed``."""
    nodes: int
    profile: str
    seed: int
    duration_s: float
    provenance: Provenance | None = None
    findings: list[Finding] = []
    convergences: list[Convergence] = []
    traffic: list[NodeTraffic] = []
    values: ValueTotals = ValueTotals()
    delays: list[DelayRow] = []
    """Empty for testbeds, where the arrival of values cannot be observed."""
    consistency: list[VariableConsistency] = []
    ages: list[AgeRow] = []
    """Empty unless they were measured (``--ages``)."""
    shares: dict[str, float] = {}
    """Frames delivered, lost, duplicated and missed, as shares of ``expected``."""
    expected: int = 0
    """Number of deliveries by a perfect medium: the neighbours of the sender, for each beacon."""
    digest: str = ""
    elapsed_s: float = 0.0
    cpu_s: float = 0.0
    late_s: float = 0.0
    """Longest delay of an event or of a query of the nodes, because the machine was busy; 0 in virtual time."""
    slowest_start_s: float = 0.0
    """Longest time until a node answered that was switched on after the start; 0 in virtual time."""

    @property
    def met(self) -> bool:
        """Whether all expectations are met."""
        return all(finding.met for finding in self.findings)

    @property
    def speed_up(self) -> float:
        """Simulated time divided by real time."""
        return self.duration_s / self.elapsed_s if self.elapsed_s else 0.0

    def plain(self) -> dict[str, Any]:
        """Return the report as plain data for JSON, with times of convergences in s."""
        found: dict[str, Any] = msgspec.to_builtins(self)
        found["convergences"] = [
            {
                "at_s": each.time / NS_PER_S,
                "what": each.what,
                "took_s": None if each.took is None else each.took / NS_PER_S,
            }
            for each in self.convergences
        ]
        return {**found, "speed_up": round(self.speed_up, 3), "met": self.met}


#: Maximum number of printed rows of a table; one line summarises the rest.
SHOWN = 24
#: Delays in s, of events and of starts, above which the report has a warning: scenarios expect results within seconds.
LATE, SLOW_START = 0.5, 1.5


def lines(report: Report) -> Iterator[str]:
    """Yield the lines of the report as text."""
    title = f"{report.title}: " if report.title else ""
    yield f"{title}{report.nodes} nodes, {report.profile}, {report.duration_s:g} s, {report.ground}, seed {report.seed}"
    yield ""
    yield from _convergences(report.convergences)
    yield from _traffic(report)
    yield from _values(report)
    if report.ages:
        seconds = sum(each.seconds for each in report.ages)
        mean = sum(each.mean_ms * each.seconds for each in report.ages) / seconds
        yield f"reports    mean age {mean:.1f} ms at {len(report.ages)} pairs of node and neighbour"
    if report.shares:
        numbers = (f"{round(share * report.expected)} {name} ({share:.2%})" for name, share in report.shares.items())
        yield f"medium     {report.expected} deliveries to neighbours: {', '.join(numbers)}"
    if report.provenance is not None:
        made = report.provenance
        warm_up = made.scenario["warm_up_s"]
        counted = f", counted from {warm_up:g} s on" if warm_up else ""
        yield f"scenario   {made.scenario_sha256[:16]}, kit {made.kit_version}{counted}"
    if report.digest:
        yield f"digest     {report.digest}"
    if report.ground == "simulate":
        yield f"speed      {report.speed_up:.1f} times real time ({report.elapsed_s:.2f} s, {report.cpu_s:.2f} s CPU)"
    if report.late_s > LATE or report.slowest_start_s > SLOW_START:
        late = f"{report.late_s:.1f} s late at most, starting a node took {report.slowest_start_s:.1f} s"
        yield f"machine    {late}: it is too busy for expectations about times"
    yield ""
    for finding in report.findings:
        found = f": {finding.found}" if finding.found else ""
        yield f"{'met    ' if finding.met else 'NOT MET'}  {finding.what}{found}"


def _convergences(convergences: Sequence[Convergence]) -> Iterator[str]:
    """Yield the table of events and the times until the databases agreed."""
    if not convergences:
        return
    yield "        at  event                                     databases agree after"
    for each in convergences[:SHOWN]:
        took = "not until the end" if each.took is None else f"{each.took / NS_PER_S:.3f} s"
        yield f"  {each.time / NS_PER_S:6.2f} s  {each.what[:40]:<40}  {took}"
    if len(convergences) > SHOWN:
        known = [each.took for each in convergences if each.took is not None]
        worst = f"{max(known) / NS_PER_S:.3f} s" if known else "-"
        yield f"  and {len(convergences) - SHOWN} more; of all, {len(known)} ended in agreement, after {worst} at most"
    yield ""


def _traffic(report: Report) -> Iterator[str]:
    """Yield the table of the nodes' traffic, if it is not too long, and the totals."""
    traffic = report.traffic
    rates = [each.beacons_per_s for each in traffic if each.beacons_per_s is not None]
    if len(traffic) <= SHOWN:
        yield "  node  beacons sent   per s   octets each  received"
        for each in traffic:
            rate = "     -" if each.beacons_per_s is None else f"{each.beacons_per_s:6.2f}"
            mean = each.octets_sent / each.beacons_sent if each.beacons_sent else 0
            yield f"  {each.node:4}  {each.beacons_sent:12}  {rate}  {mean:12.1f}  {each.beacons_received:8}"
        yield ""
    sent, received = sum(each.beacons_sent for each in traffic), sum(each.beacons_received for each in traffic)
    octets = sum(each.octets_sent for each in traffic)
    yield f"beacons    {sent} sent, {octets} octets; {received} received"
    if rates:
        mean = sum(rates) / len(rates)
        yield f"rate       {mean:.2f} beacons/s per node ({min(rates):.2f} to {max(rates):.2f})"


def _values(report: Report) -> Iterator[str]:
    """Yield totals, delays, consistency and notes about the values."""
    totals = report.values
    if totals.due:
        late = (
            f", {totals.missed_newest} of them the newest of their variable at the end" if totals.missed_newest else ""
        )
        yield (
            f"values     {totals.produced} produced; {totals.received} of {totals.due} possible receptions by other "
            f"nodes ({totals.received / totals.due:.1%}), {totals.missed} missed{late}"
        )
    yield from map(_delay, report.delays[:SHOWN])
    if len(report.delays) > SHOWN:
        yield f"           and {len(report.delays) - SHOWN} more distances; --json lists all of them"
    if report.consistency:
        seconds = sum(each.seconds for each in report.consistency)
        newest = sum(each.newest_share * each.seconds for each in report.consistency) / seconds
        complete = sum(each.complete_share * each.seconds for each in report.consistency) / seconds
        count = len(report.consistency)
        yield (
            f"newest     on average over time {newest:.1%} of the other nodes have the newest value, all of them "
            f"{complete:.1%} of the time ({count} variable{'s' * (count != 1)})"
        )
    yield from (f"note       {note}" for note in totals.notes)


def _delay(row: DelayRow) -> str:
    """Return the line for the delays of one kind of values at one distance."""
    where = "no path" if row.hops is None else f"{row.hops:2} hop{' ' if row.hops == 1 else 's'}"
    found = f"  {row.kind + 's':9}  {where:7}  {row.received} of {row.due} received ({row.share:.1%})"
    if row.mean_ms is None:
        return found
    sd = "" if row.sd_ms is None else f", sd {row.sd_ms:.1f}"
    return (
        f"{found}: mean {row.mean_ms:.1f} ms, median {row.median_ms:.1f}{sd}, 95 % within {row.p95_ms:.1f}, "
        f"at most {row.max_ms:.1f}"
    )
