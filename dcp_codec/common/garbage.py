"""Fewer garbage collections while a recording is judged or a network is simulated.

Both keep many objects for long, and create nearly no reference cycles. Python's default thresholds would search these
objects for cycles every few hundred beacons, at about a tenth of the total time. The cost of a search grows with the
number of new objects, so that a recording of usual length should end before the first one. The limit bounds the memory
that cycles can use.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

#: Number of new objects (that can be part of a cycle) between two collections; Python's default is 700.
_OBJECTS: Final = 1_000_000


@contextmanager
def few_collections() -> Iterator[None]:
    """Collect garbage after every ``_OBJECTS`` new objects; restore the thresholds of the process at the end.

    Thresholds that are higher already, or 0 (no collections), are kept. The objects that are new at the end belong to
    the oldest generation then, so that the restored thresholds do not start a search of all of them at once.
    """
    before = gc.get_threshold()
    if 0 < before[0] < _OBJECTS:
        gc.set_threshold(_OBJECTS, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
        if not gc.get_freeze_count():
            gc.freeze()
            gc.unfreeze()
