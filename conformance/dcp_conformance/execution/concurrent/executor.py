"""Execute cases side by side: choose the concurrent cases, and process their results."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

from dcp_conformance.definitions.applicability import why_not
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.case_times import load
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.body import delete_variables, recorded, run_body
from dcp_conformance.execution.case_results import result_of
from dcp_conformance.execution.runner import SLOW_DEATH, Done, Runner
from dcp_conformance.execution.survival.attribution import Trial
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.interconnection.findings import stands
from dcp_conformance.lower_tester import Arrival
from dcp_conformance.passive import SIDE_BY_SIDE
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.services.requirements import unreached

from .scheduler import Scheduler, Task
from .shared import SharedLink, SharedSession, SharedUpper
from .sharing import at_short_period, group, why_alone
from .short_period import ShortPeriod

#: Default of the maximum number of concurrent cases.
WIDTH: Final = 16
#: Maximum number of concurrent cases in the repetition of cases that did not pass beside more.
_FEW: Final = 4
#: Interval in ns at which the executor checks the implementation's process.
_LOOK: Final = 200_000_000
#: Maximum number of waves in which a case finds all identifiers used up by others, before it is executed alone.
_ATTEMPTS: Final = 4
#: Number of successive cases without a pass after which the implementation is probed.
_DOUBTFUL: Final = 6
#: Maximum number of cases that are tried alone to find the one that ended the implementation, and maximum number of
#: waves in which a case is in execution when the implementation ends, before it is executed alone.
_TRIED, _MET = 16, 3
#: Number of passes after which twice as many cases are executed at a time, up to the usual number.
_CALM: Final = 24
#: Time in ns before the last frame of the implementation in which it may have received a lethal frame.
_BEFORE: Final = 20_000_000


def execute(
    runner: Runner,
    sanity: Case,
    cases: Iterable[Case],
    width: int,
    on_result: Callable[[Case, CaseResult], None],
) -> dict[str, str]:
    """Execute the cases side by side that allow it. ``on_result`` is called with each case that passes and its result.

    If the upper tester can shorten the beacon period, it is short for all cases whose verdict does not depend on it,
    also for those that are executed alone.

    ``sanity`` is the case of the probes of the implementation; it must have been executed. ``width`` is the maximum
    number of concurrent cases. Return the cases that must be repeated alone, each with the reason.
    """
    executor = SideBySide(runner, sanity, width)
    applicable = [case for case in cases if case.id != sanity.id and not runner.why_not(case)]
    rest = [case for case in applicable if not case.destructive]
    short = ShortPeriod(runner.session, sanity)
    if short.begin(lambda: runner.initial_state(sanity, used=False)):
        executor.short = short
        quick = [case for case in rest if at_short_period(case)]
        try:
            _together(executor, quick, on_result)
            for case in quick:
                if not (case.id in executor.reasons or why_alone(case)):
                    continue
                # After a death, too: with the configured period the rest would take several times as long.
                runner.settle(case)
                short.resume(lambda: runner.initial_state(sanity, used=False))
                if runner.session.short_period is short:
                    result = runner.attempt(case)
                    if result is not None:
                        on_result(case, result)
        finally:
            executor.short = None
            short.end()
        rest = [case for case in rest if case not in quick]
    _together(executor, rest, on_result)
    if runner.session.can_restart:
        _together(executor, [case for case in applicable if case.destructive], on_result)
    return executor.reasons


def _together(executor: SideBySide, cases: Sequence[Case], on_result: Callable[[Case, CaseResult], None]) -> None:
    """Execute the cases side by side that allow it, one family after another."""
    families: dict[str, list[Case]] = {}
    for case in cases:
        if not why_alone(case):
            families.setdefault(case.family, []).append(case)
    for each in families.values():
        executor.run(each, on_result)
        executor.run_again(on_result)


class SideBySide:
    """Executes cases side by side against the implementation of a runner.

    Only undisturbed passes become results. All other cases must be executed alone (:attr:`left`).
    """

    def __init__(self, runner: Runner, sanity: Case, width: int = WIDTH) -> None:
        """``sanity``: the case of the probes of the implementation. ``width``: maximum number of concurrent cases."""
        self._runner = runner
        self._sanity = sanity
        self._session = runner.session
        self.width = width
        """Maximum number of concurrent cases: less after deaths whose cause was not found, until many have passed."""
        self._usual = width
        self._calm = 0
        """Number of passes since the last change of the width."""
        self._waiting: deque[Case] = deque()
        """Waiting cases that need VarDis, and so identifiers of variables."""
        self._light: deque[Case] = deque()
        """Waiting cases that need hardly any identifiers: they are started while a wave ends."""
        self._live: dict[str, Bench] = {}
        """The benches of the cases in execution, by case."""
        self.left: list[Case] = []
        """The cases without an undisturbed pass, in the order in which they ended."""
        self._crowded: list[Case] = []
        """The cases in :attr:`left` that may pass beside fewer others."""
        self.reasons: dict[str, str] = {}
        """By case: the reason for its repetition alone."""
        self._used_up_in: Counter[str] = Counter()
        """By case: the number of waves in which it found all identifiers used up."""
        self._draining = False
        """Whether no further case is started in this wave."""
        self._doubtful = False
        """Whether the implementation may have been lost in this wave."""
        self._suspects: list[str] = []
        """The cases in execution when that became doubtful."""
        self.short: ShortPeriod | None = None
        """The short beacon period that is set again after a restart."""
        self._met: Counter[str] = Counter()
        """By case: the number of waves in which it was in execution when the implementation ended."""
        self._hung_up: list[Bench] = []
        """The benches of the cases of this wave that lost the upper tester, in the order in which they ended."""
        self._resets = 0
        """Number of times that the implementation could not be brought into its initial state."""
        self._used_up = False
        """Whether a case of this wave has found all identifiers used up."""
        self._doubts = 0
        """Number of successive cases without a pass."""
        self._passed: list[Done] = []
        """The passes of the last seconds, not reported yet: their cases may still cause a death."""
        self._last = self._last_wall = 0
        """Time in ns of the last frame of the implementation, on the clock of the link and since 1970."""
        self._observer = Bench(self._session, sanity)
        self._frames = 0

    def run(self, cases: Sequence[Case], on_result: Callable[[Case, CaseResult], None]) -> None:
        """Execute the cases. ``on_result`` is called with each case that passes and its result.

        Exceptions such as ``KeyboardInterrupt`` are raised after all cases have undone their changes.
        """
        # Start with the longest: a long case that starts late would run without others.
        times = load()
        for case in sorted(cases, key=lambda case: -times.of(case.id)):
            (self._waiting if "vardis" in case.needs.entities else self._light).append(case)
        try:
            while self._waiting or self._light:
                self._wave(on_result)
        finally:
            for each in self._passed:
                on_result(each.trial.case, each.result)
                self._runner.remember(each.trial, each.result, each.ended)
            self._passed.clear()

    def run_again(self, on_result: Callable[[Case, CaseResult], None]) -> None:
        """Repeat the cases of the last runs that may have failed because of the load, with fewer concurrent cases."""
        again = [case for case in self._crowded if case.id in self.reasons]
        self._crowded.clear()
        if not again or self._runner.dead:
            return
        self.left = [case for case in self.left if case not in again]
        before = self.width, self._usual
        self.width = self._usual = min(self.width, _FEW)
        try:
            self.run(again, on_result)
        finally:
            self.width, self._usual = before
            self._crowded.clear()

    def _wave(self, on_result: Callable[[Case, CaseResult], None]) -> None:
        """Execute cases from one initial state of the implementation, until identifiers are used up or it is lost."""
        session = self._session
        if why := self._runner.initial_state(self._sanity, used=self._used_up):
            self._resets += 1
            # The implementation may have died after the last case: check_life() restarts it then.
            gone = self._runner.check_life(self._sanity, [case.id for case in self.left[-self.width :]])
            if gone or self._resets > _ATTEMPTS:
                self._give_up(gone or why)
            return
        self._runner.just_started = False
        scheduler = Scheduler(session.lower, session.upper, self._account)
        session.identifier_pool.in_use = self._in_use
        session.passive.begin_side_by_side(session.lower.now())
        self._draining = self._used_up = self._doubtful = False
        self._doubts = 0
        self._suspects = []
        self._hung_up = []
        ended: list[tuple[Case, Trial]] = []
        cut_off: list[Bench] = []
        looked = session.lower.now()
        try:
            while True:
                while len(scheduler.tasks) < self.width and (case := self._next()) is not None:
                    self._start(scheduler, case, ended)
                if not scheduler.tasks:
                    break
                scheduler.step(session.lower.now() + _LOOK)
                for case, trial in ended:
                    self._end(case, trial)
                ended.clear()
                self._confirm(on_result)
                if self._doubtful or session.lower.now() - looked >= _LOOK:
                    looked = session.lower.now()
                    if self._runner.life.ended():
                        self._doubtful = True
                        self._suspects = self._suspects or list(self._live)
                        # The other cases would wait for nothing.
                        cut_off = list(self._live.values())
                        scheduler.abandon("the implementation has ended")
                        break
        finally:
            scheduler.close()
            session.identifier_pool.in_use = frozenset
            session.passive.interrupted(session.lower.now())
            self._live.clear()
        if not cut_off:
            for case, trial in ended:
                self._end(case, trial)
        if cut_off or (self._hung_up and self._runner.life.ended()):
            self._after_death([*self._hung_up, *cut_off], on_result)
            return
        self.left += [bench.case for bench in self._hung_up]
        if self._silent() and not self._doubtful:
            self._doubtful = True
            self._suspects = [each.trial.case.id for each in self._passed]
        deaths = self._runner.deaths_side_by_side
        if self._doubtful and (why := self._runner.check_life(self._sanity, self._suspects)):
            self._give_up(why)
        if self._runner.deaths_side_by_side > deaths:
            self._withhold()

    def _after_death(self, cut_off: Sequence[Bench], on_result: Callable[[Case, CaseResult], None]) -> None:
        """Restart the implementation, find the case that ended it, and put the others back.

        ``cut_off``: the benches of the cases that were in execution, or lost the upper tester.
        """
        runner = self._runner
        if why := runner.check_life(self._sanity, self._suspects):
            self._requeue([bench.case for bench in cut_off])
            self._withhold()
            self._give_up(why)
            return
        tried: set[str] = set()
        killer: Case | None = None
        for case in self._candidates(cut_off)[:_TRIED]:
            tried.add(case.id)
            found = self._try(case, on_result)
            if found is not None and found.killed:
                killer = case
                break
        if killer is not None:
            # Variants of a case have the same stimulus: do not let them meet others.
            base = killer.base
            alike = [case for case in (*self._waiting, *self._light) if case.base == base]
            alike += [bench.case for bench in cut_off if bench.case.base == base and bench.case.id not in tried]
            for case in alike:
                for queue in (self._waiting, self._light):
                    if case in queue:
                        queue.remove(case)
                tried.add(case.id)
                self._try(case, on_result)
        else:
            self._withhold()
            self.width, self._calm = max(_FEW, self.width // 2), 0
        self._requeue([bench.case for bench in cut_off if bench.case.id not in tried])
        self._resume()

    def _resume(self) -> None:
        """Set the short beacon period again after a restart, if it is used."""
        if self.short is not None:
            self.short.resume(lambda: self._runner.initial_state(self._sanity, used=False))

    def _candidates(self, cut_off: Sequence[Bench]) -> list[Case]:
        """Return the cases that may have ended the implementation, the most likely one first.

        It is a case with a stimulus after the last frame of the implementation, probably the last or an unanswered one.
        """
        found: list[tuple[bool, bool, int, Case]] = []
        for bench in cut_off:
            stimuli = [each for each in bench.traffic.events if each.direction in ("sent", "call")]
            if stimuli and stimuli[-1].wall >= self._last_wall - _BEFORE:
                pending = bench is self._pending()
                found.append((pending, bench.case.kind is Kind.INVALID, stimuli[-1].wall, bench.case))
        ranked = [case for *_, case in sorted(found, key=lambda each: each[:3], reverse=True)]
        recent = [each.trial.case for each in self._passed if each.ended >= self._last]
        return [*ranked, *reversed(recent)]

    def _pending(self) -> Bench | None:
        """Return the bench of the case in whose call the connection was lost."""
        first = self._hung_up[0] if self._hung_up else None
        return first if first is not None and first.traffic.events[-1].direction == "call" else None

    def _try(self, case: Case, on_result: Callable[[Case, CaseResult], None]) -> CaseResult | None:
        """Execute a case alone, and report its result if it passes or ends the implementation."""
        self._resume()
        result = self._runner.tried_alone(case)
        self._passed = [each for each in self._passed if each.trial.case is not case]
        if result is None:
            if case not in self.left:
                self.left.append(case)
            self.reasons[case.id] = "the implementation ended while it was executed beside others"
            return None
        self.left = [each for each in self.left if each is not case]
        self.reasons.pop(case.id, None)
        on_result(case, result)
        return result

    def _requeue(self, cases: Sequence[Case]) -> None:
        """Put cases back that were in execution when the implementation ended; after some waves leave them."""
        for case in reversed(cases):
            self._met[case.id] += 1
            if self._met[case.id] >= _MET:
                self.left.append(case)
                self.reasons[case.id] = "the implementation ended several times while it was executed beside others"
            else:
                (self._waiting if "vardis" in case.needs.entities else self._light).appendleft(case)

    def _silent(self) -> bool:
        """Return whether the implementation has sent no frame since one of the last passes."""
        return any(each.trial.bench.steps.silent and each.ended >= self._last for each in self._passed)

    def _confirm(self, on_result: Callable[[Case, CaseResult], None]) -> None:
        """Report the passes that the implementation has survived: it sent frames after the time of a slow death."""
        settled = self._session.lower.now() - round(SLOW_DEATH * 1e9)
        for each in self._passed:
            if each.ended <= settled and each.ended < self._last:
                on_result(each.trial.case, each.result)
        self._passed = [each for each in self._passed if each.ended > settled or each.ended >= self._last]

    def _withhold(self) -> None:
        """Leave the cases that passed shortly before a loss of the implementation to be executed alone."""
        for each in self._passed:
            self.left.append(each.trial.case)
            self.reasons[each.trial.case.id] = "the implementation was lost shortly after it"
        self._passed.clear()

    def _next(self) -> Case | None:
        """Remove and return the next case of this wave; None if no further case may start now."""
        if self._doubtful:
            return None
        if not self._draining and (case := self._take_from(self._waiting)) is not None:
            return case
        # While the wave ends, start cases that need no identifiers, but do not delay the next wave by them.
        heavy = any("vardis" in bench.case.needs.entities for bench in self._live.values())
        return self._take_from(self._light) if heavy or not self._waiting else None

    def _take_from(self, queue: deque[Case]) -> Case | None:
        """Remove and return the first case of a queue whose group has no case in execution; None without any."""
        busy = {group(bench.case) for bench in self._live.values()} - {""}
        for place, case in enumerate(queue):
            if group(case) not in busy:
                del queue[place]
                return case
        return None

    def _start(self, scheduler: Scheduler, case: Case, ended: list[tuple[Case, Trial]]) -> None:
        def body(task: Task) -> None:
            ended.append((case, self._execute(scheduler, task, case)))

        scheduler.start(body)

    def _execute(self, scheduler: Scheduler, task: Task, case: Case) -> Trial:
        base = self._session
        upper = SharedUpper(scheduler, task, base.upper) if base.upper is not None else None
        session = SharedSession(base, SharedLink(scheduler, task), upper)
        bench = Bench(session, case)
        why_not(bench, case)
        trial = Trial(case, bench, base.lower.now(), bench.verdicts.checks)
        self._live[case.id] = bench
        base.passive.enter(case.id)
        try:
            with recorded(trial):
                run_body(trial)
            if not trial.upper_tester_error:
                delete_variables(trial, lambda: True)
        finally:
            base.passive.leave(case.id)
            del self._live[case.id]
        # Start no further case before it is known whether the implementation has ended.
        self._doubtful = self._doubtful or bool(trial.upper_tester_error)
        return trial

    def _end(self, case: Case, trial: Trial) -> None:
        """Process the outcome of a case: keep a pass, put the case back, or leave it to be executed alone."""
        session = self._session
        if trial.used_up and self._used_up_in[case.id] < _ATTEMPTS:
            # The next wave begins with all identifiers.
            self._used_up_in[case.id] += 1
            self._waiting.appendleft(case)
            self._draining = self._used_up = True
            return
        reached = not trial.upper_tester_error and not unreached(trial.bench.traffic.events)
        passed = trial.verdict is Verdict.PASS and reached and not trial.bench.restoration.restore_failure
        if passed:
            self._doubts = 0
            self._calm += 1
            if self._calm >= _CALM:
                self.width, self._calm = min(2 * self.width, self._usual), 0
            self.reasons.pop(case.id, None)
        final = trial.verdict is Verdict.INCONCLUSIVE and reached and not trial.disturbed
        # No repetition can decide an inconclusive case that stands.
        if passed or (final and stands(session, case, trial.checks)):
            result = result_of(trial, trial.checks, session.lower.now(), self._runner.rerun, side_by_side=True)
            self._passed.append(Done(trial, result, session.lower.now()))
            return
        self.reasons[case.id] = _reason(trial)
        if trial.upper_tester_error:
            # If the implementation has ended, this case was only cut off.
            self._hung_up.append(trial.bench)
        else:
            self.left.append(case)
        if trial.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE) and not trial.upper_tester_error:
            self._crowded.append(case)
        self._doubts += 1
        if trial.upper_tester_error or self._doubts >= _DOUBTFUL:
            # The implementation may be dead. It can be probed only when no other case is executed.
            self._draining = self._doubtful = True
            self._suspects = self._suspects or [case.id, *self._live]

    def _account(self, arrival: Arrival) -> None:
        """Add a frame to the session's traffic, once for all cases."""
        session, observer = self._session, self._observer
        heard = ReceivedBeacon(session.codec, 0, arrival.time, arrival.wall, arrival.octets, arrival.source)
        if observer.receiver.is_sut(heard):
            self._frames += 1
            self._last, self._last_wall = arrival.time, arrival.wall
            heard.number = self._frames
            session.heard(heard, arrival, SIDE_BY_SIDE, None, observer.identifiers.departure())

    def _in_use(self) -> Iterator[int]:
        for bench in self._live.values():
            yield from bench.identifiers.created
            yield from bench.identifiers.called_unknown

    def _give_up(self, why: str) -> None:
        """Leave all remaining cases to be executed alone."""
        for queue in (self._waiting, self._light):
            for case in queue:
                self.reasons.setdefault(case.id, why)
            self.left.extend(queue)
            queue.clear()


def _reason(trial: Trial) -> str:
    decisive = next((check for check in trial.checks if check.verdict is trial.verdict), None)
    return f"{trial.verdict} side by side" + (f": {decisive.text}" if decisive is not None else "")
