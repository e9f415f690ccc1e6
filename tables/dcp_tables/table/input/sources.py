"""Read recordings as blocks of frames: memory-mapped with machine code where possible, otherwise frame by frame.

The readers of :mod:`dcp_codec.capture` open every file. They read everything that is unusual for the machine code
("walkers"), and report all problems of a file.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from dcp_codec.capture import ETHERNET, MAX_TIME_NS, CaptureProblem, CaptureReader, Frame, open_capture
from dcp_codec.capture.bytesource import Closing, open_source
from dcp_codec.capture.frame import MAX_RECORD_LENGTH
from dcp_codec.capture.pcap.reader import PcapReader
from dcp_codec.capture.pcapng.blocks import Interface
from dcp_codec.capture.pcapng.reader import PcapngReader
from dcp_tables.table.decoding import Block, Integers, worth_compiling
from dcp_tables.table.kernel.jit import machine

from .walkers import walk_pcap, walk_pcapng

if TYPE_CHECKING:
    from .mcap_blocks import McapBlocks

#: Maximum number of frames, and of octets of the file, in one block.
FRAMES, SPAN = 1 << 16, 1 << 24
#: Maximum number of frames in one block if they are read one by one.
_COLLECTED = 1 << 13
#: Maximum excess of unusual blocks over usual ones in a pcapng file, before it is read block by block.
_ODD_BLOCKS = 1 << 10

_BIGGEST = (1 << 63) - 1


class Recording(Closing):
    """A recording that is read once, in blocks. A context manager.

    ``walk``: whether machine code finds the frames; by default it does in large files. ``frames`` and ``span`` limit a
    block (see ``FRAMES`` and ``SPAN``). ``problems`` is complete when ``blocks()`` has ended.

    Raise :class:`~dcp_codec.capture.CaptureError` if the recording cannot be read at all.
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
            # Imported only here, because other files do not need the library.
            from .mcap_blocks import McapBlocks

            octets = open_source(source)
            try:
                reader = self._mcap = McapBlocks(octets, frozenset({ETHERNET}), frames)
            except BaseException:
                octets.close()
                raise
        self._reader: CaptureReader = reader
        #: The file, if it can be mapped and is large enough for machine code.
        self._file = Path(str(source)) if mapped else None
        self._frames, self._span = frames, span
        #: Number of frames in the yielded blocks.
        self.frames = 0

    @property
    def name(self) -> str:
        """The name of the file as given by the caller."""
        return self._reader.name

    @property
    def size(self) -> int | None:
        """Size of the file in octets; None for pipes."""
        return self._reader.size

    @property
    def problems(self) -> list[CaptureProblem]:
        """Problems of the part of the file that has been read."""
        return self._reader.problems

    def blocks(self) -> Iterator[Block]:
        """Yield all frames in the order of the file."""
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
        """Map the file into memory; return None for pipes and streams, which cannot be mapped, and for small files."""
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
        # This is the end of the file or an unusual record: the reader decides.
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
                # Most blocks are unusual, so that the walker saves no time.
                break
        if odd:
            yield packed(odd, position)
        if going:
            yield from collected(reader, lambda: reader.position)

    def close(self) -> None:
        """Close the file. Further calls have no effect."""
        self._reader.close()


def _arrays(many: int, size: int) -> list[Integers]:
    # One piece of memory: small pieces that are freed and allocated again would cause page faults again.
    return list(np.empty((many, size), np.int64))


class _Passed:
    """Releases the pages of a mapped file that have been read, so that memory does not grow with the file."""

    _STEP = 1 << 26

    def __init__(self, mapped: mmap.mmap) -> None:
        self._mapped = mapped
        self._released = 0

    def __call__(self, position: int) -> None:
        """Release the pages before ``position``."""
        if position - self._released >= self._STEP:
            end = position - position % mmap.PAGESIZE
            self._mapped.madvise(mmap.MADV_DONTNEED, self._released, end - self._released)
            self._released = end


def _described(interfaces: Sequence[Interface]) -> Integers:
    """Return the table of interfaces of a section for :func:`~dcp_tables.table.input.walkers.walk_pcapng`."""
    table = np.zeros((len(interfaces), 6), np.int64)
    for row, each in zip(table, interfaces, strict=True):
        # Frames with other clocks are left to the reader, which has unbounded integers.
        fits = each.multiply <= _BIGGEST and each.divide <= _BIGGEST and 0 <= each.shift_ns <= MAX_TIME_NS
        if not each.accepted or not fits:
            continue
        most = min(_BIGGEST // each.multiply, (MAX_TIME_NS - each.shift_ns) * each.divide // each.multiply)
        row[:] = (1, each.multiply, each.divide, each.shift_ns, each.index, most)
    return table


def collected(frames: Iterable[Frame], position: Callable[[], int]) -> Iterator[Block]:
    """Collect single frames into blocks. ``position`` returns the number of octets that have been read."""
    iterator = iter(frames)
    while some := list(islice(iterator, _COLLECTED)):
        yield packed(some, position())


def packed(frames: Sequence[Frame], position: int) -> Block:
    """Return a block of frames, with their octets copied into one buffer."""
    buffer = np.frombuffer(b"".join([frame.data for frame in frames]) or b"\0", np.uint8)
    stops = np.cumsum([len(frame.data) for frame in frames], dtype=np.int64)
    starts = np.concatenate([np.zeros(1, np.int64), stops[:-1]])
    columns = np.array([(f.number, f.time_ns, f.orig_len, f.interface) for f in frames], np.int64).T
    numbers, times, lengths, interfaces = (np.ascontiguousarray(column) for column in columns)
    return Block(buffer, starts, stops, numbers, times, lengths, interfaces, len(frames), position)
