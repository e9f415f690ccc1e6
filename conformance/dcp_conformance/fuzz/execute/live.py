"""An implementation on the air, or in process behind the same bench, as a target.

Before steps it is reset or restarted, and has to be healthy (:mod:`dcp_conformance.fuzz.execute.liveness`); after them
it has to be alive.
"""

from __future__ import annotations

import time
from typing import Final

from dcp_codec.errors import DecodeError
from dcp_conformance.errors import ConformanceError, LowerTesterError, UpperTesterError, UsageError
from dcp_conformance.execution.life import DEATH_PATIENCE
from dcp_conformance.execution.target import Target as Opened
from dcp_conformance.frames.received import var_id_of
from dcp_conformance.fuzz.steps import ROBUSTNESS, Call, Effect, Frame, Step, Wait
from dcp_conformance.model.case import Case, Kind
from dcp_conformance.oracle import Limits
from dcp_conformance.sut.control import SutControl
from dcp_conformance.test_system.bench import Bench, Session

from .differential import Comparison
from .liveness import PROBES, ailing, begun_again, dead, last_number
from .model_monitor import Observer, bad_beacon

#: Frames in a second unless a rate is given: more than peers of a crowd send, less than what makes links drop.
RATE: Final = 500.0
#: Seconds that an implementation may take until it answers after its restart.
PATIENCE: Final = 30.0
#: Seconds that one may take which may have been started a moment ago, before it is restarted.
_FIRST: Final = 10.0
#: Seconds that an upper tester may stay away which nobody is known to have restarted.
_RECONNECT: Final = 10.0
_PAUSE: Final = 0.1
#: Damaged frames of a test in which variables are looked for.
_LOOKED_INTO: Final = 200
#: Frames that may be sent without a look at what came.
_UNHEARD: Final = 64


class UnhealthyError(ConformanceError):
    """The implementation did not live before anything was sent to it, or does not live any more."""


