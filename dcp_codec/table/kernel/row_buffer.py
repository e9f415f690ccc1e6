"""Where rows lie before they are moved to the columns of a batch: memory small enough to stay in the processor's cache.

A beacon gives values of some hundred columns. Written straight to where they stay, each goes to a page of its own, and
waiting for memory takes longer than decoding. So the columns of the stage are short, and when one is long enough all of
its table are moved at once (:func:`~dcp_codec.table.kernel.native.move`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .shape import Column, Shape, Table

#: Rows of a table that are moved together, and rows more than those that a usual frame may have.
MOVED, OF_A_FRAME = 256, 2048
#: Columns start at multiples of so many octets, as Arrow recommends.
_ALIGNED = 64
#: The items that memory is made of: integers, signed or not, and their octets.
ITEMS = ("i8", "i4", "u4", "i2", "u2", "i1", "u1")


def item(column: Column) -> str:
    """What a column is made of, one of ``ITEMS``: its values (floats as their bits), octets, or ends of octets."""
    match column.kind:
        case "octets":
            return "u1"
        case "varying" | "text":
            return "i4"
        case "address" | "node" | "time" | "label":
            return f"i{column.size}"
        case _:
            return f"{'i' if column.signed or column.size == 8 else 'u'}{column.size}"


def row_size(column: Column) -> int:
    """Octets of a row of a column."""
    return column.size if column.kind == "octets" else int(item(column)[1])


def places(columns: Sequence[Column]) -> dict[int, int]:
    """Octets of a row in front of each column, by its number, where wide columns come first."""
    found, at = {}, 0
    for column in sorted(columns, key=lambda each: item(each)[1], reverse=True):
        found[column.number] = at
        at += row_size(column)
    return found


def table_layout(table: Table, rows: int) -> tuple[dict[int, int], int]:
    """Where each column starts in the memory of a table with room for ``rows``, by number; and the octets of it all."""
    starts, at = {}, 0
    for column in table.columns:
        starts[column.number] = at
        # Of octets of varying number the ends are kept, after a leading 0.
        at += -(-(rows + 1) * row_size(column) // _ALIGNED) * _ALIGNED
    return starts, at


class Stage:
    """Memory for the rows of a frame of ``octets`` and some more of each table.

    ``rows`` is how many of each table there is room for, ``moved`` after how many those of a table are moved, ``items``
    the memory as each of ``ITEMS``. ``moves`` says of each column where it starts in the stage, where
    in the memory of its table (:func:`table_layout` for ``capacity`` rows), and octets of a row.
    """

    def __init__(self, shape: Shape, octets: int, moved: int, room: int) -> None:
        self.moved = moved
        # All widths fit into it as often as it takes.
        self.rows = (octets + moved) // 8 * 8 + 8
        # A batch ends after ``room`` rows, and the stage may be full then.
        self.capacity = room + self.rows
        memory = np.empty(self.rows * sum(map(row_size, shape.columns)), np.uint8)
        self.items: list[npt.NDArray[Any]] = [memory.view(kind) for kind in ITEMS]
        before = places(shape.columns)
        moves = []
        for table in shape.tables:
            starts, _ = table_layout(table, self.capacity)
            for column in table.columns:
                number, size = column.number, row_size(column)
                # The end of the octets of a row stands behind that of the row before.
                behind = size if column.kind in ("varying", "text") else 0
                moves.append((before[number] * self.rows, starts[number] + behind, size))
        self.moves = np.array(moves, np.int64)
