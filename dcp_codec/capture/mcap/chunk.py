"""Chunks of MCAP files: their heads, their compression, and what is left of one that is cut off."""

from __future__ import annotations

import struct
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from dcp_codec.capture.checksum import crc32
from dcp_codec.capture.frame import Reason

#: Octets of a chunk, packed or unpacked, that are held in memory; larger ones are passed over. Writers make
#: chunks of about a megabyte at most, unless one message is larger.
MAX_CHUNK_LENGTH = 256 * 1024 * 1024

_PIECE = 1024 * 1024
# Start and end time, unpacked size, checksum of the unpacked records, length of the compression's name.
_HEAD = struct.Struct("<QQQII")
_RECORDS_LENGTH = struct.Struct("<Q")


class ChunkError(Exception):
    """A chunk that cannot be read: `reason` as in `CaptureProblem`, the message a half sentence."""

    def __init__(self, reason: Reason, message: str) -> None:
        super().__init__(message)
        self.reason = reason


#: Gives writable memory for so many octets.
Allocate = Callable[[int], memoryview]


class Chunk(NamedTuple):
    """The records of a chunk, unpacked."""

    records: bytes | memoryview
    #: Where the records start within the content of the chunk record, -1 if they are compressed.
    start: int


def _fresh(size: int) -> memoryview:
    return memoryview(bytearray(size))


class Unpacker:
    """Unpacks the chunks of one file, into memory that `allocate` gives. Not for use by several threads at a time."""

    def __init__(self, allocate: Allocate = _fresh) -> None:
        self._allocate = allocate
        # What zstandard needs in memory takes longer to make than a chunk to unpack.
        self._zstd: Any = None

    def open(self, content: bytes, length: int) -> Chunk:
        """Unpack the chunk record of `length` octets of which `content` is there.

        Raises `ChunkError` if a whole one is damaged. Of one that is cut off, gives as much as can be unpacked, which
        nothing has checked.
        """
        whole = len(content) == length
        try:
            size, crc, compression, start, stop = _head(content, length)
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
        """Unpack what should give `size` octets; more are an error, so a small chunk cannot fill the memory."""
        read_into = self._reader(compression, packed)
        # One octet more, which shows whether the chunk has more than it claims.
        memory, used = self._allocate(size + 1), 0
        try:
            while used <= size and (count := read_into(memory[used:])):
                used += count
        except Exception as error:
            # zstandard and lz4 raise classes of their own; what they have in common is Exception.
            if whole:
                raise ChunkError("bad-compression", f"cannot be unpacked ({error})") from error
        return memory[:used]

    def _reader(self, compression: str, packed: bytes) -> Callable[[memoryview], int]:
        """Return a function that fills memory with the next octets and says how many those are, 0 at the end."""
        try:
            if compression == "zstd":
                import zstandard

                if self._zstd is None:
                    self._zstd = zstandard.ZstdDecompressor()
                read: Callable[[memoryview], int] = self._zstd.stream_reader(packed, read_across_frames=True).readinto
                return read
            if compression == "lz4":
                # By name, since it says nothing of types.
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


def _head(content: bytes, length: int) -> tuple[int, int, str, int, int]:
    """Unpacked size, checksum, compression, and where in `content` the records start and stop."""
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
