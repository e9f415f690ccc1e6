"""What a node does about its memory once everything is open: a small computer has better uses for it."""

from __future__ import annotations

import ctypes
import gc
import sys
from contextlib import suppress


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
