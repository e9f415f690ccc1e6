"""An upper tester whose UT-Reset returns before the implementation can receive hides nothing."""

from __future__ import annotations

from typing import Any

from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_conformance.upper_tester import Answer
from dcp_selftest.mutants import all_mutants
from dcp_spec.constants import BP_PROTID_VARDIS

from ..rig import codec_of, known_cases

#: Time from the answer to UT-Reset until VarDis is registered with BP again, in ns.
EARLY = 150_000_000
#: The first of its frames is the only one on which some receivers end.
CASE = "TC_VD_ROB_BI_01-header-only"


class Late(InProcess):
    """A node of several processes: VarDis registers with BP only some time after a reset."""

    registered = 0
    lists = True

    def deliver(self, octets: bytes) -> None:
        if self.now >= self.registered:
            super().deliver(octets)


class Early(VirtualUpperTester):
    """Answers UT-Reset before VarDis is registered."""

    def __init__(self, sut: Late) -> None:
        self.late = sut
        super().__init__(sut)

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        answer = super().call(method, params)
        if method == "UT-Reset" and self.late.lists:
            self.late.registered = self.late.now + EARLY
        if method == "BP-ListRegisteredProtocols" and answer.ok:
            ready = self.late.lists and self.late.now >= self.late.registered
            rows = [each for each in answer.result["protocols"] if ready or each["protocolId"] != BP_PROTID_VARDIS]
            return Answer(answer.status, {**answer.result, "protocols": rows})
        return answer


def runner_of(mutant: str | None, *, lists: bool = True) -> Runner:
    codec = codec_of("dcp-2.0")
    make = {"make": all_mutants()[mutant].make} if mutant else {}
    sut = Late(reference_config(codec), **make)
    sut.lists = lists
    runner = Runner(Session(codec, sut.lower_tester(), Early(sut), Pics()), sut)
    runner.prepare()
    return runner


def test_the_first_stimulus_after_a_reset_is_received() -> None:
    """It passed: the frame on which the receiver ends had come before VarDis was registered."""
    runner = runner_of("M-VD-ROB-01-dies-of-end")
    result = runner.run(known_cases()[CASE])
    assert result.verdict is Verdict.FAIL
    assert any("UT-Reset returned up to 150 ms before VarDis and SRP were registered" in each for each in runner.notes)


def test_without_a_list_of_protocols_a_destructive_case_waits_for_an_answer() -> None:
    runner = runner_of("M-VD-ROB-01-dies-of-end")
    assert runner.session.upper is not None
    runner.session.upper.methods -= {"BP-ListRegisteredProtocols"}
    assert runner.run(known_cases()[CASE]).verdict is Verdict.FAIL


def test_a_node_that_is_ready_at_once_is_not_waited_for() -> None:
    runner = Runner(
        Session(codec_of("dcp-2.0"), (sut := InProcess(reference_config(codec_of("dcp-2.0")))).lower_tester(),
                sut.upper_tester(), Pics()), sut,
    )  # fmt: skip
    runner.prepare()
    assert runner.run(known_cases()[CASE]).verdict is Verdict.PASS
    assert not any("UT-Reset returned" in each for each in runner.notes)


def test_a_node_that_never_lists_vardis_is_waited_for_once() -> None:
    runner = runner_of(None, lists=False)
    begun = runner.session.lower.now()
    for name in ("TC_BP_HDR_BV_01", "TC_BP_HDR_BV_02"):
        assert runner.run(known_cases()[name]).verdict is Verdict.PASS
    assert runner.session.lower.now() - begun < 6_000_000_000, "2 s for each reset"
