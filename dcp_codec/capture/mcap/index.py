"""The index at the end of an MCAP file: the places of chunks and attachments, and copies of schemas and channels.

It allows a reader to continue after damage. An index that does not match its checksum is not used.
"""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import NamedTuple

from dcp_codec.capture.checksum import crc32

#: Start and end of a file.
MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length of the content of a record.
RECORD_HEAD = struct.Struct("<BQ")
FOOTER = struct.Struct("<QQI")  # where the summary and its offsets start, checksum of the summary section
_PLACE = struct.Struct("<QQ")  # offset and length of a record with its head
#: Opcodes: the list of attachments does not need the mcap library.
_SCHEMA, _CHANNEL, _CHUNK_INDEX, _ATTACHMENT_INDEX = 0x03, 0x04, 0x08, 0x0A
#: Octets before the place of a chunk in a record of the index.
_TIMES = 16
#: Maximum length of an index that is held in memory, in octets.
_MOST = 64 * 1024 * 1024


class Place(NamedTuple):
    """A record in the file; ``length`` has its head, too."""

    offset: int
    length: int


class Index(NamedTuple):
    """The records of the summary section that help to read a damaged file."""

    chunks: tuple[Place, ...]
    attachments: tuple[Place, ...]
    descriptions: tuple[tuple[int, bytes], ...]
    """Schemas and channels: opcode and content."""


def read_index(path: str | Path) -> Index | None:
    """Return the index of a regular file; None if it has none, or a damaged one."""
    try:
        with Path(path).open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            end = size - len(MAGIC) - FOOTER.size
            if end < len(MAGIC):
                return None
            file.seek(end)
            footer = file.read(FOOTER.size)
            start, _, expected = FOOTER.unpack(footer)
            head = end - RECORD_HEAD.size
            if not len(MAGIC) <= start <= head or head - start > _MOST:
                return None
            file.seek(start)
            summary = file.read(end - start)
    except (OSError, ValueError, struct.error):
        return None
    if expected and crc32(summary + footer[: FOOTER.size - 4]) != expected:
        return None
    return _parsed(summary[: head - start])


def _parsed(summary: bytes) -> Index:
    chunks, attachments, descriptions = [], [], []
    position = 0
    while position + RECORD_HEAD.size <= len(summary):
        opcode, length = RECORD_HEAD.unpack_from(summary, position)
        content = summary[position + RECORD_HEAD.size : position + RECORD_HEAD.size + length]
        position += RECORD_HEAD.size + length
        if len(content) < length:
            break
        if opcode == _CHUNK_INDEX and length >= _TIMES + _PLACE.size:
            chunks.append(Place(*_PLACE.unpack_from(content, _TIMES)))
        elif opcode == _ATTACHMENT_INDEX and length >= _PLACE.size:
            attachments.append(Place(*_PLACE.unpack_from(content)))
        elif opcode in (_SCHEMA, _CHANNEL):
            descriptions.append((opcode, content))
    return Index(tuple(sorted(chunks)), tuple(sorted(attachments)), tuple(descriptions))


def read_record(path: str | Path, place: Place) -> bytes:
    """Return the content of a record, without its head; shorter if the file ends before."""
    with Path(path).open("rb") as file:
        file.seek(place.offset + RECORD_HEAD.size)
        return file.read(max(place.length - RECORD_HEAD.size, 0))
