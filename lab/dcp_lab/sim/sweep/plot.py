"""The plot of a study: share of receptions and delay at the farthest nodes over the first key of the study.

Needs matplotlib (extra ``plot``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.figure import Figure

from dcp_codec.common.pages.colours import light, series_colour

from .plan import Study, short
from .results import Estimate, Summary

#: Size of a panel in inches.
_WIDTH: Final = 5.0
_HEIGHT: Final = 2.9
#: Measures: label, estimate, and the highest value of the axis (None: that of the data).
_MEASURES: Final[tuple[tuple[str, Callable[[Summary], Estimate | None], float | None], ...]] = (
    ("share received", lambda each: each.share, 1.02),
    ("mean delay in ms", lambda each: None if each.few else each.delay_ms, None),
)
#: Equal results give equal files: identifiers in an SVG are random otherwise.
_STYLE: Final[Any] = {
    "svg.hashsalt": "dcp",
    "svg.fonttype": "path",
    "font.size": 9,
    "axes.edgecolor": light("line"),
    "axes.labelcolor": light("soft"),
    "xtick.color": light("soft"),
    "ytick.color": light("soft"),
    "text.color": light("ink"),
    "grid.color": light("line"),
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def draw(study: Study, found: Sequence[Summary], *files: Path) -> None:
    """Write the plot of the summaries of the farthest nodes to files (.svg, .png).

    The first key is the horizontal axis, the second one distinguishes the lines, and each combination of the others
    has a row of panels. Bars are 95 % confidence intervals. Delays of few receptions are left out.
    """
    across, *others = study.axes
    lines, panels = others[:1], others[1:]
    values = list(dict.fromkeys(cell[across] for cell in study.cells))
    names = list(dict.fromkeys(_text(study.cells[each.cell], lines) for each in found))
    rows = list(dict.fromkeys(_text(study.cells[each.cell], panels) for each in found))
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    places = [float(value) for value in values] if numeric else [float(place) for place in range(len(values))]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(2 * _WIDTH, len(rows) * _HEIGHT + (0.4 if lines else 0)), layout="constrained")
        axes = figure.subplots(len(rows), 2, squeeze=False)
        for row, panel in enumerate(rows):
            chosen = [each for each in found if _text(study.cells[each.cell], panels) == panel]
            for column, (label, measure, top) in enumerate(_MEASURES):
                axis = axes[row][column]
                for number, name in enumerate(names):
                    points = sorted(
                        (places[values.index(study.cells[each.cell][across])], estimate.mean, estimate.half or 0.0)
                        for each in chosen
                        if _text(study.cells[each.cell], lines) == name and (estimate := measure(each)) is not None
                    )
                    # Side by side, so that bars do not hide each other.
                    aside = (number - (len(names) - 1) / 2) * (max(places) - min(places) or 1.0) / 150
                    x, y, half = ([point[part] for point in points] for part in range(3))
                    axis.errorbar(
                        [place + aside for place in x], y, half, label=name, color=series_colour(number),
                        marker="o", markersize=3, linewidth=1.2, elinewidth=1.0, capsize=2,
                    )  # fmt: skip
                axis.set_title(panel, loc="left", fontsize=9)
                axis.set_xlabel(across)
                axis.set_ylabel(label)
                axis.set_xticks(places, [str(value) for value in values])
                highest = max((each.mean for one in chosen if (each := measure(one)) is not None), default=math.nan)
                # Wide intervals of single points would flatten all lines.
                axis.set_ylim(0, top or (1.25 * highest if highest > 0 else 1.0))
                axis.grid(axis="y", linewidth=0.6)
        if lines:
            handles, labels = axes[0][0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside upper center", ncols=min(len(names), 6), frameon=False)
        for file in files:
            figure.savefig(file, dpi=140, metadata={"Date": None} if file.suffix == ".svg" else {"Software": None})


def _text(cell: dict[str, Any], keys: Sequence[str]) -> str:
    """Return the values of some keys of a cell as text."""
    return ", ".join(f"{short(key)} {cell[key]}" for key in keys)
