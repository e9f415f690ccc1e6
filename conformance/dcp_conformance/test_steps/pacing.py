"""Frames at a rate for which every receiver has buffers: no rule says how many frames a node must be able to queue."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

from dcp_conformance.test_system.bench import Bench

T = TypeVar("T")

FEW = 4
"""Number of beacons in a beacon period that every receiver can buffer."""


def paced(bench: Bench, items: Iterable[T]) -> Iterator[T]:
    """Yield the items, for each of which the caller sends one frame, and wait after every :data:`FEW` of them.

    Waits a beacon period, or longer if processing was measured to take longer.
    """
    for count, each in enumerate(items, 1):
        yield each
        if count % FEW == 0:
            bench.wait(max(1, (bench.session.busy_until - bench.now()) / bench.period))
