"""What a node does about its memory once everything is open: a small computer has better uses for it."""

from __future__ import annotations

import ctypes
import gc
import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

_HUGE: Final = 2 << 20
"""Octets of a huge page, of the common page size of 4 KiB."""
_MADV_COLLAPSE: Final = 25
"""Of <linux/mman.h>, since Linux 6.1."""
_WRITABLE: Final = re.compile(r"^([0-9a-f]+)-([0-9a-f]+) rw-p 00000000 00:00 0 ", re.MULTILINE)


def settle() -> None:
    """Give back what only the start needed.

    Scapy loads the names of all manufacturers of network cards, 13 MB, which a link has no use for; this process
    shows no packets. What lives now will live to the end, so the garbage collector need not look at it again.
    """
    data = sys.modules.get("scapy.data")
    if data is not None:
        # Another version may keep them elsewhere; then they stay.
        with suppress(AttributeError):
            data.MANUFDB.d.clear()
    gc.collect()
    gc.freeze()
    if data is not None:
        # Python frees memory to the C library, and that to the system only when asked (glibc; others do by themselves).
        with suppress(AttributeError, OSError):
            ctypes.CDLL(None).malloc_trim(0)
    _collapse()


def _collapse() -> None:
    """Put the objects of the process into huge pages, where the system has them.

    A node that sleeps for 100 ms finds the caches of the processor cold, and a good part of what a wake-up then takes
    is looking up pages. Where the system does not know the advice or has no huge page to give, nothing happens.
    """
    with suppress(AttributeError, OSError):
        advise = ctypes.CDLL(None).madvise
        for begin, end in _WRITABLE.findall(Path("/proc/self/maps").read_text()):
            first, last = -(-int(begin, 16) // _HUGE) * _HUGE, int(end, 16) // _HUGE * _HUGE
            if first < last:
                advise(ctypes.c_void_p(first), ctypes.c_size_t(last - first), _MADV_COLLAPSE)
