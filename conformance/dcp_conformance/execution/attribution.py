"""Attribute a death to a case, after confirming it alone from a fresh start.

When the implementation is found dead or silent after a case, that case may have killed it, or one shortly before it (a
process takes a moment to die), or several together. Each is tried from a fresh start. What a case saw fail while the
implementation was dying is not held against the requirements of the case: only the death is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS

from dcp_codec.errors import DecodeError
from dcp_conformance.model.case import Case, Kind
from dcp_conformance.model.results import Check, Table
from dcp_conformance.model.verdict import Verdict, worst
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.traffic import Event, Traffic

from .life import Loss
from .service_requirements import concerns, violated_by_death

#: Requirements that ask for survival, by what they are about. A case that names one of them is about survival.
_SURVIVAL_OF_FRAMES: Final = "BP-RX-16"
_SURVIVAL_OF_PAYLOADS: Final = "VD-ROB-01"
_SURVIVAL: Final = frozenset({"BP-RX-15", _SURVIVAL_OF_FRAMES, _SURVIVAL_OF_PAYLOADS})


@dataclass(slots=True)
class Trial:
    """One execution of a case, with what was found of the implementation's life after it."""

    case: Case
    bench: Bench
    begun: int
    """Time of the lower tester's clock, ns."""
    checks: list[Check] = field(default_factory=list)
    loss: Loss | None = None
    stimulus: Event | None = None
    """The stimulus that probably ended the implementation; None if there was none."""
    paused: bool = False
    """BP was deactivated in the case."""
    used_up: bool = False
    """The case stopped because no identifier was left that the implementation cannot know."""
    detail: str = ""
    """Traceback of a fault of the tester."""
    hung_up: str = ""
    """How the upper tester stopped answering; empty if it did not."""

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of the checks."""
        return worst(check.verdict for check in self.checks) or Verdict.INCONCLUSIVE

    @property
    def disturbed(self) -> bool:
        """Whether nothing but the tester's own trouble has left the case, or parts of it, undecided."""
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
    """The case is to blame."""
    earlier: Trial | None = None
    """The execution of an earlier case that is to blame instead."""
    note: str = ""
    """A note for the results of the run; empty if the checks suffice."""


Again = Callable[[Sequence[Case]], Trial | str]
"""Runs cases one after the other from a fresh start; the trial of the first that ends in a loss, else of the last. A
text says why the implementation could not be started."""