class LiveTarget:
    """Carries out steps on an implementation that was opened with ``open_target``."""

    def __init__(
        self,
        opened: Opened,
        *,
        rate: float = RATE,
        differential: bool = False,
        probes: int = PROBES,
    ) -> None:
        """``rate``: frames in a second. ``differential``: compare with the model after the steps."""
        self._runner = opened.runner
        self.session: Session = opened.runner.session
        self.control: SutControl | None = opened.runner.control
        self.name = opened.runner.about().name or self.session.lower.name
        self._interval = round(1_000_000_000 / rate)
        self._differential = differential
        self._probes = probes
        self._checked = False
        self._was_well = False
        self._number: int | None = None
        """The sequence number of the last beacon that was heard."""
        self._spoilt = False
        """Whether the last steps have left an effect behind."""
        self.observer: Observer | None = None
        """What watched the last steps, in differential mode."""
        self.frames = 0
        self.restarts = 0

    def run(self, steps: list[Step]) -> Effect | None:
        """See :class:`~dcp_conformance.fuzz.steps.Target`. Raises :class:`UnhealthyError`, ``LowerTesterError``."""
        bench = self.prepare()
        self.session.lower.health()
        comparison = self._comparison(bench)
        effect = carry_out(bench, steps, self.control, self._interval, self._probes, comparison)
        # The bench has the numbers of this test only; in between nothing has begun anew that is known of.
        effect = effect or begun_again(bench, self._number)
        number = last_number(bench)
        # What comes after an effect may have begun anew without being another one.
        self._number = None if effect is not None else self._number if number is None else number
        self.frames += sum(isinstance(step, Frame) for step in steps)
        # The next steps need a healthy implementation; after an effect that has to be shown first.
        self._checked = effect is None
        self._spoilt = effect is not None
        return effect

    def run_afresh(self, steps: list[Step]) -> Effect | None:
        """As :meth:`run`, after a restart: nothing that was sent before has a part in it."""
        self._spoilt = True
        return self.run(steps)

    def prepare(self) -> Bench:
        """Bring the implementation to where it begins, alive and answering; the bench for what comes next.

        Raises :class:`UnhealthyError`, ``LowerTesterError``.
        """
        bench = Bench(self.session, _case("a sequence of the fuzzer"))
        if self._needs_restart():
            self._restart()
        else:
            self._reset()
        bench.waiting.wait_ns(0)
        bench.heard.clear()
        if not self._checked:
            self._require_health(bench)
            self._checked, self._spoilt = True, False
        return bench

    def _needs_restart(self) -> bool:
        control = self.control
        if control is None:
            return False
        if control.alive() is False:
            if control.can_restart:
                return True
            raise UnhealthyError(
                f"the implementation is dead, and there is no command to restart it: {control.why_dead()}"
            )
        # After an effect without death nothing else surely brings it back to where it began; and the model knows
        # nothing of what rounds before have left.
        return control.can_restart and (self._spoilt or (self._differential and not self._can_reset))

    @property
    def _can_reset(self) -> bool:
        upper = self.session.upper
        return upper is not None and "UT-Reset" in upper.methods

    def _restart(self) -> None:
        """Restart it; its upper tester may need some time to be there again."""
        assert self.control is not None
        self.restarts += 1
        self._checked = False
        try:
            self.control.restart()
        except UpperTesterError:
            self._reconnect(PATIENCE)
        except ConformanceError as error:
            raise UnhealthyError(f"the implementation cannot be restarted: {error}") from None
        self._forget()

    def _reset(self) -> None:
        """Reset it by its upper tester, which may have gone away with an implementation that somebody restarts."""
        upper = self.session.upper
        if upper is None or not self._can_reset:
            if self._differential:
                raise UsageError(
                    "each comparison begins at an implementation that knows nothing: give an upper tester with "
                    "UT-Reset (--ut), or a command that restarts it (--restart, or --start)"
                )
            return
        try:
            try:
                upper.call("UT-Reset", {})
            except UpperTesterError:
                self._checked = False
                self._reconnect(_RECONNECT)
                upper.call("UT-Reset", {})
        except UpperTesterError as error:
            if self.control is None or not self.control.can_restart:
                raise UnhealthyError(f"the implementation cannot be reset: {error}") from None
            self._restart()
        self._forget()

    def _reconnect(self, patience: float) -> None:
        """Open the connection to the upper tester again. Raises ``UpperTesterError`` when it stays away."""
        again = getattr(self.session.upper, "reconnect", None)
        deadline = time.monotonic() + patience
        while again is not None:
            try:
                again()
            except UpperTesterError as error:
                if dead(self.control) is not None or time.monotonic() > deadline:
                    raise UnhealthyError(f"the upper tester does not come back: {error}") from None
                time.sleep(_PAUSE)
            else:
                return

    def _forget(self) -> None:
        """What was known of an implementation before it began anew."""
        self.session.forget()
        self._number = None

    def _require_health(self, bench: Bench) -> None:
        """Raise :class:`UnhealthyError` unless it is well; one that was just restarted gets time to begin."""
        why = self._ailing(bench)
        if why is not None and not self.restarts and self.control is not None and self.control.can_restart:
            # It may be what an earlier campaign has left.
            self._restart()
            why = self._ailing(bench)
        if why is None:
            self._was_well = True
        elif not self._was_well:
            raise UnhealthyError(
                f"the implementation is not healthy, so nothing was sent to it: {why.detail}; is it running, on this "
                "link, with this profile?"
            )
        elif self.restarts:
            raise UnhealthyError(f"the implementation is not healthy after its restart: {why.detail}")
        else:
            raise UnhealthyError(
                f"the implementation does not come back by itself: {why.detail}; give a command that restarts it "
                "(--restart, or --start) to go on, and to have findings made small"
            )

    def _ailing(self, bench: Bench) -> Effect | None:
        can_restart = self.control is not None and self.control.can_restart
        if self.restarts or (self._was_well and not can_restart):
            # It begins anew, whoever has started it again.
            patience = PATIENCE
        else:
            patience = _FIRST if can_restart and not self._was_well else 0
        deadline = bench.now() + round(patience * 1e9)
        while True:
            why = ailing(bench, self.control, self._probes)
            if why is None or why.kind == "dead" or bench.now() >= deadline:
                return why
            bench.receiver.take_newcomer()

    def _comparison(self, bench: Bench) -> Comparison | None:
        if not self._differential:
            return None
        self.observer = observer_of(bench)
        return Comparison(bench, self.observer)


def observer_of(bench: Bench) -> Observer:
    """A model of the implementation as it is known to be. Stops the case if its identifier is not known."""
    limits = Limits(
        bench.sut.parameter("VARDISPAR_MAX_VALUE_LENGTH"),
        bench.sut.parameter("VARDISPAR_MAX_DESCRIPTION_LENGTH"),
        bench.sut.parameter("VARDISPAR_MAX_REPETITIONS"),
    )
    return Observer(
        bench.codec,
        bench.identifiers.sut_id,
        bench.period,
        network=bench.sut.parameter("BPPAR_NETWORK_ID"),
        limits=limits,
        window=bench.sut.reaction + 1,
    )


