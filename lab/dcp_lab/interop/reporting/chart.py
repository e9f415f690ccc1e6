"""The timeline of a cell as a message sequence chart (SVG): a lifeline for each place, an arrow for each message."""

from __future__ import annotations

from html import escape
from typing import Final

from dcp_codec.common.printable import plain
from dcp_lab.interop.results import CellResult, TimelineEntry

#: Rows at the beginning and at the end of a chart.
_ROWS: Final = 60
_LINE, _COLUMN, _LEFT, _HEAD, _TEXT = 20, 74, 66, 44, 560


def chart(cell: CellResult) -> str:
    """Return an SVG element; empty without moments. Texts are escaped."""
    if not cell.moments:
        return ""
    rows: list[TimelineEntry | int] = list(cell.moments)
    if len(rows) > 2 * _ROWS:
        rows = [*rows[:_ROWS], len(rows) - 2 * _ROWS, *rows[-_ROWS:]]
    places = len(cell.stations)
    right = _LEFT + places * _COLUMN
    width, height = right + _TEXT, _HEAD + len(rows) * _LINE + 10
    parts = [f'<svg class="msc" width="{width}" height="{height}" viewBox="0 0 {width} {height}" role="img">']
    for station in cell.stations:
        x = _x(station.place)
        role = _text(station.implementation.rpartition(":")[2][:10])
        parts.append(f'<text class="n" x="{x}" y="16" text-anchor="middle">{station.place}</text>')
        parts.append(f'<text class="i" x="{x}" y="31" text-anchor="middle">{role}</text>')
        parts.append(f'<line class="life" x1="{x}" y1="{_HEAD - 6}" x2="{x}" y2="{height - 4}"/>')
    neighbours = {station.place: station.neighbours for station in cell.stations}
    for number, row in enumerate(rows):
        y = _HEAD + number * _LINE + 8
        if isinstance(row, int):
            parts.append(f'<text class="t" x="{right}" y="{y + 4}">... {row} lines, in interop.json</text>')
            continue
        parts.append(f'<text class="t" x="{_LEFT - 26}" y="{y + 4}" text-anchor="end">{row.time:.2f}</text>')
        kind = "bad" if row.text.startswith("not met") else "frame" if row.frame else "event"
        if row.place is not None and row.place < places:
            if row.frame:
                for other in neighbours.get(row.place, ()):
                    parts.append(_arrow(_x(row.place), _x(other), y))
            parts.append(f'<circle class="{kind}" cx="{_x(row.place)}" cy="{y}" r="4"/>')
        else:
            parts.append(f'<line class="{kind} all" x1="{_LEFT - 20}" y1="{y}" x2="{right - 20}" y2="{y}"/>')
        parts.append(f'<text class="{kind}" x="{right}" y="{y + 4}">{_text(row.text[:110])}</text>')
    return "".join([*parts, "</svg>"])


def _x(place: int) -> int:
    return _LEFT + place * _COLUMN + _COLUMN // 2 - 20


def _arrow(start: int, end: int, y: int) -> str:
    tip = end - 5 if end > start else end + 5
    back = tip - 6 if end > start else tip + 6
    return (
        f'<line class="arrow" x1="{start}" y1="{y}" x2="{tip}" y2="{y}"/>'
        f'<path class="tip" d="M{tip} {y}L{back} {y - 3}L{back} {y + 3}Z"/>'
    )


def _text(text: str) -> str:
    return escape(plain(text))
