"""BP-TransmitPayload without a confirm: faults are found by beacons and by the numbers of buffered payloads."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.pics import Capabilities, Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_selftest.mutants import all_mutants

from ..rig import one_case


@pytest.mark.parametrize(
    ("mutant", "case_id"),
    [
        ("M-BP-TXP-02-no-limit", "TC_BP_TXP_BI_01-1"),
        ("M-BP-QM-01-drops-head", "TC_BP_QM_BV_01"),
        ("M-BP-QM-02-discards-new", "TC_BP_QM_BV_02"),
        ("M-BP-TXP-03-clears", "TC_BP_TXP_BI_02-once"),
    ],
)
def test_faults_are_noticed_without_a_confirm(mutant: str, case_id: str):
    pics = Pics(pics=Capabilities(transmit_payload_confirm=False))
    assert one_case(case_id, "dcp-2.0", all_mutants()[mutant].make, pics=pics).verdict is Verdict.FAIL
    assert one_case(case_id, "dcp-2.0", pics=pics).verdict is Verdict.PASS
