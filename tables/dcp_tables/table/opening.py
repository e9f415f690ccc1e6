"""``open_table``: one table of recordings for programs that use Arrow, pandas or Polars."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
from dcp_spec.profile.definition import Link

from dcp_codec.codec import Codec, get_codec

from .archive import find_recordings
from .decoding import ColumnDecoder
from .input.sources import Recording
from .job import decoder_for, resolve
from .kernel.shape import TABLES, table_names
from .parquet_output import Pile
from .writing import file_schema, fitted, joint_schema, with_file

Source = str | Path | Sequence[str | Path]


class OpenTable:
    """One table of one or more recordings. Each use reads the recordings again, so that none is kept in memory.

    The object can be used wherever an Arrow stream is accepted (``polars.DataFrame(table)``,
    ``pyarrow.table(table)``, ``duckdb.sql("SELECT * FROM table")`` with ``table = opened.arrow()``). ``schema`` is
    the Arrow schema; docs/tables.md describes the columns.
    """

    def __init__(self, name: str, recordings: Sequence[tuple[str, Codec, Link]]) -> None:
        self.name = name
        #: The profile of each recording by its path.
        self.profiles = {path: codec.profile.name for path, codec, _ in recordings}
        #: Problems of the recordings when they were last read completely, by path.
        self.problems: dict[str, list[str]] = {}
        self._recordings = recordings
        several = len(recordings) > 1
        schemas = []
        for path, codec, link in recordings:
            known = ColumnDecoder(codec, link, interpret=True).schemas
            if name not in known:
                raise ValueError(f"{path}: profile {codec.profile.name} has no table {name!r}, only {', '.join(known)}")
            schemas.append(file_schema(known[name]) if several else known[name])
        self.schema = joint_schema(schemas)

    def __repr__(self) -> str:
        return f"<{self.name} of {', '.join(self.profiles)}>"

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the rows in the order of the recordings, in batches of limited size."""
        for path, codec, link in self._recordings:
            with Recording(path) as recording:
                decoder = decoder_for(recording, codec, link)
                for block in recording.blocks():
                    for batch in decoder.batches(block):
                        rows = batch.tables[self.name]
                        if rows.num_rows:
                            yield self._fitted(rows, path)
                self.problems[path] = [problem.message for problem in recording.problems]

    def _fitted(self, rows: pa.RecordBatch, path: str) -> pa.RecordBatch:
        if len(self._recordings) > 1:
            rows = with_file(rows, file_schema(rows.schema), path)
        return rows if rows.schema.equals(self.schema) else fitted(rows, self.schema)

    def arrow(self) -> pa.Table:
        """Return all rows as an Arrow table."""
        pile = Pile(self.schema)
        for batch in self.batches():
            pile.add(batch)
        return pile.table()

    def reader(self) -> pa.RecordBatchReader:
        """Return the rows as an Arrow stream, which decodes them on demand."""
        return pa.RecordBatchReader.from_batches(self.schema, self.batches())

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Return the rows as a capsule of the Arrow PyCapsule interface."""
        return self.reader().__arrow_c_stream__(requested_schema)

    def pandas(self) -> Any:
        """Return all rows as a ``pandas.DataFrame``; identifiers are categories. Raise ImportError without pandas."""
        return self.arrow().to_pandas()

    def polars(self) -> Any:
        """Return all rows as a ``polars.DataFrame`` that shares memory. Raise ImportError without Polars."""
        import polars

        return polars.from_arrow(self.arrow())


def open_table(
    path: Source, table: str = "beacons", *, profile: str = "auto", ether_type: int | None = None
) -> OpenTable:
    """Open one table of a recording, of a folder or pattern of recordings, or of a list of them.

    ``profile`` is the name of a wire profile, a profile file, or "auto" to detect it for each recording. Only the first
    frames are read before the table is used.

    Raise ``ValueError`` for an unknown table, :class:`~dcp_tables.table.archive.TableError` if there are no recordings,
    :class:`~dcp_codec.capture.CaptureError` for one that cannot be read at all, and
    ``dcp_spec.profile.loading.ProfileError`` for an unknown or invalid profile.
    """
    known = TABLES if profile == "auto" else table_names(get_codec(profile).profile)
    if table not in known:
        raise ValueError(f"{table!r} is not one of the tables {', '.join(known)}")
    names = [str(path)] if isinstance(path, str | Path) else [str(each) for each in path]
    found = []
    for recording in find_recordings(names):
        codec, link, _ = resolve(recording, profile, ether_type)
        found.append((recording, codec, link))
    return OpenTable(table, found)
