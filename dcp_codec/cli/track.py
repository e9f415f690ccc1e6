"""``dcp-codec track``: positions of nodes as CSV, GPX or KML."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path

import click

from dcp_codec.analysis.tracks import (
    Position,
    Positions,
    Reference,
    TrackError,
    parse_reference,
    write_csv,
    write_gpx,
    write_kml,
)
from dcp_codec.capture import Frame
from dcp_codec.common.atomic_write import write_whole
from dcp_codec.common.commandline import ExpectedError, out_option, writing
from dcp_codec.framing.frames import FrameDissector
from dcp_codec.framing.locate import OtherTraffic

from .common import choose, note, open_input, profile_options, progress, report_capture_problems

_FORMATS = {".csv": "csv", ".gpx": "gpx", ".kml": "kml"}


def _reference(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Reference | None:
    try:
        return None if value is None else parse_reference(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


@click.command(
    "track",
    epilog="Exit status: 0 all good, 2 wrong usage, no positions, or input that could not be read to its end.",
)
@click.argument("file")
@out_option("FILE", "Write the positions to this file: .csv, .gpx or .kml.", required=True)
@profile_options
@click.option(
    "--reference",
    callback=_reference,
    metavar="LAT,LON[,ALT]",
    help="Position of x = y = z = 0, in degrees and metres; required for GPX and KML.",
)
@click.option(
    "--every",
    type=click.FloatRange(min=0),
    default=0.0,
    metavar="S",
    help="Write one position per node and S seconds.  [default: all]",
)
@click.option(
    "-f",
    "--format",
    "form",
    type=click.Choice(["csv", "gpx", "kml"]),
    help="Format of the output.  [default: by the suffix of --out]",
)
def command(
    file: str,
    out: Path,
    profile: str,
    ether_type: int | None,
    reference: Reference | None,
    every: float,
    form: str | None,
) -> int:
    """Write the positions that the nodes of a recording reported, for spreadsheets and maps.

    State reports have local coordinates: x is taken as metres to the east of the reference point, y to the north, z up.
    Times are those of capture.
    """
    kind = form or _FORMATS.get(out.suffix.lower())
    if kind is None:
        raise click.UsageError(f"{out}: the name must end with .csv, .gpx or .kml, or give --format")
    if kind != "csv" and reference is None:
        raise click.UsageError(f"{kind.upper()} needs degrees: give --reference LAT,LON[,ALT] for local coordinates")
    with open_input(file) as reader:
        dissector, frames = choose(profile, ether_type, iter(reader), file)
        with progress(reader, file) as advance:
            try:
                found = _positions(dissector, frames, every, advance)
                octets, count = _written(kind, found, reference)
            except TrackError as error:
                raise ExpectedError(f"{file}: {error}") from None
        status = report_capture_problems(reader, file)
    if not count:
        raise ExpectedError(f"{file}: no state report with a position was found")
    with writing(out):
        write_whole(out, octets)
    note(f"{out}: {count} positions")
    return status


def _positions(
    dissector: FrameDissector, frames: Iterator[Frame], every: float, advance: Callable[[], None]
) -> Iterator[Position]:
    reader, last, step = Positions(dissector.codec.profile), dict[str, int](), int(every * 1e9)
    for frame in frames:
        advance()
        dissected = dissector.dissect(frame)
        if isinstance(dissected, OtherTraffic):
            continue
        for position in reader.of(dissected):
            before = last.get(position.node)
            if before is None or position.time_ns - before >= step:
                last[position.node] = position.time_ns
                yield position


def _written(kind: str, positions: Iterator[Position], reference: Reference | None) -> tuple[bytes, int]:
    if kind == "csv":
        text = io.StringIO()
        count = write_csv(positions, text, reference)
        return text.getvalue().encode(), count
    assert reference is not None
    octets = io.BytesIO()
    count = (write_gpx if kind == "gpx" else write_kml)(positions, octets, reference)
    return octets.getvalue(), count
