"""Read MCAP files as blocks of frames: the reader of :mod:`dcp_codec.capture`, with machine code for its chunks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from dcp_codec.capture.bytesource import ByteSource
from dcp_codec.capture.frame import Frame
from dcp_codec.capture.mcap import raw_frame as rawframe
from dcp_codec.capture.mcap.index import RECORD_HEAD
from dcp_codec.capture.mcap.reader import McapReader
from dcp_tables.table.decoding import Block
from dcp_tables.table.kernel.jit import machine

from .mcap_messages import FULL, ODD, OTHER, RAW, walk_messages

#: Size in octets of the buffer for uncompressed chunks of one block; a larger chunk gets its own buffer.
_BUFFER = 1 << 23
_CHANNELS = 1 << 16


#: Number of pieces of memory that are kept: for the current block, the one being decoded, and one between them.
_KEPT = 3


class _Reused:
    """Memory that is reused when it has no other references. Allocating new memory takes as long as filling it."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make
        self._made: list[Any] = []

    def take(self) -> Any:
        """Return unused memory; its content is undefined."""
        for index in range(len(self._made)):
            # Two references are those of the list and of the call. Views of an array have references, too.
            if sys.getrefcount(self._made[index]) <= 2:
                return self._made[index]
        made = self._make()
        self._made = [*self._made, made][-_KEPT:]
        return made


class McapBlocks(McapReader):
    """Reads an MCAP file as blocks. Messages other than plain ones with raw frames are processed by McapReader.

    Chunks are decompressed into the buffer of the current block, and frames are not copied from there.
    """

    def __init__(self, source: ByteSource, link_types: frozenset[int], frames: int) -> None:
        self._most = frames
        self._channels = np.zeros(_CHANNELS, np.uint8)
        self._known = (0, 0)
        #: Whether a channel has messages that only the reader can decode.
        self._others_too = False
        #: Complete blocks, which are yielded first.
        self._ready: list[Block] = []
        self._buffers = _Reused(lambda: np.empty(_BUFFER, np.uint8))
        self._columns = _Reused(lambda: np.empty((6, frames), np.int64))
        self._buffer: Any = self._buffers.take()
        #: Number of used octets of the buffer, and start of the last request.
        self._used = self._last = 0
        self._begin()
        super().__init__(source, link_types, self._room)

    def _begin(self) -> None:
        """Start an empty block in the rest of the buffer."""
        self._count = 0
        # The rows keep a reference to the whole array.
        self._arrays = list(self._columns.take())

    def _records(self) -> Iterator[Any]:
        for event in self._events:
            if event is not None:
                yield event
        self._end_block()
        yield from self._take_ready()

    def blocks(self) -> Iterator[Block]:
        """Yield all frames in blocks."""
        yield from self  # type: ignore[misc] # blocks take the place of frames

    def _end_block(self) -> None:
        """Complete the current block, and start another."""
        if self._count:
            octets = self._buffer[: max(self._used, 1)]
            octets.flags.writeable = False
            starts, stops, numbers, times, lengths, interfaces = self._arrays
            block = Block(octets, starts, stops, numbers, times, lengths, interfaces, self._count, self._position)
            self._ready.append(block)
            self._begin()

    def _take_ready(self) -> Iterator[Block]:
        while self._ready:
            yield self._ready.pop(0)

    def _room(self, size: int) -> memoryview:
        """Return memory for ``size`` octets at the end of the buffer, or in a new buffer if it has no room."""
        if self._used + size > len(self._buffer):
            self._end_block()
            self._buffer = self._buffers.take() if size <= _BUFFER else np.empty(size, np.uint8)
            self._used = 0
        self._last = self._used
        self._used += size
        memory: memoryview = self._buffer.data
        return memory[self._last : self._used]

    def _copied(self, octets: bytes | memoryview) -> int:
        """Copy ``octets`` into the buffer; return their start."""
        self._room(len(octets))[:] = octets
        return self._last

    def _inside(
        self, records: bytes | memoryview, base: int, *, whole: bool = True, position: int = 0
    ) -> Iterator[Any]:
        # Chunks that were compressed are already in the buffer, see _room.
        unpacked = isinstance(records, memoryview) and records.obj is self._buffer
        begin = self._last if unpacked else self._copied(records)
        buffer = self._buffer
        while not self._others_too:
            if buffer is not self._buffer:
                # A frame of the reader did not fit into the buffer: copy the rest, because a block has one buffer.
                begin = self._copied(records[position:]) - position
                buffer = self._buffer
            before = self._count
            after, self._count, why = machine(walk_messages)(
                buffer, begin + position, begin + len(records), self._kinds(), self._count, *self._arrays
            )
            position = after - begin
            if self._count > before:
                self._number = int(self._arrays[2][self._count - 1])
                self._frames_read += self._count - before
            if why == FULL:
                self._end_block()
                continue
            yield from self._take_ready()
            assert why == ODD
            if len(records) - position < RECORD_HEAD.size:
                break
            stop = position + RECORD_HEAD.size + RECORD_HEAD.unpack_from(records, position)[1]
            if stop > len(records):
                break
            yield from self._by_reader(records[:stop], base, position)
            position = stop
        # The reader processes the rest: an incomplete record, or messages that only the reader can decode.
        yield from self._by_reader(records, base, position, whole=whole)

    def _by_reader(self, records: bytes | memoryview, base: int, position: int, *, whole: bool = True) -> Iterator[Any]:
        for event in super()._inside(records, base, whole=whole, position=position):
            if event is None:
                yield None
                continue
            self._frames_read += 1
            self._append(event)
        yield from self._take_ready()

    def _given(self, frame: Frame) -> Iterator[Any]:
        self._frames_read += 1
        self._append(frame)
        yield from self._take_ready()

    def _append(self, frame: Frame) -> None:
        if self._count == self._most:
            self._end_block()
        start = self._copied(frame.data)
        values = (start, start + len(frame.data), frame.number, frame.time_ns, frame.orig_len, frame.interface)
        for array, value in zip(self._arrays, values, strict=True):
            array[self._count] = value
        self._count += 1

    def _kinds(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return the kind of each channel (``UNKNOWN``, ``RAW`` or ``OTHER``)."""
        if self._known != (len(self._topics), len(self._raw)):
            self._known = len(self._topics), len(self._raw)
            for channel in self._topics:
                self._channels[channel] = RAW if channel in self._raw else OTHER
            self._others_too = any(decode is not rawframe.decode for decode in self._raw.values())
        return self._channels
