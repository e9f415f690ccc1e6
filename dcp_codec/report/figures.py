"""The plots of a report, one function each."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.patches import FancyArrowPatch
from matplotlib.ticker import MaxNLocator

from . import analysis
from .analysis import KINDS, Part, Steps
from .canvas import ACCENT, BAD, INK, SERIES, SOFT, Plot, dots_of, style_of
from .easel import LINES, Easel, matrix, over_time
from .recorded import Column
from .series import in_unit, ordinal, runs, seconds_text, si, thinned, usual_interval
from .variables import Hops, Values, numeric

#: Nodes and variables that are drawn one by one.
DRAWN = 20
#: Points that are drawn of one series, and dots of one plot.
_POINTS, _DOTS = 400, 2000
#: Reports of each node that a piece of time should have, so that its greatest age is one.
_REPORTS = 4
#: Positions beyond this many units are not on this planet.
_FAR = 1e8


def beacon_rate(easel: Easel, steps: Steps) -> list[Plot]:
    """Beacons per second, and the share of them that is lost."""
    recorded, time = easel.recorded, easel.time
    senders = [node for node in easel.nodes if (recorded.column("beacons", "node") == node).any()]
    found = {node: analysis.rates(recorded, time, steps, node) for node in senders}
    rate = {node: each for node, (each, _) in found.items()}
    mean = f"Mean over {seconds_text(time.width)}."
    plots = [
        over_time(easel, "beacon-rate", "Beacons heard", mean, ("beacons per second", "per second"), time.edges, rate)
    ]
    if recorded.modulus:
        loss = {node: 100 * each for node, (_, each) in found.items()}
        caption = f"Sequence numbers that are missing, of all in {seconds_text(time.width)}."
        plots.append(over_time(easel, "loss", "Beacons lost", caption, ("lost (%)", "%"), time.edges, loss))
    return plots


def presence(easel: Easel) -> Plot:
    """Who was heard when."""
    time, beacons = easel.time, easel.recorded.tables["beacons"]
    senders = [node for node in easel.nodes if (beacons["node"] == node).any()]
    caption = "Times without a beacon are blank."
    with easel.canvas("heard", "Who was heard when", caption, height=70 + 15 * len(senders)) as canvas:
        # No finer than beacons come, or each interval would be a gap.
        usual = max(
            (usual_interval(time.seconds(beacons["time"][beacons["node"] == node])) for node in senders), default=0
        )
        ends = time.finer(3 * usual)
        for row, node in enumerate(senders):
            heard, _ = np.histogram(time.seconds(beacons["time"][beacons["node"] == node]), ends)
            bars = [(float(ends[a]), float(ends[b] - ends[a])) for a, b in runs(heard > 0)]
            canvas.axes.broken_barh(bars, (row - 0.32, 0.64), color=easel.node_style(node)["color"], linewidth=0)
        canvas.time_axis(time.duration, "")
        canvas.axes.set_yticks(range(len(senders)), [easel.short[node] for node in senders])
        canvas.axes.set_ylim(max(len(senders), 1) - 0.4, -0.6)
        canvas.axes.grid(visible=False, axis="y")
        return canvas.plot(png=easel.png)


def ages(easel: Easel) -> list[Plot]:
    """The age of each node's last report, over time and as others could know it."""
    recorded, time = easel.recorded, easel.time
    reports = recorded.tables["srp"]
    nodes = [node for node in easel.nodes if (reports["node"] == node).any()]
    usual = max((usual_interval(time.seconds(reports["time"][reports["node"] == node])) for node in nodes), default=0)
    ends = time.finer(_REPORTS * usual)
    plots = []
    caption = f"Since the last state report that was heard; the greatest age in each {seconds_text(ends[1] - ends[0])}."
    found = {
        node: analysis.age(np.sort(time.seconds(reports["time"][reports["node"] == node])), ends) for node in nodes
    }
    plots.append(
        over_time(easel, "age", "Age of information", caption, ("age of the last report (s)", "s"), ends, found)
    )
    _, high = analysis.pair_ages(recorded, time, easel.nodes)
    if np.isfinite(high).any():
        plots.append(_pairs(easel, high))
    return plots


