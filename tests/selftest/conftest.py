"""Fixtures for the tests of the self-test."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_conformance.model.results import CaseResult
from dcp_selftest.cli import main

from ..conformance.command import Command
from ..conformance.rig import one_case


@pytest.fixture
def run_case() -> Callable[..., CaseResult]:
    """``run_case(case_id, profile, make=None, upper=True, pics=None)``: the result of one case against our node."""
    return one_case


@pytest.fixture
def dcp_selftest(capsys: pytest.CaptureFixture[str]) -> Command:
    """``dcp_selftest(*args)``: the command in this process; its status and what it printed."""
    return Command(capsys, main)
