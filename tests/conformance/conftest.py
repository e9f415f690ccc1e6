"""What tests of cases share."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_conformance.results import CaseResult

from .rig import one_case


@pytest.fixture
def run_case() -> Callable[..., CaseResult]:
    """``run_case(case_id, profile, make=None, upper=True, pics=None)``: the result of one case against our node."""
    return one_case
