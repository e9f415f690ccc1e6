"""Tables and pages of recordings: columnar decoding, Parquet, CSV, DuckDB, plots. docs/tables.md describes the tables.

    >>> from dcp_tables import open_table
    >>> open_table("flight.mcap", "updates").polars()

Numba, NumPy and Arrow are imported when a name is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcp_spec.exports import exported

if TYPE_CHECKING:
    from .table.decoding import Batch, Block, ColumnDecoder
    from .table.input.sources import Recording
    from .table.kernel.shape import TABLES, Shape
    from .table.opening import OpenTable, open_table

__all__ = ["TABLES", "Batch", "Block", "ColumnDecoder", "OpenTable", "Recording", "Shape", "open_table"]

__getattr__ = exported(
    __name__,
    {
        "table.decoding": ("Batch", "Block", "ColumnDecoder"),
        "table.opening": ("OpenTable", "open_table"),
        "table.kernel.shape": ("TABLES", "Shape"),
        "table.input.sources": ("Recording",),
    },
)
