"""The cases about received VarDis payloads against our node: what they find must be what is there."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_conformance.results import CaseResult
from dcp_conformance.verdict import Verdict

from .rig import OTHER_PROFILES, PROFILES, ids_of

MODULES = (
    "vardis_states",
    "vardis_state_services",
    "vardis_split",
    "vardis_receive",
    "vardis_seqno",
    "vardis_forwarding",
    "vardis_scope",
    "vardis_pending",
    "vardis_lengths",
    "vardis_robustness",
    "vardis_creation",
    "vardis_hazards",
    "vardis_types",
)
FINE = {Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE}
WIRE_PROFILES = ("dcp-1.2", "cpp-2.0")


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("case_id", ids_of(*MODULES))
def test_our_node_conforms(case_id: str, profile: str, run_case: Callable[..., CaseResult]) -> None:
    result = run_case(case_id, profile)
    assert result.verdict in FINE, f"{result.verdict}: {result.reason} {result.error_detail}"


@pytest.mark.parametrize("profile", OTHER_PROFILES)
@pytest.mark.parametrize("case_id", ids_of(*MODULES))
def test_no_case_stumbles_over_a_profile(case_id: str, profile: str, run_case: Callable[..., CaseResult]) -> None:
    result = run_case(case_id, profile)
    assert result.verdict is not Verdict.ERROR, f"{result.reason} {result.error_detail}"


@pytest.mark.parametrize("profile", WIRE_PROFILES)
@pytest.mark.parametrize("case_id", ids_of(*MODULES))
def test_without_an_upper_tester(case_id: str, profile: str, run_case: Callable[..., CaseResult]) -> None:
    result = run_case(case_id, profile, upper=False)
    assert result.verdict in FINE, f"{result.verdict}: {result.reason} {result.error_detail}"
