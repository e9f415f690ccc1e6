"""CRC-32 as zlib has it, over as much as a recording holds."""

from __future__ import annotations

import zlib
from collections.abc import Callable


def fastest() -> Callable[[bytes | memoryview, int], int]:
    """That of fastcrc, which uses wide registers and takes a tenth of the time, where it is installed; else zlib's."""
    try:
        from fastcrc.crc32 import iso_hdlc
    except ImportError:
        return zlib.crc32
    found: Callable[[bytes | memoryview, int], int] = iso_hdlc
    return found


_crc = fastest()


def crc32(octets: bytes | memoryview, before: int = 0) -> int:
    """The checksum of ``octets``, going on from that of what stands ``before`` them."""
    return _crc(octets, before)
