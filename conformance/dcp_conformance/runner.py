"""Runs cases: preamble, body, postamble, verdict. Knows nothing of pytest, files or terminals."""

from __future__ import annotations

import shlex
import traceback
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import msgspec
from dcp_spec.parameters import parameters

from .applicability import in_force, why_not
from .attribution import Trial, attribute, blamed, likely_stimulus
from .bench import Bench, Session
from .case import SANITY, Case
from .control import SutControl
from .errors import CouldNotAskError, LowerTesterError, NamesUsedUp, StopCase, UpperTesterError
from .life import Life
from .link import link_switch
from .node_id import node_id_octets
from .reaction import prepare
from .results import CaseResult, Check, EventRecord, Sut
from .session import FLOOR
from .traffic import Event
from .verdict import Verdict, worst

#: Cases that a note names of those that ended the life of the implementation in the same way.
_NAMED = 6
#: Seconds that an implementation may take to die of a case that is over, and cases that are suspected then.
SLOW_DEATH = 3.0
_SUSPECTS = 8
DEACTIVATE = "BP-MGMT-Deactivate"
#: The code of JSON-RPC for a fault of the implementation.
_INTERNAL_ERROR = -32603


class _Done(NamedTuple):
    """A case that was run, with the time of its end in ns."""

    trial: Trial
    result: CaseResult
    ended: int


