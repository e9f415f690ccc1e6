"""Columns in memory: the arrays that the decoder fills, and Arrow arrays that share their memory."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from .kernel.pools import Pool, text_array
from .kernel.row_buffer import item, row_size, table_layout
from .kernel.shape import Column, Table

Octets = npt.NDArray[np.uint8]
_INTEGERS = {
    **{(1, False): pa.uint8(), (2, False): pa.uint16(), (4, False): pa.uint32(), (8, False): pa.uint64()},
    **{(1, True): pa.int8(), (2, True): pa.int16(), (4, True): pa.int32(), (8, True): pa.int64()},
}
_FLOATS = {4: pa.float32(), 8: pa.float64()}

#: Suffix of the column that has texts that are not UTF-8 as hex, as in JSON.
HEX = "Hex"

IDENTIFIER = pa.dictionary(pa.int32(), pa.string())
TIME = pa.timestamp("ns")


def arrow_type(column: Column) -> pa.DataType:
    """Return the Arrow type of a column."""
    match column.kind:
        case "int":
            return _INTEGERS[column.size, column.signed]
        case "float":
            return _FLOATS[column.size]
        case "time":
            return TIME
        case "octets":
            return pa.binary(column.size)
        case "address" | "node":
            return IDENTIFIER
        case "label":
            return pa.dictionary(pa.int8(), pa.string())
        case "text":
            return pa.string()
        case _:
            return pa.binary()


def arrow_fields(column: Column) -> list[pa.Field]:
    """Return the Arrow fields of a column: one, and for a text a second one for octets that are not UTF-8."""
    metadata = {key: value for key, value in (("unit", column.unit), ("doc", column.doc)) if value}
    # Writers and readers need not search for nulls in a field that cannot have them.
    nullable = column.only is not None or column.kind == "text"
    field = pa.field(column.name, arrow_type(column), nullable=nullable, metadata=metadata or None)
    if column.kind != "text":
        return [field]
    return [field, pa.field(column.name + HEX, pa.string(), metadata={"doc": f"{column.name} where it is not UTF-8"})]


def schema_of(table: Table) -> pa.Schema:
    """Return the Arrow schema of a table."""
    return pa.schema([field for column in table.columns for field in arrow_fields(column)])


class Memory(NamedTuple):
    """The memory of a batch."""

    tables: list[Octets]
    """The memory of each table."""
    columns: list[npt.NDArray[Any]]
    """The columns, views of the memory of their tables, by number."""
    octets: dict[int, Octets]
    """The octets of columns with values of variable length, by number."""


class _Piece(NamedTuple):
    """A piece of memory, and the columns in it by number."""

    whole: Octets
    parts: dict[int, npt.NDArray[Any]]

    def unused(self) -> bool:
        """Return whether no batch refers to the memory."""
        # An Arrow array refers to a view, and a view to the whole memory.
        return sys.getrefcount(self.whole) <= _UNSHARED + len(self.parts)


class Storage:
    """Memory for the columns of a decoder, which is reused when no batch refers to it.

    Allocating new memory takes as long as filling it, and a program that writes batches to a file uses at most two at a
    time.
    """

    def __init__(self, tables: Sequence[Table]) -> None:
        self._tables = tables
        columns = (column for table in tables for column in table.columns)
        self._varying = sorted(column.number for column in columns if column.kind in ("varying", "text"))
        self._spare: dict[tuple[int, bool], list[_Piece]] = {}
        self._size = (0, 0)

    def take(self, rows: int, space: int) -> Memory:
        """Return memory for ``rows`` rows of each table, and ``space`` octets for each column of variable length."""
        if self._size != (rows, space):
            self._spare.clear()
            self._size = rows, space
        pieces = [self._free((table.number, False), partial(_table_memory, table, rows)) for table in self._tables]
        octets = {
            number: self._free((number, True), lambda: _Piece(_fresh(space), {})).whole for number in self._varying
        }
        parts = {number: part for piece in pieces for number, part in piece.parts.items()}
        return Memory([piece.whole for piece in pieces], [parts[number] for number in sorted(parts)], octets)

    def _free(self, key: tuple[int, bool], make: Callable[[], _Piece]) -> _Piece:
        """Return a piece of memory that is not in use; allocate one if necessary."""
        spare = self._spare.setdefault(key, [])
        for piece in spare:
            if piece.unused():
                return piece
        if len(spare) == _SPARE:
            spare.pop(0)
        made = make()
        spare.append(made)
        return made


#: Reference count of unshared memory: the reference of the piece, and that of the call of getrefcount.
_UNSHARED = 2
#: In ``parquet_output.Pile``: number of small batches that are copied together, and of large batches that are kept.
TOGETHER, KEPT = 4, 8
#: Maximum number of batches whose memory is kept: the current one, waiting ones, and those that a thread writes.
_SPARE = 2 * max(TOGETHER, KEPT) + 1


def _table_memory(table: Table, rows: int) -> _Piece:
    """Allocate memory for ``rows`` rows: integers (floats as bit patterns), octets, end offsets of variable lengths."""
    starts, size = table_layout(table, rows)
    whole = _fresh(size)
    parts: dict[int, npt.NDArray[Any]] = {}
    for column in table.columns:
        start = starts[column.number]
        part = whole[start : start + (rows + 1) * row_size(column)]
        part = part.view(item(column))
        if column.kind in ("varying", "text"):
            part[0] = 0
        parts[column.number] = part
    return _Piece(whole, parts)


def _fresh(size: int) -> Octets:
    """Allocate memory of the system allocator. Others use huge pages, which are wasted on columns with few rows."""
    return np.frombuffer(pa.allocate_buffer(size, pa.system_memory_pool()), np.uint8)


def arrow_arrays(
    column: Column, rows: int, memory: Sequence[npt.NDArray[Any]], octets: Octets | None, used: int, pool: Pool | None
) -> list[pa.Array]:
    """Return the first ``rows`` values as Arrow arrays without copying, one for each of :func:`arrow_fields`.

    ``memory`` has the arrays of all columns. ``octets`` has the octets of a column of variable length, of which
    ``used`` are valid. ``pool`` has the identifiers of a column of addresses or nodes.
    """
    values = memory[column.number]
    match column.kind:
        case "address" | "node":
            assert pool is not None
            codes = pa.Array.from_buffers(pa.int32(), rows, [None, pa.py_buffer(values[:rows])])
            return [pa.DictionaryArray.from_arrays(codes, pool.dictionary, safe=False)]
        case "label":
            codes = pa.Array.from_buffers(pa.int8(), rows, [None, pa.py_buffer(values[:rows])])
            return [pa.DictionaryArray.from_arrays(codes, text_array(column.labels), safe=False)]
        case "octets":
            return [_plain(column, rows, values[: rows * column.size])]
        case "varying" | "text":
            assert octets is not None
            ends, data = values[: rows + 1], octets[:used]
            if column.kind == "text":
                return _texts(ends, data)
            buffers = [_present(column, rows, memory), pa.py_buffer(ends), pa.py_buffer(data)]
            return [pa.Array.from_buffers(pa.binary(), rows, buffers)]
        case _:
            return [_plain(column, rows, values[:rows])]


def _plain(column: Column, rows: int, values: npt.NDArray[Any]) -> pa.Array:
    return pa.Array.from_buffers(arrow_type(column), rows, [None, pa.py_buffer(values)])


def _present(column: Column, rows: int, memory: Sequence[npt.NDArray[Any]]) -> pa.Buffer | None:
    """Return the validity bitmap of a column that only some rows have; None if all rows have it."""
    if column.only is None:
        return None
    which, index = column.only
    return pa.py_buffer(np.packbits(memory[which][:rows] == index, bitorder="little"))


def _texts(ends: npt.NDArray[np.int32], data: Octets) -> list[pa.Array]:
    """Return two arrays: values that are UTF-8 as texts, and other values as hex."""
    rows = len(ends) - 1
    if not data.size or data.max() < 0x80:
        texts = pa.Array.from_buffers(pa.string(), rows, [None, pa.py_buffer(ends), pa.py_buffer(data)])
        return [texts, pa.nulls(rows, pa.string())]
    found: list[str | None] = []
    other: list[str | None] = []
    for begin, end in pairwise(ends.tolist()):
        octets = data[begin:end].tobytes()
        try:
            found.append(octets.decode())
            other.append(None)
        except UnicodeDecodeError:
            found.append(None)
            other.append(octets.hex())
    return [pa.array(found, pa.string()), pa.array(other, pa.string())]
