"""The cases about BP, data types and the bearer against our node: what they find must be what is there."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_conformance.pics import Capabilities, Pics, Testing
from dcp_conformance.results import CaseResult
from dcp_conformance.verdict import Verdict

from .rig import OTHER_PROFILES, PROFILES, ids_of, known_cases, one_case

MODULES = (
    "data",
    "bp_header",
    "bp_seqno",
    "bp_registration",
    "bp_deregistration",
    "bp_services",
    "bp_indications",
    "bp_queueing",
    "bp_fitting",
    "bp_receive",
    "bp_length",
    "bp_robustness",
    "bp_management",
    "bp_parameters",
    "bp_timing",
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


@pytest.mark.parametrize("case_id", ids_of(*MODULES))
def test_every_case_applies_somewhere(case_id: str, run_case: Callable[..., CaseResult]) -> None:
    results = (run_case(case_id, profile) for profile in ("dcp-2.0", "dcp-1.0", "dcp-1.3"))
    assert any(result.verdict is not Verdict.NOT_APPLICABLE for result in results), known_cases()[case_id].purpose


@pytest.mark.parametrize("case_id", ["TC_BP_QM_BV_06", "TC_BP_TX_TI_01", "TC_BP_PTI_BV_02"])
def test_claims_are_checked_and_hold(case_id: str) -> None:
    claims = Capabilities(multiple_payloads=True, jitter=True, payload_transmitted_indication=True)
    result = one_case(case_id, pics=Pics(pics=claims))
    assert result.verdict is Verdict.PASS, result.reason


def test_a_mean_that_is_not_certain_is_no_failure() -> None:
    result = one_case("TC_BP_TX_TI_01", pics=Pics(pixit=Testing(period_tolerance=0.0001)))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "sample is too small" in result.reason
    assert "99 % confidence" in result.reason


def test_without_confirms_statuses_of_submissions_are_not_judged() -> None:
    denied = Pics(pics=Capabilities(transmit_payload_confirm=False))
    assert one_case("TC_BP_TXP_BI_01-1", pics=denied).verdict is Verdict.NOT_APPLICABLE
    assert one_case("TC_BP_QM_BV_07", pics=denied).verdict is Verdict.PASS


def test_readings_of_our_node_are_reported() -> None:
    found = {}
    for case_id in ("TC_BP_RX_BV_07", "TC_BP_INI_BV_01", "TC_BP_PAR_BV_02", "TC_BP_REG_BI_05-BP_QMODE_LIFO"):
        found |= one_case(case_id).readings
    assert found == {
        "X02": "length-field",
        "X03": "write-then-increment",
        "X05": "literal-minimum",
        "X06": "refuse-at-registration",
    }
