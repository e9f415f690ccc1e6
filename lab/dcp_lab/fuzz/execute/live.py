"""Fuzz an implementation on a link, or in process through the same bench.

The target is reset or restarted before the steps, and has to be alive before and after them
(:mod:`dcp_lab.fuzz.execute.liveness`).
"""

from __future__ import annotations

import time
from typing import Final

from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.errors import ConformanceError, UpperTesterError
from dcp_conformance.execution.survival.life import DEATH_PATIENCE
from dcp_conformance.execution.target import Target as Opened
from dcp_conformance.frames.received import var_id_of
from dcp_conformance.sut.control import SutControl
from dcp_conformance.test_system.bench import Bench, Session

from dcp_codec.errors import DecodeError
from dcp_lab.fuzz.steps import ROBUSTNESS, Call, Effect, Frame, Step, Wait

from .liveness import bad_beacon, begun_again, dead, last_number, lifelessness

#: Default number of frames a second: more than the nodes of a dense network send, and too few for a link to drop any.
RATE: Final = 500.0
#: Seconds that an implementation may take to answer after its restart.
PATIENCE: Final = 30.0
#: Seconds that an implementation may take to answer at the beginning: it may have just been started.
_FIRST: Final = 10.0
#: Seconds to try to reconnect to an upper tester if the tester did not restart the implementation.
_RECONNECT: Final = 10.0
_PAUSE: Final = 0.1
#: Maximum number of damaged frames of a test that are searched for variables.
_LOOKED_INTO: Final = 200
#: Maximum number of frames that are sent without reading received frames.
_UNHEARD: Final = 64


