"""A fault fails although there is an excuse for other failures: an excuse covers only what it explains."""

from __future__ import annotations

from typing import Any

import pytest
from dcp_conformance.definitions.case import SANITY, all_cases
from dcp_conformance.definitions.pics import Testing
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reference import surroundings as around
from dcp_selftest.mutants import all_mutants
from dcp_selftest.variants.applications import FastPilot, Pilot, Sensor
from dcp_selftest.variants.busy import LOADS, Busy
from dcp_selftest.variants.campaign import judge
from dcp_selftest.variants.timing import LOSS, Lossy
from dcp_selftest.variants.variant import Variant, setup, slow, without

from ..parts import every

PROFILE = "dcp-2.0"


def _busy(made: around.Setup) -> Busy:
    return Busy(made, LOADS["late-tester"], seed=1)


#: By excuse: the surroundings that give it, and by mutant the case that fails nevertheless.
EXCUSES: dict[str, tuple[dict[str, Any], dict[str, str]]] = {
    "an application replaces the data": (
        {"application": Pilot},
        {
            "M-SRP-TYP-03-exchanged-again": "TC_SRP_REC_BV_02",
            "M-SRP-TYP-06-constant": "TC_SRP_REC_BV_05",
            "M-SRP-TYP-04-other-id": "TC_SRP_REC_BV_01",
        },
    ),
    "an application replaces nearly all data": (
        {"application": FastPilot},
        {"M-SRP-TYP-04-other-id": "TC_SRP_REC_BV_01", "M-SRP-TYP-03-exchanged-again": "TC_SRP_REC_BV_02"},
    ),
    "an application has a variable": ({"application": Sensor}, {"M-VD-CMP-04-first-number": "TC_VD_SUM_BV_06"}),
    "a lost frame": (
        {"surroundings": Lossy, "pixit": Testing(loss=LOSS)},
        {"M-BP-HDR-01-two": "TC_BP_HDR_BV_01", "M-VD-CMP-06-one-more": "TC_VD_CMP_BV_01"},
    ),
    "a late tester": (
        {"surroundings": _busy},
        {"M-BP-HDR-01-two": "TC_BP_HDR_BV_01", "M-SRP-SEQ-01-by-two": "TC_SRP_REC_BV_05"},
    ),
    "an assumed parameter": (
        {"upper": without("BP-GetParameters", "VD-GetParameters", "SRP-GetParameters")},
        {"M-BP-HDR-01-two": "TC_BP_HDR_BV_01", "M-VD-CMP-06-one-more": "TC_VD_CMP_BV_01"},
    ),
    "calls that are slower than beacons": (
        {"upper": slow(120)},
        {"M-BP-QM-03-drophead-repeats": "TC_BP_QM_BV_03-drophead"},
    ),
}


@pytest.mark.parametrize("excuse", every(2, EXCUSES))
def test_an_excuse_does_not_hide_a_fault(excuse: str) -> None:
    surroundings, faults = EXCUSES[excuse]
    for mutant, case in faults.items():
        made = setup(PROFILE, make=all_mutants()[mutant].make, **surroundings)
        found = judge(
            Variant("V-X-behind", "", "", lambda _, made=made: made), PROFILE, [all_cases()[SANITY], all_cases()[case]]
        )
        failed = {each.case for each in found.fails}
        assert case in failed, (excuse, mutant, found)
        assert Verdict.ERROR not in {each.verdict for each in found.errors}
