"""A case that only the tester's own trouble leaves undecided is executed again."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

import pytest
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import MOST_EXECUTIONS, Runner
from dcp_conformance.lower_tester import LinkHealth
from dcp_conformance.reference.inprocess import InProcess, VirtualLowerTester, reference_config
from dcp_conformance.test_system.bench import Bench, Session

from ..rig import codec_of


class Losing(VirtualLowerTester):
    """The link in process; a test says how many frames its kernel has dropped."""

    dropped = 0

    def health(self) -> LinkHealth:
        dropped, self.dropped = self.dropped, 0
        return LinkHealth(dropped)


class Rig:
    """Executes one case, whose body gets the bench and the number of the execution, from 1 on."""

    def __init__(self, pics: Pics | None = None) -> None:
        codec = codec_of("dcp-2.0")
        self.sut = InProcess(reference_config(codec))
        self.lower = Losing(self.sut)
        self.runner = Runner(Session(codec, self.lower, self.sut.upper_tester(), pics or Pics()), self.sut)
        self.runner.prepare()

    def run(self, body: Callable[[Bench, int], None]) -> CaseResult:
        numbers = count(1)
        case = Case(
            "TC_BP_X_BV_01", "", ("BP-RX-07",), Kind.VALID, "", "", 4, "", "", lambda bench: body(bench, next(numbers))
        )
        return self.runner.run(case)

    def be_late(self, bench: Bench, periods: float = 1.5) -> None:
        """Be held up between two steps of a case."""
        bench.wait(0.1)
        self.sut.elapse(round(periods * bench.period))
        bench.steps.begin()


def check(bench: Bench, holds: bool, **how: bool) -> None:
    bench.verdicts.check(holds, "a beacon", "none", **how)


def test_a_late_tester_tries_again_and_the_last_execution_counts():
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        if number == 1:
            rig.be_late(bench)
        check(bench, number == 2)

    result = rig.run(body)
    assert (result.verdict, result.executions) == (Verdict.PASS, 2)
    (note,) = rig.runner.notes
    assert note.startswith("TC_BP_X_BV_01 was executed again, since the tester could not decide it: it acted late by 1")


def test_a_failure_of_the_second_execution_counts():
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        if number == 1:
            rig.be_late(bench)
        check(bench, False)

    result = rig.run(body)
    assert (result.verdict, result.executions) == (Verdict.FAIL, 2)
    assert result.reason == "a beacon: none; executed 2 times"


def test_the_executions_are_bounded():
    rig = Rig()

    def body(bench: Bench, _number: int) -> None:
        rig.be_late(bench)
        check(bench, False)

    result = rig.run(body)
    assert (result.verdict, result.executions) == (Verdict.INCONCLUSIVE, MOST_EXECUTIONS)
    assert "acted late" in result.reason
    assert result.reason.endswith(f"; executed {MOST_EXECUTIONS} times")


def test_frames_dropped_by_the_kernel_also_cause_another_execution():
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        rig.lower.dropped = 3 if number == 1 else 0
        check(bench, number == 2)

    assert (result := rig.run(body)).verdict is Verdict.PASS
    assert result.executions == 2
    assert "the kernel dropped 3 frames" in rig.runner.notes[0]


def test_a_stimulus_that_a_late_tester_did_not_send_is_repeated():
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        if number == 1:
            rig.be_late(bench)
            bench.inconclusive("two payloads between two beacons", "a beacon in between in each attempt")
        check(bench, True)

    assert rig.run(body).verdict is Verdict.PASS


@pytest.mark.parametrize("reason", ["in time", "assumed", "another reason", "passed", "shown"])
def test_only_lateness_causes_another_execution(reason: str):
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        assert number == 1
        if reason != "in time":
            rig.be_late(bench)
        if reason == "in time":
            bench.inconclusive("something", "it could not be tried")
        elif reason == "assumed":
            bench.assumptions["X"] = "X is assumed (pixit.x)"
            check(bench, False)
        elif reason == "another reason":
            check(bench, False)
            bench.steps.late_ns = bench.steps.held_ns = 0
            bench.inconclusive("something", "it could not be tried")
        elif reason == "passed":
            check(bench, True)
        else:
            check(bench, False, shown=True)

    assert rig.run(body).executions == 1


def test_a_failure_is_kept_if_a_later_execution_lacks_it():
    """The octets that were wrong once stay a failure, though the rest of the case could not be observed."""
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        if number == 1:
            bench.verdicts.check(False, "octets 01", "02", "BP-RX-01", shown=True)
            rig.be_late(bench)
            check(bench, False)
        else:
            check(bench, True)

    result = rig.run(body)
    assert (result.verdict, result.executions) == (Verdict.FAIL, 2)
    assert result.reason == "octets 01: 02; executed 2 times"


def test_unobserved_checks_of_a_failed_case_are_observed_by_another_execution():
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        bench.verdicts.check(False, "octets 01", "02", "BP-RX-01", shown=True)
        if number == 1:
            rig.be_late(bench)
        check(bench, number > 1)

    result = rig.run(body)
    assert result.verdict is Verdict.FAIL
    assert [each.verdict for each in result.checks] == [Verdict.FAIL, Verdict.PASS]


def test_each_execution_begins_with_a_reset():
    rig = Rig()
    known: list[object] = []

    def body(bench: Bench, number: int) -> None:
        known.append(bench.must("RTDB-DescribeDatabase").result.get("variables"))
        bench.must("RTDB-Create", varId=7, repCnt=1, descr="x", value="01")
        if number < 3:
            rig.be_late(bench)
        check(bench, number == 3)

    assert rig.run(body).verdict is Verdict.PASS
    assert known == [[], [], []]


def test_an_implementation_that_dies_in_the_second_execution_is_dead():
    rig = Rig()

    def body(bench: Bench, number: int) -> None:
        if number == 1:
            rig.be_late(bench)
            check(bench, False)
        else:
            rig.sut.died = "RuntimeError: a word"

    result = rig.run(body)
    assert result.verdict is Verdict.FAIL
    assert result.killed
