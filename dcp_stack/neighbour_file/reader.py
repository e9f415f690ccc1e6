"""The reader of a neighbour file."""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Self

import msgspec

from dcp_stack.positions.geometry import Vector

from . import layout
from .layout import NeighbourFileError

_ATTEMPTS: Final = 10_000
"""Maximum number of attempts to copy a table. An attempt fails only if two tables are published during the copy, so
this many failures indicate a damaged file."""


class FileEntry(msgspec.Struct, frozen=True, gc=False):
    """One neighbour of a snapshot. Position in m and velocity in m/s, None if unknown; times and intervals in ns.

    ``reception_wall`` and ``reception_mono``: reception of the last report. ``received``, ``lost``, ``repeated``:
    numbers of reports. ``restarts``: number of detected restarts of the neighbour. ``mean_gap``: mean step of the
    sequence number.
    """

    node_id: bytes
    position: Vector | None
    velocity: Vector | None
    velocity_estimated: bool
    reception_wall: int
    reception_mono: int
    stamp_wall: int | None
    """Time of the report by the neighbour's clock; None if the profile's time stamps are not wall time."""
    seqno: int
    received: int
    lost: int
    repeated: int
    restarts: int
    mean_gap: float
    mean_interval: int | None
    values: Mapping[str, float]
    """The safety data by field name, in the profile's units."""


class NeighbourFileSnapshot(msgspec.Struct, frozen=True, gc=False):
    """A table as published at one moment. Times are in ns."""

    profile: str
    node_id: bytes
    generation: int
    """Number of the table, counted by the writer from 1; 0 if it has not published any."""
    created_wall: int
    """Start time of the writer; together with ``generation`` it identifies a table."""
    published_wall: int
    published_mono: int
    heartbeat_wall: int
    heartbeat_mono: int
    closed: bool
    """Whether the writer has ended. A new writer creates a new file, which the next snapshot uses."""
    omitted: int
    """Number of neighbours that were left out: no room, or an identifier of more than 32 octets."""
    entries: tuple[FileEntry, ...]

    def silence(self, wall: int) -> int:
        """Return the time in ns since the last heartbeat. Do not use a table for control if its writer is silent."""
        return wall - self.heartbeat_wall


