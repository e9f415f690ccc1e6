"""Who hears whom in a simulated medium. Nodes are numbers from 0."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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


class Positions:
    """Nodes in space: those at most ``radio_range`` away hear a transmission. Any unit, the same for both.

    ``ranges`` gives single senders another range, which makes connections asymmetric. A node without a position
    hears nobody and is not heard.
    """

    def __init__(
        self,
        positions: Sequence[tuple[float, float, float]],
        radio_range: float,
        *,
        ranges: Mapping[int, float] | None = None,
    ) -> None:
        self.version = 0
        self._positions = list(positions)
        self._range = radio_range
        self._ranges = dict(ranges or {})

    def move(self, node: int, position: tuple[float, float, float]) -> None:
        """``node`` is at ``position`` from now on; raises ``IndexError`` if it is not the next one without any."""
        if node == len(self._positions):
            self._positions.append(position)
        else:
            self._positions[node] = position
        self.version += 1

    def position(self, node: int) -> tuple[float, float, float]:
        """Where ``node`` is."""
        return self._positions[node]

    def neighbours(self, sender: int, count: int) -> Iterable[int]:
        """The nodes in range."""
        if sender >= len(self._positions):
            return []
        x, y, z = self._positions[sender]
        # Squares are compared: a root for each pair of nodes would be most of the time.
        limit = self._ranges.get(sender, self._range) ** 2
        return [
            node
            for node, (a, b, c) in enumerate(self._positions[:count])
            if (a - x) * (a - x) + (b - y) * (b - y) + (c - z) * (c - z) <= limit
        ]
