"""Chunks of MCAP files: their heads, their compression, and the readable part of one that is cut off."""

from __future__ import annotations

import struct
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from dcp_codec.capture.checksum import crc32
from dcp_codec.capture.frame import Reason

#: The largest chunk, packed or unpacked, that is held in memory, in octets; larger ones are skipped. Writers make
#: chunks of about a megabyte at most, unless one message is larger.
MAX_CHUNK_LENGTH = 256 * 1024 * 1024

_PIECE = 1024 * 1024
# Start and end time, unpacked size, checksum of the unpacked records, length of the name of the compression.
_HEAD = struct.Struct("<QQQII")
_RECORDS_LENGTH = struct.Struct("<Q")
#: The first octets of compressed records, which are at most ``_FAR`` octets after the head.
_MARKS = {b"\x28\xb5\x2f\xfd": "zstd", b"\x04\x22\x4d\x18": "lz4"}
_FAR = 64
#: Maximum size of the records of a damaged chunk, as a multiple of the compressed size.
_MOST_RATIO = 64


class ChunkError(Exception):
    """A chunk that cannot be read: `reason` as in `CaptureProblem`, the message is a half sentence."""

    def __init__(self, reason: Reason, message: str) -> None:
        super().__init__(message)
        self.reason = reason


#: Function that returns writable memory of a given number of octets.
Allocate = Callable[[int], memoryview]


class Chunk(NamedTuple):
    """The records of a chunk, unpacked."""

    records: bytes | memoryview
    #: Offset of the records within the content of the chunk record, -1 if they are compressed.
    start: int


def _fresh(size: int) -> memoryview:
    return memoryview(bytearray(size))


class Unpacker:
    """Unpacks the chunks of one file into memory from `allocate`. Not thread-safe."""

    def __init__(self, allocate: Allocate = _fresh) -> None:
        self._allocate = allocate
        # Kept, since creating a zstandard decompressor takes longer than unpacking a chunk.
        self._zstd: Any = None

    def open(self, content: bytes, length: int, *, check: bool = True) -> Chunk:
        """Unpack the chunk record of `length` octets whose present part is `content`.

        Raises `ChunkError` if a complete one is damaged. For one that is cut off, returns as much as can be unpacked,
        without a check; so it does if not ``check``, and then neither trusts the fields of the head.
        """
        whole = check and len(content) == length
        try:
            size, crc, compression, start, stop = _head(content, length) if check else _damaged_head(content)
        except ChunkError:
            if whole:
                raise
            return Chunk(b"", -1)
        packed = content[start:stop]
        records = self._unpack(compression, packed, size, whole=whole) if compression else packed
        if whole:
            if len(records) != size:
                raise ChunkError("bad-compression", f"does not have the {size} octets unpacked that it claims")
            if crc and crc32(records) != crc:
                raise ChunkError("bad-crc", "does not match its checksum")
        return Chunk(records, -1 if compression else start)

    def _unpack(self, compression: str, packed: bytes, size: int, *, whole: bool) -> memoryview:
        """Unpack data that should give `size` octets; more are an error, so a small chunk cannot fill the memory."""
        read_into = self._reader(compression, packed)
        # One octet more, to detect a chunk with more data than it states.
        memory, used = self._allocate(size + 1), 0
        try:
            while used <= size and (count := read_into(memory[used:])):
                used += count
        except Exception as error:
            # zstandard and lz4 raise their own classes, whose only common base is Exception.
            if whole:
                raise ChunkError("bad-compression", f"cannot be unpacked ({error})") from error
        return memory[:used]

    def _reader(self, compression: str, packed: bytes) -> Callable[[memoryview], int]:
        """Return a function that fills memory with the next octets and returns their number, 0 at the end."""
        try:
            if compression == "zstd":
                import zstandard

                if self._zstd is None:
                    self._zstd = zstandard.ZstdDecompressor()
                read: Callable[[memoryview], int] = self._zstd.stream_reader(packed, read_across_frames=True).readinto
                return read
            if compression == "lz4":
                # Imported by name: lz4 has no type stubs.
                unpacker = import_module("lz4.frame").LZ4FrameDecompressor()
                given = [packed]

                def read_lz4(memory: memoryview) -> int:
                    if unpacker.eof:
                        return 0
                    piece: bytes = unpacker.decompress(given.pop() if given else b"", min(len(memory), _PIECE))
                    memory[: len(piece)] = piece
                    return len(piece)

                return read_lz4
        except ImportError as error:
            raise ChunkError("bad-compression", f"is packed with {compression}, for which {error}") from error
        raise ChunkError("bad-compression", f"is packed with {compression!r}, which is not known")


def _damaged_head(content: bytes) -> tuple[int, int, str, int, int]:
    """Return the same as `_head` for a damaged chunk: its records begin with the mark of a compression, if it has one.

    Raises `ChunkError` if the chunk is too short.
    """
    if len(content) < _HEAD.size:
        raise ChunkError("bad-record", "is too short for its head")
    marks = {content.find(mark, _HEAD.size, _HEAD.size + _FAR): name for mark, name in _MARKS.items()}
    start, compression = max(marks.items())
    if start < 0:
        # The name of no compression is empty.
        start, compression = _HEAD.size + _RECORDS_LENGTH.size, ""
    # A small chunk must not fill the memory.
    return min(_MOST_RATIO * len(content) + _PIECE, MAX_CHUNK_LENGTH), 0, compression, start, len(content)


def _head(content: bytes, length: int) -> tuple[int, int, str, int, int]:
    """Return unpacked size, checksum, compression, and the bounds of the records in `content`."""
    if len(content) < _HEAD.size:
        raise ChunkError("bad-record", "is too short for its head")
    _first, _last, size, crc, name_length = _HEAD.unpack_from(content)
    start = _HEAD.size + name_length + _RECORDS_LENGTH.size
    if start > len(content):
        raise ChunkError("bad-record", "is too short for its head")
    name = content[_HEAD.size : _HEAD.size + name_length]
    (records_length,) = _RECORDS_LENGTH.unpack_from(content, start - _RECORDS_LENGTH.size)
    if records_length > length - start:
        raise ChunkError("bad-record", f"claims {records_length} octets of records in {length - start}")
    if size > MAX_CHUNK_LENGTH:
        raise ChunkError("too-large", f"has {size} octets unpacked, and {MAX_CHUNK_LENGTH} is the most that is read")
    return size, crc, name.decode("utf-8", "replace"), start, start + records_length
