"""Parts of pcapng other than frames: blocks by number, options, interfaces and their clocks."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from math import gcd
from typing import Literal

SECTION_HEADER = 0x0A0D0D0A
INTERFACE = 0x0000_0001
PACKET = 0x0000_0002  # obsolete, last written around 2010
SIMPLE_PACKET = 0x0000_0003
NAME_RESOLUTION = 0x0000_0004
STATISTICS = 0x0000_0005
ENHANCED_PACKET = 0x0000_0006

#: Block types of the registry that do not concern frames.
SKIPPED = frozenset(
    {
        NAME_RESOLUTION,
        0x0000_0007,  # IRIG timestamp
        0x0000_0008,  # ARINC 429
        0x0000_0009,  # systemd journal
        0x0000_000A,  # decryption secrets
        0x0000_0BAD,  # custom, may be copied
        0x4000_0BAD,  # custom, may not be copied
    }
)

#: Minimum total length of the blocks whose contents are read, and their names.
_READ = {
    SECTION_HEADER: (28, "a section header"),
    INTERFACE: (20, "the description of an interface"),
    PACKET: (32, "a packet block"),
    SIMPLE_PACKET: (16, "a simple packet block"),
    STATISTICS: (24, "a statistics block"),
    ENHANCED_PACKET: (32, "an enhanced packet block"),
}
LEAST_LENGTH = {kind: least for kind, (least, _) in _READ.items()}

#: The byte-order magic of a section header, as in the file -> byte order for struct.
BYTE_ORDERS: dict[bytes, Literal["<", ">"]] = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}

SECTION_OPTIONS = {2: "hardware", 3: "os", 4: "userappl"}
INTERFACE_OPTIONS = {2: "name", 3: "description"}
IF_TSRESOL, IF_TSOFFSET = 9, 14
ISB_IFDROP, ISB_OSDROP = 5, 7

_NANO = 1_000_000_000
_UNITS = {0: "s", 3: "ms", 6: "us", 9: "ns"}


def block_name(kind: int) -> str:
    """Return the name of a block type for messages."""
    return _READ[kind][1] if kind in _READ else f"a block of type {kind:#010x}"


class BadOptionError(Exception):
    """An option that does not fit into its block or has an invalid length."""


def options(buffer: bytes, start: int, stop: int, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield codes and values of the options in `buffer[start:stop]`, up to the end-of-options mark if there is one.

    Raises `BadOptionError` at an option that does not fit, after the options before it.
    """
    head = struct.Struct(order + "HH")
    while start < stop:
        if stop - start < head.size:
            raise BadOptionError(f"{stop - start} octets are not an option")
        code, length = head.unpack_from(buffer, start)
        start += head.size
        if code == 0:
            return
        if length > stop - start:
            raise BadOptionError(f"option {code} claims {length} octets of {stop - start}")
        yield code, buffer[start : start + length]
        start += length + -length % 4


class Interface:
    """One interface of a section: its link type, its snap length, and its clock."""

    __slots__ = ("accepted", "divide", "index", "link_type", "multiply", "resolution", "shift_ns", "snap")

    def __init__(self, index: int, link_type: int, snap: int, *, accepted: bool) -> None:
        #: Counts from 0 through the whole file.
        self.index = index
        self.link_type = link_type
        #: Longest frame in octets, 0 for no limit.
        self.snap = snap
        self.accepted = accepted
        self.shift_ns = 0
        self.set_resolution(6)

    def set_resolution(self, code: int) -> None:
        """Apply `if_tsresol`: a negative power of 10, or with the top bit set of 2."""
        exponent = code & 0x7F
        if code & 0x80:
            unit, self.resolution = 1 << exponent, f"2^-{exponent} s"
        else:
            unit, self.resolution = int(10**exponent), _UNITS.get(exponent, f"10^-{exponent} s")
        common = gcd(_NANO, unit)
        # nanoseconds = stamp * multiply / divide, in integers only
        self.multiply: int = _NANO // common
        self.divide: int = unit // common

    def apply(self, code: int, value: bytes, order: str) -> None:
        """Apply an option of the description. Raises `BadOptionError` if it has the wrong length."""
        if code == IF_TSRESOL:
            if len(value) != 1:
                raise BadOptionError(f"if_tsresol has {len(value)} octets, not 1")
            self.set_resolution(value[0])
        elif code == IF_TSOFFSET:
            if len(value) != 8:
                raise BadOptionError(f"if_tsoffset has {len(value)} octets, not 8")
            self.shift_ns = struct.unpack(order + "q", value)[0] * _NANO
