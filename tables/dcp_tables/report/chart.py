"""One interactive plot with Bokeh: the style of lines, dots and boxes, and the tooltips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import bokeh
import numpy as np
from bokeh.document import Document
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    FixedTicker,
    HoverTool,
    Legend,
    LegendItem,
    NoOverlap,
    NumeralTickFormatter,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    TimedeltaAxis,
    TimedeltaTickFormatter,
    WheelZoomTool,
)
from bokeh.plotting import figure
from bokeh.themes import Theme

from dcp_codec.common.pages.colours import DASHES, SYMBOLS, light, series_colour

from .recorded import Column

#: Least distance between two labels of a time axis, in pixels.
_BETWEEN_LABELS = 10
_FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-serif"
_LABEL = {"label_text_color": light("ink"), "label_text_font": _FONT}
#: Theme of every plot; the script of the page replaces the colours in the dark scheme.
_THEME = Theme(
    json={
        "attrs": {
            "Plot": {
                "background_fill_color": light("card"),
                "border_fill_color": light("card"),
                "outline_line_color": None,
            },
            "Axis": {
                "axis_line_color": light("soft"),
                "major_tick_line_color": light("soft"),
                "minor_tick_line_color": None,
                "major_label_text_color": light("ink"),
                "major_label_text_font": _FONT,
                "major_label_text_font_size": "12px",
                "axis_label_text_color": light("ink"),
                "axis_label_text_font": _FONT,
                "axis_label_text_font_size": "12px",
                "axis_label_text_font_style": "normal",
            },
            "Grid": {"grid_line_color": light("line")},
            "Legend": {
                **_LABEL,
                "label_text_font_size": "12px",
                "background_fill_color": light("card"),
                "border_line_color": None,
                "inactive_fill_color": light("line"),
                "padding": 0,
                "margin": 4,
                "spacing": 12,
                "glyph_width": 18,
            },
        }
    }
)

#: Milliseconds of a second: Bokeh's durations are in milliseconds.
_MS = 1000.0
#: Maximum width of a legend in pixels, so that it fits on a telephone.
_LEGEND = 300
#: Hatches of stacked areas.
_HATCHES = (None, "/", "x", "-", ".", "\\", "|", "o")
_CLOCK = "%H:%M:%S.%3N"


@dataclass
class Plot:
    """One plot of the page. ``summary`` describes it in text, for readers without sight of it."""

    name: str
    title: str
    caption: str
    summary: str
    figure: Any
    #: Range of the values, to give the plots of two recordings the same vertical axis; None for plots with rows.
    limits: tuple[float, float] | None
    over_time: bool
    #: Whether the vertical axis starts at 0 if no value is negative.
    from_zero: bool = True

    def item(self, target: str) -> dict[str, Any]:
        """Return the plot as JSON for BokehJS, as ``bokeh.embed.json_item`` does without two checks."""
        document = Document(theme=_THEME, title="")
        document.add_root(self.figure)
        item = {
            "target_id": target,
            "root_id": self.figure.ref["id"],
            "doc": document.to_json(deferred=False),
            "version": bokeh.__version__,
        }
        document.clear()
        found: dict[str, Any] = _numbered(item, {})
        return found


def _numbered(value: Any, known: dict[str, str]) -> Any:
    """Number the models in JSON from 1, so that the same recording always gives the same page."""
    if isinstance(value, list):
        return [_numbered(each, known) for each in value]
    if not isinstance(value, dict):
        return value
    return {
        key: known.setdefault(each, f"m{len(known) + 1}")
        if key in ("id", "root_id") and isinstance(each, str)
        else _numbered(each, known)
        for key, each in value.items()
    }


def safe_text(text: str) -> str:
    """Replace characters that Bokeh would interpret as TeX."""
    return text.replace("$", "＄")


@dataclass
class Chart:
    """Builder of one plot. ``duration`` (s) gives it a time axis; ``rows`` are the names of horizontal rows."""

    name: str
    title: str
    caption: str
    label: str = ""
    duration: float | None = None
    rows: Sequence[str] = ()
    height: int = 300
    unit: str = ""
    from_zero: bool = True
    _entries: list[tuple[str, list[Any]]] = field(default_factory=list)
    _ends: list[float] = field(default_factory=list)
    _words: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.figure = figure(
            height=self.height,
            sizing_mode="stretch_width",
            tools=[],
            toolbar_location="above",
            x_axis_type=None if self.duration is not None else "linear",
            output_backend="canvas",
        )
        self.figure.toolbar.logo = None
        self.figure.min_border_right = 16
        self.figure.name = self.name
        zoom = BoxZoomTool(dimensions="width" if self.duration is not None else "both")
        wheel = WheelZoomTool(dimensions="width" if self.duration is not None else "both")
        self.figure.add_tools(zoom, PanTool(), wheel, SaveTool(filename=self.name), ResetTool())
        self.figure.toolbar.active_drag = zoom
        self.figure.toolbar.active_scroll = None
        if self.duration is not None:
            formats = TimedeltaTickFormatter(
                milliseconds="%s.%MS s", seconds="%M:%S", minsec="%M:%S", minutes="%H:%M h", hourmin="%H:%M h",
                hours="%H:%M h", days="%d days",
            )  # fmt: skip
            self.figure.add_layout(
                TimedeltaAxis(
                    formatter=formats,
                    axis_label="time since the first frame",
                    major_label_policy=NoOverlap(min_distance=_BETWEEN_LABELS),
                ),
                "below",
            )
            room = 0.01 * (self.duration or 1.0) * _MS
            self.figure.x_range = Range1d(-room, (self.duration or 1.0) * _MS + room)
        if self.rows:
            places = list(range(len(self.rows)))
            self.figure.yaxis.ticker = FixedTicker(ticks=places)
            names = {place: safe_text(name) for place, name in zip(places, self.rows, strict=True)}
            self.figure.yaxis.major_label_overrides = names
            self.figure.y_range = Range1d(len(self.rows) - 0.4, -0.6)
            self.figure.ygrid.visible = False
        else:
            self.figure.yaxis.axis_label = safe_text(self.label)
            self.figure.yaxis.formatter = NumeralTickFormatter(format="0,0.[000]")
            self.figure.yaxis[0].ticker.desired_num_ticks = 5

    # -- drawing ----------------------------------------------------------------------------------------------------

    def line(self, number: int, name: str, x: Column, y: Column, *, step: bool = False, **shown: Any) -> None:
        """Draw a line of series ``number``; ``shown`` are further columns of the tooltip. NaN interrupts the line."""
        source = self._source(name, x, y, shown)
        style = {
            "line_color": series_colour(number), "line_dash": DASHES[number // 10 % len(DASHES)], "line_width": 1.8,
        }  # fmt: skip
        draw = self.figure.step if step else self.figure.line
        options = {"mode": "after"} if step else {}
        drawn = draw("x", "y", source=source, **style, **options)
        # A few markers identify each series without colour.
        marks = self._marks(number, source, np.linspace(0, x.size - 1, min(x.size, 9)).astype(int))
        if step:
            # Bokeh has no tooltips for steps: use invisible dots.
            drawn_there = self.figure.scatter("x", "y", source=source, size=9, color=light("card"), alpha=0)
        self._pointer([drawn_there if step else drawn], shown)
        self._entry(name, [drawn, marks], y)

    def dots(self, number: int, name: str, x: Column, y: Column, **shown: Any) -> None:
        """Draw dots of series ``number``; ``shown`` are further columns of the tooltip."""
        source = self._source(name, x, y, shown)
        drawn = self._scatter(source, SYMBOLS[number % 10][0], series_colour(number), size=6, fill_alpha=0.55)
        self._pointer([drawn], shown)
        self._entry(name, [drawn], y)

    def levels(self, number: int, name: str, edges: Column, values: Column) -> None:
        """Draw a line that is constant in each interval of ``edges`` (s), as for means; NaN interrupts the line."""
        self.line(number, name, edges, np.append(values, values[-1:]), step=True)

    def boxes(
        self, role: str, left: Column, right: Column, bottom: Column, top: Column, *, legend: str = "",
        hatch: str | None = None, **shown: Any,
    ) -> None:  # fmt: skip
        """Draw boxes in the colour of a role, with an equivalent hatch; ``shown`` are columns of the tooltip."""
        scale = _MS if self.duration is not None else 1.0
        source = ColumnDataSource({"left": left * scale, "right": right * scale, "bottom": bottom, "top": top, **shown})
        drawn = self._quads(source, light(role), hatch, 6, 1.2)
        self._pointer([drawn], shown, span=True)
        if legend:
            self._entries.append((legend, [drawn]))

    def areas(self, series: Sequence[tuple[str, Column]], edges: Column) -> None:
        """Draw stacked steps, one for each name, with one value for each interval of ``edges`` (s)."""
        below = np.zeros(edges.size - 1)
        for number, (name, values) in enumerate(series):
            above = below + values
            source = ColumnDataSource(
                {"left": edges[:-1] * _MS, "right": edges[1:] * _MS, "bottom": below, "top": above, self.label: values},
                name=safe_text(name),
            )
            drawn = self._quads(source, series_colour(number), _HATCHES[number % len(_HATCHES)], 8, 1)
            self._pointer([drawn], {self.label: values}, span=True)
            self._entry(name, [drawn], values)
            below = above
        self._ends += [0.0, float(below.max(initial=0))]

    def marks_at(self, symbol: str, role: str, x: Column, y: Column, *, size: int = 9, **shown: Any) -> None:
        """Draw symbols in the colour of a role; ``shown`` are columns of the tooltip."""
        source = ColumnDataSource({"x": x * _MS if self.duration is not None else x, "y": y, **shown})
        drawn = self._scatter(source, symbol, light(role), size=size, line_width=1.5)
        self._pointer([drawn], shown)

    def plot(self) -> Plot:
        """Return the complete plot, with legend and axes."""
        if self._entries:
            items = [LegendItem(label=safe_text(name), renderers=drawn) for name, drawn in self._entries]
            columns = max(1, min(4, _LEGEND // (36 + 7 * max(len(name) for name, _ in self._entries))))
            # Below the plot, where it covers no data; a click hides a series.
            self.figure.add_layout(Legend(items=items, ncols=columns, click_policy="hide", location="left"), "below")
            self.figure.height += 22 * -(-len(items) // columns)
        limits = None
        if not self.rows:
            known = [end for end in self._ends if np.isfinite(end)] or [0.0, 1.0]
            limits = (min(known), max(known))
        plot = Plot(
            self.name, self.title, self.caption, "; ".join(self._words), self.figure, limits,
            self.duration is not None, self.from_zero,
        )  # fmt: skip
        if limits is not None and self.duration is not None:
            scale(plot, limits)
        return plot

    # -- internal -----------------------------------------------------------------------------------------------------

    def _source(self, name: str, x: Column, y: Column, shown: dict[str, Any]) -> ColumnDataSource:
        scaled = x * _MS if self.duration is not None else x
        columns = {
            "x": scaled,
            "y": np.asarray(y, np.float64),
            **{each: _compact(found) for each, found in shown.items()},
        }
        return ColumnDataSource(columns, name=safe_text(name))

    def _marks(self, number: int, source: ColumnDataSource, rows: Column) -> Any:
        own = ColumnDataSource({axis: np.asarray(source.data[axis])[rows] for axis in "xy"})
        return self._scatter(own, SYMBOLS[number % 10][0], series_colour(number), size=7)

    def _scatter(self, source: ColumnDataSource, marker: str, colour: str, **style: Any) -> Any:
        return self.figure.scatter(
            "x", "y", source=source, marker=marker, fill_color=colour, line_color=colour, **style
        )

    def _quads(self, source: ColumnDataSource, colour: str, hatch: str | None, wide: float, thick: float) -> Any:
        return self.figure.quad(
            "left", "right", "bottom", "top", source=source, fill_color=colour, line_color=None, hatch_pattern=hatch,
            hatch_color=light("card"), hatch_scale=wide, hatch_weight=thick,
        )  # fmt: skip

    def _pointer(self, drawn: list[Any], shown: dict[str, Any], *, span: bool = False) -> None:
        """Add a tooltip with the name, the time, the value, and further columns."""
        rows = [(name, f"@{{{name}}}{_number_format(values)}") for name, values in shown.items()]
        at = "@left{" + _CLOCK + "} to @right{" + _CLOCK + "}" if span else "@x{" + _CLOCK + "}"
        if self.duration is not None:
            rows.insert(0, ("time", at))
        elif not span:
            rows.insert(0, ("x", "@x{0,0.[000]}"))
        if not span and not self.rows:
            rows.insert(1, (self.label or "value", "@y{0,0.[000000]}"))
        names = drawn[0].data_source.name
        if names:
            rows.insert(0, ("", names.replace("@", "＠").replace("$", "＄")))
        keys = ("left", "right") if span else ("x",)
        formatters: Any = {f"@{key}": "datetime" for key in keys} if self.duration is not None else {}
        self.figure.add_tools(
            HoverTool(
                renderers=drawn,
                tooltips=rows,
                formatters=formatters,
                point_policy="follow_mouse" if span else "snap_to_data",
                visible=False,
                limit=1,
            )
        )

    def _entry(self, name: str, drawn: list[Any], y: Column) -> None:
        self._entries.append((name, drawn))
        known = np.asarray(y, np.float64)
        known = known[np.isfinite(known)]
        if known.size:
            low, high = float(known.min()), float(known.max())
            self._ends += [low, high]
            self._words.append(f"{name}: {low:.4g} to {high:.4g}{self.unit and ' ' + self.unit}")


def scale(plot: Plot, limits: tuple[float, float]) -> None:
    """Set the range of the vertical axis to ``limits``, with some margin."""
    low, high = limits
    if plot.from_zero and low >= 0:
        low, high = 0.0, high or 1.0
    # Labels have three decimals. The range must not be so narrow that those of neighbouring ticks are equal.
    narrowest = max(0.01, 1e-6 * abs(low), 1e-6 * abs(high))
    if high - low < narrowest:
        low = low if plot.from_zero and low >= 0 else (low + high - narrowest) / 2
        high = low + narrowest
    room = 0.06 * (high - low)
    plot.figure.y_range = Range1d(low - (room if low or not plot.from_zero else 0), high + room)


def _compact(values: Any) -> Any:
    """Convert integers to four octets if they fit."""
    if isinstance(values, np.ndarray) and values.dtype.kind == "i" and values.size and abs(values).max() < 1 << 31:
        return values.astype(np.int32)
    return values


def _number_format(values: Any) -> str:
    first = np.asarray(values)
    return "{0,0.[000]}" if first.dtype.kind in "fiu" else ""
