"""The plots of a report, one function each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from bokeh.models import BasicTickFormatter

from dcp_codec.analysis.entry import DELETED, UNKNOWN

from . import analysis, holding
from .analysis import KINDS, Part, Steps, Time
from .chart import Chart, Plot
from .recorded import NOBODY, Column, Recorded
from .series import extremes, in_unit, ordinal, runs, seconds_text, short, usual_interval
from .variables import Passings, Values, counted, numeric

#: Maximum number of nodes and of variables that are drawn, and of rows in the plot of held values.
DRAWN, ROWS = 20, 40
#: Maximum number of points in a plot, and minimum number of intervals of each series. Longer series are reduced to the
#: extremes of each interval.
_POINTS, _PIECES = 6_000, 60
#: Number of reports of each node in an interval, so that the maximum age is meaningful.
_REPORTS = 4
#: Markers of the kinds of anomalies.
_KIND_SYMBOLS = ("x", "diamond", "triangle", "square", "inverted_triangle")
#: Maximum absolute value of plausible coordinates.
_FAR = 1e8


@dataclass
class PlotContext:
    """The common data of all plots of one recording: time, and the colours of nodes and variables."""

    recorded: Recorded
    time: Time
    #: Numbers of the nodes that are drawn, in the order of their colours.
    nodes: list[int]
    variables: list[int]
    prefix: str = ""
    short: dict[int, str] = field(init=False)

    def __post_init__(self) -> None:
        self.short = short_names({node: self.recorded.nodes[node] for node in self.nodes})

    def name(self, node: int) -> str:
        """Return the short name of a node for plots and narrow tables."""
        return self.short.get(node) or (self.recorded.nodes[node] if node >= 0 else NOBODY)

    def times(self, table: str) -> dict[int, Column]:
        """Return the times of the rows of each drawn node in a table; nodes without rows are left out."""
        found = {node: analysis.times_of(self.recorded, self.time, table, node) for node in self.nodes}
        return {node: times for node, times in found.items() if times.size}

    def chart(self, name: str, title: str, caption: str, **options: object) -> Chart:
        """Return the builder of a new plot of this recording, over time unless ``duration`` is None."""
        return Chart(f"{self.prefix}{name}", title, caption, **{"duration": self.time.duration, **options})  # type: ignore[arg-type]


def short_names(names: dict[int, str]) -> dict[int, str]:
    """Return the shortest suffixes that distinguish identifiers, with at least two octets."""
    for octets in range(2, 256):
        found = {}
        for node, name in names.items():
            parts = name.split(":") if ":" in name else [name[at : at + 2] for at in range(0, len(name), 2)]
            joined = (":" if ":" in name else "").join(parts[-octets:])
            found[node] = joined if joined == name or name == NOBODY else f"…{joined}"
        found = {node: names[node] if names[node] == NOBODY else text for node, text in found.items()}
        if len(set(found.values())) == len(set(names.values())):
            return found
    return dict(names)


class Downsampled:
    """Reduces the series of one plot to fewer points, and counts the points."""

    def __init__(self, series: int) -> None:
        self._pieces = max(_PIECES, _POINTS // (4 * max(1, series)))
        self.drawn = self.total = 0

    def rows(self, rows: Column, x: Column, y: Column, also: Column | None = None) -> Column:
        """Return the rows to draw; ``also`` has the indices of rows that are always drawn."""
        places = self.places(x, y)
        kept: Column = rows[places if also is None else np.union1d(places, also)]
        self.drawn, self.total = self.drawn + kept.size, self.total + rows.size
        return kept

    def places(self, x: Column, y: Column) -> Column:
        """Return the indices of the points of a series to draw."""
        return extremes(x, y, self._pieces)

    @property
    def words(self) -> str:
        """Note for the caption if points were left out; otherwise empty."""
        if self.drawn >= self.total:
            return ""
        share = self.total / max(1, self.drawn)
        return f" 1 of {short(share)} drawn: the first, last, minimum and maximum of each interval."


def over_time(
    context: PlotContext, name: str, title: str, caption: str, label: str, ends: Column, series: dict[int, Column]
) -> Plot:
    """Plot one line for each node, which is constant in each interval of ``ends``."""
    chart = context.chart(name, title, caption, label=label)
    for node, each in series.items():
        chart.levels(context.nodes.index(node), context.name(node), ends, each)
    return chart.plot()


def holdings(context: PlotContext, found: holding.Holding) -> tuple[Plot | None, int]:
    """Plot the held values over time for the longest differences; also return the number of omitted rows."""
    pairs = [pair for pair in found.pairs if pair.known or pair.differs]
    longest = sorted(pairs, key=lambda each: (-each.age, -sum(b - a for a, b in each.differs)))[:ROWS]
    rows = sorted(longest, key=lambda each: (each.variable, context.recorded.nodes[each.node]))
    if not rows:
        return None, 0
    time = context.time
    edges = np.linspace(0, time.duration or 1.0, max(120, min(600, 9_000 // len(rows))) + 1)
    caption = (
        "One row for each variable and node. As the producer: the node sends its last sequence number. On its way: the "
        "producer has a newer one, for a short time. Stale (red and hatched): the producer left the node's number more "
        "than 3 s, and 10 beacons, before. Blank: it sends no record about the variable. Each interval is "
        f"{seconds_text(float(edges[1]))} long."
    )
    names = [f"{pair.variable} at {context.name(pair.node)}{' ≠' if pair.stale else ''}" for pair in rows]
    chart = context.chart("holding", "Values held by each node", caption, rows=names, height=110 + 19 * len(rows))
    same: list[tuple[float, float, int]] = []
    waits: list[tuple[float, float, int]] = []
    waiting: list[float] = []
    late: list[tuple[float, float, int]] = []
    held: list[str] = []
    produced: list[str] = []
    behind: list[str] = []
    for row, pair in enumerate(rows):
        known, differs = (holding.shares(spans, edges) for spans in (pair.known, pair.differs))
        same += [(edges[a], edges[b], row) for a, b in runs(known > 0)]
        # Adjacent intervals with the same share are one box.
        turns = np.flatnonzero(np.diff(np.round(differs, 3), prepend=-1.0, append=-1.0))
        for a, b in pairwise(turns.tolist()):
            if differs[a]:
                waits.append((edges[a], edges[b], row))
                waiting.append(float(differs[a]))
        for start, stop in pair.stale:
            late.append((start, stop, row))
            numbers = map(number_text, pair.at(stop))
            for texts, text in zip((held, produced), numbers, strict=True):
                texts.append(text)
            behind.append(f"{seconds_text(pair.age)}, {pair.numbers:,} value{'' if pair.numbers == 1 else 's'}")
    _boxes(chart, "good", same, np.ones(len(same)), legend="as the producer", row=names)
    shown = {"percent of the time": 100 * np.array(waiting)}
    _boxes(chart, "way", waits, np.array(waiting), legend="a newer one is on its way", row=names, **shown)
    tips = {"it holds": np.array(held), "producer": np.array(produced), "longest lag": np.array(behind)}
    _boxes(chart, "fail", late, np.ones(len(late)), legend="stale", hatch="/", row=names, **tips)
    places = [(pair.stale[-1][1], row) for row, pair in enumerate(rows) if pair.stale_at_end]
    if places:
        ends = np.array(places)
        chart.marks_at("x", "fail", ends[:, 0], ends[:, 1], size=10)
    return chart.plot(), len(pairs) - len(rows)


def _boxes(
    chart: Chart, role: str, boxes: Sequence[tuple[float, float, int]], share: Column, *, row: list[str], **options: Any
) -> None:
    """Draw boxes with a height of their share of a row; ``row`` has the names of rows."""
    if boxes:
        left, right, place = np.array(boxes, np.float64).T
        # A minimum height keeps short differences visible.
        top = place + 0.42 - 0.84 * np.maximum(share, 0.12)
        names = np.array([row[int(each)] for each in place])
        chart.boxes(role, left, right, place + 0.42, top, row=names, **options)


def beacon_rate(context: PlotContext, steps: Steps) -> list[Plot]:
    """Plot the beacons per second, and the share of lost beacons if there are any."""
    recorded, time = context.recorded, context.time
    found = {node: analysis.rates(recorded, time, steps, node) for node in context.times("beacons")}
    rate = {node: each for node, (each, _) in found.items()}
    mean = f"Mean over {seconds_text(time.width)}."
    plots = [over_time(context, "beacon-rate", "Beacons heard", mean, "beacons per second", time.edges, rate)]
    if recorded.modulus and steps.lost.any():
        loss = {node: 100 * each for node, (_, each) in found.items()}
        caption = f"Share of missing sequence numbers in {seconds_text(time.width)}."
        plots.append(over_time(context, "loss", "Beacons lost", caption, "lost (%)", time.edges, loss))
    return plots


def presence(context: PlotContext) -> Plot:
    """Plot the times at which beacons of each node were received."""
    time = context.time
    seconds = context.times("beacons")
    # Intervals must be longer than those between beacons, otherwise each of these would be a gap.
    ends = time.finer(3 * max(map(usual_interval, seconds.values()), default=0))
    names = [context.name(node) for node in seconds]
    caption = "Times without a beacon are blank."
    chart = context.chart("heard", "Times of received beacons", caption, rows=names, height=90 + 24 * len(names))
    bars = [
        (ends[a], ends[b], row)
        for row, at in enumerate(seconds.values())
        for a, b in runs(np.histogram(at, ends)[0] > 0)
    ]
    left, right, row = np.array(bars, np.float64).T if bars else np.zeros((3, 0))
    node = np.array([names[int(each)] for each in row])
    chart.boxes("accent", left, right, row + 0.32, row - 0.32, node=node)
    return chart.plot()


def ages(context: PlotContext) -> Plot:
    """Plot the age of each node's last report over time."""
    seconds = context.times("srp")
    ends = context.time.finer(_REPORTS * max(map(usual_interval, seconds.values()), default=0))
    caption = f"Time since the last received state report; the maximum in each {seconds_text(ends[1] - ends[0])}."
    found = {node: analysis.age(each, ends) for node, each in seconds.items()}
    return over_time(context, "age", "Age of information", caption, "age of the last report (s)", ends, found)