class NeighbourFileReader:
    """Reads the file of a :class:`NeighbourFileWriter`, independently of the writer."""

    def __init__(self, path: str | Path) -> None:
        """Map the file. Raises NeighbourFileError if it cannot be read or does not have this layout."""
        layout.little_endian_only()
        self.path = Path(path)
        self._attach()

    def _attach(self) -> None:
        """Map the file that has the name now, and check its header."""
        try:
            with self.path.open("rb") as file:
                status = os.fstat(file.fileno())
                mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is empty"
            raise NeighbourFileError(f"{self.path}: cannot be read ({reason}); is the node running?") from None
        header = layout.HEADER.unpack_from(mapped) if len(mapped) >= layout.HEADER_SIZE else (b"",)
        if header[0] != layout.MAGIC or header[1] != layout.LAYOUT_VERSION:
            mapped.close()
            raise NeighbourFileError(f"{self.path}: is not a neighbour table of layout version {layout.LAYOUT_VERSION}")
        _, _, slots, slot_size, slot_header, entry_size, capacity, field_count, id_length, node_id, profile = header
        sizes = layout.FileSizes(capacity, field_count)
        if (slots, slot_size, slot_header, entry_size) != (
            sizes.slots,
            sizes.slot_size,
            layout.SLOT_HEADER_SIZE,
            sizes.entry_size,
        ) or len(mapped) != sizes.file_size:
            mapped.close()
            raise NeighbourFileError(f"{self.path}: the sizes in its header contradict each other")
        self._identity = (status.st_dev, status.st_ino)
        self._map, self._sizes = mapped, sizes
        self._numbers = memoryview(mapped).cast("Q")
        self._signed = memoryview(mapped).cast("q")
        self._profile, self._node_id = _untext(profile), node_id[:id_length]
        records = (
            layout.FIELD.unpack_from(mapped, layout.HEADER_SIZE + layout.FIELD_SIZE * number)
            for number in range(field_count)
        )
        self._names = tuple(_untext(name) for name, *_ in records)
        self._values = struct.Struct(f"<{field_count}d")

    def _follow(self) -> None:
        """Change to the file of a new writer, if there is one; otherwise keep the current file."""
        with contextlib.suppress(OSError, NeighbourFileError):
            status = self.path.stat()
            if (status.st_dev, status.st_ino) != self._identity:
                old = (self._numbers, self._signed, self._map)
                self._attach()
                for each in old[:2]:
                    each.release()
                old[2].close()

    def snapshot(self) -> NeighbourFileSnapshot:
        """Return the latest table. Raises NeighbourFileError if the file is damaged."""
        self._follow()
        for attempt in range(_ATTEMPTS):
            generation = self._numbers[layout.LATEST // 8]
            layout.fence()
            if generation == 0:
                return self._made(layout.SLOT.pack(0, self._signed[layout.CREATED // 8], 0, 0, 0), b"")
            taken = self._copy(generation)
            if taken is not None:
                return self._made(*taken)
            if attempt % 16 == 15:
                os.sched_yield()
        raise NeighbourFileError(f"{self.path}: is damaged: no table in it has a correct checksum")

    def _copy(self, generation: int) -> tuple[bytes, bytes] | None:
        """Return slot header and entries of a generation; None if they changed during the copy."""
        sizes = self._sizes
        start = sizes.slots + (generation & 1) * sizes.slot_size
        if self._numbers[start // 8] != 2 * generation:
            return None
        layout.fence()
        head = self._map[start + 8 : start + 8 + layout.SLOT.size]
        found, _, _, count, _ = layout.SLOT.unpack(head)
        if count > sizes.capacity:
            return None
        checksum = int.from_bytes(self._map[start + layout.CHECKSUM : start + layout.CHECKSUM + 4], "little")
        begin = start + layout.SLOT_HEADER_SIZE
        entries = self._map[begin : begin + count * sizes.entry_size]
        layout.fence()
        if self._numbers[start // 8] != 2 * generation:
            return None
        fits = found == generation and zlib.crc32(entries, zlib.crc32(head)) == checksum
        return (head, entries) if fits else None

    def _made(self, head: bytes, entries: bytes) -> NeighbourFileSnapshot:
        """Return the snapshot for a copied slot."""
        generation, published_wall, published_mono, _, omitted = layout.SLOT.unpack(head)
        size = self._sizes.entry_size
        return NeighbourFileSnapshot(
            profile=self._profile,
            node_id=self._node_id,
            generation=generation,
            created_wall=self._signed[layout.CREATED // 8],
            published_wall=published_wall,
            published_mono=published_mono,
            heartbeat_wall=self._signed[layout.HEARTBEAT_WALL // 8],
            heartbeat_mono=self._signed[layout.HEARTBEAT_MONO // 8],
            closed=self._numbers[layout.STATE // 8] == layout.CLOSED,
            omitted=omitted,
            entries=tuple(self._entry(entries, offset) for offset in range(0, len(entries), size)),
        )

    def _entry(self, entries: bytes, offset: int) -> FileEntry:
        """Return the entry at an offset of the copied entries."""
        (node_id, id_length, flags, px, py, pz, vx, vy, vz, wall, mono, stamp, *counts) = layout.ENTRY.unpack_from(
            entries, offset
        )
        received, lost, repeated, interval, gap, seqno, restarts = counts
        values: tuple[Any, ...] = self._values.unpack_from(entries, offset + layout.ENTRY_FIXED)
        return FileEntry(
            node_id=node_id[:id_length],
            position=(px, py, pz) if flags & layout.HAS_POSITION else None,
            velocity=(vx, vy, vz) if flags & layout.HAS_VELOCITY else None,
            velocity_estimated=bool(flags & layout.VELOCITY_ESTIMATED),
            reception_wall=wall,
            reception_mono=mono,
            stamp_wall=None if stamp == layout.UNKNOWN_TIME else stamp,
            seqno=seqno,
            received=received,
            lost=lost,
            repeated=repeated,
            restarts=restarts,
            mean_gap=gap,
            mean_interval=None if interval < 0 else interval,
            values=dict(zip(self._names, values, strict=True)),
        )

    def close(self) -> None:
        """Unmap the file. May be called twice."""
        self._numbers.release()
        self._signed.release()
        self._map.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _untext(octets: bytes) -> str:
    """Return the text up to the first NUL."""
    return octets.split(b"\0", 1)[0].decode(errors="replace")
