"""Cases about SRP and about the services of VarDis: their verdicts on claims, on slow nodes, and on faulty ones."""

from __future__ import annotations

from typing import Any

import pytest
from dcp_conformance.definitions.pics import Capabilities, Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reference.inprocess import VirtualUpperTester
from dcp_conformance.upper_tester import Answer

from ..rig import ids_of, in_session, one_case

MODULES = (
    "srp.record",
    "srp.table",
    "srp.soft_state",
    "srp.forwarding",
    "srp.init",
    "vardis.services.create",
    "vardis.reception.recreate",
    "vardis.services.update",
    "vardis.services.delete",
    "vardis.services.read",
    "vardis.services.management",
    "vardis.services.parameters",
    "vardis.lifecycle.init",
)
CASES = ids_of(*MODULES)
GOOD = (Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE)
MS = 1_000_000
CLAIMS = [
    ("neighbour_statistics", "TC_SRP_NT_BV_03", True),
    ("describe_extra_fields", "TC_VD_DDB_BV_02", True),
    ("srp_seqno_filter", "TC_SRP_RX_BV_03-lower", False),
    ("empty_description", "TC_VD_CRE_BV_07", True),
]


@pytest.mark.parametrize(("name", "case_id", "truth"), CLAIMS)
@pytest.mark.parametrize("claimed", [True, False])
def test_claims_about_optional_behaviour_are_checked(name, case_id, truth, claimed):
    pics = Pics(pics=Capabilities(**{name: claimed}))
    expected = Verdict.PASS if claimed is truth else Verdict.FAIL
    assert one_case(case_id, pics=pics).verdict is expected


# -- slow ones ---------------------------------------------------------------------------------------------------------


class SlowUpperTester(VirtualUpperTester):
    """Each request takes 60 ms on its way to the node and back, as with a command that has to be started."""

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        self._pass(30 * MS)
        answer = super().call(method, params)
        self._pass(30 * MS)
        return answer

    def another(self) -> SlowUpperTester:
        return SlowUpperTester(self._sut)

    def _pass(self, duration: int) -> None:
        self._sut.elapse(duration)


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["dcp-1.1", "dcp-1.3", "dcp-2.0"])
def test_slow_services_pass_too(profile):
    wrong = [each for each in in_session(CASES, profile, upper=SlowUpperTester) if each.verdict not in GOOD]
    # If BP cannot be deactivated, two calls may not fit between two beacons; then they are not judged.
    judged = [
        each for each in wrong if each.verdict is not Verdict.INCONCLUSIVE or "between two beacons" not in each.reason
    ]
    assert [f"{each.id}: {each.reason}\n{each.error_detail}" for each in judged] == []


# -- upper testers that break the contract -----------------------------------------------------------------------------


class NumbersForLists(VirtualUpperTester):
    """Gives the number of entries in place of the entries."""

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        answer = super().call(method, params)
        short = {name: len(each) if isinstance(each, list | dict) else each for name, each in answer.result.items()}
        return answer if method == "UT-Hello" else Answer(answer.status, short, answer.code, answer.message)


@pytest.mark.parametrize(
    "case_id",
    [
        "TC_SRP_RX_BV_02",
        "TC_SRP_NT_BV_01",
        "TC_SRP_INI_BV_01",
        "TC_VD_INI_BV_02",
        "TC_VD_DDB_BV_01",
        "TC_VD_DVA_BV_01",
        "TC_VD_UPD_BV_07",
    ],
)
def test_malformed_answers_of_the_adapter_are_not_failures(case_id):
    result = one_case(case_id, upper=NumbersForLists)
    assert result.verdict is Verdict.INCONCLUSIVE, f"{result.verdict} {result.reason}\n{result.error_detail}"
    assert "must be a" in result.reason