def positions(context: PlotContext) -> list[Plot]:
    """Plot the positions of nodes in plan, and their heights if the profile has them."""
    reports, time = context.recorded.tables["srp"], context.time
    place = {
        node: rows[np.argsort(reports["time"][rows], kind="stable")]
        for node in context.nodes
        for rows in [np.flatnonzero((reports["node"] == node) & usable(reports))]
        if rows.size
    }
    if not place:
        return []
    unit, plan, height = context.recorded.units, Downsampled(len(place)), Downsampled(len(place))
    drawn, high = {}, {}
    for node, rows in place.items():
        at, x, y, z = time.seconds(reports["time"][rows]), *(reports[axis][rows] for axis in "xyz")
        drawn[node] = plan.rows(rows, at, x, also=plan.places(at, y))
        high[node] = height.rows(rows, at, z)
    caption = f"The square is the last position of a node.{plan.words}"
    label = f"y{in_unit(unit.get('position.y'))}"
    chart = context.chart("plan", "Positions in plan", caption, duration=None, label=label, height=380)
    chart.figure.xaxis.axis_label = f"x{in_unit(unit.get('position.x'))}"
    chart.figure.match_aspect = True
    for node, rows in drawn.items():
        x, y, at = reports["x"][rows], reports["y"][rows], time.seconds(reports["time"][rows])
        chart.line(context.nodes.index(node), context.name(node), x, y, seconds=at)
        chart.marks_at("square", f"s{context.nodes.index(node) % 10}", x[-1:], y[-1:], size=8)
    plots = [chart.plot()]
    if "position.z" not in unit:
        return plots
    caption = f"From the state reports.{height.words}"
    chart = context.chart("height", "Height", caption, label=f"z{in_unit(unit['position.z'])}", from_zero=False)
    for node, rows in high.items():
        chart.line(
            context.nodes.index(node), context.name(node), time.seconds(reports["time"][rows]), reports["z"][rows]
        )
    return [*plots, chart.plot()]


