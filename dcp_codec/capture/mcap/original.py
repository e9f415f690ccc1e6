"""The original file that is attached to an MCAP file: its frames, where those of the MCAP file are damaged."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import NamedTuple

from dcp_codec.capture.bytesource import ByteSource
from dcp_codec.capture.checksum import crc32
from dcp_codec.capture.frame import CaptureError, Frame

from .attachments import read_head
from .index import RECORD_HEAD, Index, read_record

_CRC = struct.Struct("<I")
#: Maximum length of an attachment that is held in memory, in octets.
_MOST = 1 << 30


class Original(NamedTuple):
    """The frames of an attached recording after a number."""

    name: str
    frames: Iterator[Frame]


def read_original(path: str, index: Index, link_types: frozenset[int], after: int) -> Original | None:
    """Return the frames after frame ``after`` of the first intact attachment that is a pcap or pcapng file.

    None if there is none, or if it has fewer frames.
    """
    for place in index.attachments:
        if place.length > _MOST:
            continue
        content = read_record(path, place)
        (expected,) = _CRC.unpack(content[-_CRC.size :])
        source = ByteSource(BytesIO(content), path, len(content), owned=False)
        head = read_head(source, len(content))
        if head is None or len(content) + RECORD_HEAD.size != place.length:
            continue
        if not expected or crc32(content[: -_CRC.size]) != expected:
            continue
        frames = list(_frames(source.take(head.size), head.name, link_types))
        if len(frames) > after:
            return Original(head.name, iter(frames[after:]))
    return None


def _frames(file: bytes, name: str, link_types: frozenset[int]) -> Iterator[Frame]:
    """Yield the frames of a pcap or pcapng file in memory; none of another one."""
    from dcp_codec.capture.pcap.reader import MAGICS, PcapReader
    from dcp_codec.capture.pcapng.reader import PcapngReader

    source = ByteSource(BytesIO(file), name, len(file), owned=False)
    try:
        if file[:4] in MAGICS:
            yield from PcapReader(source, link_types)
        elif file[:4] == b"\x0a\x0d\x0d\x0a":
            yield from PcapngReader(source, link_types)
    except CaptureError:
        return
