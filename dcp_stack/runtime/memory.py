"""Reducing the memory of a node after its start, for small computers."""

from __future__ import annotations

import ctypes
import gc
import sys
from contextlib import suppress


def settle() -> None:
    """Free memory that only the start needed.

    Scapy loads the names of all manufacturers of network cards (13 MB), which a link does not need. All objects that
    exist now live until the end, so they are excluded from garbage collection.
    """
    data = sys.modules.get("scapy.data")
    if data is not None:
        # Other versions may store them elsewhere; then they stay.
        with suppress(AttributeError):
            data.MANUFDB.d.clear()
    gc.collect()
    gc.freeze()
    if data is not None:
        # Python frees memory to the C library; glibc returns it to the system only on request.
        with suppress(AttributeError, OSError):
            ctypes.CDLL(None).malloc_trim(0)