def usable(reports: dict[str, Column]) -> Column:
    """Return which reports have a position that can be drawn; the height may be missing."""
    good = np.ones(reports["x"].size, bool)
    for axis in "xy":
        good &= np.abs(np.nan_to_num(reports[axis], nan=np.inf)) < _FAR
    return good & ~(np.abs(reports["z"]) >= _FAR)


def values(context: PlotContext, found: Values) -> list[Plot]:
    """Plot sequence numbers, and values that can be read as numbers, over time."""
    modulus, thinned, series = context.recorded.number_modulus, Downsampled(len(context.variables)), []
    for number, each in enumerate(context.variables):
        rows, count, created = counted(context.recorded, found, each)
        kept = thinned.rows(np.arange(rows.size), found.time[rows], count, np.flatnonzero(created))
        series.append((number, each, rows[kept], count[kept], rows[created], count[created]))
    again = ""
    if any(created.size for *_, created, _ in series):
        again = " A star: the variable was created again, and its numbers start again."
    caption = (
        f"Each value when it was first received. The numbers count modulo {modulus:,} and are drawn unwrapped."
        f"{again}{thinned.words}"
    )
    chart = context.chart("seqno", "Sequence numbers of variables", caption, label="sequence number, unwrapped")
    for number, each, rows, count, created, restarted in series:
        chart.line(
            number,
            f"variable {each}",
            found.time[rows],
            count,
            step=True,
            sent=found.seqno[rows],
            frame=found.frame[rows],
        )
        if created.size:
            chart.marks_at(
                "star", f"s{number % 10}", found.time[created], restarted, size=12, frame=found.frame[created]
            )
    plots = [chart.plot()]
    numbers = [each for each in context.variables if numeric(found, each)]
    if not numbers:
        return plots
    thinned = Downsampled(len(numbers))
    lines = [
        (each, thinned.rows(rows, found.time[rows], found.number[rows]))
        for each in numbers
        for rows in [np.flatnonzero(found.variable == each)]
    ]
    high = float(np.nanmax(found.number[np.isin(found.variable, numbers)]))
    caption = (
        "Variables whose values all have the same length of at most 8 octets, read as unsigned big-endian integers."
        f"{thinned.words}"
    )
    chart = context.chart("values", "Values of variables", caption, label="value", from_zero=False)
    for each, rows in lines:
        chart.line(
            context.variables.index(each), f"variable {each}", found.time[rows], found.number[rows], step=True,
            frame=found.frame[rows],
        )  # fmt: skip
    if high >= 1e5:
        chart.figure.yaxis.formatter = BasicTickFormatter(power_limit_high=4, precision=2)
    return [*plots, chart.plot()]


