"""Columns in memory: what the decoder fills, and the same octets as Arrow arrays."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from .pools import Pool
from .shape import Column, Table

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
    field = pa.field(column.name, arrow_type(column), metadata=metadata or None)
    if column.kind != "text":
        return [field]
    return [field, pa.field(column.name + HEX, pa.string(), metadata={"doc": f"{column.name} where it is not UTF-8"})]


def schema_of(table: Table) -> pa.Schema:
    """The Arrow schema of a table."""
    return pa.schema([field for column in table.columns for field in arrow_fields(column)])


def storage(column: Column, room: int) -> npt.NDArray[Any]:
    """Memory for ``room`` values: integers (floats as their bits), octets, or the ends of octets of varying number."""
    if column.kind == "octets":
        return np.empty(room * column.size, np.uint8)
    if column.kind in ("varying", "text"):
        return np.empty(room + 1, np.int32)
    signed = column.kind in ("address", "node", "time", "label") or column.signed or column.size == 8
    return np.empty(room, np.dtype(f"{'i' if signed else 'u'}{column.size}"))


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
            return [pa.DictionaryArray.from_arrays(codes, pa.array(column.labels, pa.string()), safe=False)]
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
