"""Execute single cases: preamble, body, postamble, verdict. The module uses neither pytest nor files or terminals."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import NamedTuple

import msgspec
from dcp_spec.parameters import parameters

from dcp_conformance.definitions.applicability import why_not
from dcp_conformance.definitions.case import SANITY, Case
from dcp_conformance.definitions.node_id import node_id_octets
from dcp_conformance.definitions.results import CaseResult, Check, Sut
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ContractError, NoAnswerError, UpperTesterError, UsageError
from dcp_conformance.impaired_link import MOST_EXECUTIONS as MOST_IMPAIRED
from dcp_conformance.interconnection.claims import contradictions, ignored
from dcp_conformance.interconnection.collision import collision
from dcp_conformance.interconnection.findings import Findings, prepare
from dcp_conformance.lower_tester import Impairs
from dcp_conformance.sut.control import SutControl
from dcp_conformance.sut.link import link_switch
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.test_system.services.requirements import unreached
from dcp_conformance.upper_tester import Checked
from dcp_conformance.upper_tester.base import INTERNAL_ERROR
from dcp_conformance.upper_tester.faults import Violation

from .body import delete_variables, recorded, run_body
from .case_results import doubted, result_of
from .remarks import deaths_alike, executed_again, left_changed, listed
from .survival.attribution import Attribution, Trial, attribute, blamed, came_back, kinds, with_failures_of
from .survival.life import Life
from .survival.readiness import Readiness

#: Maximum time in seconds between a case and the death that it causes, and maximum number of suspected cases.
SLOW_DEATH = 3.0
_SUSPECTS = 8
#: Cases that a remark names.
_NAMED = 3
DEACTIVATE = "BP-MGMT-Deactivate"
#: Number of cases with a confirmed death after which a death in the same way needs no second execution.
_KNOWN = 2
#: The expectation of cases that cannot be executed, because the implementation is lost.
_ALIVE = "the implementation is alive"
#: Maximum number of executions of a case that only lateness or lost frames of the tester leave undecided.
MOST_EXECUTIONS = 6
#: Number of further executions in which a failure must recur that lateness may explain.
CONFIRMATIONS = 2
#: Probability above which the declared loss of the link may have caused the same failure in each execution, which is to
#: be rare in a whole run; and the maximum number of recurrences that this takes.
_BY_LOSS, _MOST_CONFIRMATIONS = 1e-6, 12


class Done(NamedTuple):
    """An executed case."""

    trial: Trial
    result: CaseResult
    ended: int
    """Time of the lower tester's clock, ns."""


