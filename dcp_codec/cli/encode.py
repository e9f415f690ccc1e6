"""``dcp-codec encode``: encode JSON objects as beacons."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import click

from dcp_codec.capture import CaptureError, Frame, create_capture
from dcp_codec.codec import Codec
from dcp_codec.common.commandline import PROFILE_HELP, UNUSABLE, ExpectedError, expected
from dcp_codec.errors import EncodeError
from dcp_codec.jsonform import beacon_from_json

from .common import MALFORMED, ether_type_option, link_of, load_codec, note

_BROADCAST = b"\xff" * 6


@click.command(
    "encode",
    epilog="Exit status: 0 all good, 1 some object could not be encoded (the others are), 2 wrong usage or unreadable "
    "input.",
)
@click.argument("file", default="-", metavar="[FILE|-]")
@click.option("-p", "--profile", required=True, metavar="NAME|FILE", help=PROFILE_HELP)
@ether_type_option()
@click.option(
    "-o",
    "--out",
    metavar="FILE",
    help="Write a recording (.mcap, .pcap, .pcapng).  [default: hex lines to standard output]",
)
@click.option("--bare", is_flag=True, help="Write only the beacon as hex, without the Ethernet header.")
def command(file: str, profile: str, ether_type: int | None, out: str | None, bare: bool) -> int:
    """Encode beacons given as JSON objects, as 'decode --format jsonl' prints them: one object, a list, or lines.

    Lengths and counts are derived. src and dst default to the sender and to broadcast, time_ns to 0.
    """
    codec = load_codec(profile)
    link = link_of(codec, ether_type)
    if link.transport != "ethernet" and not bare:
        raise ExpectedError(f"profile {codec.profile.name} is carried over UDP: give --bare for its datagrams")
    if out is not None and bare:
        raise ExpectedError("a recording holds Ethernet frames: give either --out or --bare")
    source = sys.stdin.buffer if file == "-" else _open(file)
    failed = 0
    frames: list[Frame] = []
    with source:
        for number, data in enumerate(_objects(source, file), start=1):
            try:
                octets, time_ns = _frame(codec, data, link.ether_type if not bare else None)
            except EncodeError as error:
                note(f"{file}: object {number}: {error}")
                failed += 1
                continue
            if out is None:
                click.echo(octets.hex())
            else:
                frames.append(Frame(number=len(frames) + 1, time_ns=time_ns, data=octets, orig_len=len(octets)))
    if out is not None:
        _write(out, frames)
    return MALFORMED if failed else 0


def _open(file: str) -> BinaryIO:
    try:
        return Path(file).open("rb")
    except OSError as error:
        raise ExpectedError(f"{file}: cannot be read: {error.strerror}", UNUSABLE) from None


def _objects(source: BinaryIO, name: str) -> Iterator[Any]:
    """Yield the objects of one JSON document, or of JSON lines if the first line is a complete document."""
    first = source.readline()
    try:
        head = json.loads(first)
    except ValueError:
        rest = first + source.read()
        try:
            document = json.loads(rest)
        except (ValueError, RecursionError) as error:
            raise ExpectedError(f"{name}: not valid JSON: {error}") from None
        yield from document if isinstance(document, list) else [document]
        return
    except RecursionError:
        raise ExpectedError(f"{name}: line 1 nests deeper than any beacon") from None
    yield from head if isinstance(head, list) else [head]
    for number, line in enumerate(source, start=2):
        if line.strip():
            try:
                yield json.loads(line)
            except (ValueError, RecursionError) as error:
                raise ExpectedError(f"{name}: line {number} is not JSON: {error}") from None


def _frame(codec: Codec, data: Any, ether_type: int | None) -> tuple[bytes, int]:
    beacon = beacon_from_json(codec, data)
    octets = codec.encode(beacon)
    time_ns = data.get("time_ns") or 0
    if isinstance(time_ns, bool) or not isinstance(time_ns, int) or not 0 <= time_ns < 1 << 63:
        raise EncodeError("time_ns", f"{time_ns!r} is not a number of ns since 1970")
    if ether_type is None:
        return octets, time_ns
    sender = beacon.bp.sender_id if beacon.bp is not None else b""
    src = _mac(data, "src", sender if len(sender) == 6 else b"\2\0\0\0\0\0")
    return _mac(data, "dst", _BROADCAST) + src + ether_type.to_bytes(2, "big") + octets, time_ns


def _mac(data: dict[str, Any], name: str, default: bytes) -> bytes:
    text = data.get(name)
    if text is None:
        return default
    try:
        address = bytes.fromhex(text.replace(":", ""))
    except (ValueError, AttributeError):
        address = b""
    if len(address) != 6:
        raise EncodeError(name, f"{text!r} is not a MAC address")
    return address


def _write(out: str, frames: list[Frame]) -> None:
    with expected(CaptureError), create_capture(Path(out)) as writer:
        for frame in frames:
            writer.write(frame)
    note(f"{out}: {len(frames)} frames")
