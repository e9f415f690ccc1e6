"""The layout of a neighbour file, common to writer and reader; ``docs/neighbour-file.md`` describes it."""

from __future__ import annotations

import struct
import sys
import threading
from typing import Final

import msgspec

MAGIC: Final = b"DCPNEIGH"
LAYOUT_VERSION: Final = 1
HEADER_SIZE: Final = 256
FIELD_SIZE: Final = 64
SLOT_HEADER_SIZE: Final = 64
ENTRY_FIXED: Final = 160
NODE_ID_SIZE: Final = 32
MAX_CAPACITY: Final = 65_536

HEADER: Final = struct.Struct("<8s8I32s56s")
FIELD: Final = struct.Struct("<40s16sII")
SLOT: Final = struct.Struct("<QqqII")
ENTRY: Final = struct.Struct("<32sII3d3dqqqQQQqdII")
# Offsets of the header fields that change after the creation; each is a naturally aligned number of 8 octets.
LATEST, HEARTBEAT_WALL, HEARTBEAT_MONO, STATE, CREATED, PID = 128, 136, 144, 152, 160, 168
RUNNING, CLOSED = 1, 2
CHECKSUM: Final = 40

HAS_POSITION, HAS_VELOCITY, VELOCITY_ESTIMATED = 1, 2, 4
"""Flags of an entry."""
UNKNOWN_TIME: Final = -(1 << 63)
_FENCE: Final = threading.Lock()


class NeighbourFileError(Exception):
    """A neighbour file cannot be created or read; the message has its path and the reason."""


def little_endian_only() -> None:
    """Raise NeighbourFileError on a big-endian machine."""
    if sys.byteorder != "little":
        raise NeighbourFileError("neighbour files require a little-endian machine, such as x86-64 or aarch64")


def fence() -> None:
    """Execute a full memory barrier: accesses before the call take effect before accesses after it.

    Python has no barrier, but its locks are those of the system, which have to synchronize memory. Earlier accesses
    cannot move after a release, later ones cannot move before an acquire, and an acquire cannot move before a
    preceding release. Here the first pair provides the release, the second the acquire.
    """
    with _FENCE:
        pass
    with _FENCE:
        pass


class FileSizes(msgspec.Struct, frozen=True):
    """Sizes and offsets of one file, in octets. ``field_count``: numeric fields of the profile's safety data."""

    capacity: int
    field_count: int

    @property
    def entry_size(self) -> int:
        """Size of an entry: a multiple of 64 (a cache line)."""
        return -(-(ENTRY_FIXED + 8 * self.field_count) // 64) * 64

    @property
    def slots(self) -> int:
        """Offset of slot 0."""
        return HEADER_SIZE + FIELD_SIZE * self.field_count

    @property
    def slot_size(self) -> int:
        """Size of a slot, its header included."""
        return SLOT_HEADER_SIZE + self.capacity * self.entry_size

    @property
    def file_size(self) -> int:
        """Size of the file."""
        return self.slots + 2 * self.slot_size
