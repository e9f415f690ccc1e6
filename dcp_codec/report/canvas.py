"""One plot as SVG for a page of either colour scheme, and as PNG; the same octets for the same numbers.

Sizes are points; a plot is as wide as the screen of a telephone, so that its text is read there without zooming, and
two stand side by side on larger ones.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullLocator

from .series import si

WIDTH, HEIGHT = 400.0, 236.0
#: Points of one row of a legend, and characters that fit into one.
_LEGEND_ROW, _LEGEND_CHARACTERS = 14.0, 62

INK, SOFT, LINE, ACCENT, BAD = "#1c1f23", "#5d6670", "#dfe2e6", "#2b5fa8", "#c62f2f"
#: Series in light colour schemes; the page has others for dark ones under the same numbers.
SERIES = (
    "#2374b8", "#d1590c", "#1f8a4c", "#9333a8", "#a67c00",
    "#0f8a8a", "#c7357f", "#6a5acd", "#7a4b21", "#667a00",
)  # fmt: skip
_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1.2)))
#: Colour of the drawing -> variable of the page.
VARIABLES = {INK: "--ink", SOFT: "--soft", LINE: "--line", ACCENT: "--accent", BAD: "--fail"} | {
    colour: f"--s{number}" for number, colour in enumerate(SERIES)
}
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "font.family": ["DejaVu Sans"],
    "font.size": 8.5,
    # What is written comes from recordings too: no mathematics in it.
    "text.parse_math": False,
    "text.color": INK,
    "axes.labelcolor": SOFT,
    "axes.edgecolor": LINE,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "xtick.color": LINE,
    "ytick.color": LINE,
    "xtick.labelcolor": SOFT,
    "ytick.labelcolor": SOFT,
    "lines.linewidth": 1.2,
    "lines.solid_joinstyle": "round",
    "path.simplify_threshold": 0.3,
}


@dataclass(frozen=True)
class Plot:
    """A drawn plot; ``name`` is one for a file, ``caption`` says what is seen, in plain text."""

    name: str
    title: str
    caption: str
    svg: str
    png: bytes | None


def style_of(number: int) -> dict[str, Any]:
    """Colour and dashes of a series; 30 of them differ."""
    dashes = _DASHES[number // len(SERIES) % len(_DASHES)]
    return {"color": SERIES[number % len(SERIES)], "linestyle": dashes}


def dots_of(number: int, size: float) -> dict[str, Any]:
    """How the dots of a series look; those of the second ten are hollow."""
    hollow = {"fillstyle": "none", "mew": 0.8} if number >= len(SERIES) else {"mew": 0}
    colour = SERIES[number % len(SERIES)]
    # Not clipped: the first dots stand on the axis.
    return {
        "color": colour,
        "linestyle": "",
        "marker": "o",
        "markersize": size,
        "clip_on": False,
        "zorder": 3,
        **hollow,
    }


class Canvas:
    """A plot in the making: draw into ``axes`` inside of ``with``, then take ``plot()``."""

    def __init__(self, name: str, title: str, caption: str, *, height: float = HEIGHT) -> None:
        self._name, self._title, self._caption = name, title, caption
        self._height = height
        self._style = matplotlib.rc_context({**_STYLE, "svg.hashsalt": name})

    def __enter__(self) -> Canvas:
        self._style.__enter__()
        self.figure = Figure(figsize=(WIDTH / 72, self._height / 72), layout="constrained")
        self.figure.patch.set_alpha(0)
        self.axes: Axes = self.figure.add_subplot()
        self.axes.patch.set_alpha(0)
        self.axes.set_title(self._title)
        self.axes.tick_params(length=0)
        return self

    def __exit__(self, *details: Any) -> None:
        self._style.__exit__(*details)

    def label(self, x: str, y: str) -> None:
        """Name the axes, with units."""
        self.axes.set_xlabel(x)
        self.axes.set_ylabel(y)

    def time_axis(self, duration: float, y: str) -> None:
        """Time to the right, in the unit that suits; y from 0."""
        unit, seconds = next((unit for unit in (("h", 3600), ("min", 60)) if duration >= 5 * unit[1]), ("s", 1))
        self.axes.set_xlim(0, duration or 1)
        self.axes.xaxis.set_major_locator(_Multiples(seconds))
        self.axes.xaxis.set_major_formatter(lambda value, _: f"{value / seconds:g}")
        self.label(f"time since the first frame ({unit})", y)
        top = self.axes.get_ylim()[1]
        # Where clocks went backwards all may be below 0.
        self.axes.set_ylim(0, top if top > 0 else 1)

    def logarithmic(self) -> None:
        """A logarithmic y axis that has 0."""
        self.axes.set_yscale("symlog", linthresh=1)
        # Room above: in a step the highest value lies on the edge.
        top = 5 * self.axes.dataLim.ymax
        self.axes.set_ylim(0, top)
        step = 1 + int(math.log10(max(top, 1))) // 6
        self.axes.set_yticks([0.0, *(10.0**power for power in range(0, int(math.log10(max(top, 1))) + 1, step))])
        self.axes.yaxis.set_major_formatter(lambda value, _: si(value))
        self.axes.yaxis.set_minor_locator(NullLocator())

    def whole(self) -> None:
        """Only whole numbers on the y axis."""
        self.axes.yaxis.set_major_locator(MaxNLocator(integer=True))

    def legend(self, entries: Sequence[tuple[str, dict[str, Any]]]) -> None:
        """What the series are, below the plot, in as many columns as fit."""
        if not entries:
            return
        longest = max(len(name) for name, _ in entries)
        columns = max(1, min(len(entries), _LEGEND_CHARACTERS // (longest + 6)))
        rows = -(-len(entries) // columns)
        height = self._height + rows * _LEGEND_ROW
        self.figure.set_size_inches(WIDTH / 72, height / 72)
        handles = [Line2D([], [], **style) for _, style in entries]
        self.figure.legend(
            handles,
            [name for name, _ in entries],
            loc="outside lower center",
            ncols=columns,
            frameon=False,
            handlelength=1.8,
            columnspacing=1.2,
            borderaxespad=0.2,
            labelspacing=0.3,
        )

    def plot(self, *, png: bool) -> Plot:
        """The finished plot. ``png`` for a PNG as well, in light colours on white."""
        drawn = io.BytesIO()
        self.figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None})
        picture: bytes | None = None
        if png:
            pixels = io.BytesIO()
            self.figure.patch.set(alpha=1, facecolor="white")
            self.figure.savefig(pixels, format="png", dpi=180, metadata={"Software": None})
            picture = pixels.getvalue()
        svg = _inline(drawn.getvalue().decode(), self._title)
        return Plot(self._name, self._title, self._caption, svg, picture)


class _Multiples(MaxNLocator):
    """Round ticks in multiples of a unit."""

    def __init__(self, unit: float) -> None:
        super().__init__(nbins=7, steps=[1, 2, 3, 5, 10])
        self._unit = unit

    def tick_values(self, vmin: float, vmax: float) -> Any:
        return [self._unit * value for value in super().tick_values(vmin / self._unit, vmax / self._unit)]


def _inline(svg: str, title: str) -> str:
    """An SVG file as a part of a page: no references outside, colours of the page, short numbers."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    size = re.search(r'viewBox="([^"]*)"', body)
    assert size is not None
    body = body[body.index(">") + 1 :]
    body = body.replace("xlink:href", "href")
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', body))
    body = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in used else "", body)
    body = re.sub(r'(?<= )(?:d|x|y)="[^"]*"', lambda found: re.sub(r"(\.\d\d)\d+", r"\1", found[0]), body)
    body = re.sub(r'style="[^"]*"', lambda found: _themed(found[0]), body)
    # What matplotlib says once more for readers without style sheets.
    body = re.sub(r'<style type="text/css">.*?</style>', "", body, flags=re.DOTALL)
    body = re.sub(r"\n\s*", "\n", body)
    words = title.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return f'<svg viewBox="{size[1]}" role="img" aria-label="{words}">{body}'.strip()


def _themed(style: str) -> str:
    for colour, variable in VARIABLES.items():
        style = style.replace(colour, f"var({variable})")
    return re.sub(r"(font: [^']*?)'DejaVu Sans'", r"\1system-ui, 'DejaVu Sans', sans-serif", style)
