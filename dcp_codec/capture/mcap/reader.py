"""MCAP files (mcap.dev/spec), read from start to end, finished or not.

The readers of the mcap library need the summary at the end of the file, which is missing after a crash, or raise before
all readable data was returned; and they accept a short read as complete. Therefore this module splits the stream into
records and checks their lengths; the library parses the contents of a record.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Callable, Iterator
from io import BytesIO
from operator import attrgetter
from typing import Final, Never, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from dcp_codec.capture.bytesource import READ_SIZE, ByteSource
from dcp_codec.capture.checksum import crc32
from dcp_codec.capture.frame import MAX_RECORD_LENGTH, MAX_TIME_NS, Frame
from dcp_codec.capture.linktypes import link_type_name
from dcp_codec.capture.reader import CaptureReader, counted

from . import raw_frame as rawframe
from . import raw_json as rawjson
from .chunk import MAX_CHUNK_LENGTH, Chunk, ChunkError, Unpacker
from .index import FOOTER, MAGIC, RECORD_HEAD, read_index, read_record
from .original import read_original

#: Maximum number of metadata records kept from one file.
MAX_METADATA = 1_000

_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_DATA_END = struct.Struct("<I")  # checksum of the data section

#: Records that are read as a whole; all others except chunks are skipped.
_READ = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA, Opcode.DATA_END, Opcode.FOOTER})
_KNOWN = frozenset(Opcode)
_FIRST_PRIVATE = 0x80  # opcodes from here on are for private use

_Record = TypeVar("_Record", Schema, Channel, Metadata)

#: Decoders of raw frames, by the message encoding of their channel.
DECODERS: Final = {rawframe.MESSAGE_ENCODING: rawframe.decode, rawjson.MESSAGE_ENCODING: rawjson.decode}


class _End(Exception):  # noqa: N818 - not an error
    """Reading is complete; a problem, if any, has been noted."""


class McapReader(CaptureReader):
    """Reads an MCAP file; the window of `source` starts with its magic.

    Opening reads up to the first channel of raw frames, so that a file without one is refused.
    """

    format = "mcap"

    def __init__(
        self, source: ByteSource, link_types: frozenset[int], allocate: Callable[[int], memoryview] | None = None
    ) -> None:
        super().__init__(source, link_types)
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, str] = {}
        #: Channels with raw frames, and their decoders.
        self._raw: dict[int, Callable[[bytes | memoryview], rawframe.RawFrame]] = {}
        self._unpacker = Unpacker() if allocate is None else Unpacker(allocate)
        # Over the data section, and after it over the summary section.
        self._crc = 0
        #: The index of a regular file. Its descriptions are copies, in case those before the frames are damaged.
        self._index = read_index(source.name) if source.indexed else None
        for opcode, content in self._index.descriptions if self._index is not None else ():
            self._describes(opcode, memoryview(content), -1)
        self._events = self._scan()
        if self._raw:
            return
        # The first event is always the description of a channel of raw frames. A file that is cut off before any
        # channel is accepted, like one that is cut off after it.
        if next(self._events, False) is False and (self._topics or not self._log.found):
            topics = ", ".join(sorted(set(self._topics.values()))) or "none"
            raise self._refuse(
                f"is an MCAP file without raw frames (schema {rawframe.SCHEMA_NAME}, "
                f"encoding {' or '.join(DECODERS)}); its topics: {topics}"
            )

    def _records(self) -> Iterator[Frame]:
        for event in self._events:
            if event is not None:
                self._frames_read += 1
                yield event

    def _scan(self) -> Iterator[Frame | None]:
        """Yield frames, and None once, after the description of the first channel with raw frames."""
        self._crc = crc32(self._source.take(len(MAGIC)))
        try:
            while True:
                yield from self._record()
        except _End:
            self._position = self._source.position

    def _record(self) -> Iterator[Frame | None]:
        """Read one record of the file itself. Raises `_End` after the last."""
        source = self._source
        offset = self._position = source.position
        have = source.need(RECORD_HEAD.size)
        if have < RECORD_HEAD.size:
            self._end_early(offset, have)
        opcode, length = RECORD_HEAD.unpack_from(source.buffer, source.start)
        head = source.take(RECORD_HEAD.size)
        if opcode == 0:
            yield from self._by_index(offset)
            if any(head):
                self._damaged("bad-record", offset, "no record")
            else:
                self._damaged("zero-filled", offset, "only zeros, as after a power cut,")
            raise _End
        if self._is_misplaced(opcode, length, offset):
            yield from self._by_index(offset)
        before = self._crc
        self._crc = crc32(head, before)
        if opcode == Opcode.CHUNK and length <= MAX_CHUNK_LENGTH:
            yield from self._chunk(source.take(length), offset, length)
        elif opcode in _READ and length <= MAX_RECORD_LENGTH:
            content = source.take(length)
            if len(content) < length:
                self._truncated(opcode, offset, length, len(content))
            if opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                yield from self._inside(head + content, offset)
            elif opcode == Opcode.METADATA:
                self._keep_metadata(content, offset)
            elif opcode == Opcode.DATA_END:
                self._check(_DATA_END, content, before, "data section", offset)
                self._crc = 0
                return
            else:
                self._footer(content, offset)
            self._crc = crc32(content, self._crc)
        else:
            self._pass_over(opcode, offset, length)

    # Where the file ends.

    def _end_early(self, offset: int, have: int) -> Never:
        if have or self._source.failure:
            self._cut("truncated-header", offset, RECORD_HEAD.size, have, "the header of a record")
        else:
            self._note(
                "unfinished",
                f"the file ends at octet {offset} without the footer of a finished MCAP file; {self._so_far()}.",
                offset,
            )
        raise _End

    def _truncated(self, opcode: int, offset: int, length: int, have: int, rest: str = "") -> Never:
        head = RECORD_HEAD.size
        self._cut("truncated-record", offset, head + length, head + have, _name(opcode), rest)
        raise _End

    def _footer(self, content: bytes, offset: int) -> Never:
        self._check(FOOTER, content, crc32(content[: FOOTER.size - 4], self._crc), "summary section", offset)
        source = self._source
        end = source.position
        magic = source.take(len(MAGIC))
        if len(magic) < len(MAGIC):
            self._cut("truncated-record", end, len(MAGIC), len(magic), "the mark at the end of the file")
        elif magic != MAGIC:
            self._damaged("bad-record", end, f"{magic.hex(' ')} instead of the mark at the end of the file")
        elif source.need(1):
            self._note(
                "trailing-data",
                f"something follows the end of the MCAP file at octet {source.position}; {self._so_far()}.",
                source.position,
            )
        raise _End

    def _check(self, layout: struct.Struct, content: bytes, actual: int, what: str, offset: int) -> None:
        """Compare the checksum that ends `content`; 0 means that the writer made none."""
        if len(content) < layout.size:
            self._bad_record(offset, f"{len(content)} octets are too few")
            return
        expected = layout.unpack_from(content)[-1]
        if expected and expected != actual:
            self._note(
                "bad-crc",
                f"the {what} that ends at octet {offset} does not match its checksum: some of its "
                f"octets are damaged; {self._so_far()}.",
                offset,
            )

    def _pass_over(self, opcode: int, offset: int, length: int) -> None:
        if opcode == Opcode.CHUNK or opcode in _READ:
            text = f" too large to be read passed over, the first at octet {offset} with {length} octets."
            self._tally("too-large", "record", text, offset)
        elif opcode not in _KNOWN and opcode < _FIRST_PRIVATE:
            text = f" of the unknown type {opcode:#04x}, the first at octet {offset}, passed over."
            self._tally("unknown-record", "record", text, offset, of=opcode)
        left = length
        while left:
            piece = self._source.take(min(left, READ_SIZE))
            if not piece:
                self._truncated(opcode, offset, length, length - left)
            self._crc = crc32(piece, self._crc)
            left -= len(piece)

    # Contents of records.

    def _chunk(self, content: bytes, offset: int, length: int) -> Iterator[Frame | None]:
        try:
            chunk = self._unpacker.open(content, length)
        except ChunkError as error:
            yield from self._damaged_chunk(error, content, offset, length)
        else:
            before = self._frames_read
            where = -1 if chunk.start < 0 else offset + RECORD_HEAD.size + chunk.start
            yield from self._inside(chunk.records, where, whole=len(content) == length)
            if len(content) < length:
                rest = f"{self._so_far()}, {self._frames_read - before} of them from that chunk"
                self._truncated(Opcode.CHUNK, offset, length, len(content), rest)
        self._crc = crc32(content, self._crc)

    def _damaged_chunk(self, error: ChunkError, content: bytes, offset: int, length: int) -> Iterator[Frame | None]:
        """Read a chunk that is damaged or cannot be unpacked: from the attached original file, or in part."""
        if self._index is not None and self._index.attachments and self._frames_read == self._number:
            original = read_original(self._source.name, self._index, self._link_types, self._number)
            if original is not None:
                self._note(
                    error.reason,
                    f"the chunk at octet {offset} {error}: it and the rest are read from the original file that is "
                    f"attached ({original.name}); {self._so_far()}.",
                    offset,
                )
                for frame in original.frames:
                    self._number = frame.number
                    yield from self._given(frame)
                raise _End
        before = self._frames_read
        try:
            chunk = self._unpacker.open(content, length, check=False)
        except ChunkError:
            chunk = Chunk(b"", -1)
        where = -1 if chunk.start < 0 else offset + RECORD_HEAD.size + chunk.start
        yield from self._inside(chunk.records, where, whole=False)
        read = self._frames_read - before
        what = f"{counted(read, 'frame')} of it read all the same" if read else "passed over"
        text = f" damaged, the first at octet {offset} with {length} octets: it {error}; {what}."
        self._tally(error.reason, "chunk", text, offset)

    def _given(self, frame: Frame) -> Iterator[Frame]:
        """Yield a frame that does not come from a message."""
        yield frame

    def _is_misplaced(self, opcode: int, length: int, offset: int) -> bool:
        """Return whether the head of a record contradicts the index, so that the next record cannot be found."""
        if self._index is None or not self._index.chunks:
            return False
        # The chunks are many in a long recording, and so are the records between them.
        chunks = self._index.chunks
        place = bisect_left(chunks, offset, key=attrgetter("offset"))
        if place < len(chunks) and chunks[place].offset == offset:
            return opcode != Opcode.CHUNK or length != chunks[place].length - RECORD_HEAD.size
        # Some record must begin at the offset of each later chunk.
        return place < len(chunks) and offset + RECORD_HEAD.size + length > chunks[place].offset

    def _by_index(self, offset: int) -> Iterator[Frame | None]:
        """Read the chunks from `offset` on at their places in the index, and end; nothing without any."""
        places = [each for each in self._index.chunks if each.offset >= offset] if self._index is not None else []
        if not places:
            return
        self._note(
            "bad-record",
            f"the record at octet {offset} is damaged; {counted(len(places), 'chunk')} after it read by the index at "
            f"the end of the file; {self._so_far()}.",
            offset,
        )
        for place in places:
            content = read_record(self._source.name, place)
            yield from self._chunk(content, place.offset, place.length - RECORD_HEAD.size)
        raise _End

    def _inside(
        self, records: bytes | memoryview, base: int, *, whole: bool = True, position: int = 0
    ) -> Iterator[Frame | None]:
        """Read the records of a chunk from `position` on; `base` is its offset in the file, -1 if it has none."""
        view, end, head = memoryview(records), len(records), RECORD_HEAD.size
        while end - position >= head:
            opcode, length = RECORD_HEAD.unpack_from(view, position)
            start = position + head
            if not whole and opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                # The length may be the damaged field: descriptions tell their own length.
                length = _own_length(opcode, view[start:], length)
            stop = start + length
            if stop > end:
                break
            offset = base if base < 0 else base + position
            if opcode == Opcode.MESSAGE:
                frame = self._frame(view[start:stop], offset)
                if frame is not None:
                    yield frame
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and self._describes(opcode, view[start:stop], offset):
                yield None
            position = stop
        if whole and position != end:
            self._bad_record(base, f"{end - position} octets at the end of a chunk are not a record")

    def _frame(self, content: memoryview, offset: int) -> Frame | None:
        """Return the frame of a message; None if the message has another type or its link type is not wanted."""
        if len(content) < _MESSAGE_HEAD.size:
            self._bad_record(offset, f"a message of {len(content)} octets")
            return None
        channel, _sequence, log_time, _publish_time = _MESSAGE_HEAD.unpack_from(content)
        decode = self._raw.get(channel)
        if decode is None:
            if channel not in self._topics:
                self._bad_record(offset, f"a message on channel {channel}, which nothing describes")
            return None
        try:
            message = decode(content[_MESSAGE_HEAD.size :])
        except ValueError as error:
            self._bad_message(error, offset)
            return None
        if message.link_type not in self._link_types:
            self._wrong_link_type(message.link_type, offset)
            return None
        self._number = message.number or self._number + 1
        time_ns = log_time if message.time_ns is None else message.time_ns
        if time_ns > MAX_TIME_NS:
            time_ns = self._clamped(time_ns, offset)
        return Frame(
            self._number,
            time_ns,
            message.data,
            max(message.orig_len, len(message.data)),
            message.interface,
            offset,
        )

    def _describes(self, opcode: int, content: memoryview, offset: int) -> bool:
        """Process a schema or channel; return whether it is the first channel of raw frames."""
        if opcode == Opcode.SCHEMA:
            schema = self._parse(Schema, content, offset)
            # One of two copies may be damaged.
            if schema is not None and self._schemas.get(schema.id) != rawframe.SCHEMA_NAME:
                self._schemas[schema.id] = schema.name
            return False
        channel = self._parse(Channel, content, offset)
        if channel is None:
            return False
        self._topics[channel.id] = channel.topic
        first = not self._raw
        decode = DECODERS.get(channel.message_encoding)
        if decode is not None and self._schemas.get(channel.schema_id) == rawframe.SCHEMA_NAME:
            self._raw[channel.id] = decode
        return first and bool(self._raw)

    def _keep_metadata(self, content: bytes, offset: int) -> None:
        record = self._parse(Metadata, memoryview(content), offset)
        if record is not None and (len(self._metadata) < MAX_METADATA or record.name in self._metadata):
            self._metadata[record.name] = record.metadata

    def _parse(self, kind: type[_Record], content: memoryview, offset: int) -> _Record | None:
        try:
            record: _Record = kind.read(ReadDataStream(BytesIO(content)))
        except (McapError, struct.error, ValueError) as error:
            self._bad_record(offset, f"{kind.__name__.lower()}: {error or 'it is cut off'}")
            return None
        return record

    # Problems of single records. They are counted and never end the reading.

    def _bad_record(self, offset: int, why: str) -> None:
        text = f" damaged and passed over, the first {_place(offset)} ({why})."
        self._tally("bad-record", "record", text, offset)

    def _bad_message(self, error: Exception, offset: int) -> None:
        text = f" that should be raw frames passed over, the first {_place(offset)} ({error})."
        self._tally("bad-message", "message", text, offset)

    def _wrong_link_type(self, link_type: int, offset: int) -> None:
        text = f" passed over, the first {_place(offset)}: the link type is {link_type_name(link_type)}."
        self._tally("wrong-link-type", "frame", text, offset, of=link_type)


def _own_length(opcode: int, content: memoryview, length: int) -> int:
    """Return the length of a schema or channel at the start of ``content``; ``length`` if it cannot be read."""
    stream = ReadDataStream(BytesIO(content))
    try:
        (Schema if opcode == Opcode.SCHEMA else Channel).read(stream)
    except (McapError, struct.error, ValueError):
        return length
    return int(stream.count)


def _place(offset: int) -> str:
    return "inside a compressed chunk" if offset < 0 else f"at octet {offset}"


def _name(opcode: int) -> str:
    kind = Opcode(opcode).name.lower().replace("_", " ") if opcode in _KNOWN else f"of type {opcode:#04x}"
    return f"a record ({kind})"
