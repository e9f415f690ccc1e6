"""Parquet files from record batches: how columns are encoded, and row groups written beside decoding."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pyarrow as pa

from .columns import KEPT, TOGETHER

#: Rows that are collected before they are written: a row group of Parquet is worth reading on its own.
GROUP = 1 << 18
#: Rows of a batch that is worth the memory that it lies in.
MANY = GROUP // KEPT


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
    """A Parquet file with row groups of about ``GROUP`` rows.

    With an ``executor`` its threads encode and write the row groups, one of a file at a time: the caller goes on
    collecting rows, and waits if the next row group is complete before the last one is written. What a thread raises is
    raised by the next call.
    """

    def __init__(self, path: Path, schema: pa.Schema, executor: Executor | None = None) -> None:
        from pyarrow import parquet

        self._schema = schema
        self._writer = parquet.ParquetWriter(path, schema, **options(schema))
        self._pile = Pile(schema)
        self._executor = executor
        self._pending: Future[None] | None = None

    def write(self, batch: pa.RecordBatch) -> None:
        """Append rows."""
        self._pile.add(batch)
        if self._pile.rows >= GROUP:
            self.flush()

    def flush(self) -> None:
        """Write the rows that are collected, or have a thread write them."""
        self._wait()
        pile, self._pile = self._pile, Pile(self._schema)
        if not pile.rows:
            return
        if self._executor is None:
            self._write(pile)
        else:
            self._pending = self._executor.submit(self._write, pile)

    def close(self) -> None:
        """Finish the file."""
        try:
            self.flush()
            self._wait()
        finally:
            self._writer.close()

    def _write(self, pile: Pile) -> None:
        # Identifiers have one dictionary in a row group, or they would be written out.
        self._writer.write_table(pile.table(), row_group_size=2 * GROUP)

    def _wait(self) -> None:
        """Wait until no row group of this file is being written, and raise what writing it raised."""
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()


def options(schema: pa.Schema) -> dict[str, Any]:
    """Return the options of ``ParquetWriter``: the encodings that every common reader knows, chosen by size and time.

    * Identifiers are dictionaries already, and their indices are written as they are.
    * Numbers that count up are small as differences.
    * Floats are split into their octets: the high ones repeat, the low ones are noise. Integers would gain as well, but
      DuckDB before 2.0 reads this encoding of floats only.
    * lz4 for all columns: zstd at level 1 takes up to twice as long for octets and leaves as much of them.
    * The least and the greatest value of a row group are written for the time alone, by which queries cut recordings:
      finding them takes a quarter as long as writing.
    """
    identifiers = [field.name for field in schema if pa.types.is_dictionary(field.type)]
    differences = [field.name for field in schema if _counts_up(field, schema)]
    floats = [field.name for field in schema if pa.types.is_floating(field.type)]
    return {
        "compression": "lz4",
        "use_dictionary": identifiers,
        "column_encoding": dict.fromkeys(differences, "DELTA_BINARY_PACKED")
        | dict.fromkeys(floats, "BYTE_STREAM_SPLIT"),
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
