"""Options of ``decode`` and ``filter`` that select frames: a condition, frame numbers, a time span."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import click
import msgspec

from dcp_codec.analysis.conditions import Where, WhereError
from dcp_codec.capture import Frame
from dcp_codec.codec import Codec
from dcp_codec.common.commandline import F


class TimeBound(msgspec.Struct, frozen=True):
    """A bound in time: ns since 1970, or ns after the first frame when ``relative``."""

    ns: int
    relative: bool = False


def parse_time(_ctx: click.Context, _param: click.Parameter, value: str | None) -> TimeBound | None:
    """Parse ``+1.5`` (s after the first frame), ``1795225151.68`` (s since 1970) or an ISO 8601 time (UTC)."""
    if value is None:
        return None
    if match := re.fullmatch(r"(\+?)(\d+)(?:\.(\d{1,9}))?", value):
        ns = int(match[2]) * 10**9 + int((match[3] or "").ljust(9, "0"))
        return TimeBound(ns, relative=bool(match[1]))
    # Python's ISO parser reads microseconds; recordings have nanoseconds.
    iso, fraction = value, ""
    if match := re.fullmatch(r"(.*:\d\d)\.(\d{1,9})(.*)", value):
        iso, fraction = match[1] + match[3], match[2]
    try:
        time = datetime.fromisoformat(iso)
    except ValueError:
        raise click.BadParameter(f"{value!r} is not an ISO 8601 time, epoch seconds, or +seconds") from None
    if time.tzinfo is None:
        time = time.replace(tzinfo=UTC)
    return TimeBound(int(time.timestamp()) * 10**9 + int(fraction.ljust(9, "0")))


def frame_range(_ctx: click.Context, _param: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """Parse ``7``, ``7-12`` or ``7-``."""
    if value is None:
        return None
    match = re.fullmatch(r"(\d+)(?:(-)(\d*))?", value)
    if match is None:
        raise click.BadParameter(f"{value!r} is not a frame number or range such as 7, 7-12 or 7-")
    first = int(match[1])
    last = first if match[2] is None else int(match[3]) if match[3] else 1 << 62
    return first, last


def selection_options(function: F) -> F:
    """Add ``--where`` (parameter ``where``), ``--frames``, ``--from`` (``start``) and ``--to`` (``end``)."""
    for add in (
        click.option("--to", "end", callback=parse_time, metavar="TIME", help="Not after (as --from)."),
        click.option(
            "--from",
            "start",
            callback=parse_time,
            metavar="TIME",
            help="Not before: ISO time, epoch s, or +s from the first frame.",
        ),
        click.option("--frames", callback=frame_range, metavar="N[-M]", help="Only these frame numbers."),
        click.option("-w", "--where", metavar="EXPR", help="Only DCP frames that meet this condition."),
    ):
        function = add(function)
    return function


def condition(text: str | None, codec: Codec) -> Where | None:
    """Return the condition of ``--where``; None without one. Raises ``click.BadParameter``."""
    try:
        return None if text is None else Where(text, codec.profile, codec.beacon_plan)
    except WhereError as error:
        raise click.BadParameter(str(error), param_hint="'--where'") from None


class FrameRange:
    """The frames of a recording that ``--frames``, ``--from`` and ``--to`` select."""

    def __init__(self, frames: tuple[int, int] | None, start: TimeBound | None, end: TimeBound | None) -> None:
        self._frames = frames
        self._start = start
        self._end = end
        self.origin = 0
        """Time of the first frame of the recording in ns; 0 before it."""

    def includes(self, frame: Frame) -> bool:
        """Return whether a frame is selected. To be called for each frame: relative times count from the first."""
        self.origin = self.origin or frame.time_ns
        if self._frames is not None and not self._frames[0] <= frame.number <= self._frames[1]:
            return False
        if self._start is not None and frame.time_ns < self._ns(self._start):
            return False
        return self._end is None or frame.time_ns <= self._ns(self._end)

    def _ns(self, bound: TimeBound) -> int:
        return bound.ns + self.origin if bound.relative else bound.ns
