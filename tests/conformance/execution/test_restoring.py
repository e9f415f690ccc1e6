"""However a case ends, what it has changed at the implementation is changed back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError, StopCase, UpperTesterError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.test_system.services.changes import Changes
from dcp_conformance.upper_tester import Answer

from ...parts import every
from ..rig import codec_of, known_cases

LASTING = ("MGMT-Deactivate", "SetParameter", "BP-RegisterProtocol", "UT-Subscribe")
#: A variant of each case function that makes such a change.
CASES = {each.base: each.id for each in known_cases().values() if any(name.endswith(LASTING) for name in each.needs.ut)}


class Forgetful(VirtualUpperTester):
    """Carries out the call with a given number, and loses the answer."""

    lost = 0
    calls = 0

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        answer = super().call(method, params)
        self.calls += 1
        if self.calls == self.lost:
            raise UpperTesterError(f"{method} was not answered within 1 s")
        return answer


def state(sut: InProcess) -> dict[str, Any]:
    """Return the state to be restored: parameters, client protocols, and whether BP and VarDis are active."""
    upper = sut.upper_tester()
    told = {method: upper.call(method, {}).result for method in sorted(upper.methods) if method.endswith("Parameters")}
    listed = upper.call("BP-ListRegisteredProtocols", {}).result["protocols"]
    told["clients"] = sorted(each["protocolId"] for each in listed)
    told["VarDis"] = upper.call("RTDB-DescribeDatabase", {}).status
    told["BP"] = sut.node.bp.active
    return told


def left_by(case: Case, lost: int) -> tuple[dict[str, Any], dict[str, Any], int]:
    """The state before and after a case in which the answer to one call of the body is lost; calls that were made."""
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    upper = Forgetful(sut)
    # Without control of the node: it would be watched for a second of real time to see whether it dies.
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), upper, Pics()))
    runner.prepare()
    before = state(sut)
    # The first call is that of the runner: UT-Reset.
    upper.calls, upper.lost = -1, lost
    runner.run(case)
    return before, state(sut), upper.calls


@pytest.mark.part("suite")
@pytest.mark.parametrize("case_id", every(10, CASES.values()))
def test_the_state_is_restored_after_a_lost_answer(case_id: str):
    # Case functions take turns with the answers: each loses the first one, and a third of the others.
    turn = 1 + list(CASES.values()).index(case_id) % 3
    lost = calls = 1
    while lost <= min(calls, 40):
        before, after, calls = left_by(known_cases()[case_id], lost)
        assert after == before, f"answer {lost} of {calls} was lost"
        lost += turn if lost == 1 else 3


def ended(body: Callable[[Bench], None]) -> tuple[dict[str, Any], dict[str, Any], Bench]:
    """The state before and after a case with this body."""
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    before = state(sut)
    benches: list[Bench] = []

    def noted(bench: Bench) -> None:
        benches.append(bench)
        body(bench)

    runner.run(Case("TC_DCP_X_BV_01", "", ("VD-PS-01",), Kind.VALID, "", "", 4, "", __name__, noted))
    return before, state(sut), benches[0]


def test_parameters_whose_bounds_depend_on_each_other_get_their_values_back():
    def body(bench: Bench) -> None:
        for name, value in (("MAX_DESCRIPTION_LENGTH", 2), ("MAX_SUMMARIES", 1), ("MAX_PAYLOAD_SIZE", 60)):
            bench.must("VD-SetParameter", name=f"VARDISPAR_{name}", value=value)
        # Only now this is possible; the payload size must go back before it.
        bench.must("VD-SetParameter", name="VARDISPAR_MAX_VALUE_LENGTH", value=8)
        raise StopCase

    before, after, bench = ended(body)
    assert after == before
    assert bench.restoration.failure == ""


def test_changes_that_cannot_be_undone_are_reported():
    def body(bench: Bench) -> None:
        bench.must("VD-MGMT-Deactivate")

        def call(method: str, params: dict[str, Any]) -> Answer:
            raise UpperTesterError(f"{method} was not answered within 1 s")

        bench.services.upper.call = call  # type: ignore[method-assign]

    _, _, bench = ended(body)
    assert bench.restoration.failure == "VD-MGMT-Activate: VD-MGMT-Activate was not answered within 1 s"


def test_an_entity_is_reactivated_before_an_exception_propagates():
    def body(bench: Bench) -> None:
        with pytest.raises(StopCase), bench.services.deactivated("VD"):
            bench.inconclusive("something", "else")
        assert bench.call("RTDB-DescribeDatabase").ok

    _, _, bench = ended(body)
    verdict = bench.verdicts.verdict()
    assert verdict is Verdict.INCONCLUSIVE
    assert len(bench.verdicts.checks) == 1


# -- the list itself ---------------------------------------------------------------------------------------------------

OK, REFUSED = Answer("BP-STATUS-OK"), Answer("BP-STATUS-PROTOCOL-ALREADY-REGISTERED")


def changes_after(*calls: tuple[str, dict[str, Any], Answer | None]) -> list[tuple[str, dict[str, Any]]]:
    changes = Changes({"P": 7}.get)
    for method, params, answer in calls:
        changes.asked(method, params)
        if answer is not None:
            changes.answered(method, params, answer)
    return changes.due()


REGISTER, DEREGISTER, SET = "BP-RegisterProtocol", "BP-DeregisterProtocol", "BP-SetParameter"
OFF, ON = "BP-MGMT-Deactivate", "BP-MGMT-Activate"
ONE: dict[str, Any] = {"protId": 1}


@pytest.mark.parametrize(
    ("calls", "due"),
    [
        ([(OFF, {}, OK)], [(ON, {})]),
        ([(OFF, {}, None)], [(ON, {})]),
        ([(OFF, {}, OK), (ON, {}, OK)], []),
        ([(OFF, {}, OK), (ON, {}, None)], [(ON, {})]),
        ([(OFF, {}, OK), (ON, {}, REFUSED)], [(ON, {})]),
        ([(REGISTER, ONE, OK)], [(DEREGISTER, ONE)]),
        ([(REGISTER, ONE, None)], [(DEREGISTER, ONE)]),
        ([(REGISTER, ONE, REFUSED)], []),
        ([(REGISTER, ONE, OK), (REGISTER, ONE, REFUSED)], [(DEREGISTER, ONE)]),
        ([(REGISTER, ONE, OK), (DEREGISTER, ONE, OK)], []),
        ([(REGISTER, ONE, OK), (DEREGISTER, ONE, Answer("BP-STATUS-UNKNOWN-PROTOCOL"))], []),
        ([(REGISTER, ONE, OK), (DEREGISTER, ONE, Answer("BP-STATUS-EMPTY-PAYLOAD"))], [(DEREGISTER, ONE)]),
        ([(SET, {"name": "P", "value": 9}, OK)], [(SET, {"name": "P", "value": 7})]),
        ([(SET, {"name": "P", "value": 9}, REFUSED)], [(SET, {"name": "P", "value": 7})]),
        ([(SET, {"name": "P", "value": 9}, OK), (SET, {"name": "P", "value": 7}, OK)], []),
        ([(SET, {"name": "unknown", "value": 9}, OK)], []),
        ([("UT-Subscribe", {"variables": True}, OK)], [("UT-Subscribe", {})]),
        ([("UT-Subscribe", {"variables": True}, OK), ("UT-Subscribe", {}, OK)], []),
        ([(OFF, {}, OK), (REGISTER, ONE, OK)], [(DEREGISTER, ONE), (ON, {})]),
        ([(OFF, {}, OK), (REGISTER, ONE, OK), ("UT-Reset", {}, OK)], []),
    ],
)
def test_changes_to_be_undone(
    calls: list[tuple[str, dict[str, Any], Answer | None]], due: list[tuple[str, dict[str, Any]]]
):
    assert changes_after(*calls) == due


class Stubborn(VirtualUpperTester):
    """Sets a parameter once and then never again; there is no UT-Reset."""

    def __init__(self, sut: InProcess) -> None:
        super().__init__(sut)
        self.methods -= {"UT-Reset"}
        self._is_set = False

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        if method == "VD-SetParameter":
            if self._is_set:
                return Answer("VARDIS-STATUS-BUSY")
            self._is_set = True
        return super().call(method, params)


def after_a_change(sut: InProcess) -> tuple[Runner, list[CaseResult]]:
    """Results of a case that changes a parameter, and of one after it that needs the initial value."""
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), Stubborn(sut), Pics()), sut)
    runner.prepare()

    def changes(bench: Bench) -> None:
        bench.must("VD-SetParameter", name="VARDISPAR_MAX_SUMMARIES", value=1)
        bench.verdicts.check(bench.probes.probe(), "an answer", "none")

    def needs(bench: Bench) -> None:
        told = bench.must("VD-GetParameters").result["parameters"]["VARDISPAR_MAX_SUMMARIES"]
        bench.verdicts.check(told > 1, "the initial value", str(told))

    cases = [Case(f"TC_DCP_X_BV_0{number}", "", ("VD-PS-01",), Kind.VALID, "", "", 4, "", __name__, body)
             for number, body in enumerate((changes, needs))]  # fmt: skip
    return runner, [runner.run(case) for case in cases]


def test_changes_that_remain_do_not_affect_the_next_case():
    runner, results = after_a_change(InProcess(reference_config(codec_of("dcp-2.0"))))
    assert [each.verdict for each in results] == [Verdict.PASS, Verdict.PASS]
    assert runner.notes == []


def test_without_a_restart_remaining_changes_are_reported():
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    sut.can_restart = False
    runner, _ = after_a_change(sut)
    [note] = runner.notes
    assert note.startswith("not all changes that were made in TC_DCP_X_BV_00 could be undone (VD-SetParameter: ")


def test_a_restart_that_fails_is_not_the_fault_of_the_next_case():
    sut = InProcess(reference_config(codec_of("dcp-2.0")))

    def restart() -> None:
        raise ConformanceError("--restart: the command ended with status 1")

    sut.restart = restart  # type: ignore[method-assign]
    runner, (_, second) = after_a_change(sut)
    assert second.verdict is Verdict.INCONCLUSIVE
    assert "it could not be restarted: --restart: the command ended with status 1" in second.reason
    assert runner.dead
