"""One run of the suite: the selected cases in their order, and their results.

The module does not depend on terminals and files. It is used by ``dcp-conformance run`` and the pytest plugin.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import importlib
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from dcp_codec.common.signals import deferred
from dcp_conformance.definitions.case import ARTEFACT_CASES, SANITY, Case, all_cases
from dcp_conformance.definitions.outcome import INTERRUPTED, TESTER_ERROR, USAGE, assemble, exit_status
from dcp_conformance.definitions.results import CaseResult, Check, Diagnosis, RunResult, Sut, timestamp
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError, LowerTesterError, UpperTesterError, UsageError
from dcp_conformance.passive import cases as invariants
from dcp_conformance.passive import joined
from dcp_conformance.upper_tester import Checked

from .expected import ExpectedResults
from .runner import Runner
from .selection import Selection, left_out, matches, select
from .target import TargetOptions, describe, open_target


class WorkerEnd(NamedTuple):
    """The last message of a worker process, which has executed a share of the cases."""

    sut: Sut | None
    notes: tuple[str, ...]
    trouble: str
    """Why the worker could not begin or complete its share; empty if it did."""
    usage: bool
    """True if the user caused the trouble, for example by an invalid option."""
    passive: tuple[CaseResult, ...] = ()
    """Results of the passive rules."""
    alone: int = 0
    """Number of cases that were executed side by side, and repeated alone."""


class ConformanceRun:
    """One run: the selection, the cases in their order, and their results."""

    def __init__(
        self,
        target: TargetOptions,
        selection: Selection,
        *,
        expected: Path | None = None,
        repeat: int = 1,
        max_fails: int = 0,
        command: str = "",
        artefacts: Path | None = None,
        side_by_side: int = 0,
        on_start: Callable[[int], None] | None = None,
        on_result: Callable[[Case, CaseResult, str], None] | None = None,
    ) -> None:
        """Select the cases. Raise :class:`UsageError` for invalid options, selections or files.

        ``on_start`` is called with the number of executions, ``on_result`` with each case, its result, and why the
        result is unexpected (empty if it is expected). ``expected`` is a file of expected results. ``repeat`` is the
        number of repetitions of all cases. ``max_fails`` is the number of failed cases after which the run ends
        (0: never). ``artefacts`` is a folder of findings of the fuzzer, which become cases. ``side_by_side`` is the
        maximum number of concurrent cases; 0 or 1 executes them in succession.
        """
        self.options = target
        self.cases = all_cases()
        self.artefacts = artefacts
        self.found_by_fuzzer: dict[str, Case] = {}
        if artefacts is not None:
            # Imported by name, because the fuzzer imports this package.
            artefact_cases: Callable[[Path], Iterable[Case]] = importlib.import_module(ARTEFACT_CASES).artefact_cases
            self.found_by_fuzzer = {case.id: case for case in artefact_cases(artefacts)}
            self.cases |= self.found_by_fuzzer
        self.codec, self.pics = describe(target)
        self._invariants = {case.id: case for case in invariants()}
        self._without_sigint, exclude = self._excluded(selection.exclude)
        selection_of_cases = dataclasses.replace(selection, exclude=exclude)
        self.selected = select(self.cases, selection_of_cases)
        self._long = len(left_out(self.cases, selection_of_cases))
        self.with_sanity = not any(matches(self.cases[SANITY], pattern) for pattern in selection.exclude)
        self.expected = (
            ExpectedResults()
            if expected is None
            else ExpectedResults.load(expected, [*self.cases.values(), *self._invariants.values()])
        )
        self.repeat = repeat
        self.max_fails = max_fails
        self.side_by_side = side_by_side
        self.command = command
        self.repeated_alone: dict[str, str] = {}
        """By case: why a case that was executed side by side was repeated alone."""
        self._alone = 0
        """Number of these cases whose verdict is that of the repetition."""
        self.results: list[CaseResult] = []
        """Results of the cases, in the order of their executions."""
        self.passive: list[CaseResult] = []
        """Results of the passive rules, which are checked on all beacons of the run."""
        self.trouble = ""
        """Why the run could not begin or be completed: a problem of the tester, not of the implementation."""
        self._stopped = False
        """Whether ``max_fails``, or an implementation that does not take part, has ended the run."""
        self.usage = False
        """Whether the user has caused the trouble (exit status 2)."""
        self.interrupted = False
        """Whether a signal ended the run."""
        self.on_start = on_start
        self.on_wait: Callable[[str], None] = lambda _: None
        """Called with a message for the user: what the run waits for, and each fault of the adapter."""
        self._on_result = on_result
        self.on_revised: Callable[[CaseResult], None] | None = None
        self._runner: Runner | None = None
        self._stack = contextlib.ExitStack()
        self._sut: Sut | None = None
        self._notes: list[str] = []
        if self._long:
            one = self._long == 1
            cases, them = ("case that takes long was", "it") if one else ("cases that take long were", "them")
            self._notes.append(f"{self._long} {cases} left out: --plan long runs {them}, too")
        self._attempts: dict[str, int] = {}
        self._surprises: dict[tuple[str, int], str] = {}
        """By case and attempt: why the result is unexpected; empty if it is expected."""
        self._began = time.monotonic()
        self._started = timestamp()

    def _excluded(self, patterns: Sequence[str]) -> tuple[set[str], tuple[str, ...]]:
        """Return the excluded passive rules, and the patterns that do not match a passive rule."""
        meant = {each: {name for name, case in self._invariants.items() if matches(case, each)} for each in patterns}
        return set().union(*meant.values()), tuple(each for each in patterns if not meant[each])

    # -- planning ------------------------------------------------------------------------------------------------------

    def plan(self, available: Callable[[Case], bool] = lambda _: True) -> list[Case]:
        """Return the executions in their order: the sanity case first and last, unless it is excluded.

        ``available`` returns whether a selected case can be executed.
        """
        sanity, planned = self.cases[SANITY], []
        for _ in range(self.repeat):
            cases = [case for case in self.selected if case.id != SANITY and available(case)]
            if not self.with_sanity:
                planned += cases
            elif cases:
                planned += [sanity, *cases, sanity]
            elif sanity in self.selected and available(sanity):
                planned.append(sanity)
        return planned

    def restarts(self) -> str:
        """Return how often the implementation was restarted, and whether it is waited for; empty without a restart."""
        runner = self._runner
        if runner is None or not runner.restarts:
            return ""
        times = "once" if runner.restarts == 1 else f"{runner.restarts} times"
        return f"restarted {times}" + (", waiting for it to answer" if runner.restarting else "")

    # -- running -------------------------------------------------------------------------------------------------------

    def execute(self, on_revised: Callable[[CaseResult], None] | None = None) -> None:
        """Execute the run in this process.

        Every planned case has a result afterwards, unless a signal or ``max_fails`` ended the run; :attr:`trouble` is
        the reason if the run could not be completed. ``on_revised`` is called with each result that replaces an earlier
        one.
        """
        self.on_revised = on_revised
        planned = self.plan()
        if self.on_start is not None:
            self.on_start(len(planned))
        try:
            if not self.open():
                return
            rest = list(planned)
            if rest and rest[0].id == SANITY:
                result, _ = self.run_case(rest.pop(0))
                if self._absent() or self.stops(result):
                    return
            if self.side_by_side > 1 and self.repeat == 1 and self.max_fails != 1:
                rest = self._run_side_by_side(rest)
            for case in rest:
                result, _ = self.run_case(case)
                if self.stops(result):
                    return
            self.finish()
        except KeyboardInterrupt:
            self.interrupt(len(self.results), len(planned))
        except ConformanceError as error:
            self.trouble = str(error)
        except Exception as error:
            self._faulty(error)
        finally:
            with deferred():
                self.close()
        self.account(planned)

    def _run_side_by_side(self, planned: Sequence[Case]) -> list[Case]:
        """Execute cases side by side; return the planned cases without a pass, which must be executed alone."""
        from .concurrent import execute

        assert self._runner is not None
        passed: dict[str, CaseResult] = {}

        def on_result(case: Case, result: CaseResult) -> None:
            self._attempts[case.id] = 1
            passed[case.id] = result
            self.take(case, result)

        try:
            self.repeated_alone = execute(self._runner, self.cases[SANITY], planned, self.side_by_side, on_result)
        except ConformanceError:
            raise
        except Exception as error:
            # Keep the passes, and execute all other cases alone.
            self._faulty(error)
            self._notes.append(f"after it, {len(planned) - len(passed)} cases were executed one at a time")
        self._alone = len(self.repeated_alone.keys() - passed)
        return [case for case in planned if case.id not in passed]

    def _saved(self) -> list[str]:
        """Return notes on the cases that were executed side by side, or with a shorter beacon period."""
        found = []
        if beside := sum(result.side_by_side for result in self.results):
            found.append(
                f"{beside} cases passed while others were executed beside them, at most {self.side_by_side} at a time; "
                f"{self._alone} that did not pass were repeated alone, and have the verdict of the "
                "repetition"
            )
        if short := [result.short_period for result in self.results if result.short_period]:
            found.append(
                f"{len(short)} cases passed while the tester had set a beacon period of {short[0]:g} ms, which saves "
                "time; their verdicts do not depend on it. --side-by-side 1 keeps the configured period"
            )
        return found

    def _absent(self) -> bool:
        """Return whether the implementation does not take part from the beginning, so that nothing can be judged."""
        assert self._runner is not None
        if not (self.options.foreign and self._runner.dead):
            return False
        self._notes.append(f"nothing was tested on {self._runner.session.lower.name}: {self._runner.dead}")
        self._stopped = True
        return True

    def _faulty(self, error: Exception) -> None:
        """Record a fault of the tester. Earlier results are still reported."""
        self.trouble = self.trouble or f"a fault of the tester: {type(error).__name__}: {error}"
        self._notes.append("".join(traceback.format_exception(error)))

    def open(self) -> bool:
        """Open the connections to the implementation; return False if that fails (reason: :attr:`trouble`)."""
        try:
            runner = self._stack.enter_context(open_target(self.options)).runner
            self._runner = runner
            if not self.with_sanity:
                runner.rerun += f" -x {SANITY}"
            if isinstance(runner.session.upper, Checked):
                runner.session.upper.faults.report = self.on_wait
            runner.prepare()
            if self.options.foreign and self.options.start:
                runner.life.await_start(self.cases[SANITY], self.on_wait)
            if self.options.foreign and isinstance(runner.session.upper, Checked):
                runner.examine()
            if self.options.foreign:
                for text in runner.contradicted_claims(self.cases[SANITY]):
                    self.on_wait(text)
        except ConformanceError as error:
            self.trouble = str(error)
            self.usage = isinstance(error, UsageError)
            return False
        except Exception as error:
            self._faulty(error)
            return False
        return True

    def close(self) -> None:
        """Close all connections, end the implementation if the tester has started it, and add the passive results."""
        runner, self._runner = self._runner, None
        if runner is not None:
            try:
                self._sut = runner.about()
                self._notes += runner.notes
                options = {case.id: case.options for case in self.found_by_fuzzer.values()}
                self.take_passive(runner.session.passive.results(runner.rerun, options))
            except Exception as error:
                self._faulty(error)
        with contextlib.suppress(LowerTesterError, UpperTesterError):
            self._stack.close()

    def run_case(self, case: Case) -> tuple[CaseResult, str]:
        """Execute one case; return its result, and why it is unexpected (empty if it is expected)."""
        assert self._runner is not None
        attempt = self._attempts[case.id] = self._attempts.get(case.id, 0) + 1
        result = self._runner.run(case, attempt)
        for revised in self._runner.take_revised():
            self.revise(revised)
        return result, self.take(case, result)

    def finish(self) -> None:
        """Check after the last case that the implementation is alive; revise results if it is lost."""
        assert self._runner is not None
        try:
            self._runner.finish()
        except Exception as error:
            self._faulty(error)
        for revised in self._runner.take_revised():
            self.revise(revised)

    def take(self, case: Case, result: CaseResult) -> str:
        """Add a result of this process or of a worker; return why it is unexpected (empty if it is expected)."""
        if case.id == SANITY and (earlier := {each.verdict for each in self.results if each.id == SANITY}):
            # The repetition of the sanity case only checks that the implementation is alive: count a new failure.
            counted = result.verdict in (Verdict.FAIL, Verdict.ERROR) and result.verdict not in earlier
            result = msgspec.structs.replace(result, counted=counted)
        surprise = self._surprises[result.id, result.attempt] = self.expected.judge(case, result)
        self.results.append(result)
        if self._on_result is not None and (result.counted or result.verdict is Verdict.PASS):
            self._on_result(case, result, surprise)
        return surprise

    def take_passive(self, results: Iterable[CaseResult]) -> None:
        """Add the results of the passive rules, of this process or of all workers."""
        self.passive = [each for each in joined([*self.passive, *results]) if each.id not in self._without_sigint]
        for each in self.passive:
            self._surprises[each.id, 1] = self.expected.judge(self._invariants[each.id], each)

    def revise(self, result: CaseResult) -> None:
        """Replace an earlier result with the same identifier and attempt."""
        key = result.id, result.attempt
        for place, each in enumerate(self.results):
            if (each.id, each.attempt) == key:
                result = msgspec.structs.replace(result, counted=each.counted)
                self.results[place] = result
                break
        else:
            return
        case = self.cases[result.id]
        surprise = self._surprises[key] = self.expected.judge(case, result)
        if self._on_result is not None:
            self._on_result(case, result, surprise)
        if self.on_revised is not None:
            self.on_revised(result)

    def stops(self, result: CaseResult) -> bool:
        """Return whether the run ends after this result, because of ``max_fails``."""
        if self.max_fails and not self._stopped and result.verdict in (Verdict.FAIL, Verdict.ERROR):
            fails = len({each.id for each in self.results if each.verdict in (Verdict.FAIL, Verdict.ERROR)})
            self._stopped = fails >= self.max_fails
            if self._stopped and self.max_fails > 1:
                self._notes.append(f"ended after {fails} failed cases (--max-fails)")
        return self._stopped

    def interrupt(self, done: int, planned: int) -> None:
        """Record that a signal has ended the run, after ``done`` of ``planned`` executions."""
        self.interrupted = True
        self._notes.append(f"interrupted after {done} of {planned} cases")

    def account(self, planned: Sequence[Case]) -> None:
        """Add an ``error`` of the tester for each planned execution without a result."""
        if self.interrupted or self._stopped:
            return
        there = Counter(result.id for result in self.results)
        wanted = Counter(case.id for case in planned)
        for case in dict.fromkeys(planned):
            for attempt in range(there[case.id] + 1, wanted[case.id] + 1):
                self._add_lost(case, attempt)

    def _add_lost(self, case: Case, attempt: int) -> None:
        expected, observed = "the case has a result", self.trouble or "the tester has lost it"
        lost = Check(Verdict.ERROR, case.requirements, expected, observed)
        self.take(case, case.result([lost], attempt=attempt))

    # -- several workers -----------------------------------------------------------------------------------------------

    def end(self) -> WorkerEnd:
        """Return the last message of a worker that has executed its share."""
        passive = tuple(self.passive)
        return WorkerEnd(self._sut, tuple(self._notes), self.trouble, self.usage, passive, self._alone)

    def close_workers(self, ends: Sequence[WorkerEnd], workers: int, planned: Sequence[Case]) -> None:
        """Merge the last reports of all workers, add an error for each lost case, and sort the results."""
        self._sut = next((end.sut for end in ends if end.sut is not None), None)
        self._notes += dict.fromkeys(note for end in ends for note in end.notes)
        self._alone = sum(end.alone for end in ends)
        if workers > 1:
            self._notes.append(f"{workers} nodes were tested side by side, each with a share of the cases")
        for end in ends:
            if end.trouble and not self.trouble:
                self.trouble, self.usage = end.trouble, end.usage
        self.account(planned)
        self.take_passive(result for end in ends for result in end.passive)
        order = {case.id: number for number, case in enumerate(self.cases.values())}
        self.results.sort(key=lambda result: (result.id != SANITY, order[result.id], result.attempt))

    # -- results -------------------------------------------------------------------------------------------------------

    def complaints(self) -> list[str]:
        """Return messages on unexpected results, and on unused or expired entries of expected results."""
        today = datetime.datetime.now(datetime.UTC).date()
        ran = {result.id for result in self.results}
        selected = [case for case in self.selected if case.id in ran]
        selected += [self._invariants[result.id] for result in self.passive]
        unexpected = [f"{name}: {surprise}" for (name, _), surprise in self._surprises.items() if surprise]
        return [*dict.fromkeys(unexpected), *self.expected.complaints(selected, today)]

    def exit_status(self) -> int:
        """Return the documented exit status; signals precede trouble, unexpected results, and inconclusive ones."""
        if self.interrupted:
            return INTERRUPTED
        if self.trouble:
            return USAGE if self.usage else TESTER_ERROR
        return exit_status([*self.results, *self.passive], unexpected=bool(self.complaints()))

    def result(self) -> RunResult:
        """Return all results and notes of the run, also if it could not begin."""
        notes = [*self._notes, *self._saved(), *([self.trouble] if self.trouble else [])]
        if self.expected.entries:
            notes += self.complaints()
        found = [each for each in self.passive if each.verdict not in (Verdict.PASS, Verdict.NOT_APPLICABLE)]
        run = assemble(
            self.codec.profile,
            self.pics,
            [*self.results, *found],
            sut=self._sut,
            started=self._started,
            duration=time.monotonic() - self._began,
            command=self.command,
            notes=notes,
        )
        invariants = tuple(each for each in self.passive if each not in found)
        return msgspec.structs.replace(run, invariants=invariants, diagnosis=self._diagnosis())

    def _diagnosis(self) -> Diagnosis | None:
        """Return the faults that explain the failed cases; None if no case failed."""
        if not any(each.verdict is Verdict.FAIL for each in self.results):
            return None
        from dcp_conformance.diagnosis import explain, load

        return explain(self.results, load())
