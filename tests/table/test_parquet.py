"""Parquet files: what others read from them, and row groups that threads write."""

from __future__ import annotations

import errno
import threading
from pathlib import Path
from typing import Any

import duckdb
import pandas
import polars
import pyarrow as pa
import pytest
from dcp_tables import TABLES, open_table
from dcp_tables.table import archive, parquet_output
from dcp_tables.table.archive import Order, make
from dcp_tables.table.input import sources
from dcp_tables.table.job import TableError
from dcp_tables.table.parquet_output import ParquetTable
from pyarrow import parquet

pytestmark = pytest.mark.part("tables")

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
A_BUS, B_CRUD = CAPTURES / "a_bus3.mcap", CAPTURES / "b_crud.mcap"


@pytest.fixture
def small_groups(monkeypatch):
    """Row groups of some hundred rows, so that a capture has several."""
    # Not by name: a test that imports the package again leaves its own modules as attributes of the package.
    monkeypatch.setattr(parquet_output, "GROUP", 300)
    monkeypatch.setattr(sources, "FRAMES", 100)


@pytest.fixture(params=[0, 2], ids=["no threads", "two threads"])
def threads(request, monkeypatch) -> int:
    """Number of threads that write the tables of a recording."""
    monkeypatch.setattr(archive, "_threads", lambda _: request.param)
    number: int = request.param
    return number


def plain(value: Any) -> Any:
    """A value that is equal for equal cells, whoever read them."""
    if isinstance(value, float):
        return None if pandas.isna(value) else value.hex()
    return bytes(value) if isinstance(value, bytearray | memoryview) else value


def cells(table: pa.Table) -> list[tuple[Any, ...]]:
    """The rows of a table; times are ns since 1970."""
    columns = []
    for field, column in zip(table.schema, table.columns, strict=True):
        whole = column.cast(pa.int64()) if pa.types.is_timestamp(field.type) else column
        columns.append([plain(value) for value in whole.to_pylist()])
    return list(zip(*columns, strict=True))


@pytest.mark.parametrize("recording", [A_BUS, B_CRUD], ids=["a_bus3", "b_crud"])
def test_other_libraries_read_every_cell(tmp_path, recording):
    """DuckDB, Polars and pandas read what was decoded, whatever the encoding of a column is."""
    make(Order((str(recording),), tmp_path / "tables", "parquet"))
    for name in TABLES:
        path = tmp_path / "tables" / f"{name}.parquet"
        expected = cells(open_table(recording, name).arrow())
        with duckdb.connect() as database:
            by_duckdb = database.read_parquet(str(path)).to_arrow_table()
        assert cells(by_duckdb) == expected, name
        assert cells(polars.read_parquet(path).to_arrow()) == expected, name
        by_pandas = pandas.read_parquet(path)
        assert cells(pa.Table.from_pandas(by_pandas, parquet.read_schema(path), preserve_index=False)) == expected, name


def test_every_reader_knows_the_encodings(tmp_path):
    """Integers and octets are not split into streams, which DuckDB reads since 2.0 only or not at all."""
    make(Order((str(A_BUS),), tmp_path / "tables", "parquet"))
    split = set()
    for name in TABLES:
        file = parquet.ParquetFile(tmp_path / "tables" / f"{name}.parquet")
        for group in range(file.num_row_groups):
            for index in range(file.metadata.num_columns):
                column = file.metadata.row_group(group).column(index)
                assert column.compression == "LZ4"
                assert {*column.encodings} <= {
                    "PLAIN",
                    "RLE",
                    "RLE_DICTIONARY",
                    "DELTA_BINARY_PACKED",
                    "BYTE_STREAM_SPLIT",
                }
                if "BYTE_STREAM_SPLIT" in column.encodings:
                    split.add((column.path_in_schema, column.physical_type))
    assert split == {(axis, "DOUBLE") for axis in "xyz"}


def test_threads_change_nothing(tmp_path, monkeypatch, small_groups):
    """The files are the same octets, however many threads write them."""
    for number in (0, 1, 3):
        monkeypatch.setattr(archive, "_threads", lambda _, number=number: number)
        make(Order((str(B_CRUD),), tmp_path / str(number), "parquet"))
    for name in TABLES:
        files = [(tmp_path / number / f"{name}.parquet").read_bytes() for number in "013"]
        assert files[0] == files[1] == files[2], name
    assert parquet.ParquetFile(tmp_path / "3" / "summaries.parquet").num_row_groups > 3


def test_threads_share_the_cores_with_other_workers(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(8)))
    assert [archive._threads(workers) for workers in (1, 2, 3, 4, 5, 8, 9)] == [8, 4, 2, 2, 0, 0, 0]


def test_a_full_disk_is_reported_with_and_without_threads(tmp_path, monkeypatch, small_groups, threads):
    """An error while writing in a thread is the same as without threads, and no file remains at the target."""
    written = []

    def full(self: Any, table: pa.Table, row_group_size: int) -> None:
        written.append((table.num_rows, threading.current_thread() is threading.main_thread()))
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(parquet.ParquetWriter, "write_table", full)
    with pytest.raises(TableError, match="out: No space left on device"):
        make(Order((str(B_CRUD),), tmp_path / "out", "parquet"))
    assert written
    assert {main for _, main in written} == {threads == 0}
    assert list(tmp_path.iterdir()) == []


class Later:
    """An executor that does nothing until it is asked for the result."""

    def __init__(self) -> None:
        self.waiting = 0

    def submit(self, function: Any, *arguments: Any) -> Later:
        self.waiting += 1
        self._call = lambda: function(*arguments)
        return self

    def result(self) -> None:
        self.waiting -= 1
        self._call()


def test_one_row_group_of_a_file_is_written_at_a_time(tmp_path, small_groups):
    """The caller waits when a second row group is complete: what waits to be written is bounded, and in order."""
    executor = Later()
    table = pa.table({"number": pa.array(range(1000), pa.int64())})
    writer = ParquetTable(tmp_path / "numbers.parquet", table.schema, executor)  # type: ignore[arg-type]
    for batch in table.to_batches(max_chunksize=100):
        writer.write(batch)
        assert executor.waiting <= 1
    assert executor.waiting == 1
    writer.close()
    assert executor.waiting == 0
    assert parquet.read_table(tmp_path / "numbers.parquet").equals(table)
    assert parquet.ParquetFile(tmp_path / "numbers.parquet").num_row_groups == 4
