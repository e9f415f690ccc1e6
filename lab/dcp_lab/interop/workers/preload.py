"""Modules that every process of a matrix needs, imported once in the server that forks them."""

from __future__ import annotations

from dcp_lab.interop import cell, definition, implementations
from dcp_lab.interop.nodes import virtual

definition.all_tests()

__all__ = ["cell", "definition", "implementations", "virtual"]
