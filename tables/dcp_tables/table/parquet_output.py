"""Write record batches to Parquet files: encodings of columns, and row groups that threads write during decoding."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import pyarrow as pa

from .columns import KEPT, TOGETHER

#: Number of rows that are collected for one row group. Larger row groups are read faster.
GROUP = 1 << 18
#: Minimum number of rows of a large batch, which is kept without copying.
MANY = GROUP // KEPT


class Pile:
    """A collection of rows.

    The memory of a batch may have room for many more rows than the batch has. So that few rows do not occupy much
    memory, small batches are copied into larger ones.
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
        """Return all rows, with one dictionary for each column of identifiers."""
        return pa.Table.from_batches([*self._batches, *self._few], self._schema).unify_dictionaries()


class ParquetTable:
    """A Parquet file with row groups of about ``GROUP`` rows.

    With an ``executor``, its threads encode and write the row groups, one of a file at a time. The caller continues to
    collect rows, and waits if a row group is complete before the previous one is written. An exception in a thread is
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
        """Append rows; write a row group when enough are collected."""
        self._pile.add(batch)
        if self._pile.rows >= GROUP:
            self.flush()

    def flush(self) -> None:
        """Write the collected rows, or let a thread write them."""
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
        # With several dictionaries in a row group, identifiers would be written as texts.
        self._writer.write_table(pile.table(), row_group_size=2 * GROUP)

    def _wait(self) -> None:
        """Wait until the pending row group is written; raise its exception if that failed."""
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()


def options(schema: pa.Schema) -> dict[str, Any]:
    """Return the options of ``ParquetWriter``: encodings of all common readers, chosen by size and time.

    * Identifiers are dictionaries already; their indices are written unchanged.
    * Ascending numbers are written as differences, which are small.
    * The octets of floats are written separately: the high ones repeat, the low ones are noise. Integers would benefit,
      too, but DuckDB before 2.0 reads this encoding for floats only.
    * All columns are compressed with lz4: zstd at level 1 takes up to twice as long for octets with the same size.
    * Minimum and maximum of a row group are written for the time only, which queries use to select parts of recordings:
      determining them takes a twelfth of the time of writing.

    Other options were measured and do not help. PLAIN numbers without compression and statistics take half as long to
    encode, but a fifth longer in total, because the files are many times as large. PLAIN instead of differences saves a
    seventh of the time of writing, and the files become 2.7 times as large. Pages of version 2, smaller pages and other
    batch sizes change the total by less than 4 %.
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
        # Number of values that are encoded at a time; the default of about a thousand takes a tenth longer.
        "write_batch_size": 1 << 16,
    }


def _counts_up(field: pa.Field, schema: pa.Schema) -> bool:
    """Return whether the values of a column probably increase by small steps."""
    if pa.types.is_timestamp(field.type):
        # All records of a beacon have the same time.
        return "record" not in schema.names
    if not pa.types.is_integer(field.type):
        return False
    width: int = field.type.bit_width
    return width == 64 or (width == 32 and field.name == "seqno")
