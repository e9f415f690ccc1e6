"""The plot of a study as SVG: share of receptions and delay at the farthest nodes over the first key of the study."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any, Final

from dcp_codec.common.pages.colours import light, series_colour

from .plan import Study
from .results import Estimate, Summary

#: Size of a panel with its margins, and the margins around its axes, in pixels.
_WIDTH: Final = 330
_HEIGHT: Final = 230
_LEFT: Final = 52
_TOP: Final = 34
_RIGHT: Final = 14
_BOTTOM: Final = 40
#: Measures: title, estimate, and the highest value of the axis (None: that of the data).
_MEASURES: Final[tuple[tuple[str, Callable[[Summary], Estimate | None], float | None], ...]] = (
    ("share received", lambda each: each.share, 1.0),
    ("mean delay in ms", lambda each: None if each.few else each.delay_ms, None),
)


def svg(study: Study, found: Sequence[Summary]) -> str | None:
    """Return the plot of the summaries of the farthest nodes; None if the study has no key to plot over.

    The first key is the horizontal axis, the second one distinguishes the lines, and each combination of the others
    has a row of panels. Bars are 95 % confidence intervals. Delays of few receptions are left out.
    """
    if not study.axes or not found:
        return None
    across, *others = study.axes
    lines, panels = others[:1], others[1:]
    values = list(dict.fromkeys(str(cell[across]) for cell in study.cells))
    names = list(dict.fromkeys(_text(study.cells[each.cell], lines) for each in found))
    rows = list(dict.fromkeys(_text(study.cells[each.cell], panels) for each in found))
    legend = 24 if lines else 0
    height = len(rows) * _HEIGHT + legend
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * _WIDTH}" height="{height}" '
        f'viewBox="0 0 {2 * _WIDTH} {height}" font-family="system-ui, sans-serif" font-size="11">',
        f'<rect width="100%" height="100%" fill="{light("card")}"/>',
    ]
    for number, name in enumerate(names if lines else ()):
        parts.append(_label(_LEFT + number * 120, 16, name, series_colour(number), anchor="start"))
    for row, panel in enumerate(rows):
        chosen = [each for each in found if _text(study.cells[each.cell], panels) == panel]
        for column, (title, measure, top) in enumerate(_MEASURES):
            estimates = [(each, value) for each in chosen if (value := measure(each)) is not None]
            highest = top or max((value.mean for _, value in estimates), default=1.0) * 1.1 or 1.0
            parts.append(f'<g transform="translate({column * _WIDTH},{legend + row * _HEIGHT})">')
            parts.append(_label(_LEFT, 18, f"{title}{', ' if panel else ''}{panel}", light("ink"), anchor="start"))
            parts += _axes(values, across, highest)
            for number, name in enumerate(names):
                points = [
                    (values.index(str(study.cells[each.cell][across])), value)
                    for each, value in estimates
                    if _text(study.cells[each.cell], lines) == name
                ]
                points.sort(key=lambda point: point[0])
                # Side by side, so that bars do not hide each other.
                aside = (number - (len(names) - 1) / 2) * 4
                parts.append(f'<g transform="translate({aside:.1f})">')
                parts += [*_line(points, len(values), highest, series_colour(number)), "</g>"]
            parts.append("</g>")
    return "\n".join([*parts, "</svg>", ""])


def _text(cell: dict[str, Any], keys: Sequence[str]) -> str:
    """Return the values of some keys of a cell as text."""
    return ", ".join(f"{key.rpartition('.')[2]} {cell[key]}" for key in keys)


def _x(place: int, count: int) -> float:
    room = _WIDTH - _LEFT - _RIGHT
    return _LEFT + room * (place + 0.5) / count


def _y(value: float, highest: float) -> float:
    room = _HEIGHT - _TOP - _BOTTOM
    return _TOP + room * (1 - min(max(value / highest, 0.0), 1.0))


def _label(x: float, y: float, text: str, colour: str, anchor: str = "middle") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" text-anchor="{anchor}">{escape(text)}</text>'


def _axes(values: Sequence[str], title: str, highest: float) -> list[str]:
    """Return the grid, and the labels of both axes."""
    parts = []
    for step in range(5):
        value = highest * step / 4
        y = _y(value, highest)
        ends = f'x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"'
        parts.append(f'<line {ends} stroke="{light("line")}"/>')
        text = f"{value:.2f}" if highest <= 1 else f"{value:.0f}"
        parts.append(_label(_LEFT - 6, y + 4, text, light("soft"), anchor="end"))
    for place, text in enumerate(values):
        parts.append(_label(_x(place, len(values)), _HEIGHT - _BOTTOM + 16, text, light("soft")))
    return [*parts, _label((_LEFT + _WIDTH - _RIGHT) / 2, _HEIGHT - 8, title, light("soft"))]


def _line(points: Sequence[tuple[int, Estimate]], count: int, highest: float, colour: str) -> list[str]:
    """Return a line with its points and the bars of their confidence intervals."""
    places = [(_x(place, count), _y(each.mean, highest), each) for place, each in points]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y, _ in places)
    parts = [f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.5"/>']
    for x, y, each in places:
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{colour}"/>')
        if each.half is not None:
            low, high = _y(each.mean - each.half, highest), _y(each.mean + each.half, highest)
            parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{low:.1f}" y2="{high:.1f}" stroke="{colour}"/>')
    return parts
