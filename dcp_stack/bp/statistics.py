"""Counters of BP and the beacon loss of each neighbour (BP-MGT-06, BP-RX-11), in bounded memory."""

from __future__ import annotations

from typing import Final

import msgspec
from dcp_spec.constants import BP_SEQNO_MODULUS

MAX_NEIGHBOURS: Final = 4096
"""Capacity of the loss table; a further sender replaces the one that was silent for longest."""
SMOOTHING: Final = 0.95
"""Weight of the previous estimate per beacon; the loss estimate covers about the last 20 beacons."""


class Counters:
    """Counters by name. Names contain reasons and registered protocols, no received values: bounded memory."""

    def __init__(self, *always: str) -> None:
        """``always`` names counters that exist from the start with 0, so that differences can be computed."""
        self._numbers: dict[str, int] = dict.fromkeys(always, 0)

    def count(self, name: str, by: int = 1) -> None:
        """Add to a counter."""
        self._numbers[name] = self._numbers.get(name, 0) + by

    def as_dict(self) -> dict[str, int]:
        """Return a copy, ordered by name."""
        return dict(sorted(self._numbers.items()))


class NeighbourLoss(msgspec.Struct, frozen=True, gc=False):
    """Statistics of the sequence numbers of one sender; ``heard`` is monotonic ns.

    ``lost`` counts the numbers left out, ``repeated`` equal ones in a row, ``restarts`` steps back. ``loss`` is the
    share of beacons lost lately, 0..1.
    """

    node_id: bytes
    seqno: int
    heard: int
    received: int = 1
    lost: int = 0
    repeated: int = 0
    restarts: int = 0
    loss: float = 0.0

    def after(self, seqno: int, now: int) -> NeighbourLoss:
        """Return the statistics after another beacon, received at ``now``."""
        ahead = (seqno - self.seqno) % BP_SEQNO_MODULUS
        lost, repeated, restarts, loss = self.lost, self.repeated, self.restarts, self.loss
        if ahead == 0:
            repeated += 1
        elif ahead > BP_SEQNO_MODULUS // 2:
            # Numbers only step back when the sender starts again: a single hop does not reorder.
            restarts += 1
        else:
            lost += ahead - 1
            # Each lost beacon pulls the estimate to 1, the received one to 0.
            loss = (1 - (1 - loss) * SMOOTHING ** (ahead - 1)) * SMOOTHING
        return NeighbourLoss(self.node_id, seqno, now, self.received + 1, lost, repeated, restarts, loss)


class LossTable:
    """Loss estimates by sender."""

    def __init__(self, capacity: int = MAX_NEIGHBOURS) -> None:
        self._capacity = capacity
        # Ordered by when they were last heard, the longest silent first.
        self._entries: dict[bytes, NeighbourLoss] = {}

    def record(self, node_id: bytes, seqno: int, now: int) -> None:
        """Count a received beacon of ``node_id``."""
        known = self._entries.pop(node_id, None)
        if known is None and len(self._entries) >= self._capacity:
            del self._entries[next(iter(self._entries))]
        self._entries[node_id] = NeighbourLoss(node_id, seqno, now) if known is None else known.after(seqno, now)

    def entries(self) -> tuple[NeighbourLoss, ...]:
        """Return all entries, the longest silent first."""
        return tuple(self._entries.values())

    def get(self, node_id: bytes) -> NeighbourLoss | None:
        """Return the entry of a sender, or None."""
        return self._entries.get(node_id)