def attribute(trial: Trial, recent: Sequence[Case], again: Again | None) -> Attribution:
    """Find out which case ended the life of the implementation.

    ``recent``: the cases shortly before, in the same life of the implementation, in their order. ``again``: None if
    the implementation cannot be started by the tester.
    """
    loss, case = trial.loss, trial.case
    assert loss is not None
    if again is None:
        return _unconfirmed(trial, "", recent)
    alone = again([case])
    if isinstance(alone, str):
        return _unconfirmed(trial, alone, recent)
    if alone.loss is not None:
        # The first execution has the evidence of the whole run; both ended alike.
        return Attribution(trial, blamed(trial), killed=True)
    for suspect in reversed(recent):
        earlier = again([suspect])
        if isinstance(earlier, str):
            return _unconfirmed(trial, earlier, recent)
        if earlier.loss is not None:
            note = f"{case.id} found the implementation dead; {suspect.id}, before it, ends it when it is run alone"
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
    """The checks of a case that ended the life of the implementation: first the death, then what it saw.

    Only failures that were received stay fails: what is missing may be missing because the implementation was dying.
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
    violated = survival(trial)
    death = Check(verdict, violated, what, loss.observed + text, table=table)
    if service and not violated:
        # No requirement is about the service: the checks of the case keep their verdicts.
        return (death, *trial.checks)
    return (death, *_withheld(trial, f"the implementation {loss.how} in this case"))


def came_back(trial: Trial, seconds: float) -> tuple[Check, ...]:
    """The checks of a case after which the implementation was silent, and answered again after this time.

    A busy machine can do that, as well as what was sent.
    """
    assert trial.loss is not None
    text = f"{trial.loss.observed}; it answered again after {seconds:.1f} s"
    check = Check(Verdict.INCONCLUSIVE, survival(trial), "the implementation goes on answering", text)
    return (check, *_withheld(trial, "the implementation did not answer for a while"))


def with_failures_of(checks: Sequence[Check], earlier: Sequence[Check]) -> tuple[Check, ...]:
    """Checks of an execution, with the failures of an earlier one that were proved there and not seen again.

    The frames of those are in the recording of the earlier execution, which is not kept.
    """
    seen = {(check.expected, check.requirements) for check in checks if check.verdict is Verdict.FAIL}
    kept = [
        msgspec.structs.replace(check, observed=f"{check.observed} (in the first execution)", frames=())
        for check in earlier
        if check.verdict is Verdict.FAIL and check.shown and (check.expected, check.requirements) not in seen
    ]
    return (*checks, *kept)


def _withheld(trial: Trial, why: str) -> tuple[Check, ...]:
    """The checks of a trial; failures about something missing become inconclusive, proved ones stay."""
    return tuple(
        msgspec.structs.replace(check, verdict=Verdict.INCONCLUSIVE, observed=f"{check.observed}; but {why}")
        if check.verdict is Verdict.FAIL and not check.shown
        else check
        for check in trial.checks
    )


def _unconfirmed(trial: Trial, why: str, recent: Sequence[Case]) -> Attribution:
    """Without a fresh start there is no confirmation.

    That a process has ended is a fact, whatever ended it: a fail, but of no requirement where another case comes into
    question. Silence is only a doubt then.
    """
    loss = trial.loss
    assert loss is not None
    text = f"; not confirmed: {why or 'there is no command to start it again (--start, --restart)'}"
    if not recent:
        return Attribution(trial, blamed(trial, text), killed=True)
    text = f"{loss.observed}{text}; what ended it may have been sent in {', '.join(each.id for each in recent)}"
    verdict = Verdict.FAIL if loss.died else Verdict.INCONCLUSIVE
    check = Check(verdict, (), "the implementation survives", text)
    return Attribution(trial, (check, *_withheld(trial, f"the implementation {loss.how}")), killed=loss.died)


def _not_reproduced(alone: Trial, trial: Trial, recent: Sequence[Case]) -> Attribution:
    """Report a death that was seen only once; it decides no case."""
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
    """The requirements that a death in this case violates.

    Those of the case that ask for survival. Otherwise, after a frame, the one that asks for surviving what was sent;
    after a service call, the one that says what this service does
    (:mod:`dcp_conformance.execution.service_requirements`).
    """
    case = trial.case
    if case.needs.link:
        # The death follows from taking the link down, not from any frame or call.
        return case.requirements
    named = tuple(each for each in case.requirements if each in _SURVIVAL)
    deadly = trial.stimulus
    if named or deadly is None:
        return named
    codec, events = trial.bench.codec, trial.bench.traffic.events
    if deadly.direction == "call":
        shown = {each for check in trial.checks if check.verdict is Verdict.PASS for each in check.requirements}
        return violated_by_death(case, deadly, events, shown, codec.profile.spec_version)
    try:
        envelope, _ = codec.decode_envelope(deadly.frame[deadly.start :])
    except DecodeError:
        return (_SURVIVAL_OF_FRAMES,)
    carried = {each.protocol_id for each in envelope.payloads}
    return (_SURVIVAL_OF_PAYLOADS,) if BP_PROTID_VARDIS in carried else (_SURVIVAL_OF_FRAMES,)


def likely_stimulus(case: Case, traffic: Traffic) -> Event | None:
    """Find the stimulus that probably ended the implementation, without calls that only tidy up.

    In a case about services that is the last call, as its frames are honest, unless the implementation was heard after
    the call and before another frame, or the case only uses that service. Nor is it a call that was never answered and
    that the case only uses, if a frame came between the last sign of life and the call. Otherwise it is a frame since
    the last beacon.
    """
    events = traffic.events
    tidying = set(_tidying(case, events))
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


def _outlived(case: Case, events: Sequence[Event]) -> bool:
    """Whether the first of these events, a call, is a less likely cause of death than a frame after it."""
    frame = next((place for place, each in enumerate(events) if each.direction == "sent"), None)
    if frame is None or not any(each.direction == "answer" for each in events[:frame]):
        return False
    if any(each.direction == "heard" for each in events[:frame]):
        return True
    # An inactive entity must discard frames unread: they are not the cause.
    return not (events[0].text.endswith("-MGMT-Deactivate") or concerns(case, events[0].text))


def _dead_before(case: Case, events: Sequence[Event], place: int) -> bool:
    """Whether the implementation may have been dead before the call at ``place``, which the case only uses."""
    if concerns(case, events[place].text) or any(each.direction == "answer" for each in events[place + 1 :]):
        return False
    before = next((each for each in reversed(events[:place]) if each.direction in ("sent", "heard", "answer")), None)
    return before is not None and before.direction == "sent"


def _tidying(case: Case, events: Sequence[Event]) -> Iterator[int]:
    """Places of calls that only prepare or end a case, or undo something, unless the case is about that service.

    An activation counts only if it was not answered: it undoes a deactivation that may have been deadly.
    """
    for place, event in enumerate(events):
        if event.direction != "call":
            continue
        answered = any(each.direction == "answer" for each in events[place + 1 : place + 2])
        undoes = event.text == "BP-DeregisterProtocol" or (event.text.endswith("-MGMT-Activate") and not answered)
        if event.text.startswith("UT-") or (undoes and not concerns(case, event.text)):
            yield place
