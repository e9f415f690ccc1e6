"""The sanity case finds out how tester and implementation reach each other, and causes no unrelated failures."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.pics import Capabilities, Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.interconnection.contact import Contact
from dcp_conformance.interconnection.findings import Findings
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_conformance.test_system.steps import Steps
from dcp_selftest.mutants import all_mutants

from dcp_stack.node import Node

from ..rig import codec_of, known_cases, one_case


class Deaf(Node):
    """Hears nothing; it beacons when it has something to say."""

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        return


def runner_for(sut: InProcess, profile: str = "dcp-2.0", *, upper: bool = False, pics: Pics | None = None) -> Runner:
    """The tester speaking ``profile``."""
    session = Session(codec_of(profile), sut.lower_tester(), sut.upper_tester() if upper else None, pics or Pics())
    runner = Runner(session, sut)
    runner.prepare()
    return runner


def sanity(sut: InProcess, profile: str = "dcp-2.0", **more: Any) -> tuple[CaseResult, Contact]:
    """The sanity case, and what it has found."""
    runner = runner_for(sut, profile, **more)
    result = runner.run(known_cases()[SANITY])
    contact = Findings.of(runner.session).contact
    assert contact is not None
    return result, contact


def node(profile: str = "dcp-2.0", make: MakeNode = plain_node, **bp: Any) -> InProcess:
    config = reference_config(codec_of(profile))
    return InProcess(msgspec.structs.replace(config, bp=msgspec.structs.replace(config.bp, **bp)), make=make)


def late_by(duration: int) -> Callable[[Steps], int]:
    """Return a replacement of ``Steps.begin`` that reports each step as late by ``duration`` ns."""
    begin = Steps.begin

    def late(self: Steps) -> int:
        time = begin(self)
        self.late_ns = duration
        return time

    return late


def talking(sut: InProcess) -> InProcess:
    """A node with something to say in every beacon."""
    params = {"varId": 1, "repCnt": 3, "descr": "battery", "value": "01"}
    assert sut.upper_tester().call("RTDB-Create", params).ok
    return sut


def deaf(config: Any, rng: Any, now: int, wall: int) -> Node:
    return Deaf(config, rng=rng, now=now, wall=wall)


def mutant(name: str) -> MakeNode:
    return all_mutants()[name].make


def failed(result: CaseResult) -> set[str]:
    """The requirements that failed checks name."""
    return {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}


# -- all is well -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-1.2", "dcp-2.0", "cpp-1.3"])
def test_the_sanity_case_needs_one_question_and_one_answer(profile: str, upper: bool):
    result, contact = sanity(node(profile), profile, upper=upper)
    assert (result.verdict, result.reason) == (Verdict.PASS, "")
    assert [each.direction for each in result.evidence if each.frame] == ["sent", "heard"]
    assert not any(each.direction == "call" for each in result.evidence)
    assert contact.good
    assert contact.answered == {"summary"}
    assert not contact.unanswered


def test_without_vardis_a_beacon_is_enough():
    result, contact = sanity(repeating(without_vardis()), pics=Pics(pics=Capabilities(vardis=False)))
    assert result.verdict is Verdict.PASS
    assert contact.good
    assert contact.frames == 1


# -- the tester is set up wrongly --------------------------------------------------------------------------------------


def test_the_implementation_uses_another_profile():
    result, contact = sanity(talking(node("cpp-1.3")))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert contact.mistaken
    assert result.reason.partition(": ")[2].startswith("its frames look like cpp-1.3 (")
    assert result.reason.endswith("try --profile cpp-1.3")


def test_the_implementation_uses_another_profile_only_in_answers():
    result, contact = sanity(node("cpp-1.3"), "sim-1.0")
    assert (result.verdict, contact.mistaken) == (Verdict.INCONCLUSIVE, True)
    assert "its frames look like cpp-1.3 (" in result.reason
    assert not failed(result)


def test_the_implementation_reports_another_profile():
    result, contact = sanity(node("cpp-1.3", deaf), "sim-1.0", upper=True)
    # It beacons when its services are asked for.
    assert (result.verdict, contact.mistaken) == (Verdict.INCONCLUSIVE, True)
    assert "try --profile cpp-1.3" in result.reason


@pytest.mark.parametrize("says_something", [True, False])
def test_the_implementation_is_in_another_network(says_something: bool):
    sut = node(network_id=3)
    result, contact = sanity(talking(sut) if says_something else sut)
    assert (result.verdict, contact.mistaken) == (Verdict.INCONCLUSIVE, True)
    assert "its beacons carry networkId 3, the tester uses" in contact.suspicion
    assert result.reason.endswith("give [pixit] network_id = 3")


def test_the_case_passes_with_the_advised_options():
    result, _ = sanity(node(network_id=3), pics=Pics(pixit=Testing(network_id=3)))
    assert result.verdict is Verdict.PASS


def test_another_node_is_named():
    result, contact = sanity(talking(node()), pics=Pics(pixit=Testing(node_id="02:00:00:00:00:09")))
    assert (result.verdict, contact.mistaken) == (Verdict.INCONCLUSIVE, True)
    assert "frames came from 02:00:00:00:00:01" in result.reason
    assert "none from 02:00:00:00:00:09 of [pixit] node_id" in result.reason


# -- nothing, or little, is heard --------------------------------------------------------------------------------------


def test_the_implementation_is_silent():
    result, contact = sanity(node(make=deaf))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "nothing was heard: is it running, on this link, with this EtherType or port?" in result.reason
    assert (contact.frames, contact.mistaken) == (0, False)


def repeating(sut: InProcess) -> InProcess:
    """A node with a client protocol that has a payload in every beacon."""
    upper = sut.upper_tester()
    client = {"protId": 99, "name": "x", "maxPayloadSize": 9, "queueingMode": "BP_QMODE_REPEAT"}
    assert upper.call("BP-RegisterProtocol", {**client, "maxEntries": 0, "allowMultiplePayloads": False}).ok
    assert upper.call("BP-TransmitPayload", {"protId": 99, "payload": "0102"}).ok
    return sut


def without_vardis() -> InProcess:
    return InProcess(msgspec.structs.replace(reference_config(codec_of("dcp-2.0")), vardis=None))


def test_the_implementation_may_have_no_vardis():
    result, contact = sanity(repeating(without_vardis()))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "if the implementation has no VarDis, set vardis = false in [pics]" in result.reason
    assert contact.unanswered == {"summary", "create", "request"}


def test_the_implementation_is_known_to_have_vardis():
    result, _ = sanity(repeating(without_vardis()), pics=Pics(pics=Capabilities(vardis=True)))
    assert (result.verdict, failed(result)) == (Verdict.FAIL, {"BP-RX-07"})


@pytest.mark.parametrize("upper", [True, False])
def test_the_implementation_sends_beacons_without_answers(upper: bool):
    result, contact = sanity(talking(node(make=deaf)), upper=upper)
    assert (result.verdict, failed(result)) == (Verdict.FAIL, {"BP-RX-07"})
    assert contact.unanswered >= {"summary", "create", "request"}
    assert contact.answered == ({"transmit", "variable", "state"} if upper else set())
    assert "none of a summary of an unknown variable, a VarCreate and a VarReqCreate" in result.reason or upper


@pytest.mark.parametrize("upper", [True, False])
def test_the_implementation_answers_other_stimuli_but_no_summary(upper: bool):
    result, contact = sanity(node(make=mutant("M-VD-PS-01-ignored")), upper=upper)
    assert (result.verdict, failed(result)) == (Verdict.FAIL, {"VD-PS-01"})
    assert contact.answered >= {"create", "request"}
    assert contact.unanswered == {"summary"}
    assert "it answers a VarCreate" in result.reason


def test_a_tester_that_is_a_little_late_still_finds_a_kind_of_stimulus_without_answer(monkeypatch):
    """Under load the tester is late by more than a beacon period in nearly every execution of this case."""
    monkeypatch.setattr(Steps, "begin", late_by(3 * 100_000_000))
    result, _ = sanity(node(make=mutant("M-VD-PS-01-ignored")), upper=True)
    assert [each.requirements for each in result.checks if each.verdict is Verdict.FAIL] == [("VD-PS-01",)]


def test_the_implementation_delivers_payloads_but_vardis_sends_nothing():
    result, contact = sanity(node(make=mutant("M-VD-RUN-02-ignored")), upper=True)
    assert failed(result) == {"VD-RUN-02"}
    assert contact.answered >= {"payload", "transmit"}


def test_the_implementation_answers_with_another_kind_of_record():
    result, contact = sanity(node(make=mutant("M-VD-IC-02-request-types-exchanged")), upper=True)
    assert (result.verdict, failed(result)) == (Verdict.INCONCLUSIVE, set())
    assert contact.odd.startswith("a REQUEST-VARUPDATES record of variable ")
    assert contact.odd in result.reason


def test_the_implementation_is_inactive():
    result, contact = sanity(node(make=mutant("M-BP-INI-03-inactive")), upper=True)
    assert failed(result) == {"BP-INI-03"}
    assert contact.inactive


# -- octets that break rules -------------------------------------------------------------------------------------------

HEADER_FAULTS = {
    "M-BP-HDR-01-two": {"BP-HDR-01"},
    "M-BP-HDR-02-swapped": {"BP-HDR-02"},
    "M-BP-HDR-06-with-header": {"BP-HDR-06"},
    "M-BP-HDR-07-one-more": {"BP-HDR-07"},
    "M-BP-HDR-11-swapped-protocol": {"BP-HDR-11"},
    "M-DATA-01-block-length-swapped": {"BP-FMT-01"},
    "M-BP-FMT-01-checksum-in-length": {"BP-FMT-01"},
    "M-BP-HDR-11-wrong-place": {"BP-HDR-11"},
}


@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.parametrize("name", HEADER_FAULTS)
def test_a_wrong_header_is_reported_by_its_requirement(name: str, upper: bool):
    result, contact = sanity(node(make=mutant(name)), upper=upper)
    assert (result.verdict, failed(result)) == (Verdict.FAIL, HEADER_FAULTS[name])
    assert not contact.mistaken
    check = next(each for each in result.checks if each.verdict is Verdict.FAIL)
    mark = check.frames[0]
    event = next(each for each in result.evidence if each.frame == mark.frame)
    assert event.direction == "heard"
    assert mark.offset >= event.start
    assert mark.length > 0


def test_a_reversed_node_identifier_is_a_wrong_header():
    result, contact = sanity(node(make=mutant("M-BP-HDR-03-reversed")), upper=True)
    assert failed(result) == {"BP-HDR-03"}
    assert not contact.mistaken


# -- what follows for other cases --------------------------------------------------------------------------------------


def failing(make: MakeNode, choose: Callable[[str], bool] = lambda _: True) -> dict[str, set[str]]:
    """Failed requirements of the suite after the sanity case, with the cases."""
    runner = runner_for(node(make=make), upper=True)
    runner.run(known_cases()[SANITY])
    found: dict[str, set[str]] = {}
    for case in known_cases().values():
        if case.id != SANITY and choose(case.id):
            for each in failed(runner.run(case)):
                found.setdefault(each, set()).add(case.id)
    return found


@pytest.mark.part("suite")
def test_one_kind_without_answer_fails_its_own_requirement_only():
    found = failing(mutant("M-VD-PS-01-ignored"), lambda name: name.startswith(("TC_BP_", "TC_NET_", "TC_VD_RX")))
    assert set(found) == {"VD-PS-01"}


def test_a_violation_in_received_octets_fails_despite_missing_answers():
    """The contact excuses what is missing, and nothing that was received."""
    runner = runner_for(node(make=mutant("M-VD-PS-01-ignored")), upper=True)
    runner.run(known_cases()[SANITY])

    def both(bench: Any) -> None:
        peer = bench.peer()
        peer.send(peer.summary(bench.unknown_id(), 1))
        bench.verdicts.check(False, "an answer", "none", "BP-RX-07")
        bench.verdicts.check(False, "a right octet", "a wrong one", "BP-HDR-01", shown=True)

    result = runner.run(dataclasses.replace(known_cases()["TC_BP_RX_BV_01-2"], run=both))
    assert [each.verdict for each in result.checks][:2] == [Verdict.INCONCLUSIVE, Verdict.FAIL]
    assert "did not answer a summary of an unknown variable when the run began" in result.checks[0].observed


def test_a_loop_that_ends_at_the_length_without_the_header_is_named():
    """An implementer who copies the pseudo-code gets the place of the misprint."""
    found = one_case(SANITY, make=all_mutants()["M-BP-RX-07-loop-bound"].make)
    assert found.verdict is Verdict.FAIL
    assert [check.requirements for check in found.checks if check.verdict is Verdict.FAIL] == [("BP-RX-07",)]
    assert "dcp-bp.md, Receive Path (index < bearerlen)" in found.reason
