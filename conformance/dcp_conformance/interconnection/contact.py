"""Result of the basic interconnection test, and the later failures that follow from it.

An implementation that does not answer a kind of stimulus at all fails for that once, under the requirement to answer.
Every other case that waits for such an answer without success is inconclusive.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_conformance.definitions.results import Mark
from dcp_conformance.frames.header_rules import Violation
from dcp_conformance.frames.received import var_id_of
from dcp_conformance.test_system.known import Failure, Question
from dcp_conformance.test_system.traffic import Event, payloads, records

Stimulus = Literal["summary", "create", "request", "report", "payload", "transmit", "state", "variable"]
"""Kinds of stimulus to which an implementation can react."""

TOLD: Final[Mapping[Stimulus, str]] = {
    "summary": "a summary of an unknown variable",
    "create": "a VarCreate",
    "request": "a VarReqCreate",
    "report": "a state report",
    "payload": "a payload for a client protocol",
    "transmit": "BP-TransmitPayload",
    "state": "SRP-UpdateSafetyData",
    "variable": "RTDB-Create",
}
"""Text for each kind of stimulus."""

OWNERS: Final[Mapping[Stimulus, frozenset[str]]] = {
    "summary": frozenset({"VD-PS-01", "VD-IC-02"}),
    "create": frozenset({"VD-PC-07", "VD-PC-09", "VD-IC-02"}),
    "request": frozenset({"VD-RC-01", "VD-RC-03", "VD-IC-02"}),
    "report": frozenset({"SRP-RX-02"}),
    "payload": frozenset({"BP-RX-07", "BP-RXP-01"}),
    "transmit": frozenset({"BP-TX-01", "BP-TXP-09"}),
    "state": frozenset({"SRP-SRV-03"}),
    "variable": frozenset({"VD-CRE-12", "VD-RUN-02"}),
}
"""Requirements to answer each kind, or about the form of the answer: its absence never excuses their failures."""

ON_THE_AIR: Final[frozenset[Stimulus]] = frozenset({"summary", "create", "request", "transmit", "state", "variable"})
"""Kinds of stimulus that are answered with beacons."""

BEGINNING: Final = ("when the run began", "from the start of the run on")
"""Ends of excuses by what was found at the start of a run."""

_QUESTIONS: Final[frozenset[Stimulus]] = frozenset({"summary", "create", "request"})
_VARDIS: Final = _QUESTIONS | {"variable", "other"}
_SERVICES: Final[Mapping[str, Stimulus]] = {
    "RTDB-Create": "variable",
    "BP-TransmitPayload": "transmit",
    "SRP-UpdateSafetyData": "state",
}


@dataclass(frozen=True, slots=True)
class Contact:
    """How the implementation and the tester can communicate, as found at the start of a run."""

    frames: int
    """Number of frames received from the implementation."""
    beacons: int
    """Number of these frames with the header of a well-formed beacon of the profile."""
    answered: frozenset[Stimulus]
    """Kinds of stimulus that were answered."""
    unanswered: frozenset[Stimulus]
    """Kinds of stimulus that were not answered. Kinds that were not tried are in neither set."""
    violations: tuple[tuple[Violation, Mark], ...] = ()
    """One for each requirement that the frames violate, with the frame in the recording of the case."""
    suspicion: str = ""
    """The probable mistake in the setup, or the first thing to check; empty if nothing is wrong."""
    mistaken: bool = False
    """Whether the tester probably has a wrong profile, network identifier, EtherType or node identifier: received
    frames cannot be judged."""
    odd: str = ""
    """The record about the variable of a summary that was received instead of the answer; empty if none was."""
    inactive: bool = False
    """Whether BP sent no beacons before BP-MGMT-Activate, and has sent some since."""
    loses_last: bool = False
    """Whether it processes a block only if another one follows it."""
    trouble: str = ""
    """Why the upper tester did not answer; empty if it did, or if there is none."""
    blamed: frozenset[str] = frozenset()
    """The requirements that failed in the sanity case because of it."""

    @property
    def readable(self) -> bool:
        """Whether any frame of the implementation could be read."""
        return bool(self.beacons or self.answered & ON_THE_AIR)

    @property
    def good(self) -> bool:
        """Whether all stimuli were answered, and answers can be judged."""
        return not (self.mistaken or self.unanswered) and self.readable

    @property
    def question(self) -> Question:
        """The kind of stimulus for probes of VarDis: one that it answers, if there is one."""
        kinds: tuple[Question, ...] = ("summary", "create", "request")
        return next((kind for kind in kinds if kind in self.answered), "summary")

    def mute(self, entities: Collection[str]) -> bool:
        """Return whether one of these entities has answered nothing."""
        silent = {"vardis": self.unanswered >= _QUESTIONS, "srp": "report" in self.unanswered}
        return any(silent.get(each, False) for each in entities)

    def answers(self) -> str:
        """Describe which kinds of stimulus are answered and which are not."""
        yes, no = _listed(self.answered), _listed(self.unanswered)
        if not yes:
            heard = "it sends beacons and answers" if self.frames else "nothing was heard of it, and it answers"
            return f"{heard} none of {no}" if no else ""
        return f"it answers {yes}" + (f", but not {no}" if no else "")

    @property
    def own_records(self) -> str:
        """A text if its own records of VarDis have another layout; empty if not."""
        found = next((each for each, _ in self.violations if ".vardis" in each.path), None)
        return "" if found is None else f"its own records of VarDis are laid out otherwise: {found}"

    def resized(self, failure: Failure) -> str:
        """Return a text if the implementation's headers have another size; empty if not, or for a failure about it.

        With the wrong profile, for example, nothing is known of them.
        """
        if self.mistaken and not failure.requirements <= self.blamed:
            return self.suspicion
        found = (each for each, _ in self.violations if each.resized and each.requirement not in failure.requirements)
        return next((f"its headers have another size: {each}" for each in found), "")

    def excuse(self, failure: Failure) -> str:
        """Return why something missing in a case does not count; empty if it counts."""
        if self.good or failure.requirements <= self.blamed:
            return ""
        if self.mistaken:
            return f"the implementation could not be reached when the run began: {self.suspicion}"
        if not self.readable and all(each.header_problems for each in failure.heard):
            what = "none of its frames could be read" if self.frames or failure.heard else "nothing was heard of it"
            return f"{what} from the start of the run on{f': {self.suspicion}' if self.suspicion else ''}"
        if not self.unanswered:
            return ""
        mute = self.unanswered >= _QUESTIONS
        answered = {each.var_id for one in failure.heard for each in one.instructions(ICType.REQUEST_VARCREATES)}
        for kind, var_id in sorted(set(stimuli(failure.codec, failure.events, failure.created)), key=str):
            if mute and kind in _VARDIS:
                return "VarDis answered nothing that could be read when the run began"
            if kind == "other" or kind not in self.unanswered or (kind == "summary" and var_id in answered):
                continue
            # Wrong octets make every answer unreadable; without them, the missing answer itself is the fault.
            if self.violations or not OWNERS[kind] & failure.requirements:
                return f"the implementation did not answer {TOLD[kind]} when the run began"
        return ""


def stimuli(
    codec: Codec, events: Sequence[Event], made: Collection[int]
) -> Iterator[tuple[Stimulus | Literal["other"], int | None]]:
    """Yield the kinds of stimulus among events, each with its variable; None if it is not about a variable.

    ``made``: variables that the implementation may have learnt, so that a summary is another kind of stimulus.
    ``other``: any further stimulus for VarDis.
    """
    for event in events:
        if event.direction == "call" and event.text in _SERVICES:
            yield _SERVICES[event.text], None
        elif event.direction == "call" and event.text.startswith("RTDB-"):
            yield "other", None
    for payload in payloads(codec, events):
        if payload.srp is not None:
            yield "report", None
        if payload.data is not None:
            yield "payload", None
        found = [*records(payload)]
        if payload.srp is None and payload.data is None and not found:
            # A payload of other content for one of the known protocols.
            yield "payload", None
        for record in found:
            if (kind := record.IC_TYPE) is None:
                continue
            var_id = var_id_of(record)
            if kind is ICType.CREATE_VARIABLES:
                yield "create", var_id
            elif kind is ICType.REQUEST_VARCREATES:
                yield "request", var_id
            elif kind is ICType.SUMMARIES and var_id not in made:
                yield "summary", var_id
            else:
                yield "other", var_id


def _listed(kinds: Collection[Stimulus]) -> str:
    named = [TOLD[kind] for kind in TOLD if kind in kinds]
    return f"{', '.join(named[:-1])} and {named[-1]}" if len(named) > 1 else "".join(named)
