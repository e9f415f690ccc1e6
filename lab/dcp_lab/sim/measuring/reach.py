"""Shortest paths over connections that carry frames, in hops."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable

#: The distance of a node without a path from the producer.
UNREACHABLE = -1


class Reach:
    """The nodes at which a new value is counted, and their distances from its producer in hops."""

    __slots__ = ("by_hops", "hops", "mask")

    def __init__(self, producer: int, present: Iterable[int], hops: dict[int, int]) -> None:
        """``present``: the nodes that are switched on. ``hops``: distances of the nodes that can be reached."""
        self.hops = hops
        others = [node for node in present if node != producer]
        self.mask = sum(1 << node for node in others)
        """The nodes as bits; the bit of node n has the value 2^n."""
        self.by_hops = Counter(hops.get(node, UNREACHABLE) for node in others)
        """Number of nodes at each distance; :data:`UNREACHABLE` for those without a path."""


def distances(source: int, neighbours: Callable[[int], Iterable[int]]) -> dict[int, int]:
    """Return the hops from ``source`` to each node that can be reached, including 0 for itself."""
    found, waiting = {source: 0}, deque([source])
    while waiting:
        node = waiting.popleft()
        for other in neighbours(node):
            if other not in found:
                found[other] = found[node] + 1
                waiting.append(other)
    return found


def longest_distance(count: int, neighbours: Callable[[int], Iterable[int]], sources: Iterable[int]) -> int | None:
    """Return the largest distance in hops from any of ``sources`` to any of the nodes 0 to ``count`` - 1.

    Returns None if a source cannot reach one of them.
    """
    longest = 0
    for source in sources:
        found = distances(source, neighbours)
        if len(found) < count:
            return None
        longest = max(longest, *found.values())
    return longest
