"""After any failure all earlier findings are reported, and each planned execution has a result."""

from __future__ import annotations

import multiprocessing
import os
import signal
import struct
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection

import pytest
from dcp_conformance.cli import display
from dcp_conformance.definitions.case import SANITY, Case
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult, Mark
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError, UpperTesterError
from dcp_conformance.execution.concurrent.scheduler import Scheduler
from dcp_conformance.execution.run import ConformanceRun, WorkerEnd
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import Selection
from dcp_conformance.execution.target import TargetOptions
from dcp_conformance.execution.workers.parallel import messages
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.upper_tester import Answer

from dcp_codec.common.workers import Worker

from ..rig import codec_of
from .test_attribution import Frail, case_of, failed_in, says

CASES = ("TC_VD_CRE_BV_01", "TC_VD_UPD_BV_01")


class Run(ConformanceRun):
    """A run in this process in which a test breaks something."""

    def __init__(self, **more: object) -> None:
        super().__init__(TargetOptions(in_process=True), Selection(patterns=CASES), **more)  # type: ignore[arg-type]

    def of(self, verdict: Verdict) -> list[str]:
        """The executions with a verdict."""
        return [result.id for result in self.results if result.verdict is verdict]


def boom(*_: object) -> None:
    raise RuntimeError("a fault")


def test_an_error_at_the_end_loses_no_result(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Runner, "finish", boom)
    run = Run()
    run.execute()
    assert run.of(Verdict.PASS) == [SANITY, *CASES, SANITY]
    assert run.trouble == "a fault of the tester: RuntimeError: a fault"
    assert run.exit_status() == 4
    assert len(run.result().cases) == 4


@pytest.mark.parametrize("what", ["about", "notes"])
def test_an_error_while_the_implementation_is_described_loses_no_result(what: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Runner, what, boom if what == "about" else property(boom))
    run = Run()
    run.execute()
    assert run.of(Verdict.PASS) == [SANITY, *CASES, SANITY]
    assert run.exit_status() == 4


def test_after_an_error_in_a_concurrent_run_the_other_cases_are_executed_alone(monkeypatch: pytest.MonkeyPatch):
    steps, step = Counter[str](), Scheduler.step

    def fails(self: Scheduler, until: int) -> None:
        steps["step"] += 1
        if steps["step"] == 5:
            raise ValueError("a fault")
        step(self, until)

    monkeypatch.setattr(Scheduler, "step", fails)
    run = Run(side_by_side=4)
    run.execute()
    assert run.of(Verdict.PASS) == [SANITY, *CASES, SANITY]
    assert run.trouble == "a fault of the tester: ValueError: a fault"
    assert run.exit_status() == 4
    assert "executed one at a time" in " ".join(run.result().notes)


def test_errors_of_one_cause_are_one_finding_on_the_terminal(monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr(Run, "run_case", boom)
    run = Run()
    run.execute()
    display.print_summary(run.result())
    printed = capsys.readouterr().out
    assert "error 4 cases: the case has a result: a fault of the tester: RuntimeError: a fault" in printed
    assert printed.count("a fault of the tester") < 4


def test_an_error_between_cases_becomes_the_result_of_cases_that_were_not_run(monkeypatch: pytest.MonkeyPatch):
    take = Run.take

    def fails(self: Run, case: Case, result: CaseResult) -> str:
        if case.id == CASES[1] and not self.trouble:
            raise RuntimeError("a fault")
        return take(self, case, result)

    monkeypatch.setattr(Run, "take", fails)
    run = Run()
    run.execute()
    assert run.of(Verdict.PASS) == [SANITY, CASES[0]]
    assert run.of(Verdict.ERROR) == [SANITY, CASES[1]]
    assert run.exit_status() == 4


@pytest.mark.parametrize(("options", "lost"), [({"repeat": 2}, 1), ({"max_fails": 1}, 1), ({}, 1)])
def test_a_lost_execution_is_noticed(options: dict[str, object], lost: int, monkeypatch: pytest.MonkeyPatch):
    take = Run.take
    dropped: list[str] = []

    def loses(self: Run, case: Case, result: CaseResult) -> str:
        if case.id == CASES[0] and not dropped:
            dropped.append(case.id)
            return ""
        return take(self, case, result)

    monkeypatch.setattr(Run, "take", loses)
    run = Run(**options)
    run.execute()
    assert run.of(Verdict.ERROR) == [CASES[0]] * lost
    assert run.exit_status() == 4


def test_a_run_that_ends_with_the_first_failure_has_lost_nothing(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Runner, "run", lambda _self, case, attempt: failing(case, attempt))
    run = Run(max_fails=1)
    run.execute()
    assert [result.id for result in run.results] == [SANITY]


def failing(case: Case, attempt: int) -> CaseResult:
    return CaseResult(id=case.id, purpose="", section="", kind="BV", requirements=(), verdict=Verdict.FAIL,
                      attempt=attempt)  # fmt: skip


# -- workers --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("octets", [b"", struct.pack("!i", 1000) + b"half of a message", b"\0\0"])
def test_a_lane_that_is_killed_in_the_middle_of_a_message(octets: bytes):
    worker = Worker(multiprocessing.get_context("fork"), killed_after, octets)
    [end] = list(messages({worker.connection: worker}))
    assert isinstance(end, WorkerEnd)
    assert "a worker of the tester has ended with status -9" in end.trouble
    worker.end()


def killed_after(connection: Connection, octets: bytes) -> None:
    os.write(connection.fileno(), octets)
    os.kill(os.getpid(), signal.SIGKILL)


# -- the runner --------------------------------------------------------------------------------------------------------


def runner_with(sut: InProcess, upper: VirtualUpperTester | None = None, **pixit: str) -> Runner:
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), upper, Pics(pixit=Testing(**pixit))), sut)  # type: ignore[arg-type]
    runner.prepare()
    return runner


