"""Opening a capture: which format it is, is decided by its first octets alone."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from dcp_codec.capture.bytesource import ByteSource, open_source
from dcp_codec.capture.frame import ETHERNET, CaptureError
from dcp_codec.capture.pcap import MAGICS, MODIFIED_MAGICS, PcapReader
from dcp_codec.capture.pcapng import PcapngReader
from dcp_codec.capture.reader import CaptureReader

PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"
MCAP_MAGIC = b"\x89MCAP0\r\n"

#: First octets of what people mistake for a capture -> what it is and what to do.
_OTHERS = {
    b"\x1f\x8b": "is gzip-compressed: decompress it first (gunzip)",
    b"\x28\xb5\x2f\xfd": "is zstd-compressed: decompress it first (unzstd)",
    b"\x04\x22\x4d\x18": "is lz4-compressed: decompress it first (unlz4)",
    b"\xfd7zXZ\x00": "is xz-compressed: decompress it first (unxz)",
    b"BZh": "is bzip2-compressed: decompress it first (bunzip2)",
    b"PK\x03\x04": "is a zip archive: unpack it first (unzip)",
    b"\x89MCAP": "is MCAP of a version other than 0, the only one there was when this was written",
    b"#ROSBAG": "is a ROS 1 bag: convert it to MCAP first (mcap convert)",
    b"SQLite format 3": "is an SQLite database, maybe a ROS 2 bag: convert it to MCAP first (mcap convert)",
    b"snoop\x00": "is a Solaris snoop file: convert it first (editcap -F pcapng)",
}

_LONGEST_MAGIC = 16


def open_capture(
    source: str | Path | BinaryIO, *, link_types: frozenset[int] = frozenset({ETHERNET})
) -> CaptureReader:
    """Open a pcap, pcapng or MCAP file to read its frames; the name does not matter, the contents do.

    `source` is a path, ``"-"`` for standard input, or a binary stream, read forward from where it stands and
    left open. `link_types` are those whose frames are given out.

    Raises `CaptureError` if it can not be read at all: no such file, not a capture, cut off in its header, no
    interface or channel with frames of these link types. What is found later is in `CaptureReader.problems`.
    """
    octets = open_source(source)
    try:
        return _reader(octets, link_types)
    except BaseException:
        octets.close()
        raise


def _reader(source: ByteSource, link_types: frozenset[int]) -> CaptureReader:
    start = source.more(0, _LONGEST_MAGIC)[:_LONGEST_MAGIC]
    if not start:
        raise CaptureError(f"{source.name}: {source.failure or 'is empty'}")
    if start[:4] in MAGICS:
        return PcapReader(source, link_types)
    if start.startswith(PCAPNG_MAGIC):
        return PcapngReader(source, link_types)
    raise CaptureError(f"{source.name}: {_what_else(start)}")


def _what_else(start: bytes) -> str:
    """What a file is that is no capture, from its first octets."""
    if start[:4] in MODIFIED_MAGICS:
        return "is a pcap file of the modified (Kuznetzov) kind: convert it first (editcap -F pcap)"
    for magic, what in _OTHERS.items():
        if start.startswith(magic):
            return what
    text = "".join(chr(octet) if 0x20 <= octet < 0x7F else "." for octet in start)
    return f"is not a pcap, pcapng or MCAP file: it starts with {start.hex(' ')} ({text!r})"
