"""Modules that every worker needs, imported once in the process from which workers are forked."""

from __future__ import annotations

from dcp_conformance.definitions.case import all_cases
from dcp_conformance.execution import run
from dcp_conformance.reference import process

__all__ = ["process", "run"]

all_cases()
