"""An implementation on the air, or in process behind the same bench, as a target.

Whether it is alive is asked in four ways: is its process there, do beacons come, is a marker answered (a summary of a
variable that nobody has must bring a request), does the upper tester answer. Silence alone is no death: of several
markers one is enough.
"""

from __future__ import annotations

from typing import Final

from dcp_codec.errors import DecodeError
from dcp_conformance.bench import Bench, Session
from dcp_conformance.case import Case, Kind
from dcp_conformance.control import SutControl
from dcp_conformance.errors import ConformanceError, LowerTesterError, StopCase, UpperTesterError
from dcp_conformance.heard import var_id_of
from dcp_conformance.oracle import Limits
from dcp_conformance.target import Target as Opened

from .differential import Comparison
from .observing import Observer
from .steps import Call, Effect, Frame, Step, Wait

#: Markers of which one must be answered.
PROBES: Final = 4
#: Frames in a second unless a rate is given: more than peers of a crowd send, less than what makes links drop.
RATE: Final = 500.0
#: Beacon periods that an answer may take of one who beacons and did not answer sooner.
_LONG: Final = 100.0
REQUIREMENTS: Final = ("BP-RX-16", "VD-ROB-01")
"""What every finding is about: nothing received may stop an implementation."""


class UnhealthyError(ConformanceError):
    """The implementation did not live before anything was sent to it, or does not live any more."""


class LiveTarget:
    """Carries steps out on an implementation that was opened with :func:`dcp_conformance.target.open_target`."""

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
        self.observer: Observer | None = None
        """What watched the last steps, in differential mode."""
        self.frames = 0
        self.restarts = 0

    def run(self, steps: list[Step]) -> Effect | None:
        """See :class:`~dcp_conformance.fuzz.steps.Target`. Raises :class:`UnhealthyError`, ``LowerTesterError``."""
        self._revive()
        bench = Bench(self.session, _case("a sequence of the fuzzer"))
        self._reset(bench)
        if not self._checked:
            why = ailing(bench, self.control, self._probes)
            if why is not None:
                raise UnhealthyError(
                    f"the implementation is not healthy, so nothing was sent to it: {why.detail}; is it running, on "
                    "this link, with this profile?"
                )
            self._checked = True
        self.session.lower.health()
        effect = carry_out(bench, steps, self.control, self._interval, self._probes, self._comparison(bench))
        self.frames += sum(isinstance(step, Frame) for step in steps)
        # The next steps need a healthy implementation; after an effect that has to be shown first.
        self._checked = effect is None
        return effect

    def _comparison(self, bench: Bench) -> Comparison | None:
        if not self._differential:
            return None
        self.observer = observer_of(bench)
        return Comparison(bench, self.observer)

    def _revive(self) -> None:
        control = self.control
        if control is None or control.alive() is not False:
            return
        if not control.can_restart:
            raise UnhealthyError(
                f"the implementation is dead, and there is no command to restart it: {control.why_dead()}"
            )
        control.restart()
        self.restarts += 1

    def _reset(self, bench: Bench) -> None:
        upper = self.session.upper
        try:
            if upper is not None and "UT-Reset" in upper.methods:
                upper.call("UT-Reset", {})
                self.session.known.clear()
                self.session.leaving.clear()
            elif not self._checked and self.control is not None and self.control.can_restart and self.restarts:
                # After an effect without death: nothing else brings it back to where it began.
                self.control.restart()
                self.restarts += 1
        except UpperTesterError as error:
            if self.control is None or not self.control.can_restart:
                raise UnhealthyError(f"the implementation cannot be reset: {error}") from None
            self.control.restart()
            self.restarts += 1
        bench.wait_ns(0)
        bench.heard.clear()


