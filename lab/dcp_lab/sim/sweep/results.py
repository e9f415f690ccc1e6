"""The results of the runs of a study: a file that grows by a line for each run, and tables of them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import msgspec

from dcp_lab.sim.measuring.values import DelayRow
from dcp_lab.sim.virtual.player import Simulation

from .plan import Run, Study

#: Receptions below which a mean is marked: its confidence interval says little.
FEW: Final = 10
#: Place of receptions without a path in the order of distances.
_NO_PATH: Final = 1 << 30
#: Two-sided 95 % quantiles of Student's t by degrees of freedom, from 1 on; the normal quantile beyond.
_T: Final = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one run. ``newest``: mean share of the other nodes that have the newest value of a variable."""

    key: str
    cell: int
    seed: int
    digest: str
    met: bool
    newest: float | None
    octets: int
    beacons: int
    delays: list[DelayRow]
    nodes: list[DelayRow] = []
    """The same for each node; empty in files of earlier versions."""
    cpu_s: float


def outcome(run: Run) -> Outcome:
    """Execute a run."""
    simulation = Simulation(run.scenario)
    simulation.measurements.values.count_by_node()
    report = simulation.run()
    seconds = sum(each.seconds for each in report.consistency)
    newest = sum(each.newest_share * each.seconds for each in report.consistency) / seconds if seconds else None
    return Outcome(
        key=run.key,
        cell=run.cell,
        seed=run.seed,
        digest=report.digest,
        met=report.met,
        newest=newest,
        octets=sum(each.octets_sent for each in report.traffic),
        beacons=sum(each.beacons_sent for each in report.traffic),
        delays=report.delays,
        nodes=simulation.measurements.values.node_rows(),
        cpu_s=report.cpu_s,
    )


def stored(path: Path) -> dict[str, Outcome]:
    """Return the outcomes in a file of lines by their keys; an incomplete last line is ignored."""
    found = {}
    for line in path.read_bytes().splitlines() if path.exists() else ():
        try:
            each = msgspec.json.decode(line, type=Outcome)
        except msgspec.DecodeError:
            continue
        found[each.key] = each
    return found


def rows(study: Study, outcomes: Iterable[Outcome]) -> Iterator[dict[str, Any]]:
    """Yield a row for each run, kind of value and distance, and for each node at this distance."""
    for each in outcomes:
        run = {**study.cells[each.cell], "seed": each.seed}
        about = {name: getattr(each, name) for name in ("met", "newest", "octets", "beacons", "digest")}
        for delay in (*each.delays, *each.nodes):
            yield {**run, **msgspec.to_builtins(delay), **about}


class Estimate(msgspec.Struct, frozen=True):
    """A mean over seeds, and half of its 95 % confidence interval; None with fewer than two seeds."""

    mean: float
    half: float | None

    @classmethod
    def of(cls, values: Sequence[float]) -> Estimate | None:
        """Return the estimate, None without a value."""
        if not values:
            return None
        if len(values) < 2:
            return cls(values[0], None)
        free = len(values) - 1
        t = _T[free - 1] if free <= len(_T) else statistics.NormalDist().inv_cdf(0.975)
        return cls(statistics.fmean(values), t * statistics.stdev(values) / math.sqrt(len(values)))

    def text(self, digits: int, *, signed: bool = False) -> str:
        """Return ``mean +- half``."""
        return f"{self.mean:{'+' if signed else ''}.{digits}f}" + (
            "" if self.half is None else f" +- {self.half:.{digits}f}"
        )


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """The values of one kind at one distance in one cell, over all seeds."""

    cell: int
    kind: str
    hops: int | None
    seeds: int
    received: int
    share: Estimate | None
    delay_ms: Estimate | None
    newest: Estimate | None
    differences: dict[str, Estimate] = {}
    """Mean differences of share, delay_ms and newest from the preceding cell (:meth:`Study.preceding`), in pairs of
    runs with the same seed."""

    @property
    def few(self) -> bool:
        """Whether the delay is that of few receptions."""
        return self.received < FEW


#: The measures of a run at one distance.
_MEASURES: Final[dict[str, Callable[[Outcome, DelayRow], float | None]]] = {
    "share": lambda _, delay: delay.share,
    "delay_ms": lambda _, delay: delay.mean_ms,
    "newest": lambda outcome, _: outcome.newest,
}


def summaries(outcomes: Iterable[Outcome], preceding: Mapping[int, int] = MappingProxyType({})) -> list[Summary]:
    """Return the summaries of all cells, sorted by cell, kind and distance.

    ``preceding``: for cells, the one from which they have differences.
    """
    groups: dict[tuple[int, str, int], list[tuple[Outcome, DelayRow]]] = {}
    for each in sorted(outcomes, key=lambda outcome: (outcome.cell, outcome.seed)):
        for delay in each.delays:
            hops = _NO_PATH if delay.hops is None else delay.hops
            groups.setdefault((each.cell, delay.kind, hops), []).append((each, delay))
    return [
        Summary(
            cell=cell,
            kind=kind,
            hops=found[0][1].hops,
            seeds=len(found),
            received=sum(delay.received for _, delay in found),
            differences=_differences(found, groups.get((preceding.get(cell, -1), kind, hops), [])),
            **{name: Estimate.of([*_by_seed(found, measure).values()]) for name, measure in _MEASURES.items()},
        )
        for (cell, kind, hops), found in sorted(groups.items(), key=lambda item: item[0])
    ]


_Found = Sequence[tuple[Outcome, DelayRow]]


def _by_seed(found: _Found, measure: Callable[[Outcome, DelayRow], float | None]) -> dict[int, float]:
    """Return the values of a measure by the seeds of runs that have it."""
    return {each.seed: value for each, delay in found if (value := measure(each, delay)) is not None}


def _differences(found: _Found, before: _Found) -> dict[str, Estimate]:
    """Return the differences of runs with the same seed: equal random numbers cancel out."""
    estimates = {}
    for name, measure in _MEASURES.items():
        here, there = _by_seed(found, measure), _by_seed(before, measure)
        estimates[name] = Estimate.of([value - there[seed] for seed, value in here.items() if seed in there])
    return {name: each for name, each in estimates.items() if each is not None}


def farthest(found: Sequence[Summary]) -> list[Summary]:
    """Return for each cell the summary of its updates (without any, creations) at the longest distance."""
    best: dict[int, Summary] = {}
    for each in found:
        if each.hops is not None:
            known = best.get(each.cell)
            if known is None or (each.kind == "update", each.hops) > (known.kind == "update", known.hops or 0):
                best[each.cell] = each
    return [best[cell] for cell in sorted(best)]
