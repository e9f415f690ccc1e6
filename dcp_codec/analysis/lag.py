"""The lag of nodes relative to the producer of a variable: in values, and in time."""

from __future__ import annotations

from bisect import bisect_left
from operator import attrgetter
from typing import Final

from .entry import DELETED, Entry

PATIENCE: Final = 3_000_000_000
"""Time in ns after which the number of a producer must have reached all nodes."""
PATIENCE_BEACONS: Final = 10
"""The same in beacons of a node."""
#: Number of states of the producer that are kept: as many as there are sequence numbers of one octet.
_KEPT = 256


def patience(period_ns: float) -> int:
    """Return the age in ns from which a state is stale, for nodes with this beacon period."""
    return max(PATIENCE, round(PATIENCE_BEACONS * period_ns))


class Production:
    """The latest states of a variable at its producer, and the states of other nodes that follow them."""

    __slots__ = ("_base", "_counts", "_places", "_states", "_with", "node")

    def __init__(self, node: bytes) -> None:
        self.node = node
        self._states: list[Entry] = []
        self._counts: list[int] = []
        """For each state the number of states with a number up to it."""
        self._base = 0
        """Number of earlier states, which are not kept."""
        self._places: dict[int, int] = {}
        """Number -> place of the last state with it."""
        self._with: dict[bytes, Entry] = {}
        """Node -> its last state with the present number of the producer."""

    def lag(self, entry: Entry) -> int | None:
        """Return how many values the producer has had since that of a state; None if that is not known."""
        if entry.node == self.node:
            return 0
        return self._counts[-1] - entry.count if entry.count >= 0 else None

    def begins(self, entry: Entry) -> None:
        """Process the next state of a node."""
        if entry.node != self.node:
            place = self._places.get(entry.number, -1) - self._base if entry.number >= 0 else -1
            if place < 0:
                return
            entry.count = self._counts[place]
            if place == len(self._states) - 1:
                self._with[entry.node] = entry
            else:
                entry.left = self._states[place + 1]
            return
        for each in self._with.values():
            each.left = entry
        self._with.clear()
        self._places[entry.number] = self._base + len(self._states)
        entry.count = (self._counts[-1] if self._counts else 0) + (entry.number >= 0)
        self._counts.append(entry.count)
        self._states.append(entry)

    @property
    def full(self) -> bool:
        """True if the limit of kept states is reached: the older half can be removed."""
        return len(self._states) >= 2 * _KEPT

    def forget(self) -> None:
        """Forget the older half of the states. Compare the present states of all nodes before."""
        self._base += _KEPT
        del self._states[:_KEPT], self._counts[:_KEPT]

    def compare(self, entry: Entry) -> None:
        """Set what the producer had done when a node stated its number for the last time."""
        if entry.age <= 0 or (self._base and entry.until < self._states[0].time):
            # In the latter case it was compared before the states were forgotten.
            return
        last = max(bisect_left(self._states, entry.until, key=attrgetter("time")) - 1, 0)
        entry.missed = self._counts[last] - entry.count
        entry.deleted = self._states[last].number == DELETED
        while self._states[last].number < 0 and last:
            last -= 1
        entry.newest = self._states[last]
