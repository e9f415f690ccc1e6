"""Cases that take long, that restart the implementation, and that take its link down."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import StopCase
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import PLANS, Selection, left_out, select
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.reporting.files import load_results
from dcp_conformance.test_system.bench import Bench, Session

from ..command import Command
from ..rig import codec_of, known_cases, one_case

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
def test_a_case_selected_by_its_full_name_is_run(plan: str):
    assert chosen(ONE, plan=plan) == {ONE}
    assert {"TC_VD_SCR_TI_12-own", "TC_VD_SCR_TI_12-received"} == chosen("TC_VD_SCR_TI_12", plan=plan)


def test_a_glob_or_a_requirement_does_not_select_long_cases():
    assert ONE not in chosen("TC_BP_HDR_*")
    assert ONE not in chosen("BP-HDR-08")
    assert [each.id for each in left_out(known_cases(), Selection(patterns=("BP-HDR-08",)))] == [ONE, "TC_BP_HDR_TI_01"]


def test_a_run_says_what_it_has_left_out(dcp_conformance: Command, tmp_path: Path):
    done = dcp_conformance("run", "--in-process", "BP-HDR-08", "--report-dir", tmp_path)
    assert done.status == 0, done.out
    assert "2 cases that take long were left out: --plan long runs them, too" in load_results(tmp_path).notes
    assert "--plan long" in done.out


# -- jitter ------------------------------------------------------------------------------------------------------------


class SameSeed(InProcess):
    """Draws the same jitter after each start."""

    def restart(self) -> None:
        self.rng = random.Random(7)
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
        (SameSeed, "yes: nodes that are started together keep sending at the same times"),
        (Strict, "the beacons are strictly periodic"),
    ],
)
def test_the_jitter_after_two_starts_is_compared(kind: type[InProcess], said: str):
    result = one_case("TC_BP_TX_TI_04", kind=kind)
    assert [each.observed for each in result.checks] == [said]


# -- the link ----------------------------------------------------------------------------------------------------------


def test_the_link_is_taken_down_and_up_by_commands(tmp_path: Path):
    log = tmp_path / "log"
    commands = Testing(link_down=f"sh -c 'echo down >> {log}'", link_up=f"sh -c 'echo up >> {log}'")
    verdict = one_case("TC_DCP_LINK_BV_01", pics=Pics(pixit=commands)).verdict
    # The commands do nothing to a node in this process.
    assert verdict is Verdict.PASS
    assert log.read_text() == "down\nup\n"


def test_a_link_that_cannot_be_switched_is_inconclusive():
    commands = Testing(link_down="false", link_up="true")
    result = one_case("TC_DCP_LINK_BV_01", pics=Pics(pixit=commands))
    verdict = result.verdict
    assert verdict is Verdict.INCONCLUSIVE
    assert "false: exit status 1" in result.reason


def test_the_link_is_up_again_if_the_case_stops():
    class Unheard(InProcess):
        """Its beacons are never heard again."""

        def switch_link(self, up: bool) -> None:
            super().switch_link(up)
            switched.append(up)

    switched: list[bool] = []

    def body(bench: Bench) -> None:
        with bench.control.link_down():
            raise StopCase

    sut = Unheard(reference_config(codec_of("dcp-2.0")))
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    runner.run(Case("TC_DCP_X_BV_01", "", ("UWB-01",), Kind.VALID, "", "", 4, "", __name__, body))
    assert switched == [False, True]
    assert sut.linked


def test_without_a_way_to_switch_the_link_the_case_does_not_apply():
    class Fixed(InProcess):
        switch_link = None  # type: ignore[assignment]

    result = one_case("TC_DCP_LINK_BV_01", kind=Fixed)
    verdict = result.verdict
    assert verdict is Verdict.NOT_APPLICABLE
    assert "link_down" in result.reason
