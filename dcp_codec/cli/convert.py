"""``dcp-codec convert``: convert between MCAP, pcap and pcapng."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from dcp_spec.profile.definition import Link

from dcp_codec.capture import FORMATS, CaptureError, convert, extract_attachment, open_capture
from dcp_codec.capture import attachments as list_attachments
from dcp_codec.capture.bytesink import same_file
from dcp_codec.codec import Codec
from dcp_codec.common.commandline import LOSSY_HELP, UNUSABLE, ExpectedError, choice_option, expected

from .common import choose, dissector_of, interruptible, note, profile_options, progress_bar


@click.command(
    "convert",
    epilog="Exit status: 0 all good, 2 wrong usage or input that could not be read to its end (what could be read is "
    "written).",
)
@click.argument("source")
@click.argument("target")
@profile_options
@click.option(
    "--to",
    "form",
    type=click.Choice([*sorted(FORMATS), "ros2"]),
    help="Format of TARGET, by default that of its suffix. ros2 is an MCAP file with ROS 2 messages only: poses, "
    "neighbour tables, variables.",
)
@choice_option("--resolution", of=["ns", "us"], help="Resolution of the time stamps in a pcap or pcapng.")
@click.option("--lossy", is_flag=True, help=LOSSY_HELP)
@click.option(
    "--decoded/--no-decoded", default=True, show_default=True, help="Add channels with decoded messages to an MCAP."
)
@click.option("--attach/--no-attach", default=True, show_default=True, help="Attach the original file to an MCAP.")
@choice_option("--compression", of=["zstd", "lz4", "none"], help="Compression of an MCAP.")
@click.option(
    "--extract", is_flag=True, help="Write the original file that is attached to SOURCE instead, byte for byte."
)
def command(
    source: str,
    target: str,
    profile: str,
    ether_type: int | None,
    form: str | None,
    resolution: str,
    lossy: bool,
    decoded: bool,
    attach: bool,
    compression: str,
    extract: bool,
) -> int:
    """Convert SOURCE to TARGET without losing an octet or a nanosecond. Either may be - for a pipe.

    An MCAP opens in Foxglove: raw frames, decoded messages and positions have separate channels.
    """
    with expected(CaptureError):
        if extract:
            return _extract(source, target)
        if form == "ros2":
            return _ros2(source, target, profile, ether_type)
        mcap = form == "mcap" or (form is None and Path(target).suffix == ".mcap")
        if mcap and source == "-":
            attach = False
            if decoded and profile == "auto":
                raise ExpectedError("a pipe is read once: name the --profile of its frames, or give --no-decoded")
        messages, metadata = None, None
        if mcap and decoded:
            from dcp_codec.foxglove.channels import DecodedChannels, capture_metadata

            codec, link = _codec(source, profile, ether_type)
            messages = DecodedChannels(codec, link)
            metadata = capture_metadata(codec)
        with interruptible(target), _progress(source) as advance:
            report = convert(
                sys.stdin.buffer if source == "-" else Path(source),
                sys.stdout.buffer if target == "-" else Path(target),
                format=form,
                resolution=resolution,  # type: ignore[arg-type]
                metadata=metadata,
                messages=messages,
                attach_source=mcap and attach,
                compression=compression,  # type: ignore[arg-type]
                lossy=lossy,
                progress=advance,
            )
    for problem in report.problems:
        note(f"{source}: {problem.message}")
    note(f"{target}: {report.frames} frames, {report.source_format} to {report.target_format}")
    return UNUSABLE if report.problems else 0


def _ros2(source: str, target: str, profile: str, ether_type: int | None) -> int:
    from dcp_codec.ros2 import write_bag

    if target == "-":
        raise ExpectedError("an MCAP for ROS 2 is written to a file: give its name instead of -")
    if source == "-" and profile == "auto":
        raise ExpectedError("a pipe is read once: name the --profile of its frames")
    if same_file(source, target):
        raise ExpectedError(f"{target}: source and target are the same file")
    codec, link = _codec(source, profile, ether_type)
    with _progress(source) as advance:
        stream = sys.stdin.buffer if source == "-" else Path(source)
        report = write_bag(stream, Path(target), codec, link, progress=advance)
    for problem in report.problems:
        note(f"{source}: {problem.message}")
    if report.damaged:
        note(f"{source}: {report.damaged} beacons are damaged; their undamaged parts were written")
    listed = ", ".join(f"{topic} {number}" for topic, number in sorted(report.messages.items()))
    note(f"{target}: {report.frames} frames, messages on {listed or 'no topic'}")
    return UNUSABLE if report.problems else 0


def _codec(source: str, profile: str, ether_type: int | None) -> tuple[Codec, Link]:
    if profile != "auto":
        dissector = dissector_of(profile, ether_type)
    else:
        with open_capture(Path(source)) as reader:
            dissector, _ = choose(profile, ether_type, reader, source)
    return dissector.codec, dissector.link


def _extract(source: str, target: str) -> int:
    found = list_attachments(Path(source))
    if not found:
        raise ExpectedError(f"{source}: nothing is attached to it")
    if len(found) > 1:
        note(f"{source}: has {len(found)} attachments; this is the first, {found[0].name}")
    if target == "-":
        raise ExpectedError("an attachment is written to a file: give its name instead of -")
    extract_attachment(Path(source), found[0], Path(target))
    note(f"{target}: {found[0].name}, byte for byte")
    return 0


@contextmanager
def _progress(source: str) -> Iterator[Callable[[int, int | None], object] | None]:
    if (
        not sys.stderr.isatty()
        or source == "-"
        or not Path(source).is_file()
        or Path(source).stat().st_size < 4_000_000
    ):
        yield None
        return
    with progress_bar(Path(source).name, None) as update:
        yield lambda done, size: update(completed=done, total=size)
