"""Rewriting of the end of an MCAP file, for attachments that the library did not write itself."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, DataEnd, Footer, McapRecord, Statistics, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

_FOOTER_LENGTH = 20


def add_attachments(tail: bytes, start: int, indexes: list[AttachmentIndex]) -> bytes:
    """Return `tail` with the index of attachments, their number, and updated offsets and checksum.

    `tail` is the output of the library's `Writer.finish`: end of data, summary section, footer, magic. `start` is its
    offset in the file.
    """
    groups: dict[type[McapRecord], list[McapRecord]] = {}
    for record in StreamReader(BytesIO(tail), skip_magic=True).records:
        groups.setdefault(type(record), []).append(record)
    for kind in (Footer, SummaryOffset):
        groups.pop(kind, None)
    (statistics,) = groups[Statistics]
    assert isinstance(statistics, Statistics)
    statistics.attachment_count += len(indexes)
    groups.setdefault(AttachmentIndex, []).extend(indexes)

    builder: Any = RecordBuilder()  # its methods are not all typed
    for record in groups.pop(DataEnd):
        record.write(builder)
    summary_start = start + builder.count
    data_end: bytes = builder.end()

    offsets = []
    for records in groups.values():
        group_start = builder.count
        for record in records:
            record.write(builder)
        offsets.append((group_start, builder.count))
    offsets_start = summary_start + builder.count
    summary: bytes = builder.end()
    for first, end in offsets:
        # The first octet of a record is the opcode of its group.
        SummaryOffset(group_opcode=summary[first], group_start=summary_start + first, group_length=end - first).write(
            builder
        )
    summary += builder.end()
    # The checksum covers the footer's fields before the checksum.
    footer = struct.pack("<BQQQ", Opcode.FOOTER, _FOOTER_LENGTH, summary_start, offsets_start)
    crc = zlib.crc32(footer, zlib.crc32(summary))
    return data_end + summary + footer + struct.pack("<I", crc) + MCAP0_MAGIC
