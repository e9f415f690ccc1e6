"""The neighbour table as a memory-mapped file, for control loops that cannot wait for a node to answer.

The layout, how to read it from C, and why no reader ever sees a torn table are in ``docs/neighbour-file.md``. In
short: the writer prepares a table elsewhere, copies it into one of two slots under the sequence lock of that slot,
and then says which slot is the latest. A reader copies the latest slot and accepts the copy if the lock did not move
and the checksum fits. Numbers are little-endian; times are ns, wall since 1970 and monotonic as CLOCK_MONOTONIC.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import mmap
import os
import stat
import struct
import sys
import threading
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import msgspec
from dcp_spec.profile import Profile

from .neighbours import NeighbourTable, NeighbourTableEntry
from .positions.fields import ROLES
from .positions.geometry import Vector

MAGIC: Final = b"DCPNEIGH"
LAYOUT_VERSION: Final = 1
HEADER_SIZE: Final = 256
FIELD_SIZE: Final = 64
SLOT_HEADER_SIZE: Final = 64
ENTRY_FIXED: Final = 160
NODE_ID_SIZE: Final = 32
MAX_CAPACITY: Final = 65_536

_HEADER: Final = struct.Struct("<8s8I32s56s")
_FIELD: Final = struct.Struct("<40s16sII")
_SLOT: Final = struct.Struct("<QqqII")
_ENTRY: Final = struct.Struct("<32sII3d3dqqqQQQqdII")
# Offsets of what changes after the creation, each of them a naturally aligned number of 8 octets.
_LATEST, _HEARTBEAT_WALL, _HEARTBEAT_MONO, _STATE, _CREATED, _PID = 128, 136, 144, 152, 160, 168
_RUNNING, _CLOSED = 1, 2
_CHECKSUM: Final = 40

HAS_POSITION, HAS_VELOCITY, VELOCITY_ESTIMATED = 1, 2, 4
"""Bits of the flags of an entry."""
UNKNOWN_TIME: Final = -(1 << 63)
_ROLE_NUMBERS: Final = {role: 1 + number for number, role in enumerate(sorted(ROLES))}
_ATTEMPTS: Final = 10_000
"""A reader fails an attempt only when it is overtaken twice while copying; this often is damage, not bad luck."""
_FENCE: Final = threading.Lock()


class NeighbourFileError(Exception):
    """A neighbour file cannot be created or read; the message names it and says why."""


def _fence() -> None:
    """Order all memory accesses before against all after.

    Python has no barrier of its own, but its locks are those of the system, which have to synchronize memory: a
    release keeps what is before it before, an acquire what is behind it behind, and a release is not overtaken by
    the acquire that follows it. The first pair provides the release, the second the acquire.
    """
    with _FENCE:
        pass
    with _FENCE:
        pass


def _aligned(size: int) -> int:
    return -(-size // 64) * 64


class _Layout(msgspec.Struct, frozen=True):
    """Sizes in octets and offsets of one file."""

    capacity: int
    field_count: int
    entry_size: int

    @classmethod
    def of(cls, capacity: int, field_count: int) -> _Layout:
        return cls(capacity, field_count, _aligned(ENTRY_FIXED + 8 * field_count))

    @property
    def slots(self) -> int:
        return HEADER_SIZE + FIELD_SIZE * self.field_count

    @property
    def slot_size(self) -> int:
        return SLOT_HEADER_SIZE + self.capacity * self.entry_size

    @property
    def file_size(self) -> int:
        return self.slots + 2 * self.slot_size


class NeighbourFileWriter:
    """Writes the table of one node to ``path``. One thread of one process may write; any number may read."""

    def __init__(
        self, path: str | Path, profile: Profile, node_id: bytes, *, capacity: int = 1024, now: int, wall: int
    ) -> None:
        """Create the file, with mode 0644 and complete from the moment it has its name; an old one is replaced.

        ``capacity`` is the number of entries that have room, 1..65536: a file has about 2 * 192 octets for each.
        Raises NeighbourFileError if another process writes it, if something else has that name, or if the system
        refuses. /dev/shm or /run are the places to put it: elsewhere its pages go to the disk now and then.
        """
        _little_endian_only()
        if not 1 <= capacity <= MAX_CAPACITY:
            raise NeighbourFileError(f"{path}: the capacity is 1 to {MAX_CAPACITY} entries, not {capacity}")
        if len(node_id) > NODE_ID_SIZE:
            raise NeighbourFileError(f"{path}: a node identifier has at most {NODE_ID_SIZE} octets here")
        self.path = Path(path)
        self._fields = tuple(field.name for field in profile.srp.safety_data if field.type != "opaque")
        self._layout = _Layout.of(capacity, len(self._fields))
        self._values = struct.Struct(f"<{len(self._fields)}d")
        self._padding = bytes(self._layout.entry_size - ENTRY_FIXED - self._values.size)
        self._generation = 0
        temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        try:
            _refuse_foreign(self.path)
            with contextlib.suppress(FileNotFoundError):
                temporary.unlink()
            self._fd = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise NeighbourFileError(f"{path}: cannot be created ({error.strerror})") from None
        try:
            # Whoever has the file open to write holds this lock, and loses it when it dies.
            fcntl.flock(self._fd, fcntl.LOCK_EX)
            os.fchmod(self._fd, 0o644)
            # Room that is promised: writing into a mapping of a full file system would be fatal.
            os.posix_fallocate(self._fd, 0, self._layout.file_size)
            self._map = mmap.mmap(self._fd, self._layout.file_size)
            self._numbers = memoryview(self._map).cast("Q")
            self._signed = memoryview(self._map).cast("q")
            self._write_header(profile, node_id, now, wall)
            temporary.rename(self.path)
        except OSError as error:
            os.close(self._fd)
            temporary.unlink(missing_ok=True)
            raise NeighbourFileError(f"{path}: cannot be created ({error.strerror})") from None
        self._closed = False

    def _write_header(self, profile: Profile, node_id: bytes, now: int, wall: int) -> None:
        layout = self._layout
        self._map[: _HEADER.size] = _HEADER.pack(
            MAGIC,
            LAYOUT_VERSION,
            layout.slots,
            layout.slot_size,
            SLOT_HEADER_SIZE,
            layout.entry_size,
            layout.capacity,
            layout.field_count,
            len(node_id),
            node_id,
            _text(profile.name, 56),
        )
        numeric = [field for field in profile.srp.safety_data if field.type != "opaque"]
        for number, field in enumerate(numeric):
            record = _FIELD.pack(
                _text(field.name, 40),
                _text(field.unit, 16),
                ENTRY_FIXED + 8 * number,
                _ROLE_NUMBERS.get(field.role, 0),
            )
            start = HEADER_SIZE + FIELD_SIZE * number
            self._map[start : start + FIELD_SIZE] = record
        self._signed[_CREATED // 8] = wall
        self._numbers[_PID // 8] = os.getpid()
        self._numbers[_STATE // 8] = _RUNNING
        self.heartbeat(now=now, wall=wall)

    def heartbeat(self, *, now: int, wall: int) -> None:
        """Show that the writer lives, also when there is nothing new to say."""
        # Through a view of numbers, not struct: that is one store, which cannot be seen half done.
        self._signed[_HEARTBEAT_WALL // 8] = wall
        self._signed[_HEARTBEAT_MONO // 8] = now

    def publish(self, table: NeighbourTable, *, now: int, wall: int) -> None:
        """Make ``table`` the latest, and a heartbeat.

        Entries without room, and those whose node identifier has more than 32 octets, are left out and counted. The
        time is that of making the entries, microseconds for each; the slot is locked for a copy of memory only.
        """
        layout = self._layout
        made: list[bytes] = []
        omitted = 0
        for entry in table:
            if len(made) < layout.capacity and len(entry.node_id) <= NODE_ID_SIZE:
                made.append(self._entry(table, entry))
            else:
                omitted += 1
        self._generation += 1
        generation = self._generation
        head = _SLOT.pack(generation, wall, now, len(made), omitted)
        entries = b"".join(made)
        head += struct.pack("<I", zlib.crc32(entries, zlib.crc32(head)))
        start = layout.slots + (generation & 1) * layout.slot_size
        lock = start // 8
        self._numbers[lock] = 2 * generation - 1
        _fence()
        self._map[start + 8 : start + 8 + len(head)] = head
        begin = start + SLOT_HEADER_SIZE
        self._map[begin : begin + len(entries)] = entries
        _fence()
        self._numbers[lock] = 2 * generation
        _fence()
        self._numbers[_LATEST // 8] = generation
        self.heartbeat(now=now, wall=wall)

    def _entry(self, table: NeighbourTable, entry: NeighbourTableEntry) -> bytes:
        motion = table.motion(entry)
        position = motion.position if motion is not None else None
        velocity = motion.velocity if motion is not None else None
        flags = HAS_POSITION * (position is not None) | HAS_VELOCITY * (velocity is not None)
        if velocity is not None and motion is not None and motion.estimated:
            flags |= VELOCITY_ESTIMATED
        report = entry.ext_sd
        delay = table.delay(entry)
        packed = _ENTRY.pack(
            entry.node_id,
            len(entry.node_id),
            flags,
            *(position or _NOWHERE),
            *(velocity or _NOWHERE),
            entry.reception_time,
            entry.received_at,
            UNKNOWN_TIME if delay is None else _clamped(entry.reception_time - delay),
            entry.received,
            entry.lost,
            entry.repeated,
            -1 if entry.mean_interval is None else _clamped(round(entry.mean_interval)),
            entry.mean_gap,
            report.seqno & 0xFFFFFFFF,
            entry.restarts,
        )
        values = self._values.pack(*(getattr(report.s_data, name) for name in self._fields))
        return packed + values + self._padding

    def close(self) -> None:
        """Say that this was all, and remove the file; readers keep the last table. May be called twice."""
        if self._closed:
            return
        self._closed = True
        self._numbers[_STATE // 8] = _CLOSED
        with contextlib.suppress(OSError):
            ours, named = os.fstat(self._fd), self.path.stat()
            # A successor may have put its own file in the place of ours.
            if (ours.st_dev, ours.st_ino) == (named.st_dev, named.st_ino):
                self.path.unlink()
        self._numbers.release()
        self._signed.release()
        self._map.close()
        os.close(self._fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class FileEntry(msgspec.Struct, frozen=True, gc=False):
    """One neighbour of a snapshot. Position in m and velocity in m/s, None where unknown; times in ns."""

    node_id: bytes
    position: Vector | None
    velocity: Vector | None
    velocity_estimated: bool
    reception_wall: int
    reception_mono: int
    stamp_wall: int | None
    """When the neighbour made the report by its own clock; None where stamps are no wall time."""
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
    """A table as it was published at one moment. Times in ns."""

    profile: str
    node_id: bytes
    generation: int
    """Counts the tables of one writer from 1; 0 if it has not published any."""
    created_wall: int
    """When the writer started: with ``generation`` this identifies a table."""
    published_wall: int
    published_mono: int
    heartbeat_wall: int
    heartbeat_mono: int
    closed: bool
    """The writer has ended; a new one makes a new file, which the next snapshot is taken from."""
    omitted: int
    """Neighbours for which the file had no room."""
    entries: tuple[FileEntry, ...]

    def silence(self, wall: int) -> int:
        """Time in ns since the writer last showed that it lives. Do not fly by a table whose writer is silent."""
        return wall - self.heartbeat_wall


class NeighbourFileReader:
    """Reads what a :class:`NeighbourFileWriter` writes, without asking or disturbing it."""

    def __init__(self, path: str | Path) -> None:
        """Raises NeighbourFileError if there is no such file or it is none of this layout."""
        _little_endian_only()
        self.path = Path(path)
        self._attach()

    def _attach(self) -> None:
        try:
            with self.path.open("rb") as file:
                status = os.fstat(file.fileno())
                mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is empty"
            raise NeighbourFileError(f"{self.path}: cannot be read ({reason}); is the node running?") from None
        header = _HEADER.unpack_from(mapped) if len(mapped) >= HEADER_SIZE else (b"",)
        if header[0] != MAGIC or header[1] != LAYOUT_VERSION:
            mapped.close()
            raise NeighbourFileError(f"{self.path}: is no neighbour table of layout version {LAYOUT_VERSION}")
        _, _, slots, slot_size, slot_header, entry_size, capacity, field_count, id_length, node_id, profile = header
        layout = _Layout.of(capacity, field_count)
        if (slots, slot_size, slot_header, entry_size) != (
            layout.slots,
            layout.slot_size,
            SLOT_HEADER_SIZE,
            layout.entry_size,
        ) or len(mapped) != layout.file_size:
            mapped.close()
            raise NeighbourFileError(f"{self.path}: the sizes in its header contradict each other")
        self._identity = (status.st_dev, status.st_ino)
        self._map, self._layout = mapped, layout
        self._numbers = memoryview(mapped).cast("Q")
        self._signed = memoryview(mapped).cast("q")
        self._profile, self._node_id = _untext(profile), node_id[:id_length]
        records = (_FIELD.unpack_from(mapped, HEADER_SIZE + FIELD_SIZE * number) for number in range(field_count))
        self._names = tuple(_untext(name) for name, *_ in records)
        self._values = struct.Struct(f"<{field_count}d")

    def _follow(self) -> None:
        """Change over to the file of a new writer. While there is none, the last one stays."""
        with contextlib.suppress(OSError, NeighbourFileError):
            status = self.path.stat()
            if (status.st_dev, status.st_ino) != self._identity:
                old = (self._numbers, self._signed, self._map)
                self._attach()
                for each in old[:2]:
                    each.release()
                old[2].close()

    def snapshot(self) -> NeighbourFileSnapshot:
        """The latest table. Raises NeighbourFileError for a file that was damaged by others."""
        self._follow()
        for attempt in range(_ATTEMPTS):
            generation = self._numbers[_LATEST // 8]
            _fence()
            if generation == 0:
                return self._made(_SLOT.pack(0, self._signed[_CREATED // 8], 0, 0, 0), b"")
            taken = self._copy(generation)
            if taken is not None:
                return self._made(*taken)
            if attempt % 16 == 15:
                os.sched_yield()
        raise NeighbourFileError(f"{self.path}: is damaged: no table in it fits its checksum")

    def _copy(self, generation: int) -> tuple[bytes, bytes] | None:
        layout = self._layout
        start = layout.slots + (generation & 1) * layout.slot_size
        if self._numbers[start // 8] != 2 * generation:
            return None
        _fence()
        head = self._map[start + 8 : start + 8 + _SLOT.size]
        found, _, _, count, _ = _SLOT.unpack(head)
        if count > layout.capacity:
            return None
        checksum = int.from_bytes(self._map[start + _CHECKSUM : start + _CHECKSUM + 4], "little")
        begin = start + SLOT_HEADER_SIZE
        entries = self._map[begin : begin + count * layout.entry_size]
        _fence()
        if self._numbers[start // 8] != 2 * generation:
            return None
        fits = found == generation and zlib.crc32(entries, zlib.crc32(head)) == checksum
        return (head, entries) if fits else None

    def _made(self, head: bytes, entries: bytes) -> NeighbourFileSnapshot:
        generation, published_wall, published_mono, _, omitted = _SLOT.unpack(head)
        size = self._layout.entry_size
        return NeighbourFileSnapshot(
            profile=self._profile,
            node_id=self._node_id,
            generation=generation,
            created_wall=self._signed[_CREATED // 8],
            published_wall=published_wall,
            published_mono=published_mono,
            heartbeat_wall=self._signed[_HEARTBEAT_WALL // 8],
            heartbeat_mono=self._signed[_HEARTBEAT_MONO // 8],
            closed=self._numbers[_STATE // 8] == _CLOSED,
            omitted=omitted,
            entries=tuple(self._entry(entries, offset) for offset in range(0, len(entries), size)),
        )

    def _entry(self, entries: bytes, offset: int) -> FileEntry:
        (node_id, id_length, flags, px, py, pz, vx, vy, vz, wall, mono, stamp, *counts) = _ENTRY.unpack_from(
            entries, offset
        )
        received, lost, repeated, interval, gap, seqno, restarts = counts
        values: tuple[Any, ...] = self._values.unpack_from(entries, offset + ENTRY_FIXED)
        return FileEntry(
            node_id=node_id[:id_length],
            position=(px, py, pz) if flags & HAS_POSITION else None,
            velocity=(vx, vy, vz) if flags & HAS_VELOCITY else None,
            velocity_estimated=bool(flags & VELOCITY_ESTIMATED),
            reception_wall=wall,
            reception_mono=mono,
            stamp_wall=None if stamp == UNKNOWN_TIME else stamp,
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
        """Let go of the file. May be called twice."""
        self._numbers.release()
        self._signed.release()
        self._map.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


_NOWHERE: Final = (math.nan, math.nan, math.nan)


def _little_endian_only() -> None:
    if sys.byteorder != "little":
        raise NeighbourFileError("neighbour files need a machine that is little-endian, as x86-64 and aarch64 are")


def _refuse_foreign(path: Path) -> None:
    """Raise for a name that is taken by something else, or by a file that somebody is writing."""
    try:
        status = os.lstat(path)
    except FileNotFoundError:
        return
    if not stat.S_ISREG(status.st_mode):
        raise NeighbourFileError(f"{path}: is no regular file, and is not replaced")
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise NeighbourFileError(f"{path}: is no neighbour table, and is not replaced")
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise NeighbourFileError(f"{path}: is being written by another node") from None


def _text(text: str, size: int) -> bytes:
    """UTF-8 that ends with NUL, cut at a character."""
    octets = text.encode()[: size - 1].decode(errors="ignore").encode()
    return octets.ljust(size, b"\0")


def _untext(octets: bytes) -> str:
    return octets.split(b"\0", 1)[0].decode(errors="replace")


def _clamped(number: int) -> int:
    return min(max(number, -(1 << 63) + 1), (1 << 63) - 1)