def carry_out(
    bench: Bench,
    steps: list[Step],
    control: SutControl | None,
    interval: int,
    probes: int = PROBES,
    comparison: Comparison | None = None,
) -> Effect | None:
    """Carry out steps on the implementation of a bench, ``interval`` ns between frames, and see how it is then.

    Raises ``LowerTesterError`` when the link cannot be used.
    """
    at = 0
    # A marker must not be about a variable of the steps.
    bench.identifiers.created.update(_variables_of(bench, steps))
    pace = _Pace(bench, interval)
    try:
        for at, step in enumerate(steps):
            effect = _step(bench, step, pace, at, comparison) or dead(control, at)
            if effect is not None:
                return effect
        why = ailing(bench, control, probes) or begun_again(bench)
    except UpperTesterError as error:
        return _without_upper_tester(control, at, error)
    if why is not None:
        return why._replace(step=at)
    bad = next((heard for heard in bench.heard if heard.problem is not None), None)
    if bad is not None and bad.problem is not None and comparison is None:
        return bad_beacon(bench.codec, bad.octets, bad.problem, at)
    try:
        return comparison.round(at) if comparison is not None and not bench.losses.own() else None
    except UpperTesterError as error:
        return Effect("mute", str(error), at, "upper")


def _without_upper_tester(control: SutControl | None, at: int, error: UpperTesterError) -> Effect:
    """What it means that the upper tester is gone; a process closes its connections before it is gone itself."""
    deadline = time.monotonic() + DEATH_PATIENCE
    while control is not None and control.alive() and time.monotonic() < deadline:
        time.sleep(0.02)
    return dead(control, at) or Effect("mute", str(error), at, "upper")


class _Pace:
    """When the next frame is due. Who is late does not wait, so that the rate is kept on the whole."""

    def __init__(self, bench: Bench, interval: int) -> None:
        self._bench = bench
        self._interval = interval
        self._due = bench.now()
        self._unheard = 0

    def keep(self) -> None:
        """Wait until the next frame may be sent, and hear what comes meanwhile."""
        self._due += self._interval
        self._unheard += 1
        left = self._due - self._bench.now()
        if left > 0 or self._unheard >= _UNHEARD:
            self._bench.waiting.wait_ns(max(0, left))
            self._unheard = 0

    def after_a_break(self) -> None:
        """Time has passed that is not to be made up for."""
        self._due = max(self._due, self._bench.now())


def _step(bench: Bench, step: Step, pace: _Pace, at: int, comparison: Comparison | None) -> Effect | None:
    match step:
        case Frame():
            # The link carries no more; what a flood of elements says is the same without its end.
            octets = step.octets[: bench.profile.limits.uwb_max_packet]
            bench.transmission.send(octets, step.source)
            if comparison is not None:
                comparison.follow()
            pace.keep()
        case Wait():
            bench.wait(step.periods)
            pace.after_a_break()
        case Call():
            upper = bench.session.upper
            if upper is None or step.method not in upper.methods:
                return None
            answer = bench.call(step.method, **step.params)
            pace.after_a_break()
            if comparison is not None:
                return comparison.called(step, answer, at)
    return comparison.said(at) if comparison is not None else None


def _variables_of(bench: Bench, steps: list[Step]) -> set[int]:
    """The variables that frames mention; damaged ones only while they are few, since looking into them takes long."""
    found: set[int] = set()
    damaged = 0
    for step in steps:
        if not isinstance(step, Frame):
            continue
        try:
            beacon = bench.codec.decode(step.octets)
        except DecodeError:
            damaged += 1
            if damaged > _LOOKED_INTO:
                continue
            fields = bench.codec.dissect(step.octets).root.walk()
            found.update(each.value for each in fields if each.name == "varId" and isinstance(each.value, int))
            continue
        for payload in beacon.payloads:
            for container in payload.vardis or ():
                found.update(map(var_id_of, container.records))
    return found


def _case(purpose: str) -> Case:
    return Case(
        id="TC_DCP_FUZZ_BI_01",
        purpose=purpose,
        requirements=ROBUSTNESS,
        kind=Kind.INVALID,
        stimulus="drawn by chance",
        expect="it lives and answers",
        window=4,
        section="Fuzzing",
        module=__name__,
        run=lambda bench: None,  # noqa: ARG005 - the fuzzer drives the bench itself
        robustness=True,
    )


__all__ = ["LiveTarget", "LowerTesterError", "UnhealthyError", "carry_out", "observer_of"]
