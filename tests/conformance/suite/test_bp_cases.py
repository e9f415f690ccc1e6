"""Cases about BP: what they make of claims, and what readings they see in our node."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.pics import Capabilities, Pics, Testing
from dcp_conformance.definitions.verdict import Verdict

from ..rig import one_case


@pytest.mark.parametrize("case_id", ["TC_BP_QM_BV_06", "TC_BP_TX_TI_01", "TC_BP_PTI_BV_02"])
def test_claims_are_checked_and_hold(case_id: str) -> None:
    claims = Capabilities(multiple_payloads=True, jitter=True, payload_transmitted_indication=True)
    result = one_case(case_id, pics=Pics(pics=claims))
    assert result.verdict is Verdict.PASS, result.reason


def test_an_uncertain_mean_is_not_a_failure() -> None:
    result = one_case("TC_BP_TX_TI_01", pics=Pics(pixit=Testing(period_tolerance=0.0001)))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "too few beacons for their variance" in result.reason
    assert "99 % confidence" in result.reason


def test_without_confirms_statuses_of_submissions_are_not_judged() -> None:
    denied = Pics(pics=Capabilities(transmit_payload_confirm=False))
    assert one_case("TC_BP_TXP_BI_01-1", pics=denied).verdict is Verdict.PASS
    assert one_case("TC_BP_TXP_BV_01-64", pics=denied).verdict is Verdict.NOT_APPLICABLE
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
