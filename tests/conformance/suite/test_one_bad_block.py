"""One fault in a beacon is one fault in the report: the whole suite against nodes that send one thing wrong.

Failures name the requirement that is violated, and none about other parts of the same beacon.
"""

from __future__ import annotations

import pytest
from dcp_conformance.suite.bp.services.client_reception import broken_by
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import Finding, Trial, trial

MUTANTS = all_mutants()
REPORTS = ("M-SRP-FMT-01-test-pattern", "M-SRP-FMT-01-two-more", "M-SRP-FMT-01-filled-up", "M-SRP-FMT-01-two")
HEADERS = {
    "M-BP-HDR-01-two": {"BP-HDR-01"},
    "M-BP-HDR-02-swapped": {"BP-HDR-02", "DATA-01"},
    "M-BP-HDR-06-with-header": {"BP-HDR-06"},
    "M-BP-HDR-06-payloads-only": {"BP-HDR-06"},
    "M-BP-HDR-10-seqno-first": {"BP-HDR-10"},
    "M-DATA-01-all-swapped": {"DATA-01", "BP-HDR-02"},
    "M-BP-FMT-01-block-with-header": {"BP-FMT-01"},
}


def failed(outcome: Trial) -> set[str]:
    assert not outcome.errors
    findings: tuple[Finding, ...] = (*outcome.killers, *outcome.also)
    return {requirement for each in findings for requirement in each.requirements}


@pytest.mark.part("suite")
@pytest.mark.parametrize("identifier", REPORTS)
@pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.2"])
def test_an_unreadable_state_report_fails_srp_only(identifier: str, profile: str) -> None:
    outcome = trial(MUTANTS[identifier], profile=profile, full=True)
    assert outcome.killed
    assert failed(outcome) == {"SRP-FMT-01", "SRP-TYP-02"}


@pytest.mark.part("suite")
@pytest.mark.parametrize("identifier", HEADERS)
def test_a_fault_in_the_header_fails_requirements_about_that_field(identifier: str) -> None:
    outcome = trial(MUTANTS[identifier], full=True)
    assert outcome.killed
    assert failed(outcome) == HEADERS[identifier]


@pytest.mark.parametrize(
    ("head", "requirements"),
    [
        ("19 70 02 01", {"DATA-01"}),
        ("19 70 01 02", {"DATA-01"}),
        ("70 19 02 01", {"DATA-01"}),
        ("70 19 01 06", {"BP-FMT-01"}),
        ("19 70 01 06", {"DATA-01", "BP-FMT-01"}),
        ("70 19 00 02", {"BP-HDR-11"}),
        ("00 19 01 02", {"BP-HDR-11"}),
        ("01 70 19 02", {"BP-HDR-11"}),
        ("", {"BP-HDR-11"}),
    ],
)
def test_each_fault_in_the_header_of_a_block_fails_its_own_rule(head: str, requirements: set[str]) -> None:
    assert set(broken_by(bytes.fromhex(head), bytes.fromhex("70 19 01 02"))) == requirements


@pytest.mark.part("suite")
def test_a_bad_container_hides_neither_those_before_it_nor_bp() -> None:
    outcome = trial(MUTANTS["M-VD-IC-02-unknown-behind"], full=True)
    assert outcome.killed
    assert {each.partition("-")[0] for each in failed(outcome)} == {"VD"}
