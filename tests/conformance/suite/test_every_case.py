"""Every case of the suite against our node in this process: what it finds must be what is there."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import pytest
from dcp_conformance.interconnection.probe import PIXIT_OF
from dcp_conformance.model.case import DECLARED, DENIED
from dcp_conformance.model.pics import Pics, Testing
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.reference.inprocess import InProcess, reference_config

from ..rig import OTHER_PROFILES, PROFILES, codec_of, known_cases, one_case

#: Declarations of a profile or PICS are not behaviour of our node: tests/conformance/suite/test_declared.py.
CASES = tuple(each for each in known_cases() if each not in (DECLARED, DENIED))
WIRE_PROFILES = ("dcp-1.0", "dcp-1.2", "dcp-1.3", "dcp-2.0", "cpp-2.0")
#: One of each kind of version: a case that applies to none of them applies to none at all.
VERSIONS = ("dcp-2.0", "dcp-1.3", "dcp-1.1", "dcp-1.0", "cpp-2.0")
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


def otherwise(case_id: str, profiles: Iterable[str], wanted: frozenset[Verdict], *, upper: bool = True) -> list[str]:
    """On which profiles the case comes out otherwise than wanted, and why."""
    found = []
    for profile in profiles:
        # Without an upper tester the PICS tells the sizes: those of a profile are not those of every node.
        result = one_case(case_id, profile, upper=upper, pics=None if upper else told_by(profile))
        if result.verdict not in wanted:
            found.append(f"{profile}: {result.verdict}: {result.reason}\n{result.error_detail}")
    return found


def good(case_id: str) -> frozenset[Verdict]:
    return FINE | {Verdict.INFO} if known_cases()[case_id].base in OPEN else FINE


@pytest.mark.parametrize("case_id", CASES)
def test_our_node_passes(case_id: str):
    assert otherwise(case_id, PROFILES, good(case_id)) == []


@pytest.mark.parametrize("case_id", CASES)
def test_cases_that_need_no_upper_tester_pass_without_one(case_id: str):
    assert otherwise(case_id, WIRE_PROFILES, good(case_id), upper=False) == []


@pytest.mark.parametrize("case_id", CASES)
def test_no_case_raises_an_error_on_any_profile(case_id: str):
    assert otherwise(case_id, OTHER_PROFILES, frozenset(Verdict) - {Verdict.ERROR}) == []


@pytest.mark.parametrize("case_id", [each for each in CASES if not known_cases()[each].needs.pics])
def test_every_case_applies_somewhere(case_id: str):
    verdicts = (one_case(case_id, profile).verdict for profile in VERSIONS)
    assert any(verdict is not Verdict.NOT_APPLICABLE for verdict in verdicts)