class Runner:
    """Runs one case after the other against one implementation.

    A case after which the implementation is dead is run again alone before it is blamed (:mod:`.attribution`); with a
    command to restart the implementation the run goes on.
    """

    def __init__(
        self, session: Session, control: SutControl | None = None, *, rerun: str = "dcp-conformance run"
    ) -> None:
        self.session = session
        self.control = control
        self.rerun = rerun
        self.life = Life(session, control)
        self.remarks: list[str] = []
        """What the reader of the results should know, beside deaths."""
        self.dead = ""
        """Why nothing can be run any more; empty while the implementation lives."""
        self._deaths: dict[str, list[str]] = {}
        """Cases by how the implementation ended."""
        self._recent: deque[_Done] = deque(maxlen=_SUSPECTS)
        """The last cases in this life of the implementation."""
        self._revised: list[CaseResult] = []
        self._measured = 0
        """How often the reaction time was measured."""
        self._unsettled = False
        """The upper tester has reported an internal error in the last case."""
        self._renewals = 0
        """Restarts because identifiers were used up."""
        session.can_restart = control is not None and control.can_restart
        session.restart = control.restart if control is not None and control.can_restart else None
        session.switch_link = link_switch(control, session.pics.pixit)

    @property
    def notes(self) -> list[str]:
        """What the reader of the results should know of the run as a whole."""
        renewed = [f"restarted {self._renewals} times, when all identifiers of variables had been used"]
        deaths = [_told(how, cases) for how, cases in self._deaths.items()]
        return [*self.remarks, *(renewed if self._renewals else ()), *deaths]

    def prepare(self) -> None:
        """Find out about the implementation. Raises ``UpperTesterError`` if it does not keep to the contract."""
        session = self.session
        if session.pics.pixit.node_id is not None:
            session.sut_id = node_id_octets(session.pics.pixit.node_id)
        upper = session.upper
        if upper is None:
            return
        node_id = upper.about.get("nodeId")
        if session.sut_id is None and isinstance(node_id, str):
            try:
                session.sut_id = node_id_octets(node_id)
            except ValueError as error:
                raise UpperTesterError(f"{upper.name}: the nodeId of UT-Hello: {error}") from None
        self._reset()
        known = parameters()
        for method in ("BP-GetParameters", "SRP-GetParameters", "VD-GetParameters"):
            if method in upper.methods:
                answer = upper.call(method, {})
                told = answer.result.get("parameters")
                if answer.ok and isinstance(told, dict):
                    session.parameters.update({name: value for name, value in told.items() if name in known})

    def about(self) -> Sut:
        """The implementation, for the results."""
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
        """Run one case. Whatever happens, there is a result; only ``KeyboardInterrupt`` and the like get through.

        The result of the case before may have changed: see :meth:`take_revised`.
        """
        bench = Bench(self.session, case)
        reason = why_not(bench, case)
        if reason:
            return self._without_trial(case, bench, attempt, Verdict.NOT_APPLICABLE, reason)
        if self.dead:
            return self._without_trial(case, bench, attempt, Verdict.INCONCLUSIVE, "a living implementation", self.dead)
        try:
            result = self._run(case, attempt)
        except Exception as error:
            # A fault of this module: the case still has a result.
            what = f"{type(error).__name__}: {error}"
            result = self._without_trial(case, bench, attempt, Verdict.ERROR, "the case runs to its end", what)
            detail = "".join(traceback.format_exception(error))
            result = msgspec.structs.replace(result, error_detail=detail)
        return result

    def take_revised(self) -> list[CaseResult]:
        """Results of earlier cases that were found to be wrong since; each replaces the one with its id and attempt."""
        revised, self._revised = self._revised, []
        return revised

    def _run(self, case: Case, attempt: int) -> CaseResult:
        if self._unsettled and self._restartable:
            # What its upper tester reported may spoil every case from now on.
            self._recent.clear()
            self._start_afresh(case)
        self._unsettled = False
        self.session.renewable = (
            self._restartable and self._reset_mode() == "none" and self.session.pics.pixit.reset != "none"
        )
        trial = self._trial(case)
        if trial.used_up and self.session.renewable:
            trial = self._trial_after_restart(trial)
        if trial.loss is None:
            result = self._result(trial, attempt, trial.checks)
            if self._reset_mode() != "restart":
                self._recent.append(_Done(trial, result, self.session.lower.now()))
            self._refuse(case, trial)
            return result
        result = self._judge_loss(trial, attempt)
        self._revive(case, trial)
        return result

    def _trial_after_restart(self, trial: Trial) -> Trial:
        """Run a case again that found all identifiers used up, in the initial state of the implementation."""
        self._recent.clear()
        if why := self._start_afresh(trial.case):
            what = "the implementation is there after its restart"
            trial.checks.append(Check(Verdict.INCONCLUSIVE, trial.case.requirements, what, why))
            return trial
        self._renewals += 1
        self.session.renewable = False
        return self._trial(trial.case, fresh=True)

    def finish(self) -> None:
        """Look after the implementation for the last time: it may be dying of one of the last cases.

        Their results may have changed: see :meth:`take_revised`.
        """
        if self.dead or not self._recent:
            return
        last = self._recent.pop()
        trial = last.trial
        bench = Bench(self.session, trial.case)
        self.life.await_end(bench)
        trial.loss = self.life.loss(bench, ask=True)
        if trial.loss is None:
            return
        self._revised.append(self._judge_loss(trial, last.result.attempt))

    def _judge_loss(self, trial: Trial, attempt: int) -> CaseResult:
        """The result of a case after which the implementation was found dead."""
        assert trial.loss is not None
        suspects = [each for each in self._recent if trial.begun - each.ended <= SLOW_DEATH * 1e9]
        self._recent.clear()
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
        """Run a case once, and look after the implementation. ``fresh``: it is in its initial state already."""
        bench = Bench(self.session, case)
        # What it takes for the case to apply may itself be an assumption, which the bench then knows.
        why_not(bench, case)
        trial = Trial(case, bench, self.session.lower.now(), bench.checks)
        try:
            if not fresh:
                self._reset()
            if not fresh and self._reset_mode() == "restart" and (why := self.life.await_answer(case)):
                # Whatever keeps it away is not what the case is about; the next one restarts it again.
                bench.checks.append(
                    Check(Verdict.INCONCLUSIVE, case.requirements, "the implementation is there after its restart", why)
                )
                return trial
            self._measure()
            bench.mark()
            bench.heard.clear()
            self.session.passive.begin(self.session.lower.now(), bench.traffic)
            # What was lost, or looked at late, before the case is no excuse in it.
            self.session.lower.health()
            try:
                case.run(bench)
            finally:
                bench.restore()
        except NamesUsedUp:
            trial.used_up = True
        except StopCase:
            pass
        except CouldNotAskError as error:
            what = "the upper tester can ask the implementation"
            bench.checks.append(Check(Verdict.INCONCLUSIVE, case.requirements, what, f"it could not: {error}"))
        except UpperTesterError as error:
            self.life.hung_up = str(error)
            bench.checks.append(Check(Verdict.INCONCLUSIVE, case.requirements, "the upper tester answers", str(error)))
        except LowerTesterError as error:
            bench.checks.append(Check(Verdict.ERROR, case.requirements, "the link can be used", str(error)))
        except Exception as error:
            trial.detail = "".join(traceback.format_exception(error))
            what = f"{type(error).__name__}: {error}"
            bench.checks.append(Check(Verdict.ERROR, case.requirements, "the case runs to its end", what))
        trial.paused = any(event.text == DEACTIVATE for event in bench.traffic.events)
        trial.stimulus = likely_stimulus(case, bench.traffic)
        # Silence after the last stimulus is no sign of life, whatever the verdict.
        doubt = case.destructive or trial.verdict.rank > Verdict.PASS.rank or bench.silent
        if not self.life.ended() and not self.life.hung_up:
            doubt = not self._clean(bench) or doubt
        # The sanity case has asked already.
        doubt = doubt and not trial.used_up
        self._unsettled = self._reset_mode() != "restart" and _reports_internal_error(bench)
        ask = doubt and (case.id != SANITY or trial.verdict is Verdict.PASS)
        trial.loss = self.life.loss(bench, ask=ask)
        return trial

    def _measure(self) -> None:
        """Find out how fast the implementation reacts; once more if it only began to answer later."""
        if self._measured == 0 or (self._measured == 1 and self.life.has_answered):
            self._measured += 1
            found = prepare(self.session)
            told = self.session.pics.pixit.reaction_periods is not None
            if found is not None and not told and (found.periods > FLOOR or found.per_payload):
                self.remarks.append(f"reactions are waited for {found}; pixit.reaction_periods overrides this")
            self.remarks.extend(each for each in self._deviations() if each not in self.remarks)

    def _deviations(self) -> Iterator[str]:
        """What was found at the start and has consequences in many cases."""
        if lost := self.session.lost_container:
            yield (
                f"it loses the {lost} of two containers in a payload (VD-RX-04): what is missing in cases about other "
                "requirements that send such payloads is inconclusive"
            )
        for text in self.session.misread.values():
            yield f"{text}: what follows from that in other cases is inconclusive"

    def _refuse(self, case: Case, trial: Trial) -> None:
        """End the run if the sanity case has found that there is nothing to test."""
        if case.id != SANITY:
            return
        passed = trial.verdict is Verdict.PASS
        self.life.learn(trial.bench, answered=passed and trial.bench.pics.vardis is not False)
        contact = self.session.contact
        # Of what is heard through wrong settings nothing can be judged.
        heard = trial.bench.heard and not (contact is not None and contact.mistaken)
        if passed or heard or self.life.serves():
            return
        reason = next((check.observed for check in trial.checks if check.verdict is trial.verdict), "")
        self.dead = f"the implementation does not take part: {reason}"

    # -- deaths --------------------------------------------------------------------------------------------------------

    @property
    def _restartable(self) -> bool:
        return self.control is not None and self.control.can_restart

    def _again(self, cases: Sequence[Case]) -> Trial | str:
        """Run cases from a fresh start, and wait for a slow death after the last."""
        if why := self._start_afresh(cases[0]):
            return why
        for number, case in enumerate(cases):
            trial = self._trial(case, fresh=number == 0)
            if trial.loss is not None:
                return trial
        self.life.await_end(trial.bench)
        trial.loss = self.life.loss(trial.bench, ask=True)
        return trial

    def _start_afresh(self, case: Case) -> str:
        """Restart the implementation and wait until it answers; why it cannot be had back, empty if it is there."""
        assert self.control is not None
        try:
            self.control.restart()
        except Exception as error:
            return f"it could not be restarted: {error}"
        self._forget()
        if why := self.life.await_answer(case):
            return f"after a restart it {why}"
        return ""

    def _revive(self, case: Case, trial: Trial) -> None:
        """Have the implementation back for the next case."""
        assert trial.loss is not None
        if not self._restartable:
            lost = f"the implementation {trial.loss.how} in {case.id}"
            self.dead = f"{lost}, and there is no command to restart it (--restart)"
        elif why := self._start_afresh(case):
            self.dead = f"the implementation {trial.loss.how} in {case.id}; {why}"
        if self.dead:
            self.remarks.append(self.dead)

    def _count_death(self, trial: Trial) -> None:
        assert trial.loss is not None
        if trial.paused:
            # Cases about other things have another way than deactivating BP.
            self.session.pausing_fails = True
        if self._restartable and not trial.loss.upper_only:
            self._deaths.setdefault(trial.loss.group, []).append(trial.case.id)

    def _blame_earlier(self, trial: Trial, suspects: Sequence[_Done]) -> None:
        """Revise the result of an earlier case, which ended the implementation when it was run alone."""
        assert trial.loss is not None
        self._count_death(trial)
        old = next(each.result for each in suspects if each.trial.case is trial.case)
        revised = self._result(trial, old.attempt, (blamed(trial)[0], *old.checks), killed=True)
        self._revised.append(msgspec.structs.replace(revised, death=trial.loss.group))

    # -- before and after a case ---------------------------------------------------------------------------------------

    def _clean(self, bench: Bench) -> bool:
        """Without a way to reset, delete the variables that the case has made, so that summaries do not pile up.

        Returns whether nothing went wrong.
        """
        made = bench.created | bench.produced
        if self._reset_mode() != "none" or not made or not (bench.traffic.frames or bench.produced):
            return True
        upper = self.session.upper
        try:
            if upper is not None and "RTDB-Delete" in upper.methods:
                for var_id in sorted(bench.produced):
                    upper.call("RTDB-Delete", {"varId": var_id})
            peer = bench.peer()
            peer.send_all(peer.delete(var_id) for var_id in sorted(made))
            bench.wait(1)
            for var_id in made:
                self.session.identifiers.deleted(var_id, bench.departure())
        except UpperTesterError as error:
            self.life.hung_up = str(error)
            return False
        except LowerTesterError:
            return False
        return True

    def _reset_mode(self) -> str:
        mode = self.session.pics.pixit.reset
        upper = self.session.upper
        if mode == "auto":
            return "ut" if upper is not None and "UT-Reset" in upper.methods else "none"
        return mode

    def _reset(self) -> None:
        mode = self._reset_mode()
        if mode == "ut" and self.session.upper is not None:
            self.session.upper.call("UT-Reset", {})
            self._forget()
        elif mode == "restart" and self.control is not None:
            self.control.restart()
            self._forget()

    def _forget(self) -> None:
        """The implementation is in its initial state again."""
        self.session.forget()

    # -- the result ----------------------------------------------------------------------------------------------------

    def _without_trial(
        self, case: Case, bench: Bench, attempt: int, verdict: Verdict, expected: str, observed: str = ""
    ) -> CaseResult:
        trial = Trial(case, bench, self.session.lower.now())
        return self._result(trial, attempt, [Check(verdict, case.requirements, expected, observed)])

    def _result(self, trial: Trial, attempt: int, checks: Iterable[Check], *, killed: bool = False) -> CaseResult:
        case, bench, checks = trial.case, trial.bench, tuple(checks)
        verdict = worst(check.verdict for check in checks) or Verdict.INCONCLUSIVE
        decisive = next((check for check in checks if check.verdict is verdict), None)
        reason = ""
        if decisive is None:
            reason = "the case has looked at nothing"
        elif verdict is Verdict.NOT_APPLICABLE:
            reason = decisive.expected
        elif verdict is not Verdict.PASS:
            reason = f"{decisive.expected}: {decisive.observed}" if decisive.observed else decisive.expected
        return CaseResult(
            id=case.id,
            purpose=case.purpose,
            section=case.section,
            kind=str(case.kind),
            requirements=in_force(case.requirements, bench.profile.spec_version),
            verdict=verdict,
            reason=reason,
            stimulus=case.stimulus,
            expectation=case.expect,
            window=case.window,
            duration=(self.session.lower.now() - trial.begun) / 1e9,
            table="robustness" if case.robustness else "conformance",
            checks=checks,
            readings=bench.readings,
            evidence=tuple(_event_record(event) for event in bench.traffic.events),
            left_out=bench.traffic.left_out,
            rerun=f"{self.rerun} {shlex.join([*case.options, case.id])}",
            killed=killed,
            attempt=attempt,
            error_detail=trial.detail,
        )


def _told(how: str, cases: Sequence[str]) -> str:
    """Deaths that look alike, in one sentence."""
    kind, _, cause = how.partition(": ")
    if len(cases) == 1:
        return f"the implementation {kind} in {cases[0]} and was restarted"
    listed = ", ".join(cases[:_NAMED]) + (f" and {len(cases) - _NAMED} more" if len(cases) > _NAMED else "")
    return f"the implementation {kind} in {len(cases)} cases in the same way ({cause}): {listed}; restarted each time"


def _reports_internal_error(bench: Bench) -> bool:
    """Whether a service of the implementation failed for a reason of its own, which may last."""
    answers = (event.data for event in bench.traffic.events if event.direction == "answer")
    return any(isinstance(data, dict) and data.get("code") == _INTERNAL_ERROR for data in answers)


def _event_record(event: Event) -> EventRecord:
    text = event.text
    if event.data is not None:
        text = f"{text} {_short(event.data)}"
    return EventRecord(event.wall, event.direction, event.who, event.number, text, event.frame.hex(), event.start)


def _short(data: object) -> str:
    import msgspec

    text = msgspec.json.encode(data).decode()
    return text if len(text) <= 400 else f"{text[:400]}..."
