"""Where what is in a neighbour file, for its writer and its reader; ``docs/neighbour-file.md`` has it for others."""

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
# Offsets of what changes after the creation, each of them a naturally aligned number of 8 octets.
LATEST, HEARTBEAT_WALL, HEARTBEAT_MONO, STATE, CREATED, PID = 128, 136, 144, 152, 160, 168
RUNNING, CLOSED = 1, 2
CHECKSUM: Final = 40

HAS_POSITION, HAS_VELOCITY, VELOCITY_ESTIMATED = 1, 2, 4
"""Bits of the flags of an entry."""
UNKNOWN_TIME: Final = -(1 << 63)
_FENCE: Final = threading.Lock()


class NeighbourFileError(Exception):
    """A neighbour file cannot be created or read; the message names it and says why."""


def little_endian_only() -> None:
    """Raise NeighbourFileError on a machine of the other byte order."""
    if sys.byteorder != "little":
        raise NeighbourFileError("neighbour files need a machine that is little-endian, as x86-64 and aarch64 are")


def fence() -> None:
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


class Layout(msgspec.Struct, frozen=True):
    """Sizes in octets and offsets of one file."""

    capacity: int
    field_count: int
    entry_size: int

    @classmethod
    def of(cls, capacity: int, field_count: int) -> Layout:
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
