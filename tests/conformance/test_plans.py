"""Cases that take long are run in a plan of their own, or when they are named."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from dcp_conformance.reference.inprocess import InProcess
from dcp_conformance.reporting.files import load_results
from dcp_conformance.selection import PLANS, Selection, left_out, select

from .command import Command
from .rig import known_cases, one_case

LONG = {each.id for each in known_cases().values() if each.long}
ONE = "TC_BP_HDR_BV_11"


def chosen(*patterns: str, plan: str = "full") -> set[str]:
    return {each.id for each in select(known_cases(), Selection(patterns=patterns, plan=plan))}


def test_the_full_plan_leaves_long_cases_out_and_counts_them():
    assert LONG
    assert chosen() == set(known_cases()) - LONG
    assert {each.id for each in left_out(known_cases(), Selection())} == LONG


def test_the_long_plan_has_everything():
    assert chosen(plan="long") == set(known_cases())
    assert left_out(known_cases(), Selection(plan="long")) == []


def test_no_long_case_is_in_the_short_plan():
    assert not chosen(plan="smoke") & LONG


@pytest.mark.parametrize("plan", [each for each in PLANS if each != "smoke"])
def test_a_case_that_is_named_is_meant(plan: str):
    assert chosen(ONE, plan=plan) == {ONE}
    assert {"TC_VD_SCR_TI_12-own", "TC_VD_SCR_TI_12-received"} == chosen("TC_VD_SCR_TI_12", plan=plan)


def test_a_glob_or_a_requirement_does_not_name_a_case():
    assert ONE not in chosen("TC_BP_HDR_*")
    assert ONE not in chosen("BP-HDR-08")
    assert [each.id for each in left_out(known_cases(), Selection(patterns=("BP-HDR-08",)))] == [ONE]


def test_a_run_says_what_it_has_left_out(dcp_conformance: Command, tmp_path: Path):
    done = dcp_conformance("run", "--in-process", "BP-HDR-08", "--report-dir", tmp_path)
    assert done.status == 0, done.out
    assert "1 case that takes long was left out: --plan long runs it, too" in load_results(tmp_path).notes
    assert "--plan long" in done.out


# -- jitter ------------------------------------------------------------------------------------------------------------


class SameSeed(InProcess):
    """Draws the same jitter after each start."""

    def restart(self) -> None:
        self._rng = random.Random(7)
        super().restart()


class Strict(InProcess):
    """Has no jitter."""

    def restart(self) -> None:
        super().restart()
        schedule = self.node.bp._schedule
        schedule._jitter = 0.0
        schedule.restart(self.now)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (InProcess, "no"),
        (SameSeed, "yes: nodes that are started together stay in step"),
        (Strict, "beacons are strictly periodic"),
    ],
)
def test_the_jitter_after_two_starts_is_compared(kind: type[InProcess], said: str):
    result = one_case("TC_BP_TX_TI_04", kind=kind)
    assert [each.observed for each in result.checks] == [said]
