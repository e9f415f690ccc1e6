"""Columns in memory: what the decoder fills, and the same octets as Arrow arrays."""

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

#: What a text that is not UTF-8 is called when it is given as hex, as in JSON.
HEX = "Hex"

IDENTIFIER = pa.dictionary(pa.int32(), pa.string())
TIME = pa.timestamp("ns")


def arrow_type(column: Column) -> pa.DataType:
    """The Arrow type of a column."""
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
    """The Arrow fields of a column: one, and of a text a second for what is no text."""
    metadata = {key: value for key, value in (("unit", column.unit), ("doc", column.doc)) if value}
    # Saying that there are no nulls saves whoever writes or reads a file from looking for them.
    nullable = column.only is not None or column.kind == "text"
    field = pa.field(column.name, arrow_type(column), nullable=nullable, metadata=metadata or None)
    if column.kind != "text":
        return [field]
    return [field, pa.field(column.name + HEX, pa.string(), metadata={"doc": f"{column.name} where it is not UTF-8"})]


def schema_of(table: Table) -> pa.Schema:
    """The Arrow schema of a table."""
    return pa.schema([field for column in table.columns for field in arrow_fields(column)])


class Memory(NamedTuple):
    """Memory of a batch: that of each table, the columns in it, and octets of varying number by their column."""

    tables: list[Octets]
    columns: list[npt.NDArray[Any]]
    octets: dict[int, Octets]


class _Piece(NamedTuple):
    """Memory, and the columns that lie in it by number."""

    whole: Octets
    parts: dict[int, npt.NDArray[Any]]

    def unused(self) -> bool:
        """Whether nobody looks at it."""
        # An Arrow array refers to a view, and a view to the whole.
        return sys.getrefcount(self.whole) <= _UNSHARED + len(self.parts)


class Storage:
    """Memory for the columns of a decoder, used again when nobody looks at it any more.

    Fresh memory costs as much as filling it, and who streams batches to a file looks at two at a time at most.
    """

    def __init__(self, tables: Sequence[Table]) -> None:
        self._tables = tables
        columns = (column for table in tables for column in table.columns)
        self._varying = sorted(column.number for column in columns if column.kind in ("varying", "text"))
        self._spare: dict[tuple[int, bool], list[_Piece]] = {}
        self._size = (0, 0)

    def take(self, rows: int, space: int) -> Memory:
        """For each column room for so many rows, and for those of varying octets space for so many of these."""
        if self._size != (rows, space):
            self._spare.clear()
            self._size = rows, space
        pieces = [self._free((table.number, False), partial(_table_memory, table, rows)) for table in self._tables]
        octets = {number: self._free((number, True), partial(_octets_memory, space)).whole for number in self._varying}
        parts = {number: part for piece in pieces for number, part in piece.parts.items()}
        return Memory([piece.whole for piece in pieces], [parts[number] for number in sorted(parts)], octets)

    def _free(self, key: tuple[int, bool], make: Callable[[], _Piece]) -> _Piece:
        """Memory that nobody uses."""
        spare = self._spare.setdefault(key, [])
        for piece in spare:
            if piece.unused():
                return piece
        if len(spare) == _SPARE:
            spare.pop(0)
        made = make()
        spare.append(made)
        return made


#: References to memory that only a piece has: its own, and that of asking.
_UNSHARED = 2
#: Where rows are collected (``parquet_output.Pile``), batches with few that are copied together, and with many that are
#: kept.
TOGETHER, KEPT = 4, 8
#: Batches whose memory is remembered: the one being made, those that wait, and those that a thread is writing.
_SPARE = 2 * max(TOGETHER, KEPT) + 1


def _table_memory(table: Table, rows: int) -> _Piece:
    """Memory for ``rows`` rows: integers (floats as their bits), octets, ends of octets of varying number."""
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


def _octets_memory(space: int) -> _Piece:
    return _Piece(_fresh(space), {})


def _fresh(size: int) -> Octets:
    """Memory of the system's: others ask for huge pages, of which columns with few rows would fill a little each."""
    return np.frombuffer(pa.allocate_buffer(size, pa.system_memory_pool()), np.uint8)


def arrow_arrays(
    column: Column, rows: int, memory: Sequence[npt.NDArray[Any]], octets: Octets | None, used: int, pool: Pool | None
) -> list[pa.Array]:
    """The first ``rows`` values as Arrow arrays, without copying; one for each of :func:`arrow_fields`.

    ``memory`` are the storages of all columns, ``octets`` the ``used`` octets behind a column of varying ones.
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
    """The validity of a column that only some rows have; None where all have it."""
    if column.only is None:
        return None
    which, index = column.only
    return pa.py_buffer(np.packbits(memory[which][:rows] == index, bitorder="little"))


def _texts(ends: npt.NDArray[np.int32], data: Octets) -> list[pa.Array]:
    """What is UTF-8 as text, and what is not as hex."""
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