def observer_of(bench: Bench) -> Observer:
    """A model of the implementation as it is known to be. Stops the case if its identifier is not known."""
    limits = Limits(
        bench.parameter("VARDISPAR_MAX_VALUE_LENGTH"),
        bench.parameter("VARDISPAR_MAX_DESCRIPTION_LENGTH"),
        bench.parameter("VARDISPAR_MAX_REPETITIONS"),
    )
    return Observer(
        bench.codec,
        bench.sut_id,
        bench.period,
        network=bench.parameter("BPPAR_NETWORK_ID"),
        limits=limits,
        window=bench.reaction + 1,
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
    bench.created.update(_variables_of(bench, steps))
    try:
        for at, step in enumerate(steps):
            effect = _step(bench, step, interval, at, comparison)
            if effect is not None:
                return effect
            if control is not None and control.alive() is False:
                return Effect("dead", control.why_dead() or "the process is gone", at, "dead")
    except UpperTesterError as error:
        why = ailing(bench, control, probes)
        return (
            Effect(why.kind, why.detail, at, why.place) if why is not None else Effect("mute", str(error), at, "upper")
        )
    why = ailing(bench, control, probes)
    if why is not None:
        return Effect(why.kind, why.detail, at, why.place)
    bad = next((heard for heard in bench.heard if heard.problem is not None), None)
    if bad is not None and comparison is None:
        return Effect(
            "bad-beacon", f"a beacon that is none: {bad.problem}", at, bad.problem.reason if bad.problem else ""
        )
    try:
        return comparison.round(at) if comparison is not None and not bench.own_losses() else None
    except UpperTesterError as error:
        return Effect("mute", str(error), at, "upper")


def _step(bench: Bench, step: Step, interval: int, at: int, comparison: Comparison | None) -> Effect | None:
    match step:
        case Frame():
            # The link carries no more; what a flood of elements says is the same without its end.
            octets = step.octets[: bench.profile.limits.uwb_max_packet]
            bench.transmit(octets, step.source)
            if comparison is not None:
                comparison.follow()
            bench.wait_ns(interval)
        case Wait():
            bench.wait(step.periods)
        case Call():
            upper = bench.session.upper
            if upper is None or step.method not in upper.methods:
                return None
            answer = bench.call(step.method, **step.params)
            if comparison is not None:
                return comparison.called(step, answer, at)
    return comparison.said(at) if comparison is not None else None


def _variables_of(bench: Bench, steps: list[Step]) -> set[int]:
    """The variables that frames mention, also damaged ones."""
    found: set[int] = set()
    for step in steps:
        if not isinstance(step, Frame):
            continue
        try:
            beacon = bench.codec.decode(step.octets)
        except DecodeError:
            fields = bench.codec.dissect(step.octets).root.walk()
            found.update(each.value for each in fields if each.name == "varId" and isinstance(each.value, int))
            continue
        for payload in beacon.payloads:
            for container in payload.vardis or ():
                found.update(map(var_id_of, container.records))
    return found


def ailing(bench: Bench, control: SutControl | None, probes: int = PROBES) -> Effect | None:
    """What is wrong with an implementation; None if it lives and answers."""
    if control is not None and control.alive() is False:
        return Effect("dead", control.why_dead() or "the process is gone", 0, "dead")
    begun = bench.mark()
    for _ in range(probes):
        try:
            if bench.probe():
                return None
        except StopCase:
            # Every identifier was spoken of: any sign of life has to do.
            if _signs_of_life(bench):
                return None
            bench.created.clear()
        if control is not None and control.alive() is False:
            return Effect("dead", control.why_dead() or "the process is gone", 0, "dead")
    beacons = len(bench.heard) - begun
    # With much to say an answer stands at the end of a long row.
    if beacons and bench.probe(_LONG):
        return None
    answers = ""
    upper = bench.session.upper
    if upper is not None and "UT-Hello" in upper.methods:
        try:
            upper.call("UT-Hello", {})
            answers = ", its upper tester answers"
        except UpperTesterError as error:
            answers = f", and {error}"
    came = f"{beacons} beacons came" if beacons else "no beacon came"
    return Effect(
        "mute", f"none of {probes} markers was answered; {came}{answers}", 0, "beacons" if beacons else "silent"
    )


def _signs_of_life(bench: Bench) -> bool:
    upper = bench.session.upper
    if upper is not None and "UT-Hello" in upper.methods:
        try:
            upper.call("UT-Hello", {})
        except UpperTesterError:
            return False
        return True
    return bool(bench.beacons(1, 10))


def _case(purpose: str) -> Case:
    return Case(
        id="TC_DCP_FUZZ_BI_01",
        purpose=purpose,
        requirements=REQUIREMENTS,
        kind=Kind.INVALID,
        stimulus="drawn by chance",
        expect="it lives and answers",
        window=4,
        section="Fuzzing",
        module=__name__,
        run=lambda bench: None,  # noqa: ARG005 - the fuzzer drives the bench itself
        robustness=True,
    )


__all__ = ["LiveTarget", "LowerTesterError", "UnhealthyError", "ailing", "carry_out", "observer_of"]
