"""The writer of a neighbour file."""

from __future__ import annotations

import contextlib
import fcntl
import math
import mmap
import os
import stat
import struct
import zlib
from pathlib import Path
from typing import Final, Self

from dcp_spec.profile.definition import Profile

from dcp_stack.positions.fields import ROLES
from dcp_stack.srp.neighbour_table import NeighbourTable, NeighbourTableEntry

from . import layout
from .layout import NeighbourFileError

_ROLE_NUMBERS: Final = {role: 1 + number for number, role in enumerate(sorted(ROLES))}
_NOWHERE: Final = (math.nan, math.nan, math.nan)


class NeighbourFileWriter:
    """Writes the neighbour table of one node to a file. Only one thread of one process may write the file."""

    def __init__(
        self, path: str | Path, profile: Profile, node_id: bytes, *, capacity: int = 1024, now: int, wall: int
    ) -> None:
        """Create the file with mode 0644. It gets its name when it is complete, and replaces an earlier file.

        ``capacity``: maximum number of entries, 1..65536; each needs about 2 * 192 octets. Use a path in /dev/shm or
        /run: elsewhere the system writes the pages to disk from time to time. Raises NeighbourFileError if another
        process writes the file, if the name belongs to a different kind of file, or if the system refuses.
        """
        layout.little_endian_only()
        if not 1 <= capacity <= layout.MAX_CAPACITY:
            raise NeighbourFileError(f"{path}: the capacity is 1 to {layout.MAX_CAPACITY} entries, not {capacity}")
        if len(node_id) > layout.NODE_ID_SIZE:
            raise NeighbourFileError(f"{path}: a node identifier has at most {layout.NODE_ID_SIZE} octets here")
        self.path = Path(path)
        self._fields = tuple(field.name for field in profile.srp.safety_data if field.type != "opaque")
        self._sizes = layout.FileSizes(capacity, len(self._fields))
        self._values = struct.Struct(f"<{len(self._fields)}d")
        self._padding = bytes(self._sizes.entry_size - layout.ENTRY_FIXED - self._values.size)
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
            # The writer holds this lock; the kernel releases it if the process dies.
            fcntl.flock(self._fd, fcntl.LOCK_EX)
            os.fchmod(self._fd, 0o644)
            # Allocated in advance: a write into a mapping on a full file system would kill the process.
            os.posix_fallocate(self._fd, 0, self._sizes.file_size)
            self._map = mmap.mmap(self._fd, self._sizes.file_size)
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
        """Write the header and the descriptions of the fields."""
        sizes = self._sizes
        self._map[: layout.HEADER.size] = layout.HEADER.pack(
            layout.MAGIC,
            layout.LAYOUT_VERSION,
            sizes.slots,
            sizes.slot_size,
            layout.SLOT_HEADER_SIZE,
            sizes.entry_size,
            sizes.capacity,
            sizes.field_count,
            len(node_id),
            node_id,
            _text(profile.name, 56),
        )
        numeric = [field for field in profile.srp.safety_data if field.type != "opaque"]
        for number, field in enumerate(numeric):
            record = layout.FIELD.pack(
                _text(field.name, 40),
                _text(field.unit, 16),
                layout.ENTRY_FIXED + 8 * number,
                _ROLE_NUMBERS.get(field.role, 0),
            )
            start = layout.HEADER_SIZE + layout.FIELD_SIZE * number
            self._map[start : start + layout.FIELD_SIZE] = record
        self._signed[layout.CREATED // 8] = wall
        self._numbers[layout.PID // 8] = os.getpid()
        self._numbers[layout.STATE // 8] = layout.RUNNING
        self.heartbeat(now=now, wall=wall)

    def heartbeat(self, *, now: int, wall: int) -> None:
        """Renew the heartbeat, which shows readers that the writer is alive even without new tables."""
        # By a memoryview, not by struct: a single store, so readers cannot see a partial value.
        self._signed[layout.HEARTBEAT_WALL // 8] = wall
        self._signed[layout.HEARTBEAT_MONO // 8] = now

    def publish(self, table: NeighbourTable, *, now: int, wall: int) -> None:
        """Write ``table`` to the file as the latest one, and renew the heartbeat.

        Entries beyond the capacity, and those whose node identifier has more than 32 octets, are left out and counted.
        The call takes some microseconds per entry; the slot is locked only while the prepared table is copied.
        """
        sizes = self._sizes
        made: list[bytes] = []
        omitted = 0
        for entry in table:
            if len(made) < sizes.capacity and len(entry.node_id) <= layout.NODE_ID_SIZE:
                made.append(self._entry(table, entry))
            else:
                omitted += 1
        self._generation += 1
        generation = self._generation
        head = layout.SLOT.pack(generation, wall, now, len(made), omitted)
        entries = b"".join(made)
        head += struct.pack("<I", zlib.crc32(entries, zlib.crc32(head)))
        start = sizes.slots + (generation & 1) * sizes.slot_size
        lock = start // 8
        self._numbers[lock] = 2 * generation - 1
        layout.fence()
        self._map[start + 8 : start + 8 + len(head)] = head
        begin = start + layout.SLOT_HEADER_SIZE
        self._map[begin : begin + len(entries)] = entries
        layout.fence()
        self._numbers[lock] = 2 * generation
        layout.fence()
        self._numbers[layout.LATEST // 8] = generation
        self.heartbeat(now=now, wall=wall)

    def _entry(self, table: NeighbourTable, entry: NeighbourTableEntry) -> bytes:
        """Return the octets of an entry."""
        motion = table.motion(entry)
        position = motion.position if motion is not None else None
        velocity = motion.velocity if motion is not None else None
        flags = layout.HAS_POSITION * (position is not None) | layout.HAS_VELOCITY * (velocity is not None)
        if velocity is not None and motion is not None and motion.estimated:
            flags |= layout.VELOCITY_ESTIMATED
        report = entry.ext_sd
        delay = table.delay(entry)
        packed = layout.ENTRY.pack(
            entry.node_id,
            len(entry.node_id),
            flags,
            *(position or _NOWHERE),
            *(velocity or _NOWHERE),
            entry.reception_time,
            entry.received_at,
            layout.UNKNOWN_TIME if delay is None else _clamped(entry.reception_time - delay),
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
        """Mark the file as closed, and remove it; readers keep the last table. May be called twice."""
        if self._closed:
            return
        self._closed = True
        self._numbers[layout.STATE // 8] = layout.CLOSED
        with contextlib.suppress(OSError):
            ours, named = os.fstat(self._fd), self.path.stat()
            # A new writer may already have replaced this file by its own.
            if (ours.st_dev, ours.st_ino) == (named.st_dev, named.st_ino):
                self.path.unlink()
        self._numbers.release()
        self._signed.release()
        self._map.close()
        os.close(self._fd)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def _refuse_foreign(path: Path) -> None:
    """Raise NeighbourFileError if the name belongs to another kind of file, or to one that another process writes."""
    try:
        status = os.lstat(path)
    except FileNotFoundError:
        return
    if not stat.S_ISREG(status.st_mode):
        raise NeighbourFileError(f"{path}: is not a regular file, and is not replaced")
    with path.open("rb") as file:
        if file.read(len(layout.MAGIC)) != layout.MAGIC:
            raise NeighbourFileError(f"{path}: is not a neighbour table, and is not replaced")
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise NeighbourFileError(f"{path}: is being written by another node") from None


def _text(text: str, size: int) -> bytes:
    """Return text as UTF-8 of ``size`` octets, padded with NUL, and truncated at a character if necessary."""
    octets = text.encode()[: size - 1].decode(errors="ignore").encode()
    return octets.ljust(size, b"\0")


def _clamped(number: int) -> int:
    """Limit a number to the range of a signed 64-bit field, without the value for unknown."""
    return min(max(number, -(1 << 63) + 1), (1 << 63) - 1)
