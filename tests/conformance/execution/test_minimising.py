"""Stimuli of issue reports are minimised: without a frame that is left out, the same check fails again."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.execution.minimising import MOST_TRIES, executor, minimise
from dcp_conformance.execution.runner import Runner
from dcp_conformance.model.case import SANITY, all_cases
from dcp_conformance.model.pics import Pics
from dcp_conformance.model.results import CaseResult, Check
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.reference.inprocess import InProcess, plain_node, reference_config
from dcp_conformance.reporting.issues import write_issues
from dcp_conformance.reporting.issues.stimulus import only, stimulus
from dcp_conformance.test_system.session import Session
from dcp_selftest.mutants import all_mutants

from ..command import Command
from ..reporting.test_issue_reports import CODEC, run_of
from ..reporting.test_reporting import a_case

MUTANT = "M-VD-RU-03-equal-answered"


def runner_of(make: Callable = plain_node) -> Runner:
    sut = InProcess(reference_config(CODEC), make=make)
    runner = Runner(Session(CODEC, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    runner.run(all_cases()[SANITY])
    return runner


def made_up(*needed: int) -> tuple[Callable[[Collection[int]], CaseResult], Callable, list[frozenset[int]]]:
    """A case that fails as long as these frames arrive, beside one that always passes; and what was dropped."""
    tried: list[frozenset[int]] = []

    def faulty(dropped: Collection[int]) -> CaseResult:
        tried.append(frozenset(dropped))
        return a_case(Verdict.PASS if set(needed) & set(dropped) else Verdict.FAIL)

    return faulty, lambda _: a_case(Verdict.PASS), tried


CHECK = a_case(Verdict.FAIL).checks[0]


@pytest.mark.parametrize("needed", [(3,), (0, 7), (2, 3, 4), tuple(range(8))])
def test_only_needed_frames_are_kept(needed: tuple[int, ...]) -> None:
    faulty, conforming, tried = made_up(*needed)
    assert minimise(CHECK, range(8), faulty, conforming) == needed
    assert len(tried) <= MOST_TRIES


def test_a_frame_that_a_conforming_node_needs_to_pass_is_kept() -> None:
    faulty, _, _ = made_up()

    def conforming(dropped: Collection[int]) -> CaseResult:
        return a_case(Verdict.FAIL if 5 in dropped else Verdict.PASS)

    assert minimise(CHECK, range(8), faulty, conforming) == (5,)


def test_a_failure_that_is_not_reproduced_is_not_minimised() -> None:
    assert minimise(CHECK, range(4), lambda _: a_case(Verdict.PASS), lambda _: a_case(Verdict.PASS)) is None


def test_another_failure_does_not_count_as_the_failure_to_be_minimised() -> None:
    other = Check(Verdict.FAIL, ("BP-RX-15",), "something else", "x")

    def faulty(dropped: Collection[int]) -> CaseResult:
        case = a_case(Verdict.FAIL)
        return msgspec.structs.replace(case, checks=(other,)) if 1 in dropped else case

    assert minimise(CHECK, range(3), faulty, lambda _: a_case(Verdict.PASS)) == (1,)


def test_a_dropped_frame_does_not_reach_the_node() -> None:
    runner = runner_of()
    case = all_cases()["TC_VD_CMP_BV_01"]
    execute = executor(runner, case)
    assert execute(()).verdict is Verdict.PASS
    assert execute(range(100)).verdict is not Verdict.PASS
    assert execute(()).verdict is Verdict.PASS


def test_the_stimulus_of_a_mutant_becomes_shorter_and_still_shows_the_fault(tmp_path: Path) -> None:
    run = run_of(MUTANT, "TC_VD_SEQ_BV_0", "TC_VD_STATE_BO_01-alive")
    assert run.diagnosis is not None
    faulty, conforming = runner_of(all_mutants()[MUTANT].make), runner_of()
    left: list[tuple[int, int]] = []

    def needed(result: CaseResult, check: Check, frames: list[int]) -> tuple[int, ...] | None:
        case = all_cases()[result.id]
        found = minimise(check, frames, executor(faulty, case), executor(conforming, case))
        assert found is not None
        again = executor(faulty, case)(set(frames) - set(found))
        assert any(each.verdict is Verdict.FAIL and each.expected == check.expected for each in again.checks)
        left.append((len(found), len(frames)))
        return found

    (page,) = write_issues(run, tmp_path, CODEC, needed)
    (kept, before) = left[0]
    assert 1 <= kept <= before
    text = page.read_text()
    assert "The stimulus was minimised" in text
    fault = run.diagnosis.faults[0]
    case = next(each for each in run.cases if each.id == fault.case)
    assert fault.check is not None
    steps = stimulus(case, fault.check)
    assert sum(bool(step.octets) for step in only(steps, [steps[0].frame])) == 1


def test_minimising_needs_an_implementation(dcp_conformance: Command, tmp_path: Path) -> None:
    (tmp_path / "results.json").write_bytes(msgspec.json.encode(run_of(MUTANT, "TC_VD_SEQ_BV_0")))
    done = dcp_conformance("report", tmp_path, "--issues", tmp_path / "issues", "--minimise")
    assert done.status == 2
    assert "name the implementation as for the run" in done.err
    assert dcp_conformance("report", tmp_path, "--minimise").status == 2


def test_a_fault_that_the_implementation_no_longer_has_is_reported(dcp_conformance: Command, tmp_path: Path) -> None:
    (tmp_path / "results.json").write_bytes(msgspec.json.encode(run_of(MUTANT, "TC_VD_SEQ_BV_0")))
    done = dcp_conformance("report", tmp_path, "--issues", tmp_path / "issues", "--minimise", "--in-process")
    assert done.status == 0, done.err
    assert "the check did not fail again" in done.err
    (page,) = (tmp_path / "issues").glob("*.md")
    assert "minimised" not in page.read_text()