def _pairs(easel: Easel, high: Column) -> Plot:
    caption = (
        "95th percentile of the age, in seconds, whenever the node of the row sends a beacon: at best it has heard "
        "what the recorder has."
    )
    return matrix(easel, "age-pairs", "Age per neighbour pair (s)", caption, high, ("report about", "node"))


def graph(easel: Easel, edges: dict[tuple[int, int], int]) -> Plot:
    """Who passes on what whom said: nodes on a circle, an arrow for each ordered pair; of many, a matrix."""
    drawn = {pair: many for pair, many in edges.items() if pair[0] in easel.nodes and pair[1] in easel.nodes}
    nodes = [node for node in easel.nodes if any(node in pair for pair in drawn)]
    if len(nodes) > LINES:
        counts = np.full((len(easel.nodes), len(easel.nodes)), np.nan)
        for (before, node), many in drawn.items():
            counts[easel.nodes.index(node), easel.nodes.index(before)] = many
        caption = (
            "Values that the node of the row passed on when that of the column was the last one heard saying them."
        )
        return matrix(easel, "graph", "Who passes on whom", caption, counts, ("whom", "who"))
    caption = (
        "An arrow from A to B, and beside it at A's end the number of values that B passed on when A was the last one "
        "heard saying them. Who really was B's source only B knows."
    )
    with easel.canvas("graph", "Who passes on whom", caption, height=270) as canvas:
        axes = canvas.axes
        axes.set_axis_off()
        turn = 2 * math.pi / max(1, len(nodes))
        at = {node: (math.sin(turn * row), math.cos(turn * row)) for row, node in enumerate(nodes)}
        most = max(drawn.values(), default=1)
        for (a, b), many in sorted(drawn.items()):
            share = many / most
            arrow = FancyArrowPatch(
                at[a], at[b], connectionstyle="arc3,rad=0.14", arrowstyle="-|>,head_length=5,head_width=2.5",
                shrinkA=17, shrinkB=17, linewidth=0.5 + 2.2 * share, color=easel.node_style(a)["color"],
                alpha=0.35 + 0.6 * share, mutation_scale=1,
            )  # fmt: skip
            axes.add_patch(arrow)
            if len(nodes) <= 5:
                axes.text(*_beside(at[a], at[b]), str(many), ha="center", va="center", fontsize=7.5, color=SOFT)
        for node in nodes:
            axes.plot(*at[node], "o", markersize=22, color=easel.node_style(node)["color"], alpha=0.25, mew=0)
            axes.text(*at[node], easel.short[node].lstrip("…"), ha="center", va="center", fontsize=7.5)
        axes.set_xlim(-1.9, 1.9)
        axes.set_ylim(-1.3, 1.3)
        axes.set_aspect("equal")
        return canvas.plot(png=easel.png)


