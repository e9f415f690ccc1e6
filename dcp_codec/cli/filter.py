"""``dcp-codec filter``: write the frames of a recording that meet a condition to another recording."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

from dcp_codec.analysis.conditions import field_names
from dcp_codec.capture import CaptureError, create_capture
from dcp_codec.common.commandline import LOSSY_HELP, expected
from dcp_codec.framing.locate import OtherTraffic

from .common import (
    choose,
    interruptible,
    load_codec,
    note,
    open_input,
    profile_options,
    progress,
    recording_format,
    report_capture_problems,
)
from .filters import FrameRange, TimeBound, condition, selection_options


@click.command(
    "filter",
    epilog="Conditions, names and examples: docs/recordings.md. Exit status: 0 all good (also if no frame is left), 2 "
    "wrong usage or input that could not be read to its end (what could be read is written).",
)
@click.argument("source", required=False)
@click.argument("target", required=False)
@click.argument("surplus", nargs=-1, metavar="")
@profile_options
@selection_options
@click.option("--other", is_flag=True, help="Also keep frames that are not DCP.")
@recording_format("Format of TARGET.  [default: by its suffix]")
@click.option("--lossy", is_flag=True, help=LOSSY_HELP)
@click.option("--fields", "list_fields", is_flag=True, help="List the fields that conditions can use.")
def command(
    source: str | None,
    target: str | None,
    surplus: tuple[str, ...],
    profile: str,
    ether_type: int | None,
    where: str | None,
    frames: tuple[int, int] | None,
    start: TimeBound | None,
    end: TimeBound | None,
    form: str | None,
    *,
    other: bool,
    lossy: bool,
    list_fields: bool,
) -> int:
    """Copy the selected frames of SOURCE to TARGET, octet for octet. Either may be - for a pipe.

    \b
    dcp-codec filter flight.pcap deletes.pcap -w 'vardis.icType == 6'
    dcp-codec filter flight.mcap start.pcapng --to +30 --other
    dcp-codec filter flight.pcap odd.pcap -w 'errors.reason or bp.seqno < 9'
    """
    if list_fields:
        codec = load_codec("cpp-2.0" if profile == "auto" else profile)
        click.echo("\n".join(name.removeprefix("payloads.") for name in field_names(codec.beacon_plan)))
        return 0
    if surplus:
        raise click.UsageError(
            f"unexpected argument {surplus[0]!r}; give a condition with --where {shlex.quote(surplus[0])}"
        )
    if source is None or target is None:
        raise click.UsageError("give SOURCE and TARGET")
    if where is None and other is False and profile == "auto":
        # Without conditions on the content all frames are copied.
        other = True
    with open_input(source) as reader:
        dissector, rest = choose(profile, ether_type, iter(reader), source)
        wanted, selected = condition(where, dissector.codec), FrameRange(frames, start, end)
        place = sys.stdout.buffer if target == "-" else Path(target)
        kept = seen = 0
        with (
            expected(CaptureError),
            interruptible(target),
            create_capture(place, format=form, lossy=lossy, whole=True, metadata=reader.metadata) as writer,
            progress(reader, source) as advance,
        ):
            for frame in rest:
                advance()
                seen += 1
                if not selected.includes(frame):
                    continue
                found = dissector.dissect(frame) if wanted is not None or not other else None
                if isinstance(found, OtherTraffic):
                    if not other:
                        continue
                elif wanted is not None and found is not None and not wanted(found):
                    continue
                writer.write(frame)
                kept += 1
        note(f"{target}: {kept} of {seen} frames")
        return report_capture_problems(reader, source)
