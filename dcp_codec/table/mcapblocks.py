"""MCAP files as blocks of frames: the reader of :mod:`dcp_codec.capture`, with its chunks walked by machine code."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from dcp_codec.capture.bytesource import ByteSource
from dcp_codec.capture.frame import Frame
from dcp_codec.capture.mcapfile import RECORD_HEAD, McapReader

from .decoding import Block
from .messages import FULL, ODD, OTHER, RAW, walk_messages

_BUFFER = 1 << 22
_CHANNELS = 1 << 16


class McapBlocks(McapReader):
    """Reads an MCAP file as blocks; everything but plain messages with raw frames is taken as McapReader takes it."""

    def __init__(self, source: ByteSource, link_types: frozenset[int], frames: int) -> None:
        self._most = frames
        self._channels = np.zeros(_CHANNELS, np.uint8)
        self._fields = np.zeros(6, np.int64)
        self._known = (0, 0)
        self._count = self._used = 0
        self._begin(0)
        super().__init__(source, link_types)

    def _begin(self, least: int) -> None:
        """Begin an empty block with room for a frame of ``least`` octets."""
        self._count = self._used = 0
        self._buffer = np.empty(max(_BUFFER, least), np.uint8)
        self._arrays = [np.empty(self._most, np.int64) for _ in range(6)]

    def _records(self) -> Iterator[Any]:
        for event in self._events:
            if event is not None:
                yield event
        if self._count:
            yield self._block()

    def blocks(self) -> Iterator[Block]:
        """All frames."""
        yield from self  # type: ignore[misc] # blocks take the place of frames

    def _block(self) -> Block:
        starts, stops, numbers, times, lengths, interfaces = self._arrays
        octets = self._buffer[: max(self._used, 1)]
        octets.flags.writeable = False
        return Block(octets, starts, stops, numbers, times, lengths, interfaces, self._count, self._position)

    def _flush(self, least: int = 0) -> Iterator[Any]:
        if self._count:
            yield self._block()
        self._begin(least)

    def _inside(self, records: bytes, base: int, *, whole: bool = True) -> Iterator[Any]:
        octets, position, end = np.frombuffer(records, np.uint8), 0, len(records)
        while True:
            before = self._count
            position, self._count, self._used, why = walk_messages(
                octets, position, self._kinds(), self._fields, self._count, self._used, self._buffer, *self._arrays
            )
            if self._count > before:
                self._number = int(self._arrays[2][self._count - 1])
                self._frames_read += self._count - before
            if why == FULL:
                yield from self._flush(end - position)
                continue
            assert why == ODD
            if end - position < RECORD_HEAD.size:
                break
            length = RECORD_HEAD.unpack_from(records, position)[1]
            stop = position + RECORD_HEAD.size + length
            if stop > end:
                break
            offset = base if base < 0 else base + position
            for event in super()._inside(records[position:stop], offset):
                if event is None:
                    yield None
                    continue
                self._frames_read += 1
                yield from self._append(event)
            position = stop
        # What is left is no whole record, and the reader says so.
        yield from super()._inside(records[position:], base, whole=whole)

    def _append(self, frame: Frame) -> Iterator[Any]:
        size = len(frame.data)
        if self._count == self._most or self._used + size > len(self._buffer):
            yield from self._flush(size)
        self._buffer[self._used : self._used + size] = np.frombuffer(frame.data, np.uint8)
        values = (self._used, self._used + size, frame.number, frame.time_ns, frame.orig_len, frame.interface)
        for array, value in zip(self._arrays, values, strict=True):
            array[self._count] = value
        self._count += 1
        self._used += size

    def _kinds(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """What each channel is, as far as they have been described."""
        if self._known != (len(self._topics), len(self._raw)):
            self._known = len(self._topics), len(self._raw)
            for channel in self._topics:
                self._channels[channel] = RAW if channel in self._raw else OTHER
        return self._channels
