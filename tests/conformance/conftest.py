"""Fixtures and options for all tests of cases."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_conformance.cli import main
from dcp_conformance.definitions.results import CaseResult

from .command import Command
from .rig import one_case


@pytest.fixture
def run_case() -> Callable[..., CaseResult]:
    """``run_case(case_id, profile, make=None, upper=True, pics=None)``: the result of one case against our node."""
    return one_case


@pytest.fixture
def dcp_conformance(capsys: pytest.CaptureFixture[str]) -> Command:
    """``dcp_conformance(*args)``: the command in this process; its status and what it printed."""
    return Command(capsys, main)
