"""What the plots of one recording share, and the two kinds of which there are several."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path as Outline

from .analysis import Time
from .canvas import ACCENT, SOFT, Canvas, Plot, style_of
from .recorded import NOBODY, Column, Recorded
from .series import runs, si, stairs

#: Nodes that lines and arrows can show; of more, rows and matrices.
LINES = 8
#: Shades of these.
_SHADES = 5


@dataclass
class Easel:
    """What all plots of one recording share: time, who is drawn in which colour, whether PNGs are wanted."""

    recorded: Recorded
    time: Time
    #: Numbers of the nodes that are drawn, in the order of their colours.
    nodes: list[int]
    variables: list[int]
    png: bool = False
    prefix: str = ""
    short: dict[int, str] = field(init=False)

    def __post_init__(self) -> None:
        # No font of a PNG has all characters that a name may have.
        names = {node: self.recorded.nodes[node].encode("ascii", "backslashreplace") for node in self.nodes}
        self.short = short_names({node: name.decode() for node, name in names.items()})

    def canvas(self, name: str, title: str, caption: str, **size: float) -> Canvas:
        """A new plot of this recording."""
        return Canvas(f"{self.prefix}{name}", title, caption, **size)

    def node_style(self, node: int) -> dict[str, Any]:
        """How a node is drawn, everywhere."""
        return style_of(self.nodes.index(node))

    def node_legend(self, nodes: Sequence[int]) -> list[tuple[str, dict[str, Any]]]:
        """Entries of a legend."""
        return [(self.short[node], self.node_style(node)) for node in nodes]


def short_names(names: dict[int, str]) -> dict[int, str]:
    """The shortest ends of identifiers that tell them apart, two octets at least."""
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


def over_time(
    easel: Easel, name: str, title: str, caption: str, label: tuple[str, str], ends: Column, series: dict[int, Column]
) -> Plot:
    """One line for each node, level in each piece of time; of more than lines can show, one row for each.

    ``label`` names the values with their unit, and the unit alone; ``ends`` bound the pieces.
    """
    highest = max((float(np.nanmax(each)) for each in series.values() if np.isfinite(each).any()), default=0)
    if len(series) > LINES:
        return _rows(easel, name, f"{title} ({label[1]})", caption, ends, series, highest)
    with easel.canvas(name, title, caption) as canvas:
        for node, each in series.items():
            canvas.axes.plot(*stairs(ends, each), **easel.node_style(node))
        canvas.time_axis(easel.time.duration, label[0])
        canvas.axes.set_ylim(0, 1.08 * highest if highest else 10)
        if not highest:
            canvas.axes.text(0.5, 0.5, "none", transform=canvas.axes.transAxes, ha="center", color=SOFT)
        canvas.legend(easel.node_legend(list(series)))
        return canvas.plot(png=easel.png)


def _rows(
    easel: Easel, name: str, title: str, caption: str, ends: Column, series: dict[int, Column], highest: float
) -> Plot:
    with easel.canvas(name, title, caption, height=76 + 11 * len(series)) as canvas:
        levels = np.linspace(0, highest, _SHADES + 1) if highest else np.array([0.0, 1.0])
        legend = []
        for low, high in itertools.pairwise(levels.tolist()):
            boxes = [
                _box(float(ends[start]), row - 0.44, float(ends[end]), row + 0.44)
                for row, each in enumerate(series.values())
                for start, end in runs((np.nan_to_num(each) > low) & (np.nan_to_num(each) <= high))
            ]
            shade = 0.12 + 0.88 * high / levels[-1]
            if boxes:
                # One path for all of a shade keeps the page small.
                canvas.axes.add_patch(PathPatch(Outline.make_compound_path(*boxes), fc=ACCENT, alpha=shade, lw=0))
            square = {"color": ACCENT, "linestyle": "", "marker": "s", "markersize": 6, "mew": 0, "alpha": shade}
            legend.append(("to " + si(float(f"{high:.3g}")), square))
        if not highest:
            canvas.axes.text(0.5, 0.5, "none", transform=canvas.axes.transAxes, ha="center", color=SOFT)
        canvas.time_axis(easel.time.duration, "")
        canvas.axes.set_yticks(range(len(series)), [easel.short[node] for node in series], fontsize=7)
        canvas.axes.set_ylim(len(series) - 0.4, -0.6)
        canvas.axes.grid(visible=False)
        if highest:
            canvas.legend(legend)
        return canvas.plot(png=easel.png)


def _box(left: float, bottom: float, right: float, top: float) -> Outline:
    corners = [(left, bottom), (right, bottom), (right, top), (left, top), (left, bottom)]
    return Outline(corners, closed=True)


def matrix(easel: Easel, name: str, title: str, caption: str, numbers: Column, labels: tuple[str, str]) -> Plot:
    """Nodes by nodes; NaN is left blank."""
    many = len(easel.nodes)
    with easel.canvas(name, title, caption, height=max(170, 90 + 15 * many)) as canvas:
        canvas.axes.grid(visible=False)
        top = float(np.nanmax(numbers)) or 1
        for row, place in zip(*np.nonzero(np.isfinite(numbers)), strict=True):
            value = float(numbers[row, place])
            cell = Rectangle((place - 0.48, row - 0.46), 0.96, 0.92, color=ACCENT, alpha=0.08 + 0.5 * value / top, lw=0)
            canvas.axes.add_patch(cell)
            text = f"{value:.2g}" if value < 100 else si(round(value, -2) if value >= 10_000 else round(value))
            size = 8.5 if many <= LINES else 5
            canvas.axes.text(place, row, text, ha="center", va="center", fontsize=size)
        names = [easel.short[node] for node in easel.nodes]
        canvas.axes.set_xticks(range(many), names, rotation=0 if many <= 6 else 90)
        canvas.axes.set_yticks(range(many), names)
        canvas.axes.set_xlim(-0.5, many - 0.5)
        canvas.axes.set_ylim(many - 0.5, -0.5)
        for side in ("left", "bottom"):
            canvas.axes.spines[side].set_visible(False)
        canvas.label(*labels)
        return canvas.plot(png=easel.png)
