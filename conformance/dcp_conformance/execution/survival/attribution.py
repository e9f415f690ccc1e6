"""Attribute the end of the implementation ("death") to a case, and confirm it by executing the case alone.

When the implementation is found dead or silent after a case, the cause may be that case, an earlier one (a process
takes a moment to end), or several cases together. Each is executed again after a restart. Checks that failed for lack
of a reaction while the implementation was ending do not count against the requirements of the case.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.results import Check, Table
from dcp_conformance.definitions.verdict import Verdict, worst
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.services.requirements import (
    concerns,
    is_answered,
    not_reached,
    violated_by_death,
)
from dcp_conformance.test_system.traffic import Event

from .life import Loss

#: Requirements to survive any input. A case that names one of them is about survival.
_SURVIVAL_OF_FRAMES: Final = "BP-RX-16"
_SURVIVAL_OF_PAYLOADS: Final = "VD-ROB-01"
_SURVIVAL: Final = frozenset({"BP-RX-15", _SURVIVAL_OF_FRAMES, _SURVIVAL_OF_PAYLOADS})

#: Services that prepare a case, or undo what it has changed.
_PREPARES: Final = re.compile(r"UT-.*|.*-(MGMT|Get|Set).*|BP-(Register|Deregister).*|RTDB-Delete")
#: Services that change nothing: one that was answered did not end the implementation.
_READS: Final = re.compile(r".*-Get.*|BP-(List|Query).*|RTDB-(Describe|Read).*|SRP-NeighbourTable")
#: Number of beacons after a frame from which on the frame does not count as the cause.
_OUTLIVED: Final = 5


@dataclass(slots=True)
class Trial:
    """One execution of a case, with the state of the implementation after it."""

    case: Case
    bench: Bench
    begun: int
    """Time of the lower tester's clock, ns."""
    checks: list[Check] = field(default_factory=list)
    loss: Loss | None = None
    """How the implementation was lost in or after the case; None if it is alive."""
    stimulus: Event | None = None
    """The stimulus that probably ended the implementation; None without any stimulus."""
    paused: bool = False
    """Whether BP was deactivated in the case."""
    first: bool = False
    """Whether it is the first execution since the implementation was restarted."""
    used_up: bool = False
    """Whether the case stopped because all identifiers that the implementation cannot know were used up."""
    detail: str = ""
    """Traceback of a fault of the tester."""
    upper_tester_error: str = ""
    """Error message if the upper tester stopped answering; otherwise empty."""

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of the checks."""
        return worst(check.verdict for check in self.checks) or Verdict.INCONCLUSIVE

    @property
    def failed(self) -> frozenset[tuple[int, str]]:
        """The requirements of the failed checks, each with the place of its check in the case."""
        failed = ((place, each) for place, each in enumerate(self.checks) if each.verdict is Verdict.FAIL)
        return frozenset((place, each) for place, check in failed for each in check.requirements)

    @property
    def disturbed(self) -> bool:
        """Whether only a disturbance of the tester (lateness, lost frames) left the case, or parts of it, undecided."""
        undecided = self.verdict in (Verdict.INCONCLUSIVE, Verdict.FAIL)
        return undecided and self.loss is None and not self.used_up and bool(self.bench.verdicts.disturbed)


@dataclass(frozen=True, slots=True)
class Attribution:
    """The outcome for a case after which the implementation was found dead."""

    trial: Trial
    """The execution that counts for the case itself."""
    checks: tuple[Check, ...]
    """The checks that count for the case itself."""
    killed: bool
    """Whether the case is the cause."""
    earlier: Trial | None = None
    """The execution of an earlier case that is the cause instead."""
    note: str = ""
    """A note for the results of the run; empty if the checks suffice."""


Again = Callable[[Sequence[Case]], Trial | str]
"""Function that restarts the implementation and executes cases in succession. It returns the trial of the first case
that ends in a loss, otherwise of the last case, or a text with the reason why the implementation could not be started.
"""


def attribute(trial: Trial, recent: Sequence[Case], again: Again | None) -> Attribution:
    """Determine which case ended the implementation.

    ``recent`` has the cases shortly before ``trial``, since the last start of the implementation, in their order.
    ``again`` is None if the tester cannot start the implementation.
    """
    loss, case = trial.loss, trial.case
    assert loss is not None
    if again is None:
        return _unconfirmed(trial, "", recent)
    alone = again([case])
    if isinstance(alone, str):
        return _unconfirmed(trial, alone, recent)
    if alone.loss is not None:
        # Both executions ended in the same way. Report the first: its evidence is that of the run.
        return Attribution(trial, blamed(trial), killed=True)
    for suspect in reversed(recent):
        earlier = again([suspect])
        if isinstance(earlier, str):
            return _unconfirmed(trial, earlier, recent)
        if earlier.loss is not None:
            note = f"the implementation was dead after {case.id}; {suspect.id}, an earlier case, ends it when run alone"
            checks = with_failures_of(alone.checks, trial.checks)
            return Attribution(alone, checks, killed=False, earlier=earlier, note=note)
    if recent:
        row = again([*recent, case])
        if isinstance(row, Trial) and row.loss is not None:
            text = f" (only when it follows {', '.join(each.id for each in recent)})"
            if row.case is case:
                return Attribution(row, blamed(row, text), killed=True)
    return _not_reproduced(alone, trial, recent)


def blamed(trial: Trial, text: str = "") -> tuple[Check, ...]:
    """Return the checks of a case that ended the implementation: first the death, then the checks of the case.

    Failures that a received frame or answer proves stay fails. A missing reaction becomes inconclusive, because the
    implementation may have been ending. ``text`` is appended to the observation.
    """
    loss = trial.loss
    assert loss is not None
    if loss.upper_only:
        what = "the upper tester stays connected"
        check = Check(Verdict.INCONCLUSIVE, trial.case.requirements, what, loss.observed + text)
        return (check, *_withheld(trial, "its upper tester was gone"))
    table: Table = "robustness" if trial.case.robustness else "conformance"
    verdict = Verdict.INCONCLUSIVE if loss.doubtful else Verdict.FAIL
    service = trial.stimulus.text if trial.stimulus is not None and trial.stimulus.direction == "call" else ""
    what = "the implementation survives" + (f" {service}" if service else "")
    violated = tuple(dict.fromkeys((*survival(trial), *_unfulfilled(trial))))
    death = Check(verdict, violated, what, loss.observed + text, table=table)
    if service and not violated:
        # No requirement applies to the service: the checks of the case keep their verdicts.
        return (death, *trial.checks)
    return (death, *_withheld(trial, f"the implementation {loss.how} in this case"))


def _unfulfilled(trial: Trial) -> tuple[str, ...]:
    """Return the requirement of a case that a death after a valid stimulus also violates; empty without one.

    It is that of the first reaction that was missing, otherwise the first one that no check has shown, because the
    implementation owed the reaction. A case that ended early, because a call that it needs did not succeed, has not
    reached the step that shows it. A frame after which several beacons came is not the cause. A call that only prepares
    the case is not its stimulus.
    """
    case, stimulus = trial.case, trial.stimulus
    if case.kind is not Kind.VALID or case.robustness or case.needs.link or stimulus is None:
        return ()
    if stimulus.direction == "call" and (_PREPARES.search(stimulus.text) or concerns(case, stimulus.text)):
        return ()
    missing = (check.requirements for check in trial.checks if check.verdict is Verdict.FAIL and not check.shown)
    if owed := next(missing, ()):
        return owed
    cut_short = stimulus.direction == "call" and any(check.verdict is Verdict.INCONCLUSIVE for check in trial.checks)
    if cut_short or _is_outlived(stimulus, trial.bench):
        return ()
    shown = {each for check in trial.checks if check.verdict is Verdict.PASS for each in check.requirements}
    return next(((each,) for each in case.requirements if each not in shown), ())


def came_back(trial: Trial, seconds: float) -> tuple[Check, ...]:
    """Return the checks of a case after which the implementation was silent, and answered again after ``seconds``.

    The cause may be a busy machine or the stimulus, so that the verdict is inconclusive.
    """
    assert trial.loss is not None
    text = f"{trial.loss.observed}; it answered again after {seconds:.1f} s"
    check = Check(Verdict.INCONCLUSIVE, survival(trial), "the implementation continues to answer", text)
    return (check, *_withheld(trial, "the implementation did not answer for a while"))


def with_failures_of(checks: Sequence[Check], earlier: Sequence[Check]) -> tuple[Check, ...]:
    """Return the checks of an execution, and the proved failures of an earlier execution that did not occur again.

    The added checks have no frames, because the recording of the earlier execution is not kept.
    """
    seen = {(check.expected, check.requirements) for check in checks if check.verdict is Verdict.FAIL}
    kept = [
        msgspec.structs.replace(check, observed=f"{check.observed} (in the first execution)", frames=())
        for check in earlier
        if check.verdict is Verdict.FAIL and check.shown and (check.expected, check.requirements) not in seen
    ]
    return (*checks, *kept)


def _withheld(trial: Trial, why: str) -> tuple[Check, ...]:
    """Return the checks of a trial; failures for lack of a reaction become inconclusive for the reason ``why``."""
    return tuple(check if check.shown else check.excused(why) for check in trial.checks)


def _unconfirmed(trial: Trial, why: str, recent: Sequence[Case]) -> Attribution:
    """Return the attribution without a confirmation, because the implementation cannot be restarted (``why``).

    A process that has ended is a fail; it names no requirement if an earlier case may be the cause. Silence is
    inconclusive in that case.
    """
    loss = trial.loss
    assert loss is not None
    text = f"; not confirmed: {why or 'there is no command to start it again (--start, --restart)'}"
    if not recent:
        return Attribution(trial, blamed(trial, text), killed=True)
    text = f"{loss.observed}{text}; the cause may have been sent in {', '.join(each.id for each in recent)}"
    verdict = Verdict.FAIL if loss.died else Verdict.INCONCLUSIVE
    check = Check(verdict, (), "the implementation survives", text)
    return Attribution(trial, (check, *_withheld(trial, f"the implementation {loss.how}")), killed=loss.died)


def _not_reproduced(alone: Trial, trial: Trial, recent: Sequence[Case]) -> Attribution:
    """Return the attribution of a death that occurred only once; it decides no case."""
    loss = trial.loss
    assert loss is not None
    tried = f"{trial.case.id} alone"
    if recent:
        tried += f", {', '.join(each.id for each in recent)} alone, and all of them in a row"
    text = f"{loss.observed}; not reproduced from a fresh start ({tried})"
    check = Check(Verdict.INCONCLUSIVE, survival(trial), "the implementation survives", text)
    note = f"the implementation {loss.how} once, in or before {trial.case.id}; it was not reproduced: {tried}"
    return Attribution(alone, with_failures_of([*alone.checks, check], trial.checks), killed=False, note=note)


def survival(trial: Trial) -> tuple[str, ...]:
    """Return the requirements that a death in this case violates.

    These are the requirements of the case about survival. Without any, a frame violates the requirement to survive its
    payload, and a service call violates the requirement about the service
    (:mod:`dcp_conformance.test_system.services.requirements`). A frame after which several beacons were received is not
    the cause: then no requirement is named.
    """
    case = trial.case
    if case.needs.link:
        # The cause is the switched-off link, not a frame or a call.
        return case.requirements
    named = tuple(each for each in case.requirements if each in _SURVIVAL)
    deadly = trial.stimulus
    if named or deadly is None:
        return named
    codec, events = trial.bench.codec, trial.bench.traffic.events
    if deadly.direction == "call":
        shown = {each for check in trial.checks if check.verdict is Verdict.PASS for each in check.requirements}
        return violated_by_death(case, deadly, events, shown, codec.profile.spec_version)
    if _is_outlived(deadly, trial.bench):
        return ()
    try:
        envelope, _ = codec.decode_envelope(deadly.frame[deadly.start :])
    except DecodeError:
        return (_SURVIVAL_OF_FRAMES,)
    carried = {each.protocol_id for each in envelope.payloads}
    return (_SURVIVAL_OF_PAYLOADS,) if BP_PROTID_VARDIS in carried else (_SURVIVAL_OF_FRAMES,)


def _is_outlived(stimulus: Event, bench: Bench) -> bool:
    """Return whether several beacons were received after a frame, so that it is not the cause of a death."""
    events = bench.traffic.events
    later = events[events.index(stimulus) + 1 :] if stimulus.direction == "sent" else []
    return sum(each.direction == "heard" for each in later) >= _OUTLIVED


def kinds(codec: Codec, event: Event) -> frozenset[int] | None:
    """Return the types of the containers in a valid frame; None for any other frame."""
    try:
        beacon = codec.decode(event.frame[event.start :])
    except DecodeError:
        return None
    return frozenset(each.ic_type for payload in beacon.payloads for each in payload.vardis or ())


def likely_stimulus(case: Case, bench: Bench) -> Event | None:
    """Find the stimulus that probably ended the implementation, without calls that only restore its state.

    After calls in a case with valid frames, frames of kinds that the implementation has survived before are not the
    cause.

    In a case about services with valid frames, it is the last call, with two exceptions. First, the call was answered
    before a later frame, and a beacon was received in between or the case only uses the service. Second, the case only
    uses the service, the call was never answered, and a frame was sent between the last sign of life and the call.
    Otherwise it is a frame that was sent after the last beacon. Nothing that follows the first sign of the loss counts:
    a call that could not reach the implementation. None if that call and an earlier one can be the cause.
    """
    events = bench.traffic.events
    tidying = set(_tidying(case, events))
    lost = next((place for place in _unreached(events) if place not in tidying), None)
    if lost is not None:
        heard = max((place for place in range(lost) if events[place].direction == "heard"), default=-1)
        before = [place for place in range(heard + 1, lost) if place not in tidying]
        if any(events[place].direction == "call" for place in before):
            return None
        frames = any(events[place].direction == "sent" for place in before)
        events = events[: lost + (not frames)]
    if (call := _call_before_harmless(case, bench, events, tidying)) is not None:
        return call
    if case.needs.ut and case.kind is not Kind.INVALID:
        calls = [place for place, each in enumerate(events) if each.direction == "call" and place not in tidying]
        if calls and not _outlived(case, events[calls[-1] :]) and not _dead_before(case, events, calls[-1]):
            return events[calls[-1]]
    recent: Event | None = None
    for place in reversed(range(len(events))):
        event = events[place]
        if event.direction == "heard" and recent is not None:
            break
        if event.direction == "sent":
            return event
        if event.direction == "call" and recent is None and place not in tidying:
            recent = event
    return recent


def _unreached(events: Sequence[Event]) -> Iterator[int]:
    """Yield the places of calls whose answers show that the implementation could not be reached."""
    call = 0
    for place, event in enumerate(events):
        if event.direction == "call":
            call = place
        elif event.direction == "answer" and not_reached(event):
            yield call


def _call_before_harmless(case: Case, bench: Bench, events: Sequence[Event], tidying: Container[int]) -> Event | None:
    """Return the last call after the last beacon if all frames after that beacon are of kinds survived before."""
    survived = bench.session.survived
    if case.kind is Kind.INVALID or case.robustness or case.destructive:
        return None
    last = max((place for place, each in enumerate(events) if each.direction == "heard"), default=-1)
    later = [(place, each) for place, each in enumerate(events) if place > last]
    calls = [
        each
        for place, each in later
        if each.direction == "call" and place not in tidying and not _PREPARES.search(each.text)
    ]
    frames = [each for _, each in later if each.direction == "sent"]
    return calls[-1] if calls and frames and all(kinds(bench.codec, each) in survived for each in frames) else None


def _outlived(case: Case, events: Sequence[Event]) -> bool:
    """Return whether the first of these events, a call, is a less likely cause of death than a later frame."""
    frame = next((place for place, each in enumerate(events) if each.direction == "sent"), None)
    if frame is None or not any(each.direction == "answer" for each in events[:frame]):
        return False
    if any(each.direction == "heard" for each in events[:frame]):
        return True
    # An inactive entity must discard frames unread: then frames are not the cause.
    return not (events[0].text.endswith("-MGMT-Deactivate") or concerns(case, events[0].text))


def _dead_before(case: Case, events: Sequence[Event], place: int) -> bool:
    """Return whether the implementation may have been dead before the call at ``place``, which the case only uses."""
    if concerns(case, events[place].text) or any(each.direction == "answer" for each in events[place + 1 :]):
        return False
    before = next((each for each in reversed(events[:place]) if each.direction in ("sent", "heard", "answer")), None)
    return before is not None and before.direction == "sent"


def _tidying(case: Case, events: Sequence[Event]) -> Iterator[int]:
    """Yield the indices of calls that only prepare, end or undo something, unless the case is about the service.

    An activation is yielded only if it was not answered: it undoes a deactivation that may be the cause. A query that
    was answered is yielded if the implementation was changed by an earlier call, whatever the case is about.
    """
    changed = False
    for place, event in enumerate(events):
        if event.direction != "call":
            continue
        answered = is_answered(event, events)
        reads = _READS.fullmatch(event.text) is not None
        undoes = event.text == "BP-DeregisterProtocol" or (event.text.endswith("-MGMT-Activate") and not answered)
        if (
            event.text.startswith("UT-")
            or (undoes and not concerns(case, event.text))
            or (reads and answered and changed)
        ):
            yield place
        changed = changed or not (reads or event.text.startswith("UT-"))
