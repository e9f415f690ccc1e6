"""The page of a report: chapters on recordings, with sections of plots and tables, in one self-contained file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

from bokeh.resources import Resources

from dcp_codec.common import pages
from dcp_codec.common.pages.colours import SCHEMES, SYMBOLS

from .chart import Plot, scale


@dataclass
class Cell:
    """One cell of a table. ``series`` is the number of the series whose colour and symbol it has; ``number`` aligns it
    to the right; ``bad`` marks it in red; ``code``: it is a command to copy; ``bar`` is a share (0 to 1) that is drawn
    as a bar in the background.
    """

    text: str
    number: bool = False
    series: int | None = None
    mono: bool = False
    bad: bool = False
    code: bool = False
    bar: float = 0.0

    @property
    def symbol(self) -> str:
        """The character of the series."""
        return SYMBOLS[(self.series or 0) % len(SYMBOLS)][1]


@dataclass
class Table:
    """A table with caption and headings. ``matrix``: the first cell of each row is a heading, too."""

    caption: str
    heads: list[Cell]
    rows: list[list[Cell]]
    matrix: bool = False


@dataclass
class Section:
    """One section. ``words`` are paragraphs of text, also if there is nothing to draw."""

    id: str
    title: str
    words: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    plots: list[Plot] = field(default_factory=list)


@dataclass
class Chapter:
    """The chapter on one recording. ``figures`` are those of the comparison of recordings, as (name, text)."""

    name: str
    facts: list[tuple[str, str]]
    tiles: list[tuple[str, str, str]]
    problems: list[str]
    sections: list[Section]
    figures: list[tuple[str, str]] = field(default_factory=list)
    duration: float = 0.0

    @property
    def plots(self) -> list[Plot]:
        """All plots in the order of the page."""
        return [plot for section in self.sections for plot in section.plots]


def table(caption: str, heads: Sequence[str], rows: list[list[Cell]], *, matrix: bool = False) -> Table:
    """Return a table whose headings have the alignment of their columns. ``rows`` must not be empty."""
    return Table(caption, [Cell(head, number=rows[0][place].number) for place, head in enumerate(heads)], rows, matrix)


def render(chapters: Sequence[Chapter]) -> str:
    """Render the page; text from recordings is escaped. Two recordings are shown side by side."""
    pair = len(chapters) == 2
    if pair:
        _one_scale(chapters)
    items = {
        plot.name: {
            "item": plot.item(f"p-{plot.name}"),
            "time": plot.over_time,
            "group": "all" if pair else plot.name.partition("-")[0],
        }
        for chapter in chapters
        for plot in chapter.plots
    }
    scripts = [_library()] if items else []
    return pages.render(
        __package__,
        "report.html",
        *scripts,
        pages.text(__package__, "report.js"),
        chapters=chapters,
        pair=pair,
        side_by_side=list(zip_longest(*(chapter.sections for chapter in chapters))) if pair else [],
        comparison=_comparison(chapters) if len(chapters) > 1 else None,
        data=_script_json(items),
        swap=_script_json([list(pair) for pair in SCHEMES.values()]),
        any_plots=bool(items),
    )


def _library() -> str:
    """Return BokehJS without widgets, tables and TeX."""
    return "\n".join(Resources(mode="inline", components=["bokeh"], minified=True).js_raw)


def _script_json(value: Any) -> str:
    """Return JSON that is safe in a script element."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


def _one_scale(chapters: Sequence[Chapter]) -> None:
    """Give corresponding plots of two recordings the same axes."""
    longest = max(chapter.duration for chapter in chapters)
    known = [{plot.name.partition("-")[2]: plot for plot in chapter.plots} for chapter in chapters]
    for name in known[0].keys() & known[1].keys():
        both = [plots[name] for plots in known]
        limits = [plot.limits for plot in both if plot.limits is not None]
        for plot in both:
            if plot.over_time and longest:
                plot.figure.x_range.update(start=-10 * longest, end=1010 * longest)
            if len(limits) == 2 and plot.over_time:
                scale(plot, (min(low for low, _ in limits), max(high for _, high in limits)))


def _comparison(chapters: Sequence[Chapter]) -> Table:
    names = list(dict.fromkeys(name for chapter in chapters for name, _ in chapter.figures))
    known = [dict(chapter.figures) for chapter in chapters]
    rows = [[Cell(name), *(Cell(each.get(name, "-"), number=True) for each in known)] for name in names]
    heads = ["", *(chapter.name for chapter in chapters)]
    return table("The recordings compared", heads, rows or [[Cell("") for _ in heads]], matrix=True)
