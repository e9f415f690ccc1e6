"""``dcp-codec record``: record an interface passively."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import click

from dcp_codec.capture import CaptureError
from dcp_codec.capture.ring import RingWriter
from dcp_codec.common.commandline import ExpectedError, expected, out_option
from dcp_codec.framing.frames import with_ether_type

from .common import ether_type_option, listening, load_codec, note, recording_format


@click.command(
    "record",
    epilog="A file that is cut off by a crash can be read up to the last second (MCAP: the last chunk). Exit status: 0 "
    "recorded until Ctrl-C, SIGTERM or --count; 2 wrong usage, no such interface, no permission, or a full disk.",
)
@click.option("-i", "--interface", required=True, metavar="IF", help="Ethernet interface to record (needs scapy).")
@out_option(
    "FILE",
    "Write the recording to this file: .pcapng, .pcap or .mcap, compressed if .gz or .zst follows.",
    required=True,
)
@click.option(
    "-p",
    "--profile",
    metavar="NAME|FILE",
    help="Record only frames with the EtherType of this profile, or UDP.  [default: all]",
)
@ether_type_option("Record only frames with this EtherType, such as 0x4953.")
@click.option("-c", "--count", type=click.IntRange(min=1), metavar="N", help="End after N frames.")
@click.option(
    "--ring-size", type=click.FloatRange(min=0.001), metavar="MB", help="Begin a new file after MB megabytes."
)
@click.option("--ring-time", type=click.FloatRange(min=0.1), metavar="S", help="Begin a new file after S seconds.")
@click.option("--ring-files", type=click.IntRange(min=1), metavar="N", help="Keep only the last N files.")
@recording_format()
def command(
    interface: str,
    out: Path,
    profile: str | None,
    ether_type: int | None,
    count: int | None,
    ring_size: float | None,
    ring_time: float | None,
    ring_files: int | None,
    form: str | None,
) -> int:
    """Record what an interface receives, passively, until Ctrl-C or SIGTERM.

    \b
    dcp-codec record -i wlan0 -o flight.pcapng
    dcp-codec record -i wlan0 -o day.pcapng.zst --ring-time 3600 --ring-files 24
    """
    if ring_files is not None and ring_size is None and ring_time is None:
        raise click.UsageError("--ring-files needs --ring-size or --ring-time")
    link = load_codec(profile).profile.link if profile is not None else None
    if ether_type is not None:
        link = with_ether_type(link or load_codec("dcp-2.0").profile.link, ether_type)
    try:
        with (
            listening(interface, link) as reader,
            expected(CaptureError),
            RingWriter(
                out,
                max_octets=None if ring_size is None else int(ring_size * 1e6),
                max_ns=None if ring_time is None else int(ring_time * 1e9),
                keep=ring_files,
                format=form,
                metadata=reader.metadata,
            ) as ring,
        ):
            note(f"{interface}: recording to {ring.files[-1]}; Ctrl-C ends")
            for frame in islice(reader, count):
                ring.write(frame)
    except OSError as error:
        raise ExpectedError(f"{error.filename or out}: {error.strerror}") from None
    kept = f", {len(ring.files)} of {ring.count} files kept" if ring.count > 1 else ""
    note(f"{ring.files[-1]}: {ring.frames} frames{kept}")
    return 0
