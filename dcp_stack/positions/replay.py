"""Replay of positions from CSV files and recordings of DCP traffic."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from dcp_codec.capture import CaptureError, open_capture
from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.framing.locate import OtherTraffic, locate
from dcp_codec.jsonform import node_id_text
from dcp_codec.values import Beacon, ExtendedSafetyData

from .base import PositionSource, Sample, SourceError
from .fields import FieldError, SafetyFields
from .geometry import NS_PER_S
from .tracks import as_sample

#: Name of the time column -> its unit in ns.
TIME_COLUMNS: Final[Mapping[str, int]] = {
    "time": NS_PER_S,
    "time_s": NS_PER_S,
    "time_ms": 10**6,
    "time_us": 10**3,
    "time_ns": 1,
}


class Replay(PositionSource):
    """Provides samples at given times (ns, increasing), relative to the first poll.

    ``loop`` repeats them: between the last sample and the first of the next round there is one mean interval.
    ``speed`` 2 replays twice as fast. A late poll returns all samples that are due, so none is left out.
    """

    def __init__(self, name: str, samples: list[tuple[int, Sample]], *, speed: float = 1.0, loop: bool = False) -> None:
        """Raises ValueError if there are no samples or the speed is not greater than 0."""
        super().__init__(name)
        if not samples:
            raise ValueError("there is nothing to replay")
        if not (speed > 0 and math.isfinite(speed)):
            raise ValueError(f"speed must be greater than 0, not {speed:g}")
        first = samples[0][0]
        self._samples = [(round((time - first) / speed), sample) for time, sample in samples]
        length = self._samples[-1][0]
        # At least 1 ms, otherwise the first poll of a loop over a single sample would never end.
        self._length = length + max(length // max(len(samples) - 1, 1), 1_000_000)
        self._loop = loop
        self._start: int | None = None
        self._next = 0

    @property
    def finished(self) -> bool:
        """Whether the last sample has been returned."""
        return self._next >= len(self._samples) and not self._loop

    def poll(self, now: int, wall: int) -> list[Sample]:  # noqa: ARG002 - the same call for every source
        """Return all samples that are due, except those of rounds that were missed completely."""
        if self._start is None:
            self._start = now
        if self._loop and now - self._start >= 2 * self._length:
            # Leave out rounds that have passed completely since the last poll.
            self._start += (now - self._start) // self._length * self._length
            self._next = 0
        found: list[Sample] = []
        while (due := self.poll_timeout()) is not None and due <= now:
            found.append(self._samples[self._next][1])
            self._next += 1
            if self._next == len(self._samples) and self._loop:
                self._next = 0
                self._start += self._length
        return found

    def poll_timeout(self) -> int | None:
        """Return when the next sample is due (monotonic ns); 0 before the first, None after the last."""
        if self.finished:
            return None
        return 0 if self._start is None else self._start + self._samples[self._next][0]


def read_csv(path: Path, fields: SafetyFields) -> list[tuple[int, Sample]]:
    """Return the samples of a CSV file with their times in ns, from any origin.

    The first line has the names of the columns: one of :data:`TIME_COLUMNS`, and fields of the profile, roles or
    aliases (x, y, z, vx, vy, vz). Empty lines and lines that start with # are skipped. Raises SourceError with file and
    line for invalid content, and if times decrease.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise SourceError(f"{path}: cannot be read: {reason}") from None
    rows = csv.reader(text.splitlines(), skipinitialspace=True, strict=True)
    lines = ((rows.line_num, row) for row in rows if any(row) and not row[0].startswith("#"))
    try:
        number, header = next(lines)
    except StopIteration:
        raise SourceError(f"{path}: there is no header line, such as time,x,y,z") from None
    header = [name.strip() for name in header]
    unit = _checked_header(f"{path}:{number}", header, fields)
    found: list[tuple[int, Sample]] = []
    try:
        for number, row in lines:
            time, sample = _sample(f"{path}:{number}", header, row, fields, unit)
            if found and time < found[-1][0]:
                raise SourceError(f"{path}:{number}: the time decreases; sort the rows by time")
            found.append((time, sample))
    except csv.Error as error:
        raise SourceError(f"{path}:{rows.line_num}: {error}") from None
    if not found:
        raise SourceError(f"{path}: there is a header but no row")
    return found


def _checked_header(place: str, header: list[str], fields: SafetyFields) -> int:
    """Return the unit of the time column in ns. Raises SourceError for unknown, repeated or missing columns."""
    times = [name for name in header if name in TIME_COLUMNS]
    if len(times) != 1:
        what = "no time column" if not times else f"more than one time column ({', '.join(times)})"
        raise SourceError(f"{place}: there is {what}; one of {', '.join(TIME_COLUMNS)} is needed")
    seen: dict[str, str] = {}
    for name in header:
        if name in TIME_COLUMNS:
            continue
        try:
            field = fields.column(name)
        except FieldError as error:
            raise SourceError(f"{place}: {error}") from None
        if field in seen:
            raise SourceError(f"{place}: the columns {seen[field]!r} and {name!r} are the same field")
        seen[field] = name
    if not seen:
        raise SourceError(f"{place}: there are no columns besides the time, such as x,y,z")
    return TIME_COLUMNS[times[0]]


