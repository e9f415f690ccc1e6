"""Opening of captures. The first octets of an input determine its format; the suffix or the caller that of an
output.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, Literal

from .bytesink import open_sink, same_file
from .bytesource import ByteSource, open_source
from .compressed import decompressed, without_compression
from .frame import ETHERNET, CaptureError
from .mcap.index import MAGIC
from .pcap.reader import MAGICS, MODIFIED_MAGICS, PcapReader
from .pcap.writer import PcapWriter
from .pcapng.reader import PcapngReader
from .pcapng.writer import PcapngWriter
from .reader import CaptureReader
from .writer import CaptureWriter, MessageSource, Metadata

PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"

FORMATS = ("pcap", "pcapng", "mcap")
#: Suffix of a file -> format to write.
SUFFIXES: Mapping[str, str] = {".pcap": "pcap", ".cap": "pcap", ".pcapng": "pcapng", ".mcap": "mcap"}

#: First octets of files that are mistaken for captures -> description and remedy.
_OTHERS = {
    b"\x1f\x8b": "is gzip-compressed twice: decompress it first (gunzip)",
    b"\x28\xb5\x2f\xfd": "is zstd-compressed twice: decompress it first (unzstd)",
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


def open_capture(source: str | Path | BinaryIO, *, link_types: frozenset[int] = frozenset({ETHERNET})) -> CaptureReader:
    """Open a pcap, pcapng or MCAP file to read its frames; the name does not matter, the contents do.

    A file that is compressed as a whole with gzip or zstd is decompressed on the way.

    `source` is a path, ``"-"`` for standard input, or a binary stream, which is read from its current position and left
    open. Frames of other link types than `link_types` are skipped.

    Raises `CaptureError` if it cannot be read at all: no such file, not a capture, cut off in its header, no interface
    or channel with frames of these link types. Later problems are in `CaptureReader.problems`.
    """
    octets = open_source(source)
    try:
        octets = decompressed(octets)
        return _reader(octets, link_types)
    except BaseException:
        octets.close()
        raise


def create_capture(
    target: str | Path | BinaryIO,
    *,
    format: str | None = None,
    resolution: Literal["ns", "us"] = "ns",
    metadata: Metadata | None = None,
    messages: MessageSource | None = None,
    attachment: Path | None = None,
    compression: Literal["zstd", "lz4", "none"] = "zstd",
    lossy: bool = False,
    whole: bool = False,
) -> CaptureWriter:
    """Create a pcap, pcapng or MCAP file to write frames to.

    `target` is a path, ``"-"`` for standard output, or a binary stream, which is left open; it need not be seekable. An
    existing file is only touched after all other checks. `format` is "pcap", "pcapng" or "mcap", and may be left out
    for a path with one of the `SUFFIXES`.

    `resolution` is the unit of the stamps, and `lossy` permits the loss of data that the format cannot hold
    (nanoseconds with the resolution "us", `Frame.interface` in pcap). `metadata` may change while frames are written:
    pcapng looks up an interface when it first occurs, MCAP writes new entries at the end. `messages`, `attachment` (a
    file that is attached byte for byte) and `compression` of the chunks are for MCAP only.

    A path that ends with ``.gz`` or ``.zst`` is compressed. With `whole` the file appears at `target` when it is
    closed, and not at all if the with-block ends with an exception; without, it grows there.

    Raises `CaptureError` if the file cannot be created, the format is unknown, or the format does not support an
    option.
    """
    name = target if isinstance(target, (str, Path)) else getattr(target, "name", "<stream>")
    kind = format or _format_of(target)
    if kind not in FORMATS:
        known = ", ".join(FORMATS)
        raise CaptureError(f"{name}: {kind!r} is not a format that can be written; there are {known}")
    if resolution not in ("ns", "us"):
        raise ValueError(f"resolution {resolution!r} is neither 'ns' nor 'us'")
    about: Metadata = {} if metadata is None else metadata
    if kind == "mcap":
        if resolution != "ns":
            raise CaptureError(f"{name}: MCAP has nanoseconds and nothing else")
        return _create_mcap(target, about, messages, attachment, compression, whole=whole)
    if messages is not None or attachment is not None:
        raise CaptureError(f"{name}: only MCAP has a place for messages and attachments, not {kind}")
    sink = open_sink(target, whole=whole)
    try:
        if kind == "pcap":
            return PcapWriter(sink, resolution, lossy=lossy)
        return PcapngWriter(sink, resolution, about, lossy=lossy)
    except BaseException:
        sink.abandon()
        sink.close()
        raise


def _create_mcap(
    target: str | Path | BinaryIO,
    metadata: Metadata,
    messages: MessageSource | None,
    attachment: Path | None,
    compression: Literal["zstd", "lz4", "none"],
    *,
    whole: bool,
) -> CaptureWriter:
    from .mcap.writer import COMPRESSIONS, McapWriter, OpenAttachment

    if compression not in COMPRESSIONS:
        raise ValueError(f"unknown compression {compression!r}; expected one of {', '.join(COMPRESSIONS)}")
    if attachment is not None and same_file(attachment, target):
        raise CaptureError(f"{attachment}: cannot be attached to itself")
    original = None if attachment is None else OpenAttachment(attachment)
    try:
        sink = open_sink(target, whole=whole)
        try:
            return McapWriter(sink, metadata, messages, original, compression)
        except BaseException:
            sink.abandon()
            sink.close()
            raise
    except BaseException:
        if original is not None:
            original.close()
        raise


def _format_of(target: str | Path | BinaryIO) -> str:
    if not isinstance(target, (str, Path)) or target == "-":
        raise CaptureError("standard output and streams have no suffix that names the format: give it (--format)")
    suffix = without_compression(target).suffix.lower()
    if suffix not in SUFFIXES:
        known = ", ".join(SUFFIXES)
        raise CaptureError(
            f"{target}: the suffix names no format (known: {known}); change it, or give the format (--format)"
        )
    return SUFFIXES[suffix]


def _reader(source: ByteSource, link_types: frozenset[int]) -> CaptureReader:
    start = source.more(0, _LONGEST_MAGIC)[:_LONGEST_MAGIC]
    if not start:
        raise CaptureError(f"{source.name}: {source.failure or 'is empty'}")
    if start[:4] in MAGICS:
        return PcapReader(source, link_types)
    if start.startswith(PCAPNG_MAGIC):
        return PcapngReader(source, link_types)
    if start.startswith(MAGIC):
        # Imported here, so that users without MCAP files do not pay for importing the library.
        from .mcap.reader import McapReader

        return McapReader(source, link_types)
    raise CaptureError(f"{source.name}: {_describe_other_file(start)}")


def _describe_other_file(start: bytes) -> str:
    """Describe a file that is not a capture, by its first octets."""
    if start[:4] in MODIFIED_MAGICS:
        return "is a pcap file of the modified (Kuznetzov) kind: convert it first (editcap -F pcap)"
    for magic, what in _OTHERS.items():
        if start.startswith(magic):
            return what
    text = "".join(chr(octet) if 0x20 <= octet < 0x7F else "." for octet in start)
    return f"is not a pcap, pcapng or MCAP file: it starts with {start.hex(' ')} ({text!r})"