class Runner:
    """Executes cases in succession against one implementation.

    If the implementation is dead after a case, the case is repeated alone before the death is attributed to it
    (:mod:`dcp_conformance.execution.survival.attribution`), unless it is the first one since a start and several cases
    have confirmed deaths of this kind. With a command to restart the implementation the run continues.
    """

    def __init__(
        self,
        session: Session,
        control: SutControl | None = None,
        *,
        rerun: str = "dcp-conformance run",
        start_timeout: float | None = None,
    ) -> None:
        """``rerun``: the command of the run, without cases. ``start_timeout``: see :class:`Life`, in seconds."""
        self.session = session
        self.control = control
        self.rerun = rerun
        self.life = Life(session, control, start_timeout)
        self._readiness = Readiness(session)
        self._findings = Findings.of(session)
        self.remarks: list[str] = []
        """Notes for the results, without those on deaths."""
        self.dead = ""
        """Why no further case can be executed; empty while the implementation is alive."""
        self.deaths_side_by_side = 0
        """Number of times that the implementation was lost while cases were executed side by side."""
        self._deaths: dict[str, list[str]] = {}
        """Cases in which the implementation ended, by :attr:`dcp_conformance.execution.survival.life.Loss.group`."""
        self.just_started = False
        """Whether the implementation was restarted, and no case has been executed since."""
        self._recent: deque[Done] = deque(maxlen=_SUSPECTS)
        """The last cases since the start of the implementation."""
        self._revised: list[CaseResult] = []
        self._measured = 0
        """Number of measurements of the reaction time."""
        self._unsettled = False
        """Whether the last case has left a state that can affect later ones, or got an internal error as an answer."""
        self._not_restored: dict[str, str] = {}
        """Cases whose changes could not be undone, with the reason."""
        self._ignored: list[str] = []
        """Sentences on frames with its own identifier that the implementation reported at first."""
        self.restarts = 0
        """Number of restarts."""
        self.restarting = False
        """Whether a restart is in progress: the implementation has not answered yet."""
        self._renewals = 0
        """Number of restarts because identifiers were used up."""
        self._disturbed: dict[str, str] = {}
        """Cases that were executed again because of a disturbance of the tester, with the disturbance."""
        session.can_restart = control is not None and control.can_restart
        session.restart = control.restart if control is not None and control.can_restart else None
        session.switch_link = link_switch(control, session.pics.pixit)

    @property
    def notes(self) -> list[str]:
        """Notes on the run as a whole, for the results."""
        upper = self.session.upper
        found = [str(each) for each in upper.faults.found.values()] if isinstance(upper, Checked) else []
        found += self.remarks
        if self._not_restored and not self._restartable:
            found.append(left_changed(self._not_restored))
        if self._renewals:
            found.append(f"restarted {self._renewals} times, when all identifiers of variables had been used")
        if self._readiness.longest:
            found.append(
                f"UT-Reset returned up to {self._readiness.longest / 1e6:.0f} ms before VarDis and SRP were registered "
                "with BP; the tester waited for them"
            )
        if isinstance(self.session.lower, Impairs):
            found.append(self.session.lower.summary())
        elif self._disturbed:
            found.append(executed_again(self._disturbed))
        return found + [deaths_alike(how, cases) for how, cases in self._deaths.items()]

    def prepare(self) -> None:
        """Read node identifier and parameters of the implementation, and reset it.

        Raise ``UpperTesterError`` if the upper tester violates its contract.
        """
        session = self.session
        if session.pics.pixit.node_id is not None:
            session.sut_id = node_id_octets(session.pics.pixit.node_id)
        upper = session.upper
        if upper is None:
            return
        node_id = upper.about.get("nodeId")
        if session.sut_id is None and isinstance(node_id, str):
            try:
                told = node_id_octets(node_id)
            except ValueError as error:
                raise UpperTesterError(f"{upper.name}: the nodeId of UT-Hello: {error}") from None
            # An identifier of another size fits into no field of the profile; the sanity case judges its beacons.
            if session.codec.profile.types.node_id.width in (0, len(told)):
                session.sut_id = told
        if "UT-Status" in upper.methods:
            # UT-Reset may set its counters to zero.
            with suppress(UpperTesterError):
                self._ignored += ignored(upper.call("UT-Status", {}).result.get("drops"))
        self._first_reset()
        known = parameters()
        for method in ("BP-GetParameters", "SRP-GetParameters", "VD-GetParameters"):
            if method in upper.methods:
                try:
                    answer = upper.call(method, {})
                except (ContractError, NoAnswerError):
                    continue
                reported = answer.result.get("parameters")
                if answer.ok and isinstance(reported, dict):
                    session.parameters.update({name: value for name, value in reported.items() if name in known})

    def _first_reset(self) -> None:
        """Reset the implementation; if UT-Reset is not answered, do without it."""
        try:
            self._reset()
        except NoAnswerError as error:
            upper = self.session.upper
            if self.session.pics.pixit.reset != "auto" or not isinstance(upper, Checked):
                raise
            upper.methods -= {"UT-Reset"}
            upper.faults.unused.add("UT-Reset")
            upper.faults.add(Violation("UT-Reset", f"{error} The run continues without it", "Methods", usable=True))

    def examine(self) -> None:
        """Check before the first case whether the upper tester keeps to its contract; its faults are notes."""
        upper = self.session.upper
        if upper is None or "UT-Reset" not in upper.methods:
            return
        from dcp_conformance.upper_tester.examination import Examination

        try:
            Examination(upper, self.session.codec.profile, whole=self._restartable).walk()
        except UpperTesterError as error:
            self.remarks.append(f"the examination of the upper tester ended early: {error}")
        lost = isinstance(upper, Checked) and upper.faults.forgets_protocols
        if self._restartable and (lost or self.life.ended()):
            assert self.control is not None
            self.control.restart()
        self._reset()

    def contradicted_claims(self, case: Case) -> list[str]:
        """Listen for some beacons; return claims of the PICS that they contradict, and a sentence on ignored frames.

        Raise :class:`UsageError` if two nodes send with the identifier of the implementation.
        """
        session = self.session
        if why := collision(Bench(session, case)):
            raise UsageError(why)
        bench = Bench(session, case)
        with suppress(UpperTesterError):
            bench.beacons(5, 8)
        about = session.upper.about if session.upper is not None else {}
        found = list(contradictions(session.pics, bench, session.parameters, about))
        found += self._ignored
        self.remarks += found
        return found

    def about(self) -> Sut:
        """Return the description of the implementation for the results."""
        session, upper = self.session, self.session.upper
        about = upper.about if upper is not None else {}
        target = session.pics.sut
        return Sut(
            name=target.name or str(about.get("name", "")),
            version=target.version or str(about.get("version", "")),
            spec_version=str(about.get("specVersion", "")),
            node_id=session.sut_id.hex(":") if session.sut_id else "",
            link=session.lower.name,
            upper_tester=upper.name if upper is not None else "",
            methods=tuple(sorted(upper.methods)) if upper is not None else (),
        )

    # -- one case ------------------------------------------------------------------------------------------------------

    def run(self, case: Case, attempt: int = 1) -> CaseResult:
        """Execute one case and return its result. Only exceptions outside of ``Exception`` are propagated.

        Results of earlier cases may have changed: see :meth:`take_revised`. ``attempt`` counts repetitions from 1.
        """
        bench = Bench(self.session, case)
        reason = why_not(bench, case)
        if reason:
            return self._without_trial(case, bench, attempt, Verdict.NOT_APPLICABLE, reason)
        if self.dead:
            return self._without_trial(case, bench, attempt, Verdict.INCONCLUSIVE, _ALIVE, self.dead)
        try:
            result = self._run(case, attempt)
        except Exception as error:
            # A fault of the tester outside of the case body; the case gets a result all the same.
            what = f"{type(error).__name__}: {error}"
            expected = "the case runs without an internal error"
            result = self._without_trial(case, bench, attempt, Verdict.ERROR, expected, what)
            detail = "".join(traceback.format_exception(error))
            result = msgspec.structs.replace(result, error_detail=detail)
        return result

    def why_not(self, case: Case) -> str:
        """Return why the case is not applicable to the implementation; empty if it is applicable."""
        return why_not(Bench(self.session, case), case)

    def take_revised(self) -> list[CaseResult]:
        """Return and clear the revised results of earlier cases; each replaces that with its identifier and attempt."""
        revised, self._revised = self._revised, []
        return revised

    def _run(self, case: Case, attempt: int) -> CaseResult:
        if self._unsettled and self._restartable:
            # The state after the last case could affect this one.
            self._recent.clear()
            if why := self._restart_sut(case):
                # This case did not cause the failed restart.
                self.dead = f"the implementation was restarted after the case before {case.id}; {why}"
                self.remarks.append(self.dead)
                bench = Bench(self.session, case)
                return self._without_trial(case, bench, attempt, Verdict.INCONCLUSIVE, _ALIVE, self.dead)
        self._unsettled = False
        self.session.renewable = (
            self._restartable and self._reset_mode() == "none" and self.session.pics.pixit.reset != "none"
        )
        trial = self._trial(case)
        if trial.used_up and self.session.renewable:
            trial = self._trial_after_restart(trial)
        trial, executions = self._undisturbed(trial)
        trial, further = self._confirmed(trial)
        executions += further
        if trial.loss is not None and not self._restartable:
            self._wait_for(trial)
        if trial.loss is None:
            result = self._result(trial, attempt, trial.checks, executions=executions)
            if self._reset_mode() != "restart":
                self.remember(trial, result, self.session.lower.now())
            self._refuse(case, trial)
            return result
        result = msgspec.structs.replace(self._judge_loss(trial, attempt), executions=executions)
        self._revive(case, trial)
        return result

    def _wait_for(self, trial: Trial) -> None:
        """Wait until a silent implementation that cannot be restarted answers again: its loss would end the run."""
        loss = trial.loss
        if loss is None or loss.died or loss.upper_only:
            return
        begun = self.session.lower.now()
        if not self.life.await_answer(trial.case):
            trial.checks = list(came_back(trial, (self.session.lower.now() - begun) / 1e9))
            trial.loss = None

    def _undisturbed(self, trial: Trial) -> tuple[Trial, int]:
        """Execute a case again as long as only disturbances of the tester leave it undecided.

        Return the execution that counts, and the number of executions. The last one counts, except that a fail is not
        replaced by a later execution without a fail.
        """
        executions = 1
        most = MOST_IMPAIRED if isinstance(self.session.lower, Impairs) else MOST_EXECUTIONS
        while executions < most and trial.disturbed:
            self._disturbed.setdefault(trial.case.id, trial.bench.verdicts.disturbed)
            again = self._trial(trial.case)
            executions += 1
            if again.used_up:
                break
            if trial.verdict is Verdict.FAIL and again.verdict is not Verdict.FAIL and again.loss is None:
                break
            trial = again
        return trial, executions

    def _confirmed(self, trial: Trial) -> tuple[Trial, int]:
        """Execute a case again that failed because something was missing that may only be late.

        The failure counts if it recurs in each execution, and is inconclusive otherwise. Return the execution that
        counts, and the number of further executions.
        """
        if trial.verdict is not Verdict.FAIL or trial.loss is not None:
            return trial, 0
        losses, why, executions, recurred = trial.bench.losses, trial.bench.verdicts.may_be_late, 0, 0
        # With the declared loss and many stimuli, some may be lost in each execution.
        counts = range(CONFIRMATIONS, _MOST_CONFIRMATIONS + 1)
        needed = next((count for count in counts if losses.chance ** (1 + count) < _BY_LOSS), None)
        while why and recurred < (needed or CONFIRMATIONS):
            with self._provisionally():
                again = self._trial(trial.case)
                if again.used_up and self.session.renewable:
                    again = self._trial_after_restart(again)
            executions += 1
            if again.loss is not None:
                return again, executions
            if trial.failed & again.failed:
                recurred += 1
            elif again.verdict is Verdict.PASS and losses.declared:
                # Without the lost frame, the case passes.
                return again, executions
            elif not again.disturbed or executions >= max(MOST_EXECUTIONS, 2 * (needed or 0)):
                # An execution that the tester's own lateness leaves undecided shows nothing.
                trial.checks = [doubted(each, executions, why) for each in trial.checks]
                break
        if why and needed is None:
            trial.checks = [each.excused(f"{losses.declared}, which may explain it") for each in trial.checks]
        return trial, executions

    def _trial_after_restart(self, trial: Trial) -> Trial:
        """Execute a case again that has used up all identifiers, after a restart of the implementation."""
        self._recent.clear()
        if why := self._restart_sut(trial.case):
            what = "the implementation answers after its restart"
            trial.checks.append(Check(Verdict.INCONCLUSIVE, trial.case.requirements, what, why))
            return trial
        self._renewals += 1
        self.session.renewable = False
        return self._trial(trial.case, fresh=True)

    def finish(self) -> None:
        """Check the implementation after the last case: one of the last cases may have ended it.

        Their results may change: see :meth:`take_revised`.
        """
        if self.dead or not self._recent:
            return
        last = self._recent.pop()
        trial = last.trial
        bench = Bench(self.session, trial.case)
        self.life.await_end(bench)
        trial.loss = self.life.loss(bench, ask=True)
        if trial.loss is not None and not self._restartable:
            self._wait_for(trial)
        if trial.loss is None:
            return
        result = self._judge_loss(trial, last.result.attempt)
        self._revised.append(msgspec.structs.replace(result, executions=last.result.executions))

    def _needs_no_confirmation(self, trial: Trial) -> bool:
        """Return whether no other case can be the cause of a loss, and several had the same in two executions each."""
        loss = trial.loss
        if loss is None or loss.doubtful or loss.upper_only or not trial.first:
            return False
        return len(self._deaths.get(loss.group, ())) >= _KNOWN

    def _judge_loss(self, trial: Trial, attempt: int) -> CaseResult:
        """Attribute a loss to a case; return the result of the case after which the loss was found."""
        assert trial.loss is not None
        suspects = [each for each in self._recent if trial.begun - each.ended <= SLOW_DEATH * 1e9]
        self._recent.clear()
        if self._needs_no_confirmation(trial):
            found = Attribution(trial, blamed(trial), killed=True)
        else:
            again = self._again if self._restartable else None
            found = attribute(trial, [each.trial.case for each in suspects], again)
        result = self._result(found.trial, attempt, found.checks, killed=found.killed)
        if found.killed:
            self._count_death(trial)
            result = msgspec.structs.replace(result, death=trial.loss.group)
        if found.earlier is not None:
            self._blame_earlier(found.earlier, suspects)
        if found.note:
            self.remarks.append(found.note)
        return result

    def _trial(self, case: Case, *, fresh: bool = False) -> Trial:
        """Execute a case once, and check the implementation. ``fresh``: whether it is in its initial state already."""
        bench = Bench(self.session, case)
        # The applicability of the case may depend on assumptions: let the bench record them.
        why_not(bench, case)
        trial = Trial(case, bench, self.session.lower.now(), bench.verdicts.checks, first=self.just_started)
        self.just_started = False
        with recorded(trial):
            # Before the reset, which removes the variables that the measurement creates.
            self._measure()
            if not fresh:
                self._reset(case)
            if not fresh and self._may_not_receive(case) and (why := self.life.await_answer(case)):
                # This case did not cause the failed restart; the next case restarts again.
                what = "the implementation answers after its restart or reset"
                bench.verdicts.checks.append(Check(Verdict.INCONCLUSIVE, case.requirements, what, why))
                return trial
            self.session.passive.begin(self.session.lower.now(), bench.traffic, case.id)
            with self._believed(trial):
                run_body(trial)
        self._note_hang_up(trial)
        trial.paused = any(event.text == DEACTIVATE for event in bench.traffic.events)
        # Silence after the last stimulus, or a call that did not arrive, leaves a doubt, whatever the verdict.
        doubt = case.destructive or trial.verdict.rank > Verdict.PASS.rank or bench.steps.silent
        doubt = doubt or unreached(bench.traffic.events)
        if not self.life.ended() and not self.life.upper_tester_error:
            doubt = not self._clean(trial) or doubt
        doubt = doubt and not trial.used_up
        self._unsettled = self._reset_mode() != "restart" and _reports_internal_error(bench)
        # The sanity case itself has probed the implementation: if it failed, another probe adds no evidence.
        ask = doubt and (case.id != SANITY or trial.verdict is Verdict.PASS)
        trial.loss = self.life.loss(bench, ask=ask)
        if trial.loss is None and bench.restoration.restore_failure and self._reset_mode() == "none":
            self._unsettled = True
            self._not_restored.setdefault(case.id, bench.restoration.restore_failure)
        return trial

    @contextmanager
    def _believed(self, trial: Trial) -> Iterator[None]:
        """Leave failures undecided if a message of the upper tester could not be used in the block."""
        upper = self.session.upper
        before = upper.faults.unusable if isinstance(upper, Checked) else 0
        try:
            yield
        finally:
            if isinstance(upper, Checked) and upper.faults.unusable > before:
                why = "a message of the adapter broke the contract of the upper tester in this case"
                for place, check in enumerate(trial.checks):
                    if check.verdict is Verdict.FAIL:
                        trial.checks[place] = msgspec.structs.replace(check.excused(why), shown=False)

    @contextmanager
    def _provisionally(self) -> Iterator[None]:
        """Execute cases in the block of which only a pass, or the end of the implementation, counts."""
        self.session.provisional = True
        try:
            yield
        finally:
            self.session.provisional = False

    def _measure(self) -> None:
        """Measure the reaction time before the first case, and a second time once the implementation has answered."""
        if self._measured == 0 or (self._measured == 1 and self.life.has_answered):
            self._measured += 1
            if prepare(self.session):
                self.remarks.extend(self._findings.notes(self.session.pics.pixit))

    def _refuse(self, case: Case, trial: Trial) -> None:
        """Make all further cases inconclusive if the sanity case has found no sign of the implementation."""
        if case.id != SANITY:
            return
        passed = trial.verdict is Verdict.PASS
        self.life.learn(trial.bench, answered=passed and trial.bench.sut.pics.vardis is not False)
        contact = self._findings.contact
        # With wrong settings of the tester, received frames cannot be judged.
        heard = trial.bench.heard and not (contact is not None and contact.mistaken)
        if passed or heard or self.life.serves():
            return
        reason = next((check.observed for check in trial.checks if check.verdict is trial.verdict), "")
        self.dead = f"the implementation does not take part: {reason}"

    # -- for cases that are executed side by side ----------------------------------------------------------------------

    def initial_state(self, case: Case, *, used: bool) -> str:
        """Bring the implementation into its initial state, as far as the tester can; return why that failed, or "".

        ``case`` is the case of the probes. ``used``: whether all identifiers have been used up, so that a restart is
        worth its time if no other reset exists.
        """
        self._recent.clear()
        mode = self._reset_mode()
        if mode == "ut":
            return self._reset_by_service(case)
        restarts = self._restartable and self.session.pics.pixit.reset != "none"
        return self._restart_sut(case) if mode == "restart" or (used and restarts) else ""

    def _reset_by_service(self, case: Case) -> str:
        try:
            self._reset(case)
        except UpperTesterError as error:
            self.life.upper_tester_error = str(error)
            return f"UT-Reset failed: {error}"
        return ""

    def settle(self, case: Case) -> None:
        """Restart the implementation if the last case may have left a state that affects ``case``."""
        if self._unsettled and self._restartable:
            self._recent.clear()
            if why := self._restart_sut(case):
                self.dead = f"the implementation was restarted before {case.id}; {why}"
                self.remarks.append(self.dead)

    def attempt(self, case: Case) -> CaseResult | None:
        """Execute a case alone; return its result if it is an undisturbed pass, otherwise None: it must be repeated.

        An implementation that has died is restarted if possible. The case has its result if it ends it a second time.
        """
        if self.dead or self._unsettled:
            return None
        with self._provisionally():
            trial = self._trial(case)
        if trial.loss is not None:
            self._recent.clear()
            if not self._restartable:
                self._wait_for(trial)
                return None
            if self._needs_no_confirmation(trial):
                return self._killed(trial)
            if self._restart_sut(case) or not trial.loss.died:
                return None
            result = self.tried_alone(case)
            return result if result is not None and result.killed else None
        if (
            trial.verdict is not Verdict.PASS
            or trial.bench.restoration.restore_failure
            or trial.disturbed
            or trial.upper_tester_error
        ):
            return None
        result = self._result(trial, 1, trial.checks)
        self.remember(trial, result, self.session.lower.now())
        return result

    def tried_alone(self, case: Case) -> CaseResult | None:
        """Execute a case alone in which the implementation may have ended while others were executed beside it.

        Return its result if it passes, or if the implementation ends again, which confirms the first end; otherwise
        None. An implementation that has ended is restarted.
        """
        if self.dead:
            return None
        with self._provisionally():
            trial = self._trial(case)
        if trial.loss is None:
            good = trial.verdict is Verdict.PASS and not trial.bench.restoration.restore_failure
            return self._result(trial, 1, trial.checks) if good and not trial.disturbed else None
        self._recent.clear()
        if trial.loss.died:
            return self._killed(trial)
        self._revive(case, trial)
        return None

    def _killed(self, trial: Trial) -> CaseResult:
        """Return the result of a case that has ended the implementation, and start it again."""
        assert trial.loss is not None
        self._count_death(trial)
        result = self._result(trial, 1, blamed(trial), killed=True)
        self._revive(trial.case, trial)
        return msgspec.structs.replace(result, death=trial.loss.group)

    def remember(self, trial: Trial, result: CaseResult, ended: int) -> None:
        """Remember a case that the implementation survived and that ended at ``ended`` (ns).

        It may cause a later death. Its valid frames are not the cause of a death in a later case that also calls
        services.
        """
        self._recent.append(Done(trial, result, ended))
        sent = (each for each in trial.bench.traffic.events if each.direction == "sent")
        found = {kinds(self.session.codec, each) for each in sent}
        self.session.survived |= {each for each in found if each is not None}

    def check_life(self, case: Case, during: Sequence[str]) -> str:
        """Check whether the implementation is alive, and restart it if it is not.

        ``during`` has the cases that were executed when a doubt arose. Return why no further case can be executed side
        by side, or an empty text.
        """
        bench = Bench(self.session, case)
        loss = self.life.loss(bench, ask=True)
        if loss is None:
            return ""
        self.deaths_side_by_side += 1
        many = "1 case was" if len(during) == 1 else f"{len(during)} cases were"
        text = f"while {many} executed side by side ({listed(during, _NAMED)}), the implementation {loss.summary}"
        self.remarks.append(f"{text}. These cases were executed again")
        if not self._restartable:
            self.dead = f"{text}. There is no command to restart it (--restart)"
            return self.dead
        if why := self._restart_sut(case):
            self.dead = f"{text}; {why}"
            self.remarks.append(self.dead)
            return self.dead
        return ""

    # -- deaths --------------------------------------------------------------------------------------------------------

    @property
    def _restartable(self) -> bool:
        return self.control is not None and self.control.can_restart

    def _again(self, cases: Sequence[Case]) -> Trial | str:
        """Restart, execute cases in succession, and wait for a slow death; see ``attribution.Again``."""
        if why := self._restart_sut(cases[0]):
            return why
        for number, case in enumerate(cases):
            trial = self._trial(case, fresh=number == 0)
            if trial.loss is not None:
                return trial
        self.life.await_end(trial.bench)
        trial.loss = self.life.loss(trial.bench, ask=True)
        # The checks of the only case may count in place of those of its first execution.
        return trial if len(cases) > 1 else self._confirmed(trial)[0]

    def _restart_sut(self, case: Case) -> str:
        """Restart the implementation and wait until it answers; return why that failed, or an empty text."""
        assert self.control is not None
        self.restarts += 1
        self.restarting = True
        try:
            self.control.restart()
        except Exception as error:
            return f"it could not be restarted: {error}"
        self.session.forget()
        if self.session.short_period is not None:
            self.session.short_period.forget()
        self._unsettled = False
        if why := self.life.await_answer(case):
            return f"after a restart it {why}"
        self.just_started, self.restarting = True, False
        return ""

    def _revive(self, case: Case, trial: Trial) -> None:
        """Restart the implementation for the next case, or set :attr:`dead` if that is impossible."""
        assert trial.loss is not None
        if not self._restartable:
            lost = f"the implementation {trial.loss.how} in {case.id}"
            self.dead = f"{lost}, and there is no command to restart it (--restart)"
        elif why := self._restart_sut(case):
            self.dead = f"the implementation {trial.loss.how} in {case.id}; {why}"
        if self.dead:
            self.remarks.append(self.dead)

    def _count_death(self, trial: Trial) -> None:
        assert trial.loss is not None
        if trial.paused:
            # Later cases deactivate BP only if they are about deactivation.
            self.session.pausing_fails = True
        if self._restartable and not trial.loss.upper_only:
            self._deaths.setdefault(trial.loss.group, []).append(trial.case.id)

    def _blame_earlier(self, trial: Trial, suspects: Sequence[Done]) -> None:
        """Revise the result of an earlier case that ended the implementation when it was executed alone."""
        assert trial.loss is not None
        self._count_death(trial)
        old = next(each.result for each in suspects if each.trial.case is trial.case)
        checks = with_failures_of(blamed(trial), old.checks)
        revised = self._result(trial, old.attempt, checks, killed=True, executions=old.executions)
        self._revised.append(msgspec.structs.replace(revised, death=trial.loss.group))

    # -- before and after a case ---------------------------------------------------------------------------------------

    def _clean(self, trial: Trial) -> bool:
        """Delete the variables of the case if the implementation cannot be reset; return False if that failed."""
        if self._reset_mode() != "none":
            return True
        deleted = delete_variables(trial, self.life.serves)
        self._note_hang_up(trial)
        return deleted

    def _note_hang_up(self, trial: Trial) -> None:
        if trial.upper_tester_error:
            self.life.upper_tester_error = trial.upper_tester_error

    def _reset_mode(self) -> str:
        mode = self.session.pics.pixit.reset
        upper = self.session.upper
        if mode == "auto":
            return "ut" if upper is not None and "UT-Reset" in upper.methods else "none"
        return mode

    def _may_not_receive(self, case: Case) -> bool:
        """Return whether an answer shows only now that the implementation receives again after its reset.

        A case that it may not survive would pass if its frames were lost.
        """
        mode = self._reset_mode()
        return mode == "restart" or (mode == "ut" and case.destructive and not self._readiness.known)

    def _reset(self, case: Case | None = None) -> None:
        """Bring the implementation into its initial state; before ``case``, wait until it can receive."""
        mode = self._reset_mode()
        if mode == "ut" and self.session.upper is not None:
            self.session.upper.call("UT-Reset", {})
            self.session.forget()
            if self.session.short_period is not None:
                self.session.short_period.renew()
            self._restore_parameters()
            if case is not None:
                self._readiness.wait(case)
                if self._readiness.lost and not self._restartable:
                    self.dead = "UT-Reset did not restore VarDis, and there is no command to restart the implementation"
                    raise UpperTesterError(self.dead)
        elif mode == "restart" and self.control is not None:
            self.control.restart()
            self.session.forget()

    def _restore_parameters(self) -> None:
        """Set parameters to their initial values, if UT-Reset does not do so."""
        upper = self.session.upper
        if not isinstance(upper, Checked) or not upper.faults.forgets_parameters:
            return
        for protocol in ("BP", "SRP", "VD"):
            if not {f"{protocol}-GetParameters", f"{protocol}-SetParameter"} <= upper.methods:
                continue
            now = upper.call(f"{protocol}-GetParameters", {}).result.get("parameters", {})
            for name, value in now.items():
                if (initial := self.session.parameters.get(name, value)) != value:
                    upper.call(f"{protocol}-SetParameter", {"name": name, "value": initial})

    # -- the result ----------------------------------------------------------------------------------------------------

    def _without_trial(
        self, case: Case, bench: Bench, attempt: int, verdict: Verdict, expected: str, observed: str = ""
    ) -> CaseResult:
        trial = Trial(case, bench, self.session.lower.now())
        return self._result(trial, attempt, [Check(verdict, case.requirements, expected, observed)])

    def _result(
        self, trial: Trial, attempt: int, checks: Iterable[Check], *, killed: bool = False, executions: int = 1
    ) -> CaseResult:
        ended = self.session.lower.now()
        return result_of(trial, checks, ended, self.rerun, attempt=attempt, killed=killed, executions=executions)


def _reports_internal_error(bench: Bench) -> bool:
    """Return whether a service answered with an internal error, whose cause may persist."""
    answers = (event.data for event in bench.traffic.events if event.direction == "answer")
    return any(isinstance(data, dict) and data.get("code") == INTERNAL_ERROR for data in answers)
