"""CRC-32 as zlib has it, over as much as a recording holds."""

from __future__ import annotations

import zlib
from collections.abc import Callable

Crc = Callable[[bytes, int], int]


def _fastest() -> Crc:
    """That of fastcrc, which uses wide registers and takes a tenth of the time, where it is installed."""
    try:
        from fastcrc.crc32 import iso_hdlc
    except ImportError:
        return zlib.crc32
    found: Crc = iso_hdlc
    return found


_crc = _fastest()


def crc32(octets: bytes, before: int = 0) -> int:
    """The checksum of ``octets``, going on from that of what stands ``before`` them."""
    return _crc(octets, before)
