"""Every case of the suite against our node in this process: what it finds must be what is there."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from itertools import groupby

import pytest
from dcp_conformance.interconnection.probe import PIXIT_OF
from dcp_conformance.model.case import DECLARED, DENIED
from dcp_conformance.model.pics import Pics, Testing
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.reference.inprocess import InProcess, reference_config

from ..rig import OTHER_PROFILES, PROFILES, codec_of, known_cases, one_case

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


def check(base: str, profiles: Iterable[str], *, upper: bool = True, any_verdict: bool = False) -> set[str]:
    """Execute all variants of a case on these profiles, and return those that applied.

    ``any_verdict``: every verdict is right, except an error.
    """
    applied, wrong = set(), []
    for case_id in VARIANTS[base]:
        wanted = frozenset(Verdict) - {Verdict.ERROR} if any_verdict else good(case_id)
        for profile in profiles:
            # Without an upper tester the PICS states the sizes: those of a profile are not those of every node.
            result = one_case(case_id, profile, upper=upper, pics=None if upper else told_by(profile))
            if result.verdict not in wanted:
                wrong.append(f"{case_id} on {profile}: {result.verdict}: {result.reason}\n{result.error_detail}")
            if result.verdict is not Verdict.NOT_APPLICABLE:
                applied.add(case_id)
    assert not wrong, "\n".join(wrong)
    return applied


@pytest.mark.parametrize("base", VARIANTS)
def test_our_node_passes_and_each_case_applies_to_some_version(base: str):
    missing = {each for each in VARIANTS[base] if not known_cases()[each].needs.pics} - check(base, VERSIONS)
    # Some cases are about the wire format of an implementation.
    assert not missing or missing <= check(base, ["cpp-2.0"])


@pytest.mark.part("suite")
@pytest.mark.parametrize("base", VARIANTS)
def test_our_node_passes_on_the_other_profiles(base: str):
    check(base, [each for each in PROFILES if each not in VERSIONS])


@pytest.mark.part("suite")
@pytest.mark.parametrize("base", VARIANTS)
def test_our_node_passes_without_an_upper_tester(base: str):
    check(base, WIRE_PROFILES, upper=False)


@pytest.mark.part("suite")
@pytest.mark.parametrize("base", VARIANTS)
def test_no_case_ends_with_an_error_on_a_foreign_profile(base: str):
    check(base, OTHER_PROFILES, any_verdict=True)
