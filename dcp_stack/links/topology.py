"""Who hears whom in a simulated medium. Nodes are numbers from 0."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Protocol


class Topology(Protocol):
    """Says which nodes a transmission reaches; need not be symmetric."""

    @property
    def version(self) -> int:
        """Changes whenever neighbourhoods do."""
        ...

    def neighbours(self, sender: int, count: int) -> Iterable[int]:
        """Who of the nodes 0..count-1 hears ``sender``, in any order; ``sender`` and other numbers do no harm."""
        ...


class Full:
    """Everybody hears everybody."""

    version = 0

    def neighbours(self, sender: int, count: int) -> Iterable[int]:  # noqa: ARG002
        """All nodes."""
        return range(count)


class Line:
    """Each node hears the nodes next to it, those at the ends have one neighbour."""

    version = 0

    def neighbours(self, sender: int, count: int) -> Iterable[int]:  # noqa: ARG002
        """The one before and the one behind."""
        return (sender - 1, sender + 1)


class Grid:
    """Nodes row by row with ``columns`` in each; neighbours are above, below, left and right, or also diagonal."""

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
        """Up to four nodes, with diagonals up to eight."""
        row, column = divmod(sender, self._columns)
        for down, right in self._steps:
            if 0 <= column + right < self._columns:
                yield (row + down) * self._columns + column + right


class Neighbours:
    """Neighbourhoods as given: sender -> those who hear it. Both directions have to be stated."""

    def __init__(self, heard_by: Mapping[int, Iterable[int]]) -> None:
        self.version = 0
        self._heard_by = {sender: frozenset(receivers) for sender, receivers in heard_by.items()}

    def neighbours(self, sender: int, count: int) -> Iterable[int]:  # noqa: ARG002
        """What was given; nobody for a sender that was not."""
        return self._heard_by.get(sender, frozenset())

    def connect(self, sender: int, receiver: int) -> None:
        """``receiver`` hears ``sender`` from now on."""
        self._heard_by[sender] = self._heard_by.get(sender, frozenset()) | {receiver}
        self.version += 1

    def disconnect(self, sender: int, receiver: int) -> None:
        """``receiver`` does not hear ``sender`` any more."""
        self._heard_by[sender] = self._heard_by.get(sender, frozenset()) - {receiver}
        self.version += 1


Point = tuple[float, float, float]
_Cell = tuple[int, int, int]


class Positions:
    """Nodes in space: those at most ``radio_range`` away hear a transmission. Any unit, the same for both.

    ``ranges`` gives single senders another range, which makes connections asymmetric. A node without a position
    (None, or not in the sequence) hears nobody and is not heard.

    Nodes are kept by the cube of space they are in, as wide as the range: a sender looks at 27 cubes, and not at all
    nodes.
    """

    def __init__(
        self,
        positions: Sequence[Point | None],
        radio_range: float,
        *,
        ranges: Mapping[int, float] | None = None,
    ) -> None:
        """Raises ValueError for a range that is not greater than 0."""
        if not radio_range > 0:
            raise ValueError(f"a radio range is greater than 0, not {radio_range:g}")
        self.version = 0
        self._positions = list(positions)
        self._range = radio_range
        self._ranges = dict(ranges or {})
        self._cells: dict[_Cell, set[int]] = {}
        for node, position in enumerate(self._positions):
            if position is not None:
                self._cells.setdefault(self._cell(position), set()).add(node)

    def move(self, node: int, position: Point) -> None:
        """``node`` is at ``position`` from now on; raises ``IndexError`` if it is not the next one without any."""
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
        """Where ``node`` is; None if it is nowhere."""
        return self._positions[node]

    def neighbours(self, sender: int, count: int) -> Iterable[int]:
        """The nodes in range."""
        here = self._positions[sender] if sender < len(self._positions) else None
        if here is None:
            return []
        x, y, z = here
        reach = self._ranges.get(sender, self._range)
        # Squares are compared: a root for each pair of nodes would be most of the time.
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
        """The nodes in cells at most ``steps`` away, and perhaps others."""
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
