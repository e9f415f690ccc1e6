"""Excuses for failed checks: what excuses a fault that received octets prove, and what only something missing."""

from __future__ import annotations

import pytest
from dcp_conformance.frames.builder import Block
from dcp_conformance.interconnection.contact import Contact
from dcp_conformance.lower_tester import Incident
from dcp_spec.constants import BP_PROTID_VARDIS

from dcp_codec.values import VarSumm

from .parts import PERIOD, Parts

REQUIREMENTS = ("VD-PS-01",)


def sent(parts: Parts, octets: bytes) -> None:
    """Record a frame of the tester."""
    parts.traffic.frame("sent", 0, "", octets, 0)


def test_without_losses_and_assumptions_a_failure_counts():
    parts = Parts()
    parts.hear(parts.beacon(1), parts.beacon(2))
    assert parts.excuses.find(REQUIREMENTS) is None
    assert parts.excuses.find(REQUIREMENTS, shown=True) is None


def test_a_loss_excuses_something_missing_and_then_everything():
    parts = Parts()
    parts.link.dropped = 2
    assert parts.excuses.find(REQUIREMENTS, shown=True) is None
    excuse = parts.excuses.find(REQUIREMENTS)
    assert excuse is not None
    assert excuse == ("the tester has lost something: the kernel dropped 2 frames", "the kernel dropped 2 frames")
    assert parts.excuses.find(REQUIREMENTS, shown=True) is not None


def test_a_gap_excuses_no_fault_of_sequence_numbers():
    parts = Parts()
    parts.hear(parts.beacon(1), parts.beacon(3))
    assert parts.excuses.find(REQUIREMENTS, numbers=True) is None
    excuse = parts.excuses.find(REQUIREMENTS)
    assert excuse is not None
    assert not excuse.disturbance


def test_an_assumed_expectation_excuses_both_kinds_and_an_assumed_stimulus_only_something_missing():
    parts = Parts()
    parts.assumptions.stimuli["A"] = "A is assumed"
    assert parts.excuses.find(REQUIREMENTS, shown=True) is None
    assert parts.excuses.find(REQUIREMENTS) == ("A is assumed", "")
    parts = Parts()
    parts.assumptions.expectations["B"] = "B is assumed"
    assert parts.excuses.find(REQUIREMENTS, shown=True) == ("B is assumed", "")


def test_a_lost_stimulus_excuses_both_kinds():
    parts = Parts()
    parts.link.incidents.append(Incident(True, "lost", b"stimulus"))
    assert parts.excuses.find(REQUIREMENTS, shown=True) is not None


def test_an_unreadable_beacon_hides_records_and_excuses_no_later_proof():
    parts = Parts()
    broken = parts.builder.beacon(b"\x02\0\0\0\0\x01", 1, [Block(BP_PROTID_VARDIS, b"\x01\xff")], network_id=0x1111)
    parts.hear(broken)
    excuse = parts.excuses.find(REQUIREMENTS)
    assert excuse is not None
    assert excuse.text.startswith("1 of its 1 beacons cannot be read: ")
    assert not excuse.disturbance
    assert parts.excuses.find(REQUIREMENTS, shown=True) is None


def test_a_misread_field_excuses_only_checks_that_rely_on_it():
    parts = Parts()
    parts.run.known.misread["creationTime"] = "it compares creation times wrongly"
    assert parts.excuses.find(REQUIREMENTS) is None
    excuse = parts.excuses.find(REQUIREMENTS, shown=True, field="creationTime")
    assert excuse == ("this follows from another fault: it compares creation times wrongly", "")
    assert parts.excuses.find(("DATA-01",), field="creationTime") is None
    parts.excuses.relies_on("creationTime")
    assert parts.excuses.find(REQUIREMENTS, shown=True) is not None


def test_a_misread_report_excuses_something_missing_after_a_report():
    parts = Parts()
    parts.run.known.misread["report"] = "reports are laid out otherwise"
    assert parts.excuses.find(REQUIREMENTS) is None
    report = parts.builder.srp(parts.records.report(b"\x02\0\0\0\0\x09", 1))
    sent(parts, parts.builder.beacon(b"\x02\0\0\0\0\x09", 1, [report], network_id=0x1111))
    assert parts.excuses.find(REQUIREMENTS) is not None
    assert parts.excuses.find(REQUIREMENTS, shown=True) is None


def test_a_lost_container_excuses_cases_that_sent_two_except_about_extraction():
    parts = Parts()
    parts.run.known.lost_container = "second"
    sent(parts, parts.beacon(1, VarSumm(1, 1)))
    assert parts.excuses.find(REQUIREMENTS) is None
    containers = [parts.builder.container(VarSumm(1, 1)), parts.builder.container(VarSumm(2, 1))]
    block = parts.builder.vardis(*containers)
    sent(parts, parts.builder.beacon(b"\x02\0\0\0\0\x09", 1, [block], network_id=0x1111))
    excuse = parts.excuses.find(REQUIREMENTS)
    assert excuse is not None
    assert "loses the second of two containers" in excuse.text
    assert parts.excuses.find(("VD-RX-04",)) is None


def test_after_a_loss_only_a_misread_field_explains_a_failure_for_certain():
    """Another execution may decide a check that a lost container explains, and none that a misread field explains."""
    parts = Parts()
    parts.run.known.lost_container = "second"
    parts.run.known.misread["report"] = "reports are laid out otherwise"
    several = parts.builder.vardis(*(parts.builder.container(VarSumm(each, 1)) for each in (1, 2)))
    sent(parts, parts.builder.beacon(b"\x02\0\0\0\0\x09", 1, [several], network_id=0x1111))
    parts.steps.late_ns = 2 * PERIOD
    excuse = parts.excuses.find(REQUIREMENTS)
    assert excuse is not None
    assert excuse.disturbance == "it acted late by 200 ms"
    report = parts.builder.srp(parts.records.report(b"\x02\0\0\0\0\x09", 1))
    sent(parts, parts.builder.beacon(b"\x02\0\0\0\0\x09", 2, [report], network_id=0x1111))
    excuse = parts.excuses.find(REQUIREMENTS)
    assert excuse == ("this follows from another fault: reports are laid out otherwise", "")


@pytest.mark.parametrize(("created", "excused"), [(set(), True), ({7}, False)])
def test_a_stimulus_that_is_never_answered_excuses_other_requirements(created: set[int], excused: bool):
    """A summary of a variable that the case has created is another stimulus."""
    parts = Parts()
    parts.created.update(created)
    parts.run.known.contact = Contact(3, 3, frozenset({"create"}), frozenset({"summary"}))
    sent(parts, parts.beacon(1, VarSumm(7, 1)))
    assert parts.excuses.find(("VD-PS-01",)) is None
    assert (parts.excuses.find(("VD-CMP-06",)) is not None) is excused


def test_lateness_of_the_tester_is_worth_another_execution():
    parts = Parts()
    parts.steps.late_ns = 2 * PERIOD
    excuse = parts.excuses.find(REQUIREMENTS)
    assert excuse is not None
    assert excuse.disturbance == "it acted late by 200 ms"
