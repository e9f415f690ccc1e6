"""Verdicts by answers: a wrong status fails, a status that was merely needed does not, nor does the adapter."""

from __future__ import annotations

from typing import Any

import pytest
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import CouldNotAskError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_conformance.upper_tester import Answer

from ..rig import codec_of, known_cases

ODD = "VARDIS_STATUS_INTERNAL_SHARED_MEMORY_ERROR"


class Answering(VirtualUpperTester):
    """Answers one method with something else than the node does."""

    method = ""
    instead: Answer | Exception

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        if method != self.method:
            return super().call(method, params)
        if isinstance(self.instead, Exception):
            raise self.instead
        return self.instead


def result_of(case_id: str, method: str, instead: Answer | Exception) -> CaseResult:
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    upper = Answering(sut)
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), upper, Pics()))
    runner.prepare()
    upper.method, upper.instead = method, instead
    return runner.run(known_cases()[case_id])


DUE = [
    ("TC_VD_MGT_BO_03", "RTDB-Create", "VD-CRE-01"),
    ("TC_VD_MGT_BO_04", "RTDB-Update", "VD-UPD-01"),
    ("TC_VD_MGT_BO_05", "RTDB-Delete", "VD-DEL-01"),
    ("TC_VD_DVA_BI_01", "RTDB-DescribeVariable", "VD-DVA-02"),
    ("TC_VD_CRE_BV_01", "RTDB-Create", "VD-CRE-14"),
    ("TC_VD_CRE_BI_05-descr+value", "RTDB-Create", "VD-CRE-13"),
    ("TC_VD_SRV_BV_01", "RTDB-Update", "VD-SRV-02"),
    ("TC_BP_TXP_BO_01-before-registration", "BP-TransmitPayload", "BP-TXP-01"),
    ("TC_SRP_SRV_BO_01", "SRP-UpdateSafetyData", "SRP-SRV-01"),
]


@pytest.mark.parametrize(("case_id", "method", "requirement"), DUE)
@pytest.mark.parametrize("instead", [Answer(ODD), Answer(code=-32603, message="oh")], ids=["status", "own-error"])
def test_an_answer_that_the_specification_does_not_have_fails_where_a_status_is_due(
    case_id: str, method: str, requirement: str, instead: Answer
):
    if case_id not in known_cases():
        pytest.fail(f"{case_id} is gone")
    result = result_of(case_id, method, instead)
    failed = [each for each in result.checks if each.verdict is Verdict.FAIL]
    assert any(requirement in each.requirements and str(instead) in each.observed for each in failed), result.reason


@pytest.mark.parametrize(("case_id", "method", "requirement"), DUE)
@pytest.mark.parametrize(
    "instead", [Answer(code=-32003, message="the daemon is away"), Answer(code=-32602, message="no such type")]
)
def test_a_call_that_the_upper_tester_could_not_make_decides_nothing(
    case_id: str, method: str, requirement: str, instead: Answer
):
    result = result_of(case_id, method, instead)
    verdict = result.verdict
    assert verdict in (Verdict.INCONCLUSIVE, Verdict.INFO), result.reason
    passed = [each for each in result.checks if each.verdict is Verdict.PASS]
    assert not any(requirement in each.requirements and method in each.expected for each in passed)
    if instead.code == -32003:
        assert "the upper tester could not ask: error -32003: the daemon is away" in result.reason


def test_a_request_that_an_adapter_cannot_make_is_inconclusive():
    result = result_of("TC_VD_CRE_BV_01", "RTDB-Create", CouldNotAskError("the command has no option for repCnt"))
    verdict = result.verdict
    assert verdict is Verdict.INCONCLUSIVE
    assert not result.killed
    assert "it could not: the command has no option for repCnt" in result.reason


def test_a_status_that_is_merely_needed_is_inconclusive_and_named():
    result = result_of("TC_VD_UPD_BV_01", "RTDB-Create", Answer(ODD))
    verdict = result.verdict
    assert verdict is Verdict.INCONCLUSIVE
    assert f"{ODD!r}, a status that the specification does not have" in result.reason


@pytest.mark.parametrize("status", ["FOO-STATUS-OK", "VARDIS-STATUS-OKAY", "OK", ""])
def test_only_a_status_of_the_specification_is_success(status: str):
    assert not Answer(status).ok
    assert not Answer(status).known


#: Methods that cases only use on the way, and parts of which no certain status is due.
_UNJUDGED = frozenset({"UT-Reset", "UT-Subscribe", "BP-DeregisterProtocol"})
#: Cases in which any refusal is right.
_ANY_REFUSAL = frozenset(
    {
        "TC_BP_REG_BI_05",
        "TC_BP_PAR_BI_02",
        "TC_SRP_PAR_BI_01",
        "TC_VD_CRE_BV_07",
        "TC_DCP_DATA_BI_01",
        "TC_VD_DB_BV_06",
    }
)


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    "case_id", [each.id for each in known_cases().values() if each.needs.ut and each.base not in _ANY_REFUSAL]
)
def test_no_case_passes_with_unknown_statuses(case_id: str):
    """A status that the specification lacks, to every call of one method that the case makes."""
    case = known_cases()[case_id]
    # Sequences of the model that deactivate are undone afterwards by these, which are not judged.
    undoing = {"BP-MGMT-Activate", "VD-MGMT-Activate"} if case.base == "TC_DCP_MODEL_BV_01" else set()
    for method in set(case.needs.ut) - _UNJUDGED - undoing:
        result = result_of(case_id, method, Answer(ODD))
        made = any(each.direction == "call" and each.text.startswith(f"{method} ") for each in result.evidence)
        verdict = result.verdict
        assert not made or verdict not in (Verdict.PASS, Verdict.ERROR), f"{method}: {result.error_detail}"


@pytest.mark.parametrize("code", [-32003, -32602])
def test_a_timeout_that_the_upper_tester_could_not_ask_for_was_not_refused(code: int):
    result = result_of("TC_SRP_PAR_BI_01", "SRP-SetParameter", Answer(code=code, message="no"))
    assert [each.verdict for each in result.checks] == [Verdict.INFO, Verdict.INFO], result.reason


# -- readings ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("case_id", "method", "reading"),
    [
        ("TC_SRP_SRV_BO_01", "SRP-UpdateSafetyData", "X10"),
        ("TC_VD_CRE_BO_02", "RTDB-Create", "X20"),
        ("TC_VD_STATE_BV_03-alive-producer.app-create", "RTDB-Create", "X20"),
    ],
)
def test_a_reading_that_was_not_observed_is_not_reported(case_id: str, method: str, reading: str):
    assert reading not in result_of(case_id, method, Answer(ODD)).readings


def test_a_mode_that_the_upper_tester_cannot_ask_for_was_not_refused_by_the_implementation():
    result = result_of("TC_BP_REG_BI_05-BP_QMODE_LIFO", "BP-RegisterProtocol", Answer(code=-32602, message="no such"))
    assert result.readings == {}
    verdict = result.verdict
    assert verdict is Verdict.INFO
