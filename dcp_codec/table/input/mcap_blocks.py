"""MCAP files as blocks of frames: the reader of :mod:`dcp_codec.capture`, with its chunks walked by machine code."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from dcp_codec.capture.bytesource import ByteSource
from dcp_codec.capture.frame import Frame
from dcp_codec.capture.mcap import raw_frame as rawframe
from dcp_codec.capture.mcap.reader import RECORD_HEAD, McapReader
from dcp_codec.table.decoding import Block
from dcp_codec.table.kernel.jit import machine

from .mcap_messages import FULL, ODD, OTHER, RAW, walk_messages

#: Octets of unpacked chunks that one block has, unless one chunk has more.
_BUFFER = 1 << 23
_CHANNELS = 1 << 16


#: Pieces of memory of one kind that are kept: for the block being made, the one being decoded, and one between them.
_KEPT = 3


class _Reused:
    """Memory that is given out again as soon as nobody refers to it; fresh memory costs as much as filling it."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make
        self._made: list[Any] = []

    def take(self) -> Any:
        """Return memory that nobody uses, with whatever was left in it."""
        for index in range(len(self._made)):
            # The list and the call refer to it. Views of an array do, too.
            if sys.getrefcount(self._made[index]) <= 2:
                return self._made[index]
        made = self._make()
        self._made = [*self._made, made][-_KEPT:]
        return made


class McapBlocks(McapReader):
    """Reads an MCAP file as blocks; everything but plain messages with raw frames is taken as McapReader takes it.

    Chunks are unpacked into the buffer of the block that is being made, and frames stay where they lie in it.
    """

    def __init__(self, source: ByteSource, link_types: frozenset[int], frames: int) -> None:
        self._most = frames
        self._channels = np.zeros(_CHANNELS, np.uint8)
        self._known = (0, 0)
        #: Whether there is a channel whose messages only the reader understands.
        self._others_too = False
        #: Blocks that are finished, to be given out before anything else.
        self._ready: list[Block] = []
        self._buffers = _Reused(lambda: np.empty(_BUFFER, np.uint8))
        self._columns = _Reused(lambda: np.empty((6, frames), np.int64))
        self._buffer: Any = self._buffers.take()
        #: Octets of the buffer that are taken, and where the last of them begin that were asked for at once.
        self._used = self._last = 0
        self._begin()
        super().__init__(source, link_types, self._room)

    def _begin(self) -> None:
        """Begin an empty block, in what is left of the buffer."""
        self._count = 0
        # The rows refer to the whole.
        self._arrays = list(self._columns.take())

    def _records(self) -> Iterator[Any]:
        for event in self._events:
            if event is not None:
                yield event
        self._end_block()
        yield from self._take_ready()

    def blocks(self) -> Iterator[Block]:
        """All frames."""
        yield from self  # type: ignore[misc] # blocks take the place of frames

    def _end_block(self) -> None:
        """Set aside the block that was being made, and begin another."""
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
        """Return memory for ``size`` octets at the end of the buffer, of a fresh one if this one has no room."""
        if self._used + size > len(self._buffer):
            self._end_block()
            self._buffer = self._buffers.take() if size <= _BUFFER else np.empty(size, np.uint8)
            self._used = 0
        self._last = self._used
        self._used += size
        memory: memoryview = self._buffer.data
        return memory[self._last : self._used]

    def _copied(self, octets: bytes | memoryview) -> int:
        """Copy ``octets`` into the buffer; returns where they begin in it."""
        self._room(len(octets))[:] = octets
        return self._last

    def _inside(
        self, records: bytes | memoryview, base: int, *, whole: bool = True, position: int = 0
    ) -> Iterator[Any]:
        # Chunks that were packed are in the buffer already, see _room.
        unpacked = isinstance(records, memoryview) and records.obj is self._buffer
        begin = self._last if unpacked else self._copied(records)
        buffer = self._buffer
        while not self._others_too:
            if buffer is not self._buffer:
                # A frame that the reader took did not fit, and all frames of a block lie in one buffer.
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
        # What is left is for the reader: no whole record, or messages of a channel that only it understands.
        yield from self._by_reader(records, base, position, whole=whole)

    def _by_reader(self, records: bytes | memoryview, base: int, position: int, *, whole: bool = True) -> Iterator[Any]:
        for event in super()._inside(records, base, whole=whole, position=position):
            if event is None:
                yield None
                continue
            self._frames_read += 1
            self._append(event)
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
        """What each channel is, as far as they have been described."""
        if self._known != (len(self._topics), len(self._raw)):
            self._known = len(self._topics), len(self._raw)
            for channel in self._topics:
                self._channels[channel] = RAW if channel in self._raw else OTHER
            self._others_too = any(decode is not rawframe.decode for decode in self._raw.values())
        return self._channels
