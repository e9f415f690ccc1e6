"""Import once what every worker needs: workers are forked from a process that has imported this module."""

from __future__ import annotations

from dcp_conformance.model.case import all_cases
from dcp_conformance.reference import process

from . import run

__all__ = ["process", "run"]

all_cases()
