"""Every case of the suite against our node in this process: what it finds must be what is there."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from itertools import groupby

import pytest
from dcp_conformance.definitions.case import DECLARED, DENIED
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.interconnection.probe import PIXIT_OF
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_selftest.costs import COUNTING

from ...parts import also
from ..rig import OTHER_PROFILES, PROFILES, codec_of, in_session, known_cases, one_case

#: By case function, the identifiers of its variants. What a profile or a PICS declares is not behaviour of our node:
#: tests/conformance/suite/test_declared.py.
VARIANTS = {
    base: tuple(each.id for each in cases)
    for base, cases in groupby(known_cases().values(), key=lambda case: case.base)
    if base not in (DECLARED, DENIED)
}
WIRE_PROFILES = ("dcp-1.0", "dcp-1.2", "dcp-1.3", "dcp-2.0", "cpp-2.0")
#: The versions of the specification.
VERSIONS = ("dcp-2.0", "dcp-1.3", "dcp-1.2", "dcp-1.1", "dcp-1.0")
FINE = frozenset((Verdict.PASS, Verdict.NOT_APPLICABLE))
#: Cases that only report what the specification leaves open and the PICS does not state, without their variants.
OPEN = frozenset(
    (
        *(
            "TC_BP_PTI_BV_01",
            "TC_BP_REC_BV_01",
            "TC_BP_TX_TI_03",
            "TC_BP_TX_TI_04",
            "TC_DCP_UWB_BV_02",
            "TC_SRP_NT_BV_03",
            "TC_SRP_REC_BV_01",
        ),
        *("TC_SRP_REC_BV_01", "TC_VD_DDB_BV_02", "TC_VD_LEN_BI_01", "TC_VD_PAY_BV_08"),
    )
)


@cache
def told_by(profile: str) -> Pics:
    """A PICS with the parameters of our node, as its upper tester tells them."""
    asked = InProcess(reference_config(codec_of(profile))).upper_tester()
    told: dict[str, float] = {}
    for method in ("BP-GetParameters", "SRP-GetParameters", "VD-GetParameters"):
        parameters = asked.call(method, {}).result.get("parameters", {})
        told.update({PIXIT_OF[name]: value for name, value in parameters.items() if name in PIXIT_OF})
    return Pics(pixit=Testing(**told))


def good(case_id: str) -> frozenset[Verdict]:
    """The verdicts that are right for our node."""
    return FINE | {Verdict.INFO} if known_cases()[case_id].base in OPEN else FINE


def wrong(results: Iterable[CaseResult], profile: str) -> list[str]:
    """Results that are not right for our node on a profile."""
    return [
        f"{each.id} on {profile}: {each.verdict}: {each.reason}\n{each.error_detail}"
        for each in results
        if each.verdict not in good(each.id)
    ]


def check(base: str, profiles: Iterable[str]) -> set[str]:
    """Execute all variants of a case on these profiles, each against a new node, and return those that applied."""
    applied, found = set(), []
    for profile in profiles:
        results = [one_case(case_id, profile) for case_id in VARIANTS[base]]
        found += wrong(results, profile)
        applied |= {each.id for each in results if each.verdict is not Verdict.NOT_APPLICABLE}
    assert not found, "\n".join(found)
    return applied


#: Cases whose variants all belong to the long plan: a second of CPU time or more for each version.
LONG = [base for base, ids in VARIANTS.items() if all(known_cases()[each].long for each in ids)]


@pytest.mark.parametrize("base", [*(each for each in VARIANTS if each not in LONG), *also("suite", *LONG)])
def test_our_node_passes_and_each_case_applies_to_some_version(base: str):
    # 65,536 beacons take five seconds for each version; what they count is the same in all of them.
    versions = VERSIONS[:1] if base in COUNTING else VERSIONS
    missing = {each for each in VARIANTS[base] if not known_cases()[each].needs.pics} - check(base, versions)
    # Some cases are about the wire format of an implementation.
    assert not missing or missing <= check(base, ["cpp-2.0"])


ALL = [case_id for variants in VARIANTS.values() for case_id in variants if case_id not in COUNTING]


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", [each for each in PROFILES if each not in VERSIONS])
def test_our_node_passes_on_the_other_profiles(profile: str):
    assert not wrong(in_session(ALL, profile), profile)


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", WIRE_PROFILES)
def test_our_node_passes_without_an_upper_tester(profile: str):
    # The PICS states the sizes: those of a profile are not those of every node.
    assert not wrong(in_session(ALL, profile, upper=False, pics=told_by(profile)), profile)


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", OTHER_PROFILES)
def test_no_case_ends_with_an_error_on_a_foreign_profile(profile: str):
    results = in_session(ALL, profile)
    assert not [(each.id, each.reason, each.error_detail) for each in results if each.verdict is Verdict.ERROR]
