"""One recording to files: a writer for each table, fed with record batches."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import pyarrow as pa

from dcp_codec.common.spreadsheet import FORMULA_STARTS

from .columns import KEPT, TOGETHER

Format = Literal["parquet", "csv", "duckdb"]

#: Rows that are collected before they are written: a row group of Parquet is worth reading on its own.
GROUP = 1 << 18
#: Rows of a batch that is worth the memory that it lies in.
MANY = GROUP // KEPT
_HEX = np.frombuffer(b"".join(f"{octet:02x}".encode() for octet in range(256)), np.uint16)


class Writer(Protocol):
    """Writes the rows of one table to one file."""

    def write(self, batch: pa.RecordBatch) -> None:
        """Append rows."""

    def close(self) -> None:
        """Finish the file."""


class Pile:
    """Rows that are collected.

    A batch lies in memory with room for many more rows than it may have. Few rows are not to hold on to much memory, so
    batches with few are copied together, some at a time.
    """

    def __init__(self, schema: pa.Schema) -> None:
        self._schema = schema
        self._few: list[pa.RecordBatch] = []
        self._batches: list[pa.RecordBatch] = []
        self.rows = 0

    def add(self, batch: pa.RecordBatch) -> None:
        """Append the rows of a batch."""
        if not batch.num_rows:
            return
        self.rows += batch.num_rows
        if batch.num_rows < MANY:
            self._few.append(batch)
            if len(self._few) < TOGETHER:
                return
        if self._few:
            whole = pa.Table.from_batches(self._few, self._schema).unify_dictionaries().combine_chunks()
            self._batches += whole.to_batches()
            self._few = []
        if batch.num_rows >= MANY:
            self._batches.append(batch)

    def table(self) -> pa.Table:
        """All rows, with one dictionary for each column of identifiers."""
        return pa.Table.from_batches([*self._batches, *self._few], self._schema).unify_dictionaries()


class ParquetTable:
    """A Parquet file with row groups of about ``GROUP`` rows."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        from pyarrow import parquet

        self._schema = schema
        self._writer = parquet.ParquetWriter(path, schema, **_parquet_options(schema))
        self._pile = Pile(schema)

    def write(self, batch: pa.RecordBatch) -> None:
        """Append rows."""
        self._pile.add(batch)
        if self._pile.rows >= GROUP:
            self._flush()

    def _flush(self) -> None:
        # Identifiers have one dictionary in a row group, or they would be written out.
        self._writer.write_table(self._pile.table(), row_group_size=2 * GROUP)
        self._pile = Pile(self._schema)

    def close(self) -> None:
        """Finish the file."""
        if self._pile.rows:
            self._flush()
        self._writer.close()


def _parquet_options(schema: pa.Schema) -> dict[str, Any]:
    """How each column is written: measured by ``benchmarks/columns.py``, size against time.

    Numbers that count up are small as differences. Of numbers, times and identifiers lz4 leaves about as little as zstd
    does, in a fraction of the time; octets and floats are worth zstd. The least and the greatest value of a row group
    are written for the time alone, by which queries cut recordings: finding them takes a quarter as long as writing.
    """
    identifiers = [field.name for field in schema if pa.types.is_dictionary(field.type)]
    differences = [field.name for field in schema if _counts_up(field, schema)]
    numbers = [field.name for field in schema if pa.types.is_integer(field.type) or pa.types.is_timestamp(field.type)]
    quick = {*identifiers, *numbers}
    return {
        "compression": {field.name: "lz4" if field.name in quick else "zstd" for field in schema},
        "compression_level": {field.name: 1 for field in schema if field.name not in quick},
        "use_dictionary": identifiers,
        "column_encoding": dict.fromkeys(differences, "DELTA_BINARY_PACKED"),
        "write_statistics": ["time"] if "time" in schema.names else False,
        # Values that are encoded at a time; the thousand that is usual costs a tenth more.
        "write_batch_size": 1 << 16,
    }


def _counts_up(field: pa.Field, schema: pa.Schema) -> bool:
    """Whether each value of a column is likely to be a little more than the one before."""
    if pa.types.is_timestamp(field.type):
        # All records of a beacon have its time.
        return "record" not in schema.names
    if not pa.types.is_integer(field.type):
        return False
    width: int = field.type.bit_width
    return width == 64 or (width == 32 and field.name == "seqno")


