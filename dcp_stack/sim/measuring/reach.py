"""Shortest paths over connections that carry frames, in hops."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable

#: The distance of a node that no path leads to.
UNREACHABLE = -1


class Reach:
    """Which nodes a value born now can be counted at, and how many hops away each of them is."""

    __slots__ = ("by_hops", "hops", "mask")

    def __init__(self, producer: int, present: Iterable[int], hops: dict[int, int]) -> None:
        """``present`` are the nodes that are switched on, ``hops`` the distances of those that can be reached."""
        self.hops = hops
        others = [node for node in present if node != producer]
        self.mask = sum(1 << node for node in others)
        """One bit for each node, by its number."""
        self.by_hops = Counter(hops.get(node, UNREACHABLE) for node in others)
        """How many nodes there are at each distance; :data:`UNREACHABLE` for those without a path."""


def distances(source: int, neighbours: Callable[[int], Iterable[int]]) -> dict[int, int]:
    """Hops from ``source`` to each node that can be reached, itself included."""
    found, waiting = {source: 0}, deque([source])
    while waiting:
        node = waiting.popleft()
        for other in neighbours(node):
            if other not in found:
                found[other] = found[node] + 1
                waiting.append(other)
    return found


def longest_distance(count: int, neighbours: Callable[[int], Iterable[int]], sources: Iterable[int]) -> int | None:
    """The largest distance from any of ``sources`` to any node of 0..count-1; None if a node cannot be reached."""
    longest = 0
    for source in sources:
        found = distances(source, neighbours)
        if len(found) < count:
            return None
        longest = max(longest, *found.values())
    return longest