def _beside(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    """A place beside the arrow, nearer to its beginning, on the side that it bends to."""
    x, y = b[0] - a[0], b[1] - a[1]
    return a[0] + 0.36 * x + 0.155 * y, a[1] + 0.36 * y - 0.155 * x


def positions(easel: Easel) -> list[Plot]:
    """Where nodes were: in plan, and their height."""
    reports, time = easel.recorded.tables["srp"], easel.time
    place = {
        node: rows[np.argsort(reports["time"][rows], kind="stable")]
        for node in easel.nodes
        for rows in [np.flatnonzero((reports["node"] == node) & usable(reports))]
        if rows.size
    }
    if not place:
        return []
    unit = easel.recorded.units
    plots = []
    with easel.canvas(
        "plan", "Positions in plan", "A ring is where a node was first, a dot where last.", height=280
    ) as canvas:
        for node, rows in place.items():
            rows = thinned(rows, _POINTS)
            x, y, style = reports["x"][rows], reports["y"][rows], easel.node_style(node)
            canvas.axes.plot(x, y, **style)
            canvas.axes.plot(x[0], y[0], "o", color=INK, fillstyle="none", markersize=6, zorder=3)
            canvas.axes.plot(x[-1], y[-1], "o", color=INK, markersize=3.5, zorder=3)
        drawn = np.concatenate(list(place.values()))
        canvas.axes.set_xlim(*_room(reports["x"][drawn]), auto=True)
        canvas.axes.set_ylim(*_room(reports["y"][drawn]), auto=True)
        canvas.axes.set_aspect("equal", "datalim")
        canvas.label(f"x{in_unit(unit.get('position.x'))}", f"y{in_unit(unit.get('position.y'))}")
        canvas.legend(easel.node_legend(list(place)))
        plots.append(canvas.plot(png=easel.png))
    if "position.z" not in unit:
        return plots
    with easel.canvas("height", "Height", "As state reports say it.", height=280) as canvas:
        for node, rows in place.items():
            rows = thinned(rows, _POINTS)
            canvas.axes.plot(time.seconds(reports["time"][rows]), reports["z"][rows], **easel.node_style(node))
        canvas.time_axis(time.duration, f"z{in_unit(unit.get('position.z'))}")
        canvas.axes.set_ylim(*_room(reports["z"][np.concatenate(list(place.values()))]))
        canvas.legend(easel.node_legend(list(place)))
        plots.append(canvas.plot(png=easel.png))
    return plots


def _room(values: Column) -> tuple[float, float]:
    """Limits of an axis around values; never so narrow that they are one number."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    half = 0.56 * max(high - low, 1e-3, 1e-6 * abs(low), 1e-6 * abs(high))
    return (low + high) / 2 - half, (low + high) / 2 + half


def usable(reports: dict[str, Column]) -> Column:
    """Which reports say a place that can be drawn; a height may be missing."""
    good = np.ones(reports["x"].size, bool)
    for axis in "xy":
        good &= np.abs(np.nan_to_num(reports[axis], nan=np.inf)) < _FAR
    return good & ~(np.abs(reports["z"]) >= _FAR)


def values(easel: Easel, found: Values) -> list[Plot]:
    """Sequence numbers, and values that fit a number, over time."""
    time, plots = easel.time, []
    legend = [(f"variable {each}", style_of(number)) for number, each in enumerate(easel.variables)]
    with easel.canvas("seqno", "Sequence numbers of variables", "Each value when it was first heard.") as canvas:
        for number, each in enumerate(easel.variables):
            rows = thinned(np.flatnonzero(found.variable == each), _POINTS)
            canvas.axes.plot(found.time[rows], found.seqno[rows], **dots_of(number, 2.4 if rows.size > 60 else 3.4))
        canvas.time_axis(time.duration, "sequence number")
        canvas.whole()
        canvas.axes.set_ylim(bottom=-0.04 * max(1, canvas.axes.get_ylim()[1]))
        canvas.legend([(name, dots_of(number, 4)) for number, (name, _) in enumerate(legend)])
        plots.append(canvas.plot(png=easel.png))
    numbers = [each for each in easel.variables if numeric(found, each)]
    if not numbers:
        return plots
    caption = (
        "Those whose values all have one length of at most 8 octets, read as unsigned, most significant octet first."
    )
    with easel.canvas("values", "Values of variables", caption) as canvas:
        for each in numbers:
            rows = thinned(np.flatnonzero(found.variable == each), _POINTS)
            style = style_of(easel.variables.index(each))
            canvas.axes.plot(found.time[rows], found.number[rows], drawstyle="steps-post", **style)
            canvas.axes.plot(found.time[rows], found.number[rows], "o", color=style["color"], markersize=2.5)
        canvas.time_axis(time.duration, "value")
        if np.nanmax(found.number[np.isin(found.variable, numbers)]) >= 1e4:
            canvas.logarithmic()
            canvas.axes.set_ylabel("value (logarithmic)")
        canvas.legend([entry for entry, each in zip(legend, easel.variables, strict=True) if each in numbers])
        plots.append(canvas.plot(png=easel.png))
    return plots


def delays(easel: Easel, hops: Hops) -> list[Plot]:
    """How long values take to be passed on."""
    counted = hops.counted & np.isin(hops.node, easel.nodes)
    nodes = [node for node in easel.nodes if (counted & (hops.node == node)).any()]
    plots = []
    caption = "From the first beacon with a value to the first of each other node that passes it on."
    with easel.canvas("delay", "Dissemination delay of each value", caption) as canvas:
        for node in nodes:
            rows = thinned(np.flatnonzero(counted & (hops.node == node)), _DOTS // len(nodes))
            canvas.axes.plot(hops.time[rows], hops.delay[rows], **dots_of(easel.nodes.index(node), 2.6), alpha=0.85)
        canvas.time_axis(easel.time.duration, "delay (s)")
        canvas.legend([(easel.short[node], dots_of(easel.nodes.index(node), 4)) for node in nodes])
        plots.append(canvas.plot(png=easel.png))
    caption = (
        "Of the values that a first, second, ... other node passed on: the share for which it had after this delay."
    )
    with easel.canvas("delay-hops", "Delay by hop", caption) as canvas:
        ranks = np.unique(hops.hop[counted]).tolist()[:DRAWN]
        for number, rank in enumerate(ranks):
            delay = np.sort(hops.delay[counted & (hops.hop == rank)])
            share = 100 * np.arange(1, delay.size + 1) / delay.size
            kept = thinned(np.arange(delay.size), _POINTS)
            x, y = np.concatenate([delay[:1], delay[kept]]), np.concatenate([[0.0], share[kept]])
            canvas.axes.plot(x, y, drawstyle="steps-post", **style_of(number))
        canvas.label("delay (s)", "values (%)")
        longest = float(hops.delay[counted].max())
        canvas.axes.set_xlim(0, 1.05 * longest if longest > 0 else 1)
        canvas.axes.set_ylim(0, 102)
        names = [f"{ordinal(rank)} node" for rank in ranks]
        canvas.legend([(name, style_of(number)) for number, name in enumerate(names)])
        plots.append(canvas.plot(png=easel.png))
    return plots


def octets(easel: Easel, parts: Sequence[Part]) -> list[Plot]:
    """Where the octets on the air go."""
    total, plots = sum(part.octets for part in parts) or 1, []
    caption = f"{total:,} octets in frames with good beacons; each kind of container with its header."
    with easel.canvas("octets", "Octets by kind", caption, height=60 + 20 * len(parts)) as canvas:
        axes = canvas.axes
        largest = max((part.octets for part in parts), default=1)
        for row, part in enumerate(parts):
            axes.barh(row, part.octets, color=SERIES[row % len(SERIES)], height=0.62)
            axes.text(part.octets + 0.015 * largest, row, f"{100 * part.octets / total:.2g} %", va="center", color=INK)
        axes.set_yticks(range(len(parts)), [part.name for part in parts])
        axes.set_ylim(len(parts) - 0.4, -0.6)
        axes.set_xlim(0, 1.16 * largest)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(lambda value, _: si(value))
        axes.grid(visible=False, axis="y")
        canvas.label("octets", "")
        plots.append(canvas.plot(png=easel.png))
    with easel.canvas(
        "load", "Load over time", f"Mean over {seconds_text(easel.time.width)}, one kind upon the other."
    ) as canvas:
        below = np.zeros(len(easel.time.edges) - 1)
        for row, part in enumerate(parts):
            rate = part.over_time * 8 / easel.time.width
            bottom, top = np.append(below, below[-1]), np.append(below + rate, below[-1] + rate[-1])
            colour = SERIES[row % len(SERIES)]
            canvas.axes.fill_between(easel.time.edges, bottom, top, step="post", color=colour, linewidth=0, alpha=0.8)
            below = below + rate
        canvas.time_axis(easel.time.duration, "bit/s")
        canvas.axes.yaxis.set_major_formatter(lambda value, _: si(value))
        square = {"linestyle": "", "marker": "s", "markersize": 5}
        canvas.legend([(part.name, {**square, "color": SERIES[row % len(SERIES)]}) for row, part in enumerate(parts)])
        plots.append(canvas.plot(png=easel.png))
    return plots


def anomalies(easel: Easel, times: dict[str, Column]) -> Plot:
    """When something was odd."""
    caption = (
        "Malformed frames, gaps in sequence numbers, restarts (numbers that go back), repeated numbers, and a clock "
        "of the recorder that was set back."
    )
    with easel.canvas("anomalies", "When something was odd", caption, height=165) as canvas:
        for row, kind in enumerate(KINDS):
            at = thinned(np.sort(times[kind]), _DOTS // len(KINDS))
            colour = BAD if kind in ("malformed", "gap") else ACCENT
            canvas.axes.plot(at, np.full(at.size, row), "|", markersize=13, color=colour, mew=1)
        canvas.time_axis(easel.time.duration, "")
        canvas.axes.set_yticks(range(len(KINDS)), [f"{kind} ({times[kind].size:,})" for kind in KINDS])
        canvas.axes.set_ylim(len(KINDS) - 0.4, -0.6)
        return canvas.plot(png=easel.png)
