"""Attachments of MCAP files: listing, and extraction byte for byte."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec

from dcp_codec.capture.bytesource import READ_SIZE, ByteSource, explain, open_source
from dcp_codec.capture.frame import CaptureError

from .index import MAGIC, RECORD_HEAD, read_index

_OPCODE = 0x09
_FOOTER = 0x02
_TIMES = struct.Struct("<QQ")
_LENGTH = struct.Struct("<I")
_SIZE = struct.Struct("<Q")
_CRC = struct.Struct("<I")
#: Octets of a name or a media type; a longer one counts as damage.
_MAX_TEXT = 65_536
_MAX_HEAD = _TIMES.size + 2 * (_LENGTH.size + _MAX_TEXT) + _SIZE.size


class Attachment(msgspec.Struct, frozen=True):
    """A file inside an MCAP file."""

    name: str
    media_type: str
    #: Size of the file in octets.
    size: int
    #: Nanoseconds since the Unix epoch; 0 if unknown.
    log_time: int
    create_time: int
    #: Offset of the content of its record in the MCAP file, in octets.
    offset: int


def attachments(path: str | Path) -> list[Attachment]:
    """Return the attachments of an MCAP file in their order, also of an unfinished file.

    An attachment that is cut off is left out. The index tells the places after damage. Raises `CaptureError` if the
    file is not an MCAP file.
    """
    source = open_source(path)
    try:
        found = {each.offset: each for each in _scan(source)}
    finally:
        source.close()
    index = read_index(path)
    for place in index.attachments if index is not None else ():
        start = place.offset + RECORD_HEAD.size
        if start not in found:
            source = open_source(path)
            try:
                source.skip(start)
                each = read_head(source, place.length - RECORD_HEAD.size)
            finally:
                source.close()
            if each is not None:
                found[start] = each
    return [found[offset] for offset in sorted(found)]


def extract_attachment(path: str | Path, attachment: Attachment, target: str | Path) -> None:
    """Write an attachment of the MCAP file `path` to the file `target`, which is replaced only when complete.

    Raises `CaptureError` if the attachment does not match its checksum or its description, or if `target` cannot be
    written.
    """
    source = open_source(path)
    part = Path(f"{target}.part")
    try:
        source.skip(attachment.offset)
        with part.open("wb") as stream:
            start = source.position
            found = read_head(source, _MAX_HEAD + attachment.size)
            if found != attachment:
                raise CaptureError(f"{path}: has no attachment {attachment.name!r} at octet {start}")
            crc = zlib.crc32(source.buffer[source.start - (source.position - start) : source.start])
            left = attachment.size
            while left:
                piece = source.take(min(left, READ_SIZE))
                if not piece:
                    raise CaptureError(f"{path}: ends within the attachment {attachment.name!r}")
                stream.write(piece)
                crc = zlib.crc32(piece, crc)
                left -= len(piece)
        expected = source.take(_CRC.size)
        # 0 means that the writer made no checksum.
        if any(expected) and expected != _CRC.pack(crc):
            raise CaptureError(f"{path}: the attachment {attachment.name!r} does not match its checksum")
        part.replace(target)
    except (OSError, ValueError) as error:
        raise CaptureError(f"{target}: cannot be written: {explain(error)}") from error
    finally:
        source.close()
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _scan(source: ByteSource) -> Iterator[Attachment]:
    if source.take(len(MAGIC)) != MAGIC:
        raise CaptureError(f"{source.name}: {source.failure or 'is not an MCAP file'}")
    while source.need(RECORD_HEAD.size) >= RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(source.take(RECORD_HEAD.size))
        end = source.position + length
        found = read_head(source, length) if opcode == _OPCODE else None
        left = end - source.position
        if opcode in (0, _FOOTER) or source.skip(left) < left:
            return
        if found is not None:
            yield found


def read_head(source: ByteSource, length: int) -> Attachment | None:
    """Return the fields before the octets of an attachment, in a record with `length` octets; None if they are invalid.

    Moves the cursor to their end.
    """
    offset = source.position
    # Request the whole head, so that it stays in the window.
    have = min(source.need(min(length, _MAX_HEAD)), length)
    buffer, start = source.buffer, source.start
    stop = start + have
    at = start + _TIMES.size
    texts = []
    for _ in ("name", "media type"):
        if at + _LENGTH.size > stop:
            return None
        (size,) = _LENGTH.unpack_from(buffer, at)
        at += _LENGTH.size
        if size > _MAX_TEXT or at + size > stop:
            return None
        texts.append(buffer[at : at + size].decode("utf-8", "replace"))
        at += size
    if at + _SIZE.size > stop:
        return None
    (size,) = _SIZE.unpack_from(buffer, at)
    at += _SIZE.size
    if size > length - (at - start) - _CRC.size:
        return None
    log_time, create_time = _TIMES.unpack_from(buffer, start)
    source.start = at
    return Attachment(texts[0], texts[1], size, log_time, create_time, offset)