def _sample(place: str, header: list[str], row: list[str], fields: SafetyFields, unit: int) -> tuple[int, Sample]:
    """Return time (ns) and sample of a row. Raises SourceError for invalid values."""
    if len(row) != len(header):
        raise SourceError(f"{place}: there are {len(row)} values for {len(header)} columns")
    time = 0
    values: dict[str, Any] = {}
    for name, cell in zip(header, row, strict=True):
        try:
            # Integers are not converted to float, which cannot represent ns since 1970 exactly.
            value = int(cell) if cell.strip().lstrip("+-").isdecimal() else float(cell)
            if name in TIME_COLUMNS:
                time = value * unit if isinstance(value, int) else round(value * unit)
            else:
                values[name] = value
        except (ValueError, OverflowError):
            raise SourceError(f"{place}: {name} is not a number: {cell!r}") from None
    try:
        return time, fields.from_sample(values)
    except FieldError as error:
        raise SourceError(f"{place}: {error}") from None


def read_capture(path: Path, recorded: Codec, node: str | None, fields: SafetyFields) -> list[tuple[int, Sample]]:
    """Return the state reports of one node in a recording, without repetitions, with their times in ns since 1970.

    ``recorded``: the codec of the recording. If its profile differs from that of ``fields``, only position and velocity
    are converted. ``node``: the identifier as text; None if the recording has only one node. Raises SourceError if the
    recording cannot be read, or does not have the node; the message has the nodes of the recording.
    """
    by_node: dict[bytes, list[tuple[int, ExtendedSafetyData]]] = {}
    try:
        for time, report in _reports(path, recorded):
            reports = by_node.setdefault(report.node_id, [])
            if not reports or reports[-1][1].seqno != report.seqno:
                reports.append((time, report))
    except CaptureError as error:
        raise SourceError(str(error)) from None
    representation = recorded.profile.types.node_id.representation
    names = {node_id_text(node_id, representation): node_id for node_id in by_node}
    if not names:
        raise SourceError(f"{path}: there is no state report in it (read as {recorded.profile.name})")
    if node is None and len(names) > 1:
        raise SourceError(f"{path}: which node? Add node=ID, one of {', '.join(sorted(names))}")
    wanted = names.get((node or next(iter(names))).lower()) or names.get(node or "")
    if wanted is None:
        raise SourceError(f"{path}: there is no state report of {node}; the nodes are {', '.join(sorted(names))}")
    return _carried_over(path, by_node[wanted], SafetyFields(recorded.profile), fields)


def _reports(path: Path, codec: Codec) -> Iterator[tuple[int, ExtendedSafetyData]]:
    """Yield all state reports of a recording with their times in ns since 1970. Raises CaptureError."""
    with open_capture(path) as frames:
        for frame in frames:
            framing = locate(frame.data, codec.profile.link)
            if isinstance(framing, OtherTraffic):
                continue
            try:
                beacon = codec.decode(frame.data[framing.start : framing.end])
            except DecodeError as error:
                if not isinstance(error.partial, Beacon):
                    continue
                beacon = error.partial
            for payload in beacon.payloads:
                if payload.srp is not None:
                    yield frame.time_ns, payload.srp


def _carried_over(
    path: Path, reports: list[tuple[int, ExtendedSafetyData]], recorded: SafetyFields, fields: SafetyFields
) -> list[tuple[int, Sample]]:
    """Return reports as samples of another profile, sorted by time.

    Raises SourceError if the profiles do not both have a position, or if no position can be converted.
    """
    same = recorded.profile.srp.safety_data == fields.profile.srp.safety_data
    if not same and not (recorded.has_position and fields.has_position):
        names = f"{recorded.profile.name} and {fields.profile.name}"
        raise SourceError(f"{path}: the profiles {names} have no position in common")
    found: list[tuple[int, Sample]] = []
    for time, report in sorted(reports, key=lambda each: each[0]):
        position = recorded.position(report.s_data)
        try:
            if same:
                found.append((time, fields.from_sample(report.s_data.as_dict())))
            elif position is not None:
                found.append((time, fields.from_sample(as_sample(position, recorded.velocity(report.s_data)))))
        except FieldError:
            # Leave out positions that the other profile cannot represent.
            continue
    if not found:
        raise SourceError(f"{path}: none of the positions fits the profile {fields.profile.name}")
    return found
