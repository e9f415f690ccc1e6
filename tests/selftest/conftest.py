"""Fixtures for the tests of the self-test."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.results import CaseResult
from dcp_selftest import runner
from dcp_selftest.cli import main
from dcp_selftest.variants import campaign

from ..conformance.command import Command
from ..conformance.rig import known_cases, one_case


@pytest.fixture
def run_case() -> Callable[..., CaseResult]:
    """``run_case(case_id, profile, make=None, upper=True, pics=None)``: the result of one case against our node."""
    return one_case


@pytest.fixture
def few_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let campaigns execute a few cases, where their tables and files are the point."""
    about = {"BP-HDR-01", "BP-HDR-02", "VD-RU-03"}
    few = {each.id: each for each in known_cases().values() if each.id == SANITY or about & set(each.requirements)}
    monkeypatch.setattr(runner, "all_cases", lambda: few)
    monkeypatch.setattr(runner, "cases", lambda *_: tuple(few.values()))
    monkeypatch.setattr(campaign, "all_cases", lambda: few)


@pytest.fixture
def dcp_selftest(capsys: pytest.CaptureFixture[str]) -> Command:
    """``dcp_selftest(*args)``: the command in this process; its status and what it printed."""
    return Command(capsys, main)
