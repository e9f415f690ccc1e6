"""Checks and the verdicts that follow from them."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.results import Mark
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import NamesUsedUp, StopCase
from dcp_spec.constants import ICType

from dcp_codec.values import VarDelete, VarSumm

from .parts import PERIOD, Parts


def test_without_checks_the_verdict_is_inconclusive_and_the_worst_check_decides():
    verdicts = Parts().verdicts
    assert verdicts.verdict() is Verdict.INCONCLUSIVE
    assert verdicts.check(1, "one is true")
    assert verdicts.verdict() is Verdict.PASS
    verdicts.info("a question?", "an answer")
    assert not verdicts.check((), "an empty list is true", "the list is false")
    assert verdicts.verdict() is Verdict.FAIL
    assert not verdicts.all_hold()


def test_a_check_decides_the_named_requirements_or_those_of_the_case():
    verdicts = Parts(requirements=("BP-RX-07", "BP-RX-08")).verdicts
    verdicts.check(True, "of the case")
    verdicts.check(True, "its own", "", "BP-TX-01")
    verdicts.check(True, "several", "", "BP-TX-01 BP-TX-03", "BP-TX-04")
    assert [each.requirements for each in verdicts.checks] == [
        ("BP-RX-07", "BP-RX-08"), ("BP-TX-01",), ("BP-TX-01", "BP-TX-03", "BP-TX-04"),
    ]  # fmt: skip


def test_the_observation_of_a_check_that_holds_is_not_kept():
    verdicts = Parts().verdicts
    verdicts.check(True, "expected", "observed", shown=True)
    assert (verdicts.checks[0].observed, verdicts.checks[0].shown) == ("", False)


def test_an_inconclusive_case_names_its_assumptions():
    parts = Parts()
    parts.assumptions.expectations["X"] = "X is assumed (pixit.x)"
    with pytest.raises(StopCase):
        parts.verdicts.inconclusive("something", "nothing")
    assert parts.verdicts.checks[0].observed == "nothing; X is assumed (pixit.x)"


def test_a_case_without_identifiers_stops_with_a_distinct_exception():
    parts = Parts()
    with pytest.raises(NamesUsedUp):
        parts.verdicts.used_up("an identifier", "none left")
    assert parts.verdicts.checks[0].verdict is Verdict.INCONCLUSIVE


def test_not_applicable_keeps_earlier_checks():
    verdicts = Parts().verdicts
    verdicts.check(False, "something", "nothing")
    with pytest.raises(StopCase):
        verdicts.not_applicable("the profile cannot express it")
    assert verdicts.verdict() is Verdict.FAIL


def test_the_evidence_of_a_record_is_its_octets_in_the_frame():
    parts = Parts()
    octets = parts.beacon(1, VarSumm(3, 1), VarSumm(4, 1), VarDelete(5))
    parts.traffic.frame("heard", 0, "", b"head" + octets, 4)
    parts.hear(octets)
    [second] = parts.heard[0].instructions(ICType.SUMMARIES, 4)
    parts.verdicts.check(True, "something", frames=[second, parts.heard[0], Mark(7)])
    record, frame, other = parts.verdicts.checks[0].frames
    assert (b"head" + octets)[record.offset : record.offset + record.length] == b"\x04\x01"
    assert record.path.endswith("records[1]")
    assert (frame, other) == (Mark(1), Mark(7))


def test_faults_of_the_tester_alone_are_worth_another_execution():
    parts = Parts()
    parts.steps.late_ns = 2 * PERIOD
    parts.verdicts.check(False, "something", "nothing")
    assert parts.verdicts.checks[0].verdict is Verdict.INCONCLUSIVE
    assert parts.verdicts.disturbed == "it acted late by 200 ms"


@pytest.mark.parametrize(
    ("held", "overload", "reason"),
    [
        (0, "", ""),
        (0, "the machine was overloaded", "the machine was overloaded"),
        (2 * PERIOD, "", "tester or implementation were held up for 200 ms"),
    ],
)
def test_a_case_that_a_busy_machine_leaves_undecided_is_worth_another_execution(held: int, overload: str, reason: str):
    parts = Parts()
    parts.steps.held(held)
    with pytest.raises(StopCase):
        parts.verdicts.inconclusive("a full payload", "none in time", overload=overload)
    assert parts.verdicts.disturbed == reason


def test_assumptions_are_not_worth_another_execution():
    parts = Parts()
    parts.steps.late_ns = 2 * PERIOD
    parts.assumptions.stimuli["X"] = "X is assumed"
    parts.verdicts.check(False, "something", "nothing")
    assert parts.verdicts.checks[0].verdict is Verdict.INCONCLUSIVE
    assert parts.verdicts.disturbed == ""
