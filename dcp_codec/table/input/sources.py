"""Recordings as blocks of frames: memory-mapped and walked by machine code where that can be, read frame by frame else.

The readers of :mod:`dcp_codec.capture` open every file and have the last word: whatever a walker does not take for
plain is read by them, and what is wrong with a file is in their words.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Self

import numpy as np

from dcp_codec.capture import ETHERNET, MAX_TIME_NS, CaptureProblem, CaptureReader, Frame, open_capture
from dcp_codec.capture.bytesource import open_source
from dcp_codec.capture.frame import MAX_RECORD_LENGTH
from dcp_codec.capture.pcap.reader import PcapReader
from dcp_codec.capture.pcapng.blocks import Interface
from dcp_codec.capture.pcapng.reader import PcapngReader
from dcp_codec.table.decoding import Block, Integers, worth_compiling
from dcp_codec.table.kernel.jit import machine

from .walkers import walk_pcap, walk_pcapng

if TYPE_CHECKING:
    from .mcap_blocks import McapBlocks

#: Frames, and octets of the file, that one block holds at most.
FRAMES, SPAN = 1 << 16, 1 << 24
#: Frames that are collected into one block where they come one by one.
_COLLECTED = 1 << 13
#: Blocks of a pcapng file that may be unusual, more than there are usual ones, before it is read block by block.
_ODD_BLOCKS = 1 << 10

_BIGGEST = (1 << 63) - 1


class Recording:
    """A recording to be read once, in blocks. A context manager.

    ``walk`` says whether machine code finds the frames; by default it does in files that are worth it.

    Raises :class:`~dcp_codec.capture.CaptureError` if it cannot be read at all; ``problems`` is complete when
    ``blocks()`` has ended. ``frames`` counts those given out.
    """

    def __init__(
        self, source: str | Path | BinaryIO, *, frames: int = FRAMES, span: int = SPAN, walk: bool | None = None
    ) -> None:
        reader = open_capture(source)
        self._mcap: McapBlocks | None = None
        walk = worth_compiling(reader.size) if walk is None else walk
        mapped = isinstance(source, str | Path) and source != "-" and bool(reader.size) and walk
        if reader.format == "mcap" and mapped:
            assert isinstance(source, str | Path)
            reader.close()
            # Here, so that nobody who has no MCAP file pays for importing the library.
            from .mcap_blocks import McapBlocks

            octets = open_source(source)
            try:
                reader = self._mcap = McapBlocks(octets, frozenset({ETHERNET}), frames)
            except BaseException:
                octets.close()
                raise
        self._reader: CaptureReader = reader
        #: The file, if it can be mapped and is worth walking by machine code.
        self._file = Path(str(source)) if mapped else None
        self._frames, self._span = frames, span
        #: Frames that were given out so far.
        self.frames = 0

    @property
    def name(self) -> str:
        """The file, as the caller called it."""
        return self._reader.name

    @property
    def size(self) -> int | None:
        """Octets of the file, None for pipes."""
        return self._reader.size

    @property
    def problems(self) -> list[CaptureProblem]:
        """What was wrong with the file so far."""
        return self._reader.problems

    def blocks(self) -> Iterator[Block]:
        """All frames, in file order."""
        for block in self._blocks():
            self.frames += block.frames
            yield block

    def _blocks(self) -> Iterator[Block]:
        reader = self._reader
        mapped = self._mapped() if isinstance(reader, PcapReader | PcapngReader) else None
        if self._mcap is not None:
            yield from self._mcap.blocks()
        elif mapped is None:
            yield from collected(reader, lambda: reader.position)
        elif isinstance(reader, PcapReader):
            yield from self._pcap(mapped, reader)
        elif isinstance(reader, PcapngReader):
            yield from self._pcapng(mapped, reader)

    def _mapped(self) -> mmap.mmap | None:
        """The file in memory; None for what cannot be mapped (pipes, streams) and for little files."""
        if self._file is None:
            return None
        try:
            with self._file.open("rb") as file:
                return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError):
            return None

    def _pcap(self, mapped: mmap.mmap, reader: PcapReader) -> Iterator[Block]:
        octets, done = np.frombuffer(mapped, np.uint8), _Passed(mapped)
        big, scale, limit = reader.layout
        position, number = reader.position, 0
        nothing = np.zeros(self._frames, np.int64)
        while True:
            arrays = _arrays(5, self._frames)
            count, after, _ = machine(walk_pcap)(
                octets, position, big, scale, limit, number, self._frames, self._span, *arrays
            )  # fmt: skip
            if not count:
                break
            number, position = number + count, after
            starts, stops, numbers, times, lengths = arrays
            yield Block(octets, starts, stops, numbers, times, lengths, nothing, count, position)
            done(position)
        # The end of the file, or what makes it end here: the reader finds out which.
        reader.resume(position, number)
        yield from collected(reader, lambda: reader.position)

    def _pcapng(self, mapped: mmap.mmap, reader: PcapngReader) -> Iterator[Block]:
        octets, done = np.frombuffer(mapped, np.uint8), _Passed(mapped)
        position, number, given = reader.position, reader.number, 0
        described: Integers | None = None
        known: Sequence[Interface] = ()
        going, odd_blocks = True, 0
        odd: list[Frame] = []
        arrays = _arrays(6, self._frames)
        while going:
            if known is not reader.interfaces or described is None or len(described) != len(reader.interfaces):
                known = reader.interfaces
                described = _described(known)
            count, after = machine(walk_pcapng)(
                octets, position, reader.big_endian, described, MAX_RECORD_LENGTH, number, self._frames, self._span,
                *arrays,
            )  # fmt: skip
            if count:
                if odd:
                    yield packed(odd, position)
                    odd = []
                number, given, position = number + count, given + count, after
                starts, stops, numbers, times, lengths, interfaces = arrays
                yield Block(octets, starts, stops, numbers, times, lengths, interfaces, count, position)
                arrays = _arrays(6, self._frames)
                done(position)
                odd_blocks = max(0, odd_blocks - count)
                continue
            odd_blocks += 1
            going, frame = reader.step(position, number, given)
            position, number = reader.position, reader.number
            if frame is not None:
                odd.append(frame)
                given += 1
            if odd_blocks > _ODD_BLOCKS:
                # Nothing here is plain: walking only costs time.
                break
        if odd:
            yield packed(odd, position)
        if going:
            yield from collected(reader, lambda: reader.position)

    def close(self) -> None:
        """Let go of the file. May be called again."""
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _arrays(many: int, size: int) -> list[Integers]:
    # In one piece: memory that is let go and asked for again at once has to be fetched anew if it is in small ones.
    return list(np.empty((many, size), np.int64))


class _Passed:
    """Gives the pages of a mapped file back that lie behind us, so that memory does not grow with the file."""

    _STEP = 1 << 26

    def __init__(self, mapped: mmap.mmap) -> None:
        self._mapped = mapped
        self._behind = 0

    def __call__(self, position: int) -> None:
        if position - self._behind >= self._STEP:
            end = position - position % mmap.PAGESIZE
            self._mapped.madvise(mmap.MADV_DONTNEED, self._behind, end - self._behind)
            self._behind = end


def _described(interfaces: Sequence[Interface]) -> Integers:
    """What :func:`~dcp_codec.table.input.walkers.walk_pcapng` wants to know of the interfaces of a section."""
    table = np.zeros((len(interfaces), 6), np.int64)
    for row, each in zip(table, interfaces, strict=True):
        # Clocks that do not fit are read by the reader, which knows integers without bounds.
        fits = each.multiply <= _BIGGEST and each.divide <= _BIGGEST and 0 <= each.shift_ns <= MAX_TIME_NS
        if not each.accepted or not fits:
            continue
        most = min(_BIGGEST // each.multiply, (MAX_TIME_NS - each.shift_ns) * each.divide // each.multiply)
        row[:] = (1, each.multiply, each.divide, each.shift_ns, each.index, most)
    return table


def collected(frames: Iterable[Frame], position: Callable[[], int]) -> Iterator[Block]:
    """Frames that come one by one as blocks."""
    iterator = iter(frames)
    while some := list(islice(iterator, _COLLECTED)):
        yield packed(some, position())


def packed(frames: Sequence[Frame], position: int) -> Block:
    """A block of frames; their octets are copied into one buffer."""
    buffer = np.frombuffer(b"".join([frame.data for frame in frames]) or b"\0", np.uint8)
    stops = np.cumsum([len(frame.data) for frame in frames], dtype=np.int64)
    starts = np.concatenate([np.zeros(1, np.int64), stops[:-1]])
    columns = np.array([(f.number, f.time_ns, f.orig_len, f.interface) for f in frames], np.int64).T
    numbers, times, lengths, interfaces = (np.ascontiguousarray(column) for column in columns)
    return Block(buffer, starts, stops, numbers, times, lengths, interfaces, len(frames), position)
