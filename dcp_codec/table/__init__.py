"""Recordings as tables: columnar decoding in machine code that is generated from the layout of a profile.

The package needs the extra ``table`` (Numba, NumPy, Arrow), which is imported when a name is first used. It is the base
of ``dcp_codec.open_table`` and ``dcp-codec table``; docs/tables.md describes the tables.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcp_spec.exports import exported

if TYPE_CHECKING:
    from .decoding import Batch, Block, ColumnDecoder
    from .input.sources import Recording
    from .kernel.shape import TABLES, Shape
    from .opening import OpenTable, open_table

__all__ = ["TABLES", "Batch", "Block", "ColumnDecoder", "OpenTable", "Recording", "Shape", "open_table"]

__getattr__ = exported(
    __name__,
    {
        "decoding": ("Batch", "Block", "ColumnDecoder"),
        "opening": ("OpenTable", "open_table"),
        "kernel.shape": ("TABLES", "Shape"),
        "input.sources": ("Recording",),
    },
)
