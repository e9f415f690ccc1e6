"""``dcp-codec layout``: write a Foxglove layout for an MCAP file."""

from __future__ import annotations

from pathlib import Path

import click

from dcp_codec.capture import CaptureError
from dcp_codec.common.atomic_write import write_whole
from dcp_codec.common.commandline import FORCE_HELP, ExpectedError, expected, out_option, writing

from .common import note


@click.command(
    "layout",
    epilog="In Foxglove: open FILE, then choose Layouts, Import from file. docs/mcap.md describes the topics. "
    "Exit status: 0 all good, 2 wrong usage or a file that cannot be read.",
)
@click.argument("file", type=click.Path(path_type=Path))
@out_option(
    "FILE.json",
    "Write the layout to this file; -: standard output.  [default: in the current folder, NAME.foxglove.json]",
)
@click.option("--force", is_flag=True, help=FORCE_HELP)
def command(file: Path, out: Path | None, force: bool) -> int:
    """Write a Foxglove layout for FILE, an MCAP file written by convert.

    It shows the positions of all nodes in space and over time, beacons, instructions, and the problems of frames.
    """
    from dcp_codec.foxglove.layouts import layout_of, layout_text

    target = out or Path(f"{file.stem}.foxglove.json")
    if str(target) != "-" and target.exists() and not force:
        raise ExpectedError(f"{target}: exists; give --force to replace it")
    with expected(CaptureError):
        text = layout_text(layout_of(file))
    if str(target) == "-":
        click.echo(text, nl=False)
        return 0
    with writing(target):
        write_whole(target, text.encode())
    note(f"{target}: import it in Foxglove, where {file.name} is open")
    return 0
