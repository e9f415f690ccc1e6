"""Recordings as tables: columnar decoding in machine code that is generated from the layout of a profile.

Needs the extra ``table`` (Numba, NumPy, Arrow), which is imported when a name is first used. ``dcp_codec.open_table``
and ``dcp-codec table`` are built on it; docs/tables.md describes the tables.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .decoding import Batch, Block, ColumnDecoder
    from .opening import OpenTable, open_table
    from .shape import TABLES, Shape
    from .sources import Recording

__all__ = ["TABLES", "Batch", "Block", "ColumnDecoder", "OpenTable", "Recording", "Shape", "open_table"]

_PLACES = {
    "Batch": "decoding",
    "Block": "decoding",
    "ColumnDecoder": "decoding",
    "OpenTable": "opening",
    "Recording": "sources",
    "Shape": "shape",
    "TABLES": "shape",
    "open_table": "opening",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_PLACES[name]}"), name)