class CsvTable:
    """A CSV file with a heading; octets are lower-case hex, as in JSON."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        from pyarrow import csv

        self._schema = pa.schema([pa.field(field.name, _csv_type(field.type)) for field in schema])
        self._writer = csv.CSVWriter(path, self._schema)

    def write(self, batch: pa.RecordBatch) -> None:
        """Append rows."""
        arrays = [_csv_array(column, field.type) for column, field in zip(batch.columns, self._schema, strict=True)]
        self._writer.write_batch(pa.RecordBatch.from_arrays(arrays, schema=self._schema))

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()


def _csv_type(kind: pa.DataType) -> pa.DataType:
    if pa.types.is_dictionary(kind) or pa.types.is_binary(kind) or pa.types.is_fixed_size_binary(kind):
        return pa.string()
    return kind


def _csv_array(array: pa.Array, wanted: pa.DataType) -> pa.Array:
    if pa.types.is_fixed_size_binary(array.type):
        array = array.cast(pa.binary())
    if pa.types.is_binary(array.type):
        return hexadecimal(array)
    return _safe(array.cast(wanted)) if pa.types.is_string(wanted) else array.cast(wanted)


def _safe(array: pa.Array) -> pa.Array:
    """Texts as :func:`dcp_codec.common.spreadsheet.safe_cell` has them."""
    import pyarrow.compute as pc

    formulas = pc.match_substring_regex(array, f"^[{re.escape(FORMULA_STARTS)}]")
    if not pc.any(formulas).as_py():
        return array
    return pc.if_else(formulas, pc.binary_join_element_wise("'", array, ""), array)


def hexadecimal(array: pa.Array) -> pa.Array:
    """A binary array as text: two digits for each octet."""
    validity, offsets, data = array.buffers()
    ends = np.frombuffer(offsets, np.int32, len(array) + 1, array.offset * 4)
    octets = np.frombuffer(data, np.uint8) if data is not None else np.empty(0, np.uint8)
    digits = _HEX[octets[ends[0] : ends[-1]]]
    found = pa.Array.from_buffers(
        pa.string(), len(array), [None, pa.py_buffer(2 * (ends - ends[0])), pa.py_buffer(digits)]
    )
    if not array.null_count or validity is None:
        return found
    import pyarrow.compute as pc

    return pc.if_else(array.is_valid(), found, pa.scalar(None, pa.string()))


SUFFIXES: Mapping[str, str] = {"parquet": ".parquet", "csv": ".csv", "duckdb": ".parquet"}


def open_writer(form: Format, path: Path, schema: pa.Schema) -> Writer:
    """A writer of the format; tables of a DuckDB database are Parquet files until all are there."""
    return CsvTable(path, schema) if form == "csv" else ParquetTable(path, schema)


def with_file(batch: pa.RecordBatch, schema: pa.Schema, name: str) -> pa.RecordBatch:
    """A batch with the column ``file`` in front that ``schema`` has."""
    codes = pa.array(np.zeros(batch.num_rows, np.int32))
    column = pa.DictionaryArray.from_arrays(codes, pa.array([name], pa.string()))
    return pa.RecordBatch.from_arrays([column, *batch.columns], schema=schema)


FILE = pa.field("file", pa.dictionary(pa.int32(), pa.string()), nullable=False, metadata={"doc": "the recording"})


def file_schema(schema: pa.Schema) -> pa.Schema:
    """The schema of a table of several recordings."""
    return pa.schema([FILE, *schema])


def joint_schema(schemas: Sequence[pa.Schema]) -> pa.Schema:
    """The columns of all tables, integers as wide as the widest. What one table has not is null in its rows."""
    found = pa.unify_schemas(schemas, promote_options="permissive")
    return pa.schema(
        [
            field.with_nullable(field.nullable or not all(field.name in schema.names for schema in schemas))
            for field in found
        ]
    )


def write_database(path: Path, parts: Mapping[str, Sequence[Path]]) -> None:
    """A DuckDB database with the tables that are in ``parts``, Parquet files by the name of the table.

    Raises ImportError without DuckDB.
    """
    import duckdb

    with duckdb.connect(str(path)) as database:
        # Rows stay in the order of the recordings and frames.
        database.execute("SET preserve_insertion_order = true")
        for name, files in parts.items():
            listed = [str(file) for file in files]
            # The name is one of ours, and the files are an argument.
            database.execute(
                f'CREATE TABLE "{name}" AS SELECT * FROM read_parquet($files, union_by_name = true)',  # noqa: S608
                {"files": listed},
            )