def test_a_failed_restart_is_not_an_error_of_the_tester():
    sut = InProcess(reference_config(codec_of("dcp-2.0")))

    def restart() -> None:
        raise ConformanceError("--restart: the command ended with status 1")

    sut.restart = restart  # type: ignore[method-assign]
    result = runner_with(sut, reset="restart").run(case_of("TC_DCP_X_BV_01", lambda bench: None))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert result.reason == "the implementation is in its initial state: --restart: the command ended with status 1"
    assert result.error_detail == ""


def once(*steps: Callable[[Bench], None]) -> Callable[[Bench], None]:
    """A body that differs from execution to execution."""
    left = list(steps)
    return lambda bench: (left.pop(0) if len(left) > 1 else left[0])(bench)


def wrong_and_deadly(bench: Bench) -> None:
    bench.verdicts.check(False, "octets 01", "02", "VD-RX-03", frames=[Mark(1)], shown=True)
    says(b"\x01")(bench)


def right(bench: Bench) -> None:
    bench.verdicts.check(bench.probes.probe(), "an answer", "none", "VD-RX-04")


def test_a_proved_failure_is_kept_if_a_later_crash_is_not_reproduced():
    result = runner_with(Frail()).run(case_of("TC_DCP_X_BV_01", once(wrong_and_deadly, right)))
    assert result.verdict is Verdict.FAIL
    assert result.reason == "octets 01: 02 (in the first execution)"
    assert failed_in(result) == {"VD-RX-03"}


def test_a_proved_failure_of_an_earlier_case_is_kept_when_it_caused_the_crash():
    sut = Frail()
    sut.delay_ms = 400
    runner = runner_with(sut)
    earlier = case_of("TC_DCP_X_BV_01", once(wrong_and_deadly, says(b"\x01")))
    assert runner.run(earlier).verdict is Verdict.FAIL
    runner.run(case_of("TC_DCP_X_BV_02", right))
    runner.finish()
    revised = next(each for each in runner.take_revised() if each.id == earlier.id)
    assert revised.killed
    assert failed_in(revised) == {"VD-ROB-01", "VD-RX-03"}
    # The recording is that of the execution alone.
    assert [check.frames for check in revised.checks if check.expected == "octets 01"] == [()]


class CrashesOnDelete(VirtualUpperTester):
    """RTDB-Delete ends the implementation; there is no UT-Reset."""

    def __init__(self, sut: InProcess) -> None:
        super().__init__(sut)
        self.methods -= {"UT-Reset"}

    def call(self, method: str, params: dict[str, object]) -> Answer:
        if method == "RTDB-Delete":
            self._sut.died = "RuntimeError: a deletion"
            raise UpperTesterError("it has closed the connection")
        return super().call(method, params)


def test_a_crash_by_the_clean_up_after_a_case_is_attributed_to_the_deletion():
    sut = InProcess(reference_config(codec_of("dcp-2.0")))

    def creates(bench: Bench) -> None:
        answer = bench.call("RTDB-Create", varId=bench.identifiers.own_var_id(), repCnt=1, descr="d", value="01")
        bench.verdicts.check(answer.ok, "it is created", str(answer), "VD-CRE-12")
        bench.verdicts.check(bench.beacons(1), "a beacon", "none")

    case = case_of("TC_DCP_X_BV_01", creates, "VD-CRE-12")
    result = runner_with(sut, CrashesOnDelete(sut)).run(case)
    assert result.killed
    assert failed_in(result) == {"VD-DEL-05"}
