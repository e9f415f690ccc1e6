"""One fault in a beacon is one fault in the report: samples of the suite against nodes that send one thing wrong.

Failures name the requirement that is violated, and none about other parts of the same beacon. Each test takes another
third of the case functions, and all cases about the fault.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import pytest
from dcp_conformance.definitions.results import CaseResult, Check
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.suite.bp.services.client_reception import broken_by
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import Suite

from ..rig import sampled_cases

MUTANTS = all_mutants()
REPORTS = [
    ("M-SRP-FMT-01-test-pattern", "dcp-2.0"),
    ("M-SRP-FMT-01-two-more", "dcp-1.2"),
    ("M-SRP-FMT-01-filled-up", "dcp-2.0"),
    ("M-SRP-FMT-01-two", "dcp-1.2"),
]
HEADERS = {
    "M-BP-HDR-01-two": {"BP-HDR-01"},
    "M-BP-HDR-02-swapped": {"BP-HDR-02", "DATA-01"},
    "M-BP-HDR-06-with-header": {"BP-HDR-06"},
    "M-BP-HDR-06-payloads-only": {"BP-HDR-06"},
    "M-BP-HDR-07-one-more": {"BP-HDR-07"},
    "M-BP-HDR-10-seqno-first": {"BP-HDR-10"},
    "M-DATA-01-all-swapped": {"DATA-01", "BP-HDR-02"},
    "M-BP-FMT-01-block-with-header": {"BP-FMT-01"},
}


#: Faults due to which an answer of the node cannot be read.
UNREADABLE = {
    "M-BP-HDR-11-swapped-protocol": {"BP-HDR-11"},
    "M-DATA-01-block-length-swapped": {"BP-FMT-01"},
    "M-BP-FMT-01-checksum-in-length": {"BP-FMT-01"},
    "M-BP-HDR-11-wrong-place": {"BP-HDR-11"},
}


def failures(identifier: str, seed: int, about: set[str], profile: str = "dcp-2.0") -> Failures:
    """Run a sample of the suite, and all cases about the fault, against a mutant."""
    suite = Suite(profile, MUTANTS[identifier].make)
    results = list(suite.run(sampled_cases(seed, *about, *MUTANTS[identifier].requirements)))
    assert [each.error_detail for each in results if each.verdict is Verdict.ERROR] == []
    return Failures(failed_checks(results), failed_checks(suite.passive()))


def failed_checks(results: Iterable[CaseResult]) -> list[Check]:
    return [check for each in results for check in each.checks if check.verdict is Verdict.FAIL]


class Failures(NamedTuple):
    """Failed checks of cases, and of the rules for received beacons."""

    cases: list[Check]
    passive: list[Check]

    @property
    def requirements(self) -> set[str]:
        return {requirement for check in (*self.cases, *self.passive) for requirement in check.requirements}


@pytest.mark.part("suite")
@pytest.mark.parametrize(("identifier", "profile"), REPORTS)
def test_an_unreadable_state_report_fails_srp_only(identifier: str, profile: str) -> None:
    about = {"SRP-FMT-01", "SRP-TYP-02"}
    assert failures(identifier, REPORTS.index((identifier, profile)), about, profile).requirements == about


@pytest.mark.part("suite")
@pytest.mark.parametrize("identifier", HEADERS)
def test_a_fault_in_the_header_fails_requirements_about_that_field(identifier: str) -> None:
    found = failures(identifier, list(HEADERS).index(identifier), HEADERS[identifier])
    assert found.requirements == HEADERS[identifier]


@pytest.mark.part("suite")
@pytest.mark.parametrize("identifier", UNREADABLE)
def test_an_unreadable_answer_does_not_count_as_missing(identifier: str) -> None:
    """Checks of received octets may find another fault; an unreadable answer does not count as an answer."""
    about = {*UNREADABLE[identifier], *MUTANTS[identifier].requirements}
    checks = failures(identifier, list(UNREADABLE).index(identifier), about).cases
    assert any(about.intersection(each.requirements) for each in checks)
    assert all(each.shown for each in checks if not about.intersection(each.requirements))


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
    about = set(MUTANTS["M-VD-IC-02-unknown-behind"].requirements)
    found = failures("M-VD-IC-02-unknown-behind", 0, about).requirements
    assert found & about
    assert {each.partition("-")[0] for each in found} == {"VD"}
