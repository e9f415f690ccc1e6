"""Runs cases: preamble, body, postamble, verdict. Knows nothing of pytest, files or terminals."""

from __future__ import annotations

import shlex
import time
import traceback
from collections.abc import Iterable

from dcp_spec.parameters import parameters
from dcp_spec.requirements import requirements

from .applicability import why_not
from .bench import Bench, Session
from .case import Case
from .control import SutControl
from .errors import LowerTesterError, StopCase, UpperTesterError
from .node_id import node_id_octets
from .results import CaseResult, Check, EventRecord, Sut, Table
from .traffic import Event
from .verdict import Verdict

#: Questions without an answer after which an implementation is taken for dead.
_QUESTIONS = 4
#: Seconds that an implementation which has hung up may take to be seen dead.
DEATH_PATIENCE = 1.0
#: Seconds that an implementation may take until it answers after it was started.
START_PATIENCE = 30.0


class Runner:
    """Runs one case after the other against one implementation.

    A case that finds the implementation dead is named; with a command to restart it the run goes on.
    """

    def __init__(
        self, session: Session, control: SutControl | None = None, *, rerun: str = "dcp-conformance run"
    ) -> None:
        self.session = session
        self.control = control
        self.rerun = rerun
        self.notes: list[str] = []
        self._lived = control is not None
        """Whether there ever was a sign of life."""
        self.dead = ""
        """Why nothing can be run any more; empty while the implementation lives."""
        session.can_restart = control is not None and control.can_restart
        session.restart = control.restart if control is not None and control.can_restart else None

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

    # -- one case ----------------------------------------------------------------------------------------------

    def run(self, case: Case, attempt: int = 1) -> CaseResult:
        """Run one case. Whatever happens, there is a result; only ``KeyboardInterrupt`` and the like get through."""
        bench = Bench(self.session, case)
        begun = self.session.lower.now()
        reason = why_not(bench, case)
        if reason:
            check = Check(Verdict.NOT_APPLICABLE, case.requirements, reason)
            return self._result(case, bench, begun, attempt, [check])
        if self.dead:
            check = Check(Verdict.INCONCLUSIVE, case.requirements, "a living implementation", self.dead)
            return self._result(case, bench, begun, attempt, [check])
        detail = ""
        try:
            self._reset()
            if self._reset_mode() == "restart" and (why := self.await_answer(case)):
                # Whatever keeps it away is not what the case is about; the next one restarts it again.
                what = "the implementation is there after its restart"
                check = Check(Verdict.INCONCLUSIVE, case.requirements, what, why)
                return self._result(case, bench, begun, attempt, [check])
            bench.mark()
            bench.heard.clear()
            # What was lost, or looked at late, before the case is no excuse in it.
            self.session.lower.health()
            case.run(bench)
        except StopCase:
            pass
        except UpperTesterError as error:
            self._judge_silence(bench, error)
        except LowerTesterError as error:
            bench.checks.append(Check(Verdict.ERROR, case.requirements, "the link can be used", str(error)))
        except Exception as error:
            detail = "".join(traceback.format_exception(error))
            what = f"{type(error).__name__}: {error}"
            bench.checks.append(Check(Verdict.ERROR, case.requirements, "the case runs to its end", what))
        killed = self._look_after(case, bench)
        return self._result(case, bench, begun, attempt, bench.checks, killed=killed, detail=detail)

    def _judge_silence(self, bench: Bench, error: UpperTesterError) -> None:
        """The upper tester failed in a case. If the implementation is dead, that is looked at afterwards."""
        bench.checks.append(
            Check(Verdict.INCONCLUSIVE, bench.case.requirements, "the upper tester answers", str(error))
        )
        # A process closes its connections before it is gone.
        deadline = time.monotonic() + DEATH_PATIENCE
        while self.control is not None and self.control.alive() and time.monotonic() < deadline:
            time.sleep(0.02)

    def _look_after(self, case: Case, bench: Bench) -> bool:
        """See whether the implementation survived; whether it is dead now. Brings it back if that can be done."""
        suspicious = case.destructive or bench.verdict().rank > Verdict.PASS.rank
        control = self.control
        dead = control is not None and control.alive() is False
        mute = suspicious and not dead and not self._answers(bench)
        # One that was never there has not died here.
        self._lived = self._lived or bool(bench.heard)
        if not (dead or mute) or not self._lived:
            self._clean(bench)
            return False
        why = control.why_dead() if control is not None and dead else ""
        observed = "it is dead after this case" if dead else self._muteness(bench)
        table: Table = "robustness" if case.robustness else "conformance"
        bench.checks.append(
            Check(
                Verdict.FAIL,
                _broken_by_death(case),
                "the implementation survives",
                f"{observed}{f': {why}' if why else ''}{_last_sign(bench) if dead else ''}",
                table=table,
            )
        )
        self._revive(case, "died" if dead else "fell silent")
        return True

    def _answers(self, bench: Bench) -> bool:
        """Whether the implementation still takes part: what the sanity case asks. Only silence after several questions
        is silence, since frames get lost. When a case has left no variable to ask about, beacons have to do.
        """
        try:
            if bench.pics.vardis is False or not bench.has_unknown_ids():
                return any(bench.beacons(1, 5) for _ in range(_QUESTIONS)) or self._serves()
            return any(bench.probe(5) for _ in range(_QUESTIONS)) or (bench.pics.vardis is None and self._serves())
        except LowerTesterError:
            return False

    def _serves(self) -> bool:
        """Whether the upper tester answers."""
        upper = self.session.upper
        if upper is None or "UT-Hello" not in upper.methods:
            return False
        try:
            upper.call("UT-Hello", {})
        except UpperTesterError:
            return False
        self._lived = True
        return True

    def _muteness(self, bench: Bench) -> str:
        """What is left of an implementation that does not answer."""
        try:
            if bench.beacons(1, 5):
                return "VarDis does not answer any more, though there are beacons"
        except LowerTesterError:
            pass
        runs = self.control is not None and self.control.alive()
        return "it does not answer any more" + (", though its process runs" if runs else "")

    def _revive(self, case: Case, how: str) -> None:
        control = self.control
        if control is None or not control.can_restart:
            self.dead = f"the implementation {how} in {case.id}, and there is no command to restart it (--restart)"
            self.notes.append(self.dead)
            return
        try:
            control.restart()
        except Exception as error:
            self.dead = f"the implementation {how} in {case.id} and could not be restarted: {error}"
            self.notes.append(self.dead)
            return
        self.session.known.clear()
        self.session.summarised.clear()
        if why := self.await_answer(case):
            self.dead = f"the implementation {how} in {case.id}, was restarted, and {why}"
            self.notes.append(self.dead)
            return
        self.notes.append(f"the implementation {how} in {case.id} and was restarted")

    def await_answer(self, case: Case) -> str:
        """Wait until an implementation that was started answers: what is sent before that, it cannot hear.

        ``case``: the next one, or the last. Returns why there is nothing to wait for any more, empty if it answers.
        """
        if not self._lived:
            return ""
        # What it takes is no evidence of the case.
        bench, control = Bench(self.session, case), self.control
        deadline = bench.now() + round(START_PATIENCE * 1e9)
        while not self._answers(bench):
            bench.take_newcomer()
            if control is not None and control.alive() is False:
                return f"is dead again: {control.why_dead()}"
            if bench.now() >= deadline:
                return f"does not answer within {START_PATIENCE:g} s"
            try:
                bench.wait(1)
            except LowerTesterError as error:
                return f"cannot be reached: {error}"
        return ""

    def _clean(self, bench: Bench) -> None:
        """Without a way to reset, delete the variables that the case has made, so that summaries do not pile up."""
        made = bench.created | bench.produced
        if self._reset_mode() != "none" or not made or not bench.traffic.frames:
            return
        upper = self.session.upper
        try:
            if upper is not None and "RTDB-Delete" in upper.methods:
                for var_id in sorted(bench.produced):
                    upper.call("RTDB-Delete", {"varId": var_id})
            peer = bench.peer()
            peer.send_all(peer.delete(var_id) for var_id in sorted(made))
            bench.wait(1)
            if bench.features.removed_after_deletion:
                gone = bench.now() + (bench.parameter("VARDISPAR_MAX_REPETITIONS") + 4) * bench.period
                self.session.leaving.update(dict.fromkeys(made, gone))
        except (LowerTesterError, UpperTesterError):
            # What is wrong will show in the next case.
            return

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
            self.session.known.clear()
            self.session.summarised.clear()
        elif mode == "restart" and self.control is not None:
            self.control.restart()
            self.session.known.clear()
            self.session.summarised.clear()

    # -- the result --------------------------------------------------------------------------------------------

    def _result(
        self,
        case: Case,
        bench: Bench,
        begun: int,
        attempt: int,
        checks: Iterable[Check],
        *,
        killed: bool = False,
        detail: str = "",
    ) -> CaseResult:
        checks = tuple(checks)
        verdict = max((check.verdict for check in checks), key=lambda each: each.rank, default=Verdict.INCONCLUSIVE)
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
            requirements=case.requirements,
            verdict=verdict,
            reason=reason,
            stimulus=case.stimulus,
            expectation=case.expect,
            window=case.window,
            duration=(self.session.lower.now() - begun) / 1e9,
            table="robustness" if case.robustness else "conformance",
            checks=checks,
            readings=bench.readings,
            evidence=tuple(_event_record(event) for event in bench.traffic.events),
            left_out=bench.traffic.left_out,
            rerun=f"{self.rerun} {shlex.quote(case.id)}",
            killed=killed,
            attempt=attempt,
            error_detail=detail,
        )


def _last_sign(bench: Bench) -> str:
    """Behind which of its beacons an implementation died, as the end of a sentence; empty if that says nothing."""
    frames = [event for event in bench.traffic.events if event.number and event.direction in ("sent", "heard")]
    last = max((place for place, event in enumerate(frames) if event.direction == "heard"), default=len(frames))
    behind = frames[last + 1 :]
    return f"; its last beacon came before frame {behind[0].number} of {bench.traffic.frames}" if behind else ""


def _broken_by_death(case: Case) -> tuple[str, ...]:
    """The requirements of a case that a death violates: what is an implementation's own choice cannot be violated."""
    known = requirements()
    binding = tuple(each for each in case.requirements if each not in known or known[each].level != "optional")
    return binding or case.requirements


def _event_record(event: Event) -> EventRecord:
    text = event.text
    if event.data is not None:
        text = f"{text} {_short(event.data)}"
    return EventRecord(event.wall, event.direction, event.who, event.number, text, event.frame.hex(), event.start)


def _short(data: object) -> str:
    import msgspec

    text = msgspec.json.encode(data).decode()
    return text if len(text) <= 400 else f"{text[:400]}..."


def timestamp() -> str:
    """Now, ISO 8601 in UTC, to the second."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