#: A bench needs a case.
_CASE: Final = Case(
    id="TC_DCP_FUZZ_BI_01",
    purpose="a sequence of the fuzzer",
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


class NotAliveError(ConformanceError):
    """The implementation was not alive before the first frame, or cannot be brought back after an effect."""


class LiveTarget:
    """Executes steps on an implementation that was opened with ``open_target``."""

    def __init__(self, opened: Opened, *, rate: float = RATE) -> None:
        """``rate``: frames a second."""
        self._runner = opened.runner
        self.session: Session = opened.runner.session
        self.control: SutControl | None = opened.runner.control
        self.name = opened.runner.about().name or self.session.lower.name
        self._interval = round(1_000_000_000 / rate)
        self._checked = False
        self._was_well = False
        self._number: int | None = None
        """Sequence number of the last received beacon; None if unknown."""
        self._uncertain_state = False
        """Whether the last steps had an effect, so that the state of the implementation is unknown."""
        self.frames = 0
        self.restarts = 0

    def run(self, steps: list[Step]) -> Effect | None:
        """See :class:`~dcp_lab.fuzz.steps.Target`. Raises :class:`NotAliveError`, ``LowerTesterError``."""
        bench = self.prepare()
        self.session.lower.health()
        effect = carry_out(bench, steps, self.control, self._interval)
        # The bench has the sequence numbers of this test only; compare them with the last one before it, too.
        effect = effect or begun_again(bench, self._number)
        number = last_number(bench)
        # After an effect the implementation may restart; that restart is not another effect.
        self._number = None if effect is not None else self._number if number is None else number
        self.frames += sum(isinstance(step, Frame) for step in steps)
        # The next steps need a healthy implementation; after an effect its health has to be checked again.
        self._checked = effect is None
        self._uncertain_state = effect is not None
        return effect

    def run_after_restart(self, steps: list[Step]) -> Effect | None:
        """Execute the steps after a restart, so that earlier frames have no influence. See :meth:`run`."""
        self._uncertain_state = True
        return self.run(steps)

    def prepare(self) -> Bench:
        """Bring the implementation into its initial state and check that it answers. Returns the bench of the test.

        Raises :class:`NotAliveError` if it does not answer, ``LowerTesterError`` if the link cannot be used.
        """
        bench = Bench(self.session, _CASE)
        if self._needs_restart():
            self._restart()
        else:
            self._reset()
        bench.waiting.wait_ns(0)
        bench.heard.clear()
        if not self._checked:
            self._require_health(bench)
            self._checked, self._uncertain_state = True, False
        return bench

    def _needs_restart(self) -> bool:
        control = self.control
        if control is None:
            return False
        if control.alive() is False:
            if control.can_restart:
                return True
            raise NotAliveError(
                f"the implementation is dead, and there is no command to restart it: {control.why_dead()}"
            )
        # Only a restart surely restores the initial state after an effect.
        return control.can_restart and self._uncertain_state

    def _restart(self) -> None:
        """Restart the implementation, and wait for its upper tester. Raises :class:`NotAliveError`."""
        assert self.control is not None
        self.restarts += 1
        self._checked = False
        try:
            self.control.restart()
        except UpperTesterError:
            self._reconnect(PATIENCE)
        except ConformanceError as error:
            raise NotAliveError(f"the implementation cannot be restarted: {error}") from None
        self._forget()

    def _reset(self) -> None:
        """Reset the implementation by its upper tester; reconnect first if it was restarted from outside."""
        upper = self.session.upper
        if upper is None or "UT-Reset" not in upper.methods:
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
                raise NotAliveError(f"the implementation cannot be reset: {error}") from None
            self._restart()
        self._forget()

    def _reconnect(self, patience: float) -> None:
        """Reconnect to the upper tester within ``patience`` seconds. Raises :class:`NotAliveError` if that fails."""
        again = getattr(self.session.upper, "reconnect", None)
        deadline = time.monotonic() + patience
        while again is not None:
            try:
                again()
            except UpperTesterError as error:
                if dead(self.control) is not None or time.monotonic() > deadline:
                    raise NotAliveError(f"the upper tester does not come back: {error}") from None
                time.sleep(_PAUSE)
            else:
                return

    def _forget(self) -> None:
        """Forget the observations of the implementation before its restart or reset."""
        self.session.forget()
        self._number = None

    def _require_health(self, bench: Bench) -> None:
        """Check that the implementation answers. Raises :class:`NotAliveError` if not, also after a restart."""
        why = self._lifelessness(bench)
        if why is not None and not self.restarts and self.control is not None and self.control.can_restart:
            # An earlier campaign may have left it in this state.
            self._restart()
            why = self._lifelessness(bench)
        if why is None:
            self._was_well = True
        elif not self._was_well:
            raise NotAliveError(
                f"the implementation is not healthy, so nothing was sent to it: {why.detail}; is it running, on this "
                "link, with this profile?"
            )
        elif self.restarts:
            raise NotAliveError(f"the implementation is not healthy after its restart: {why.detail}")
        else:
            raise NotAliveError(
                f"the implementation does not come back by itself: {why.detail}; give a command that restarts it "
                "(--restart, or --start) to continue, and to minimise findings"
            )

    def _lifelessness(self, bench: Bench) -> Effect | None:
        can_restart = self.control is not None and self.control.can_restart
        if self.restarts or (self._was_well and not can_restart):
            # It is starting: the tester or its own supervisor has restarted it.
            patience = PATIENCE
        else:
            patience = _FIRST if can_restart and not self._was_well else 0
        deadline = bench.now() + round(patience * 1e9)
        while True:
            why = lifelessness(bench, self.control)
            if why is None or why.kind == "dead" or bench.now() >= deadline:
                return why
            bench.receiver.take_newcomer()


def carry_out(bench: Bench, steps: list[Step], control: SutControl | None, interval: int) -> Effect | None:
    """Execute steps on the implementation of a bench, ``interval`` ns between frames, then check that it is alive.

    Returns the first effect, or None. Raises ``LowerTesterError`` if the link cannot be used.
    """
    at = 0
    # A marker must not use a variable of the steps.
    bench.identifiers.created.update(_variables_of(bench, steps))
    pace = _Pace(bench, interval)
    try:
        for at, step in enumerate(steps):
            _step(bench, step, pace)
            if (effect := dead(control, at)) is not None:
                return effect
        why = lifelessness(bench, control) or begun_again(bench)
    except UpperTesterError as error:
        return _without_upper_tester(control, at, error)
    if why is not None:
        return why._replace(step=at)
    bad = next((heard for heard in bench.heard if heard.problem is not None), None)
    if bad is not None and bad.problem is not None:
        return bad_beacon(bench.codec, bad.octets, bad.problem, at)
    return None


def _without_upper_tester(control: SutControl | None, at: int, error: UpperTesterError) -> Effect:
    """Return the effect of a lost upper tester: ``dead`` if the process ends within ``DEATH_PATIENCE``, else ``mute``.

    A process that is ending closes its connections first, so its end has to be awaited.
    """
    deadline = time.monotonic() + DEATH_PATIENCE
    while control is not None and control.alive() and time.monotonic() < deadline:
        time.sleep(0.02)
    return dead(control, at) or Effect("mute", str(error), at, "upper")


class _Pace:
    """Keeps the average rate of frames: a frame that is late is sent without waiting."""

    def __init__(self, bench: Bench, interval: int) -> None:
        self._bench = bench
        self._interval = interval
        self._due = bench.now()
        self._without_sigint = 0

    def keep(self) -> None:
        """Wait until the next frame is due, and receive frames during this time."""
        self._due += self._interval
        self._without_sigint += 1
        left = self._due - self._bench.now()
        if left > 0 or self._without_sigint >= _UNHEARD:
            self._bench.waiting.wait_ns(max(0, left))
            self._without_sigint = 0

    def after_a_break(self) -> None:
        """Continue from now after a wait or a call, without catching up."""
        self._due = max(self._due, self._bench.now())


def _step(bench: Bench, step: Step, pace: _Pace) -> None:
    match step:
        case Frame():
            # Truncate to the maximum frame size of the link; the rest of a long list of elements has no other effect.
            octets = step.octets[: bench.profile.limits.uwb_max_packet]
            bench.transmission.send(octets, step.source)
            pace.keep()
        case Wait():
            bench.wait(step.periods)
            pace.after_a_break()
        case Call():
            upper = bench.session.upper
            if upper is not None and step.method in upper.methods:
                bench.call(step.method, **step.params)
                pace.after_a_break()


def _variables_of(bench: Bench, steps: list[Step]) -> set[int]:
    """Return the variables that frames name. Only the first damaged frames are dissected, because it is slow."""
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
