"""The part of the findings before the first case that cases and their verdicts use."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, Protocol

from dcp_codec.codec import Codec
from dcp_conformance.definitions.pics import REACTION_FLOOR
from dcp_conformance.frames.received import ReceivedBeacon

from .traffic import Event

UNREADABLE: Final = "judged by the rules for every beacon"
"""End of the observation of a case that beacons leave undecided because they cannot be read."""

Question = Literal["summary", "create", "request"]
"""Kinds of stimulus that VarDis must answer with a beacon."""
Misread = Literal["creationTime", "report", "VarCreate", "VarDis", "size"]
"""Something that can be misread: the creationTime of a VarSpecT; a whole state report or VarCreate; all payloads of
VarDis, because its own records have another layout; the size of headers or records."""


class Reaction(NamedTuple):
    """The measured reaction time of the implementation, in beacon periods."""

    periods: float = REACTION_FLOOR
    """Time limit for the answer to a single question: the longest measured time and a margin."""
    per_payload: float = 0.0
    """Additional time for each received payload that is processed before the question; 0: all are processed at once."""
    samples: tuple[float, ...] = ()
    """The measured times from question to answer; empty if no question was answered."""

    def __str__(self) -> str:
        if not self.samples:
            return f"{self.periods:g} beacon periods (not measured: no answer)"
        one = f", and {self.per_payload:.2g} for each payload that waits" if self.per_payload else ""
        return (
            f"{self.periods:.1f} beacon periods{one} (slowest of {len(self.samples)} answers: {max(self.samples):.2f})"
        )


class Failure(NamedTuple):
    """A failed check, and what its case has sent and received so far."""

    requirements: frozenset[str]
    shown: bool
    """Whether received octets prove the failure; otherwise something is missing."""
    relied: frozenset[Misread]
    """The fields that the check depends on."""
    on_air: bool
    """Whether the check is about received frames."""
    codec: Codec
    events: Sequence[Event]
    heard: Sequence[ReceivedBeacon]
    """The beacons of the implementation."""
    created: Collection[int]
    """Identifiers of the variables that the case has created."""
    sut_id: bytes | None
    """The implementation's node identifier, if it is known."""
    wall: int
    """The current time in ns since 1970."""


class Cause(NamedTuple):
    """The finding that a failed check follows from."""

    text: str
    certain: bool = False
    """Whether the finding explains the failure even if the tester has lost something."""


@dataclass
class Known:
    """The findings about the implementation: none, until :mod:`dcp_conformance.interconnection` adds some."""

    reaction: Reaction = field(default_factory=Reaction)
    """The reaction time of the implementation; without samples before the measurement, or if nothing was answered."""
    lost_container: str = ""
    """The container of a payload that the implementation loses, "first" or "second"; empty if none."""

    @property
    def processing(self) -> float:
        """Number of beacon periods after which a frame that was sent has been processed: the slowest measured answer.

        It includes the wait for a beacon.
        """
        return max((0.5, *self.reaction.samples))

    @property
    def question(self) -> Question:
        """The kind of stimulus for probes of VarDis."""
        return "summary"

    def cause(self, failure: Failure) -> Cause | None:  # noqa: ARG002 - nothing is known
        """Return the finding that a failed check follows from; None if the failure counts."""
        return None


class RunFindings(Protocol):
    """The findings of a run about the implementation."""

    sut_id: bytes | None
    """Its node identifier, once it is known."""
    known: Known
