"""Who is to blame for a death: confirmed alone, from a fresh start, before it is a verdict.

When the implementation is found dead or silent after a case, that case may have killed it, or the one before it (a
process takes a moment to die), or both together. Each is tried from a fresh start. What a case saw fail while the
implementation was dying is not held against the requirements of the case: only the death is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS

from dcp_codec.errors import DecodeError

from .bench import Bench
from .case import Case
from .life import Loss
from .results import Check, Table
from .traffic import Event, Traffic
from .verdict import Verdict, worst

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
    """What was done last in the case, apart from questions after its end."""
    detail: str = ""
    """Traceback of a fault of the tester."""

    @property
    def verdict(self) -> Verdict:
        """What the checks come to."""
        return worst(check.verdict for check in self.checks) or Verdict.INCONCLUSIVE


@dataclass(frozen=True, slots=True)
class Attribution:
    """What became of a case after which the implementation was found dead."""

    trial: Trial
    """The execution that counts for the case itself."""
    checks: tuple[Check, ...]
    """What counts for the case itself."""
    killed: bool
    """The case is to blame."""
    before: tuple[Check, ...] = ()
    """What is to be added to the case before it; empty if that is not to blame."""
    before_trial: Trial | None = None
    note: str = ""
    """What the run should say of it; empty if the blame says it all."""


Again = Callable[[Sequence[Case]], Trial | str]
"""Runs cases one after the other from a fresh start; the trial of the first that ends in a loss, else of the last. A
text says why the implementation could not be started."""


def attribute(trial: Trial, before: Case | None, again: Again | None) -> Attribution:
    """Find out which case ended the life of the implementation.

    ``before``: the case that ran before in the same life of the implementation, if there was one. ``again``: None if
    the implementation cannot be started by the tester.
    """
    loss, case = trial.loss, trial.case
    assert loss is not None
    if again is None:
        return _unconfirmed(trial, "", before)
    alone = again([case])
    if isinstance(alone, str):
        return _unconfirmed(trial, alone, before)
    if alone.loss is not None:
        # The first execution has the evidence of the whole run; both ended alike.
        return Attribution(trial, _blamed(trial, loss), killed=True)
    if before is None:
        return _not_reproduced(alone, trial, before)
    earlier = again([before])
    if isinstance(earlier, str):
        return _unconfirmed(trial, earlier, before)
    if earlier.loss is not None:
        note = f"{case.id} found the implementation dead: it {earlier.loss.how} of {before.id}, before it"
        return Attribution(
            alone, tuple(alone.checks), killed=False, before=_blamed(earlier, earlier.loss), before_trial=earlier,
            note=note,
        )  # fmt: skip
    both = again([before, case])
    if isinstance(both, str) or both.loss is None:
        return _not_reproduced(alone, trial, before)
    text = f" (only when it follows {before.id})"
    return Attribution(both, _blamed(both, both.loss, text), killed=True)


def _blamed(trial: Trial, loss: Loss, text: str = "") -> tuple[Check, ...]:
    """The checks of a case that is to blame: its death, and what it saw before without holding it against anybody."""
    if loss.upper_only:
        what = "the upper tester stays connected"
        check = Check(Verdict.INCONCLUSIVE, trial.case.requirements, what, loss.observed + text)
        return (check, *_withheld(trial, "its upper tester was gone"))
    table: Table = "robustness" if trial.case.robustness else "conformance"
    verdict = Verdict.INCONCLUSIVE if loss.doubtful else Verdict.FAIL
    death = Check(verdict, survival(trial), "the implementation survives", loss.observed + text, table=table)
    return (death, *_withheld(trial, f"the implementation {loss.how} in this case"))


def _withheld(trial: Trial, why: str) -> tuple[Check, ...]:
    """The checks of a trial, without blame for what a dead implementation did not do."""
    return tuple(
        msgspec.structs.replace(check, verdict=Verdict.INCONCLUSIVE, observed=f"{check.observed}; but {why}")
        if check.verdict is Verdict.FAIL
        else check
        for check in trial.checks
    )


def _unconfirmed(trial: Trial, why: str, before: Case | None) -> Attribution:
    """Without a fresh start there is no confirmation: a case is blamed if the implementation lived in it."""
    loss = trial.loss
    assert loss is not None
    if trial.bench.heard or (loss.died and before is None):
        # It lived when the case began, and no other case comes into question.
        text = f"; not confirmed: {why or 'there is no command to start it again (--start, --restart)'}"
        return Attribution(trial, _blamed(trial, loss, text), killed=True)
    text = loss.observed if not why else f"{loss.observed}; {why}"
    if before is not None:
        text += f"; nothing was heard in this case, so that {before.id} before it may have been the cause"
    what = "the implementation takes part in this case"
    check = Check(Verdict.INCONCLUSIVE, trial.case.requirements, what, text)
    return Attribution(trial, (check, *_withheld(trial, f"the implementation {loss.how}")), killed=False)


def _not_reproduced(alone: Trial, trial: Trial, before: Case | None) -> Attribution:
    """The death was seen once: a fact of the run, and no verdict about any case."""
    loss = trial.loss
    assert loss is not None
    tried = f"{trial.case.id} alone" + (f", {before.id} alone, and both in a row" if before is not None else "")
    text = f"{loss.observed}; not reproduced from a fresh start ({tried})"
    check = Check(Verdict.INCONCLUSIVE, survival(trial), "the implementation survives", text)
    note = f"the implementation {loss.how} once, in or before {trial.case.id}; it was not reproduced: {tried}"
    return Attribution(alone, (*alone.checks, check), killed=False, note=note)


def survival(trial: Trial) -> tuple[str, ...]:
    """The requirements that a death in this case violates.

    Those of the case that ask for survival; else the one that asks for surviving what was sent last. A service call
    that ends the implementation violates no requirement of the catalogue: the verdict is about the case alone.
    """
    named = tuple(each for each in trial.case.requirements if each in _SURVIVAL)
    if named:
        return named
    deadly = trial.stimulus
    if deadly is None or deadly.direction == "call":
        return ()
    codec = trial.bench.codec
    try:
        envelope, _ = codec.decode_envelope(deadly.frame[deadly.start :])
    except DecodeError:
        return (_SURVIVAL_OF_FRAMES,)
    carried = {each.protocol_id for each in envelope.payloads}
    return (_SURVIVAL_OF_PAYLOADS,) if BP_PROTID_VARDIS in carried else (_SURVIVAL_OF_FRAMES,)


def likely_stimulus(traffic: Traffic) -> Event | None:
    """What was done last to an implementation that died: frames sent since its last beacon, else the last stimulus.

    A call that follows a frame is often the tester's own cleaning up.
    """
    recent: Event | None = None
    for event in reversed(traffic.events):
        if event.direction == "heard" and recent is not None:
            break
        if event.direction == "sent":
            return event
        if event.direction == "call" and recent is None:
            recent = event
    return recent
