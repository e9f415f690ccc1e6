"""Without a way to reset the implementation no case fails for what earlier cases have left in its database."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from dcp_conformance.definitions.case import DECLARED, DENIED, Case, Kind
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.upper_tester import Answer
from dcp_spec.constants import ICType, SpecVersion

from ..rig import codec_of, every_case, known_cases

FINE = (Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE)
#: Remedies that the tester offers to the user when identifiers are used up.
REMEDIES = ("UT-Reset", "--start", "--restart", 'reset = "restart"')
#: Checks of statements in a PICS or profile: not behaviour of our node.
ON_PAPER = (DECLARED, DENIED)


class NoReset(VirtualUpperTester):
    """Everything but UT-Reset."""

    def __init__(self, sut: InProcess) -> None:
        super().__init__(sut)
        self.methods -= {"UT-Reset"}

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        assert method != "UT-Reset"
        return super().call(method, params)


def runner_of(profile: str) -> Runner:
    sut = InProcess(reference_config(codec_of(profile)))
    runner = Runner(Session(codec_of(profile), sut.lower_tester(), NoReset(sut), Pics()))
    runner.prepare()
    return runner


def still_reporting(profile: str, result: CaseResult) -> bool:
    """Return whether there was no pause because a report submitted by an earlier case is repeated.

    Up to 1.2 SRP repeats it in every beacon until a reset.
    """
    if result.reason.startswith("a beacon with room for exactly these payloads"):
        # The summaries of variables of earlier cases take turns in the beacons.
        return result.verdict is Verdict.INCONCLUSIVE and result.id.startswith("TC_BP_TX_BV_01-")
    return (
        codec_of(profile).profile.spec_version < SpecVersion.V1_3
        and result.id in ("TC_BP_HDR_BV_09", "TC_BP_HDR_BV_12")
        and result.verdict is Verdict.INCONCLUSIVE
        and result.reason.startswith("no beacon during the pause: ")
    )


def odd(results: Iterator[CaseResult], profile: str) -> list[str]:
    """Results that a conforming implementation should not get."""
    return [
        f"{each.id}: {each.verdict}: {each.reason} {each.error_detail}"
        for each in results
        if each.verdict not in FINE
        and not (each.verdict is Verdict.INCONCLUSIVE and all(remedy in each.reason for remedy in REMEDIES))
        and not still_reporting(profile, each)
    ]


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["dcp-2.0", "cpp-2.0"])
def test_the_whole_suite_without_a_restart_of_the_node(profile: str):
    """The next test has the older versions."""
    runner = runner_of(profile)
    cases = [each for each in every_case() if not each.needs.restart and each.id not in ON_PAPER]
    assert odd((runner.run(each) for each in cases), profile) == []


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["dcp-1.3", "dcp-1.0"])
def test_up_to_1_3_identifiers_are_never_used_up(profile: str):
    """Deleted variables leave the database."""
    runner = runner_of(profile)
    cases = [each for each in every_case() if not each.needs.restart]
    results = [runner.run(each) for each in cases]
    wrong = [each for each in results if each.verdict not in FINE and not still_reporting(profile, each)]
    assert [f"{each.id}: {each.reason}" for each in wrong] == []


def test_a_pixit_without_resets_excludes_cases_that_need_one():
    """The upper tester has UT-Reset, but the user does not want it to be called."""
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    pics = Pics(pixit=Testing(reset="none"))
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), VirtualUpperTester(sut), pics))
    runner.prepare()
    result = runner.run(known_cases()["TC_VD_PAY_BV_05"])
    assert (result.verdict, result.reason) == (
        Verdict.NOT_APPLICABLE,
        'the PIXIT excludes resets ([pixit] reset = "none")',
    )


def _case(body: Callable[[Bench], None]) -> Case:
    return Case("TC_DCP_X_BV_01", "", ("VD-PS-01",), Kind.VALID, "", "", 4, "", __name__, body)


def used(bench: Bench) -> None:
    """Many identifiers are in use: peers and the application have created and deleted variables."""
    for _ in range(14):
        peer = bench.peer()
        bench.learn(peer, *(peer.create(each) for each in bench.identifiers.var_ids(9)))
    for _ in range(20):
        bench.must("RTDB-Create", varId=bench.identifiers.own_var_id(), repCnt=1, descr="own", value="01")
    bench.passed("identifiers are in use")


def idle(bench: Bench) -> None:
    """Wait until the last deletions are announced."""
    bench.until_quiet(lambda heard: heard.instructions(ICType.DELETE_VARIABLES))
    bench.wait(30)
    bench.passed("nothing is announced any more")


@pytest.mark.part("suite")
@pytest.mark.parametrize("start", range(64))
def test_a_case_where_many_identifiers_have_been_used(start: int):
    """Since 2.0 they stay in the database for good."""
    runner = runner_of("dcp-2.0")
    assert runner.run(_case(used)).verdict is Verdict.PASS
    assert runner.run(_case(idle)).verdict is Verdict.PASS
    # Cases that are far from each other in the suite: none of them uses the last identifiers.
    assert odd((runner.run(each) for each in list(known_cases().values())[start::64]), "dcp-2.0") == []
