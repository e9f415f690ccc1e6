"""The stage: a buffer for rows before they are moved to the columns of a batch, small enough for the processor's cache.

A beacon has values of some hundred columns. Written directly to the columns of the batch, each value would be in
another page of memory, and waiting for memory would take longer than decoding. So the columns of the stage are short,
and when a table has enough rows, all of its columns are moved at once (:func:`~dcp_tables.table.kernel.native.move`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .shape import Column, Shape, Table

#: Number of rows of a table that are moved together, and maximum number of rows of a usual frame.
MOVED, OF_A_FRAME = 256, 2048
#: Alignment of columns in octets, as Arrow recommends.
_ALIGNED = 64
#: The item types of memory: signed (i) and unsigned (u) integers, with their size in octets.
ITEMS = ("i8", "i4", "u4", "i2", "u2", "i1", "u1")


def item(column: Column) -> str:
    """Return the item type of a column, one of ``ITEMS``: of its values (floats as bit patterns), octets or offsets."""
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
    """Return the size of a row of a column in octets."""
    return column.size if column.kind == "octets" else int(item(column)[1])


def places(columns: Sequence[Column]) -> dict[int, int]:
    """Return the offset in octets of each column in a row, by its number, with wide columns first."""
    found, at = {}, 0
    for column in sorted(columns, key=lambda each: item(each)[1], reverse=True):
        found[column.number] = at
        at += row_size(column)
    return found


def table_layout(table: Table, rows: int) -> tuple[dict[int, int], int]:
    """Return the start of each column in the memory of a table of ``rows`` rows, by number, and the total size."""
    starts, at = {}, 0
    for column in table.columns:
        starts[column.number] = at
        # One row more, because columns of variable length have a leading 0 before their end offsets.
        at += -(-(rows + 1) * row_size(column) // _ALIGNED) * _ALIGNED
    return starts, at


class StagingRows:
    """Memory for ``moved`` rows of each table, and for those of one more frame of ``octets`` octets.

    ``rows`` is the capacity for each table, ``moved`` the number of rows after which those of a table are moved, and
    ``items`` the memory as an array of each of ``ITEMS``. ``moves`` has for each column its start in the stage, its
    start in the memory of its table (:func:`table_layout` for ``capacity`` rows), and the size of a row in octets.
    """

    def __init__(self, shape: Shape, octets: int, moved: int, room: int) -> None:
        self.moved = moved
        # A multiple of 8, so that the columns of all widths are aligned.
        self.rows = (octets + moved) // 8 * 8 + 8
        # A batch ends after ``room`` rows; the stage may have further rows then.
        self.capacity = room + self.rows
        memory = np.empty(self.rows * sum(map(row_size, shape.columns)), np.uint8)
        self.items: list[npt.NDArray[Any]] = [memory.view(kind) for kind in ITEMS]
        before = places(shape.columns)
        moves = []
        for table in shape.tables:
            starts, _ = table_layout(table, self.capacity)
            for column in table.columns:
                number, size = column.number, row_size(column)
                # End offsets start after the leading 0.
                leading = size if column.kind in ("varying", "text") else 0
                moves.append((before[number] * self.rows, starts[number] + leading, size))
        self.moves = np.array(moves, np.int64)
