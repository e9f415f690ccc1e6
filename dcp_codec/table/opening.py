"""``open_table``: one table of recordings for programs that speak Arrow, pandas or Polars."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
from dcp_spec.profile.definition import Link

from dcp_codec.codec import Codec, get_codec

from .archive import find_recordings
from .decoding import ColumnDecoder, worth_compiling
from .input.sources import Recording
from .job import resolve
from .kernel.shape import TABLES, table_names
from .parquet_output import Pile
from .writing import file_schema, joint_schema, with_file

Source = str | Path | Sequence[str | Path]


class OpenTable:
    """One table of one or more recordings. Each use of it reads the recordings anew, so that none is held in memory.

    Anything that takes an Arrow stream takes the object itself (``polars.DataFrame(table)``,
    ``pyarrow.table(table)``, ``duckdb.sql("SELECT * FROM table")`` with ``table = opened.arrow()``). ``schema`` is
    the Arrow schema; columns are described in docs/tables.md.
    """

    def __init__(self, name: str, recordings: Sequence[tuple[str, Codec, Link]]) -> None:
        self.name = name
        #: The profile of each recording by its path.
        self.profiles = {path: codec.profile.name for path, codec, _ in recordings}
        #: What was wrong with the recordings the last time they were read to their end, by path.
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
        """The rows in the order of the recordings, in pieces that keep memory bounded."""
        for path, codec, link in self._recordings:
            with Recording(path) as recording:
                decoder = ColumnDecoder(codec, link, interpret=not worth_compiling(recording.size))
                for block in recording.blocks():
                    for batch in decoder.batches(block):
                        rows = batch.tables[self.name]
                        if rows.num_rows:
                            yield self._fitted(rows, path)
                self.problems[path] = [problem.message for problem in recording.problems]

    def _fitted(self, rows: pa.RecordBatch, path: str) -> pa.RecordBatch:
        if len(self._recordings) > 1:
            rows = with_file(rows, file_schema(rows.schema), path)
        if rows.schema.equals(self.schema):
            return rows
        names = set(rows.schema.names)
        arrays = [
            rows.column(field.name).cast(field.type) if field.name in names else pa.nulls(rows.num_rows, field.type)
            for field in self.schema
        ]
        return pa.RecordBatch.from_arrays(arrays, schema=self.schema)

    def arrow(self) -> pa.Table:
        """All rows as an Arrow table."""
        pile = Pile(self.schema)
        for batch in self.batches():
            pile.add(batch)
        return pile.table()

    def reader(self) -> pa.RecordBatchReader:
        """The rows as an Arrow stream, decoded as they are asked for."""
        return pa.RecordBatchReader.from_batches(self.schema, self.batches())

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """The Arrow PyCapsule interface."""
        return self.reader().__arrow_c_stream__(requested_schema)

    def pandas(self) -> Any:
        """All rows as a ``pandas.DataFrame``; identifiers are categories. Raises ImportError without pandas."""
        return self.arrow().to_pandas()

    def polars(self) -> Any:
        """All rows as a ``polars.DataFrame``, sharing memory. Raises ImportError without Polars."""
        import polars

        return polars.from_arrow(self.arrow())


def open_table(
    path: Source, table: str = "beacons", *, profile: str = "auto", ether_type: int | None = None
) -> OpenTable:
    """Open one table of a recording, of a folder or pattern of recordings, or of a list of them.

    ``profile`` is the name of a wire profile, a profile file, or "auto" to find it out for each recording. Nothing
    but the first frames is read before the table is used.

    Raises ``ValueError`` for a table that does not exist, :class:`~dcp_codec.table.archive.TableError` where there
    are no recordings, :class:`~dcp_codec.capture.CaptureError` for one that cannot be read at all, and
    ``dcp_spec.profile.loading.ProfileError`` for a profile that cannot be had.
    """
    known = TABLES if profile == "auto" else table_names(get_codec(profile).profile)
    if table not in known:
        raise ValueError(f"{table!r} is none of the tables {', '.join(known)}")
    names = [str(path)] if isinstance(path, str | Path) else [str(each) for each in path]
    found = []
    for recording in find_recordings(names):
        codec, link, _ = resolve(recording, profile, ether_type)
        found.append((recording, codec, link))
    return OpenTable(table, found)
