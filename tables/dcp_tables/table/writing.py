"""Writers of record batches to files: one for each table of a recording."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import pyarrow as pa

from dcp_codec.common.spreadsheet import FORMULA_STARTS

from .kernel.pools import text_array
from .parquet_output import ParquetTable

Format = Literal["parquet", "csv", "duckdb"]

_HEX = np.frombuffer(b"".join(f"{octet:02x}".encode() for octet in range(256)), np.uint16)


class Writer(Protocol):
    """Writes the rows of one table to one file."""

    def write(self, batch: pa.RecordBatch) -> None:
        """Append rows."""

    def flush(self) -> None:
        """Write the collected rows, or let a thread write them."""

    def close(self) -> None:
        """Finish the file."""


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

    def flush(self) -> None:
        """Do nothing: no rows are collected."""

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
    """Return texts in the form of :func:`dcp_codec.common.spreadsheet.safe_cell`, which is not read as a formula."""
    import pyarrow.compute as pc

    formulas = pc.match_substring_regex(array, f"^[{re.escape(FORMULA_STARTS)}]")
    if not pc.any(formulas).as_py():
        return array
    return pc.if_else(formulas, pc.binary_join_element_wise("'", array, ""), array)


def hexadecimal(array: pa.Array) -> pa.Array:
    """Return a binary array as text, with two hexadecimal digits for each octet."""
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


def open_writer(form: Format, path: Path, schema: pa.Schema, executor: Executor | None = None) -> Writer:
    """Open a writer of the format; tables of a DuckDB database are Parquet files until all are complete.

    Threads of ``executor`` write Parquet files; None: the caller's thread.
    """
    return CsvTable(path, schema) if form == "csv" else ParquetTable(path, schema, executor)


def with_file(batch: pa.RecordBatch, schema: pa.Schema, name: str) -> pa.RecordBatch:
    """Return a batch with the additional first column ``file``, which has the value ``name``."""
    codes = pa.Array.from_buffers(pa.int32(), batch.num_rows, [None, pa.py_buffer(np.zeros(batch.num_rows, np.int32))])
    column = pa.DictionaryArray.from_arrays(codes, text_array([name]))
    return pa.RecordBatch.from_arrays([column, *batch.columns], schema=schema)


FILE = pa.field("file", pa.dictionary(pa.int32(), pa.string()), nullable=False, metadata={"doc": "the recording"})


def file_schema(schema: pa.Schema) -> pa.Schema:
    """Return the schema of a table of several recordings, with the column ``file``."""
    return pa.schema([FILE, *schema])


def joint_schema(schemas: Sequence[pa.Schema]) -> pa.Schema:
    """Return the columns of all tables, with the widest integer types. Missing columns are null in a table's rows."""
    found = pa.unify_schemas(schemas, promote_options="permissive")
    return pa.schema(
        [
            field.with_nullable(field.nullable or not all(field.name in schema.names for schema in schemas))
            for field in found
        ]
    )


def fitted(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    """Return a batch with the columns of a joint schema; missing ones are null."""
    names = set(batch.schema.names)
    arrays = [
        batch.column(field.name).cast(field.type) if field.name in names else pa.nulls(batch.num_rows, field.type)
        for field in schema
    ]
    return pa.RecordBatch.from_arrays(arrays, schema=schema)


def write_database(path: Path, parts: Mapping[str, Sequence[Path]]) -> None:
    """Write a DuckDB database with the tables in ``parts``, which has Parquet files by the name of the table.

    Raise ImportError without DuckDB.
    """
    import duckdb

    with duckdb.connect(str(path)) as database:
        # Keep the rows in the order of recordings and frames.
        database.execute("SET preserve_insertion_order = true")
        for name, files in parts.items():
            listed = [str(file) for file in files]
            # No injection: the name is a table name of ours, and the files are a parameter.
            database.execute(
                f'CREATE TABLE "{name}" AS SELECT * FROM read_parquet($files, union_by_name = true)',  # noqa: S608
                {"files": listed},
            )
