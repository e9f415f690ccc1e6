"""Classic pcap files: draft-ietf-opsawg-pcap, with microseconds or nanoseconds, in either byte order."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from dcp_codec.capture.bytesource import ByteSource
from dcp_codec.capture.frame import (
    MAX_FRAME_LENGTH,
    MAX_RECORD_LENGTH,
    Frame,
)
from dcp_codec.capture.linktypes import wrong_link_type
from dcp_codec.capture.reader import CaptureReader

#: First four octets -> byte order for struct, nanoseconds per unit of the stamps.
MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}

#: Alexey Kuznetzov's variant of the 1990s, with eight more octets in each record header.
MODIFIED_MAGICS = frozenset({b"\x34\xcd\xb2\xa1", b"\xa1\xb2\xcd\x34"})

HEADER_LENGTH = 24
RECORD_HEADER_LENGTH = 16

_ZERO_HEADER = bytes(RECORD_HEADER_LENGTH)
_SECOND = 1_000_000_000
# As in libpcap: the low 26 bits are the link type, above are a flag and the length of a frame checksum.
_LINK_TYPE_MASK = 0x03FF_FFFF
_FCS_PRESENT = 0x0400_0000


class PcapReader(CaptureReader):
    """Reads a pcap file; the window of `source` starts with its magic."""

    format = "pcap"

    def __init__(self, source: ByteSource, link_types: frozenset[int]) -> None:
        super().__init__(source, link_types)
        header = source.more(0, HEADER_LENGTH)
        if len(header) < HEADER_LENGTH:
            raise self._refuse(
                f"is cut off in the header of a pcap file, which needs {HEADER_LENGTH} octets: there are {len(header)}"
            )
        self._order, self._scale = MAGICS[header[:4]]
        major, minor, _zone, _figures, snap, link = struct.unpack_from(self._order + "HHiIII", header, 4)
        if (major, minor) != (2, 4):
            raise self._refuse(
                f"is a pcap file of version {major}.{minor}; only 2.4, in use since 1998, is read "
                "(editcap of Wireshark may convert it)"
            )
        if link & _LINK_TYPE_MASK not in link_types:
            raise self._refuse(f"has {wrong_link_type(link & _LINK_TYPE_MASK, link_types)}")
        if link & _FCS_PRESENT:
            # The top four bits give the length of the checksum in units of 16 bits.
            self._metadata["pcap"] = {"fcsLength": str((link >> 28) * 2)}
        self._limit = max(MAX_FRAME_LENGTH, min(snap, MAX_RECORD_LENGTH))
        self._position = source.start = HEADER_LENGTH

    @property
    def layout(self) -> tuple[bool, int, int]:
        """Return the layout of records: whether big-endian, nanoseconds per unit of the stamps, the longest frame."""
        return self._order == ">", self._scale, self._limit

    def resume(self, position: int, frames: int) -> None:
        """Continue at octet `position`, the record after the first `frames`. Only before iterating."""
        self._source.skip(position - self._source.position)
        self._number = self._frames_read = frames
        self._position = position

    def _records(self) -> Iterator[Frame]:
        source, scale, limit = self._source, self._scale, self._limit
        unpack = struct.Struct(self._order + "IIII").unpack_from
        buffer, base, start = source.buffer, source.base, source.start
        end = len(buffer)
        number = self._number
        while True:
            body = start + RECORD_HEADER_LENGTH
            if body > end:
                buffer = source.more(start, RECORD_HEADER_LENGTH)
                base, start, body, end = source.base, 0, RECORD_HEADER_LENGTH, len(buffer)
                if body > end:
                    if end:
                        self._cut("truncated-header", base, body, end, f"the header of record {number + 1}")
                    return
            seconds, fraction, captured, length = unpack(buffer, start)
            if captured > limit:
                self._too_long(base + start, captured, limit)
                return
            stop = body + captured
            if stop > end:
                buffer = source.more(start, RECORD_HEADER_LENGTH + captured)
                base, start, body, end = source.base, 0, RECORD_HEADER_LENGTH, len(buffer)
                stop = body + captured
                if stop > end:
                    self._cut("truncated-record", base, stop, end, f"record {number + 1}")
                    return
            if not length and buffer[start:body] == _ZERO_HEADER:
                self._zero_filled(base + start)
                return
            number += 1
            self._number = self._frames_read = number
            self._position = base + stop
            yield Frame(
                number,
                seconds * _SECOND + fraction * scale,
                buffer[body:stop],
                # Some recorders state fewer octets than they captured; the captured octets are present.
                length if length > captured else captured,
                0,
                base + start,
            )
            start = stop

    def _too_long(self, offset: int, captured: int, limit: int) -> None:
        self._note(
            "bad-record-length",
            f"record {self._number + 1} at octet {offset} claims {captured} octets, more than the {limit} "
            f"that a frame of this file can have, so the file is damaged there; {self._so_far()}.",
            offset,
            needed=captured,
            available=limit,
        )

    def _zero_filled(self, offset: int) -> None:
        self._note(
            "zero-filled",
            f"there are only zeros at octet {offset}, where record {self._number + 1} should start, "
            f"as after a power cut; {self._so_far()}.",
            offset,
        )
