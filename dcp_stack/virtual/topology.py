"""The neighbourhoods of a simulated medium. Nodes are numbers from 0."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Protocol


class Topology(Protocol):
    """A rule that determines which nodes receive a transmission; it need not be symmetric."""

    @property
    def version(self) -> int:
        """A number that changes whenever neighbourhoods do."""
        ...

    def neighbours(self, sender: int, count: int) -> Iterable[int]:
        """Return the nodes that receive from ``sender``, in any order; ``sender`` and numbers >= count are ignored."""
        ...


class Full:
    """A topology in which all nodes receive each other."""

    version = 0

    def neighbours(self, sender: int, count: int) -> Iterable[int]:  # noqa: ARG002
        """Return all nodes."""
        return range(count)


class Line:
    """A line: each node receives from the nodes next to it; the nodes at the ends have one neighbour."""

    version = 0

    def neighbours(self, sender: int, count: int) -> Iterable[int]:  # noqa: ARG002
        """Return the previous and the next number."""
        return (sender - 1, sender + 1)


class Grid:
    """Rows of ``columns`` nodes each; neighbours are above, below, left and right, with ``diagonal`` also diagonal."""

    version = 0

    def __init__(self, columns: int, *, diagonal: bool = False) -> None:
        if columns < 1:
            raise ValueError(f"a grid has at least one column, not {columns}")
        self._columns = columns
        self._steps = [
            (down, right)
            for down in (-1, 0, 1)
            for right in (-1, 0, 1)
            if (down or right) and (diagonal or not (down and right))
        ]

    def neighbours(self, sender: int, count: int) -> Iterable[int]:  # noqa: ARG002
        """Yield up to four nodes, with diagonals up to eight."""
        row, column = divmod(sender, self._columns)
        for down, right in self._steps:
            if 0 <= column + right < self._columns:
                yield (row + down) * self._columns + column + right


class Neighbours:
    """Explicit neighbourhoods: sender -> receivers. A connection in both directions needs two entries."""

    def __init__(self, heard_by: Mapping[int, Iterable[int]]) -> None:
        self.version = 0
        self._heard_by = {sender: frozenset(receivers) for sender, receivers in heard_by.items()}

    def neighbours(self, sender: int, count: int) -> Iterable[int]:  # noqa: ARG002
        """Return the receivers given for ``sender``; none if it has no entry."""
        return self._heard_by.get(sender, frozenset())

    def connect(self, sender: int, receiver: int) -> None:
        """Let ``receiver`` receive from ``sender`` from now on."""
        self._heard_by[sender] = self._heard_by.get(sender, frozenset()) | {receiver}
        self.version += 1

    def disconnect(self, sender: int, receiver: int) -> None:
        """Stop ``receiver`` from receiving from ``sender``."""
        self._heard_by[sender] = self._heard_by.get(sender, frozenset()) - {receiver}
        self.version += 1


Point = tuple[float, float, float]
_Cell = tuple[int, int, int]


class Positions:
    """Nodes in space: all nodes at most ``radio_range`` away receive a transmission.

    Positions and ranges have the same unit, which can be any. ``ranges`` gives single senders another range, which
    makes connections asymmetric. A node without a position (None, or not in the sequence) has no neighbours.

    Nodes are stored by cube, with edges as long as the range: a search visits 27 cubes instead of all nodes.
    """

    def __init__(
        self,
        positions: Sequence[Point | None],
        radio_range: float,
        *,
        ranges: Mapping[int, float] | None = None,
    ) -> None:
        """Raises ValueError if ``radio_range`` is not greater than 0."""
        if not radio_range > 0:
            raise ValueError(f"the radio range must be greater than 0, not {radio_range:g}")
        self.version = 0
        self._positions = list(positions)
        self._range = radio_range
        self._ranges = dict(ranges or {})
        self._cells: dict[_Cell, set[int]] = {}
        for node, position in enumerate(self._positions):
            if position is not None:
                self._cells.setdefault(self._cell(position), set()).add(node)

    def move(self, node: int, position: Point) -> None:
        """Move ``node`` to ``position``; raises ``IndexError`` if it is neither known nor the next new number."""
        if node == len(self._positions):
            self._positions.append(None)
        old, cell = self._positions[node], self._cell(position)
        if old == position:
            return
        self._positions[node] = position
        left = None if old is None else self._cell(old)
        if left != cell:
            if left is not None:
                self._cells[left].discard(node)
                if not self._cells[left]:
                    del self._cells[left]
            self._cells.setdefault(cell, set()).add(node)
        self.version += 1

    def position(self, node: int) -> Point | None:
        """Return the position of ``node``; None if it has none."""
        return self._positions[node]

    def distance(self, one: int, other: int) -> float | None:
        """Return the distance of two nodes; None if one of them has no position."""
        here, there = self._positions[one], self._positions[other]
        return None if here is None or there is None else math.dist(here, there)

    def neighbours(self, sender: int, count: int) -> Iterable[int]:
        """Return the nodes within range of ``sender``."""
        here = self._positions[sender] if sender < len(self._positions) else None
        if here is None:
            return []
        x, y, z = here
        reach = self._ranges.get(sender, self._range)
        # Compare squares: a square root for each pair of nodes would dominate the run time.
        limit = reach**2
        found = []
        for node in self._near(here, math.ceil(reach / self._range)):
            place = self._positions[node]
            if place is None or node >= count:
                continue
            a, b, c = place
            if (a - x) * (a - x) + (b - y) * (b - y) + (c - z) * (c - z) <= limit:
                found.append(node)
        return found

    def _near(self, point: Point, steps: int) -> Iterable[int]:
        """Return the nodes in cells at most ``steps`` away, and possibly others."""
        if (2 * steps + 1) ** 3 > len(self._cells):
            return chain.from_iterable(self._cells.values())
        across, up, deep = self._cell(point)
        around = range(-steps, steps + 1)
        cells = ((across + dx, up + dy, deep + dz) for dx in around for dy in around for dz in around)
        return chain.from_iterable(self._cells[cell] for cell in cells if cell in self._cells)

    def _cell(self, point: Point) -> _Cell:
        x, y, z = point
        side = self._range
        return (math.floor(x / side), math.floor(y / side), math.floor(z / side))