def delays(context: PlotContext, passed: Passings) -> list[Plot]:
    """Plot the delays of the dissemination of values."""
    ours = passed.counted & np.isin(passed.node, context.nodes)
    nodes = [node for node in context.nodes if (ours & (passed.node == node)).any()]
    series, thinned = [], Downsampled(len(nodes))
    for node in nodes:
        rows = np.flatnonzero(ours & (passed.node == node))
        rows = rows[np.argsort(passed.time[rows], kind="stable")]
        series.append((node, thinned.rows(rows, passed.time[rows], passed.delay[rows])))
    caption = f"From the first beacon with a value to the first beacon of each other node with it.{thinned.words}"
    chart = context.chart("delay", "Dissemination delay of each value", caption, label="delay (s)")
    for node, rows in series:
        chart.dots(
            context.nodes.index(node), context.name(node), passed.time[rows], passed.delay[rows],
            variable=passed.variable[rows], frame=passed.frame[rows],
        )  # fmt: skip
    plots = [chart.plot()]
    caption = (
        "Share of values that the 1st, 2nd, ... further node had forwarded within this delay. The order in which nodes "
        "forward a value is not a number of hops."
    )
    title = "Delay by order of forwarding"
    ranked = context.chart("delay-order", title, caption, duration=None, label="values (%)")
    for number, rank in enumerate(np.unique(passed.order[ours]).tolist()[:DRAWN]):
        delay = np.sort(passed.delay[ours & (passed.order == rank)])
        share = 100 * np.arange(1, delay.size + 1) / delay.size
        kept = extremes(np.arange(delay.size), delay, 400)
        ranked.line(
            number, f"{ordinal(rank)} node", np.append(delay[:1], delay[kept]), np.append(0.0, share[kept]), step=True
        )
    ranked.figure.xaxis.axis_label = "delay (s)"
    return [*plots, ranked.plot()]


def load(context: PlotContext, parts: Sequence[Part]) -> Plot:
    """Plot the transmitted octets of each kind over time."""
    time = context.time
    caption = f"Mean over {seconds_text(time.width)}, stacked by kind."
    chart = context.chart("load", "Load over time", caption, label="bit/s", unit="bit/s")
    chart.areas([(part.name, part.over_time * 8 / time.width) for part in parts], time.edges)
    return chart.plot()


def anomalies(context: PlotContext, times: dict[str, Column]) -> Plot:
    """Plot the times of anomalies by kind."""
    thinned = Downsampled(len(KINDS))
    kept = {kind: thinned.rows(at, at, np.zeros(at.size)) for kind in KINDS for at in [np.sort(times[kind])]}
    caption = (
        "Malformed frames, gaps in sequence numbers, restarts (numbers that go back), repeated numbers, and a clock "
        f"of the recorder that was set back.{thinned.words}"
    )
    names = [f"{kind} ({times[kind].size:,})" for kind in KINDS]
    chart = context.chart("anomalies", "Times of anomalies", caption, rows=names, height=230)
    for row, (kind, symbol) in enumerate(zip(KINDS, _KIND_SYMBOLS, strict=True)):
        role = "fail" if kind in ("malformed", "gap") else "accent"
        chart.marks_at(symbol, role, kept[kind], np.full(kept[kind].size, row))
    return chart.plot()


def number_text(number: int | None) -> str:
    """Return the text of a held sequence number for tables."""
    return "nothing" if number is None else {DELETED: "deleted", UNKNOWN: "not known"}.get(number, str(number))
