"""``dcp-codec merge``: merge several recordings into one in the order of time."""

from __future__ import annotations

import heapq
from contextlib import ExitStack
from itertools import repeat
from pathlib import Path

import click
import msgspec

from dcp_codec.capture import CaptureError, create_capture
from dcp_codec.common.commandline import LOSSY_HELP, ExpectedError, expected, out_option

from .common import interruptible, note, open_input, recording_format, report_capture_problems


@click.command(
    "merge",
    epilog="Exit status: 0 all good, 2 wrong usage or input that could not be read to its end (what could be read is "
    "written).",
)
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@out_option("FILE", "Write the merged recording to this file.", required=True)
@recording_format()
@click.option("--keep-interfaces", is_flag=True, help="Keep interface numbers.  [default: a new one for each FILE]")
@click.option("--lossy", is_flag=True, help=LOSSY_HELP)
def command(files: tuple[str, ...], out: Path, form: str | None, *, keep_interfaces: bool, lossy: bool) -> int:
    """Merge recordings into one, frame by frame in the order of their time stamps.

    The frames of one FILE keep their order. Recordings may have different formats; each becomes a separate interface,
    so that pcapng and MCAP still distinguish them (pcap cannot: use --keep-interfaces or --lossy).
    """
    if any(out.resolve() == Path(name).resolve() for name in files):
        raise ExpectedError(f"{out} is one of the recordings to merge; give another --out")
    status = count = 0
    with ExitStack() as stack:
        readers = [stack.enter_context(open_input(name)) for name in files]
        streams = [zip(repeat(place), reader) for place, reader in enumerate(readers)]
        with (
            expected(CaptureError),
            interruptible(out),
            create_capture(out, format=form, lossy=lossy, whole=True) as writer,
        ):
            for place, frame in heapq.merge(*streams, key=lambda each: (each[1].time_ns, each[0])):
                count += 1
                interface = frame.interface if keep_interfaces else place
                writer.write(msgspec.structs.replace(frame, number=count, interface=interface))
        for name, reader in zip(files, readers, strict=True):
            status = max(status, report_capture_problems(reader, name))
    note(f"{out}: {count} frames of {len(files)} recordings")
    return status
