"""A single fault fails only the requirements it violates, not those that fail as a consequence."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_selftest.mutants import all_mutants

from ..rig import one_case

#: It processes containers only that begin in the first half of a payload's octets.
LOSES_SECOND = "M-VD-RX-04-octets"


@pytest.mark.parametrize(
    "case_id",
    [
        "TC_NET_PART_BV_04",
        "TC_NET_RACE_BV_03-one-payload-update-first",
        "TC_NET_RACE_BV_04-creation-first",
        "TC_VD_RX_BV_05-in-order",
        "TC_VD_RX_BV_06-reversed",
        "TC_VD_SCP_BV_01",
        "TC_VD_SCP_BV_02",
        "TC_VD_TYP_BV_01",
    ],
)
@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.req("VD-RX-04")
def test_losing_the_second_container(case_id: str, upper: bool):
    result = one_case(case_id, "cpp-2.0", all_mutants()[LOSES_SECOND].make, upper=upper)
    blamed = {each for check in result.checks if check.verdict is not Verdict.PASS for each in check.requirements}
    assert blamed <= {"VD-RX-04"}, result.reason


def test_losing_a_container_in_some_orders_does_not_violate_the_order_of_processing():
    result = one_case("TC_VD_RX_BV_02", "cpp-2.0", all_mutants()[LOSES_SECOND].make)
    blamed = {each for check in result.checks if check.verdict is not Verdict.PASS for each in check.requirements}
    assert blamed == {"VD-RX-02"}, result.reason


@pytest.mark.parametrize("variant", ["in-order", "reversed"])
def test_the_order_of_processing_is_not_judged_by_a_lost_container(variant: str):
    result = one_case(f"TC_VD_RX_BV_11-{variant}", "cpp-2.0", all_mutants()[LOSES_SECOND].make)
    assert result.verdict in (Verdict.INCONCLUSIVE, Verdict.PASS), result.reason


@pytest.mark.parametrize("number", ["07", "08", "11"])
def test_a_lost_container_leaves_the_order_of_processing_open(number: str):
    """That nothing is requested proves nothing if the summary or the request was lost."""
    result = one_case(f"TC_VD_RX_BV_{number}-in-order", "cpp-2.0", all_mutants()[LOSES_SECOND].make)
    assert result.verdict is Verdict.INCONCLUSIVE, result.reason
