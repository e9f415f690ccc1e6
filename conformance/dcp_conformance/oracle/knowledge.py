"""What the model of a node knows of variables, and what it says."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from dcp_spec.constants import ICType

from dcp_codec.values import VarSpec

State = Literal["unknown", "alive", "deleted"]
#: Versions of a variable that are remembered: what it was a while ago.
VERSIONS = 64


@dataclass(frozen=True, slots=True)
class Limits:
    """The node's parameters that decide what it takes; lengths in octets."""

    max_value_length: int
    max_description_length: int
    max_repetitions: int


class Version(NamedTuple):
    """What a variable was from a time on."""

    since: int
    state: State
    spec: VarSpec | None
    seqno: int
    value: bytes


@dataclass(slots=True)
class Variable:
    """What the node holds of one variable, and held before."""

    versions: deque[Version] = field(default_factory=lambda: deque(maxlen=VERSIONS))
    armed: dict[tuple[ICType, int], int] = field(default_factory=dict)
    """(kind, number) -> beacons that it may stand in."""
    said: dict[tuple[ICType, int], int] = field(default_factory=dict)
    uncertain: bool = False

    @property
    def now(self) -> Version:
        """What it is."""
        return self.versions[-1]


class Owed(NamedTuple):
    """Something that the node has to say by ``deadline``."""

    deadline: int
    kind: ICType
    var_id: int
    seqno: int
    """For updates and creates: this number or a newer one."""
    requirement: str
    cause: int
    """Number of the frame that asks for it; 0 for a service call."""


class Complaint(NamedTuple):
    """Something that is not as the model has it."""

    requirement: str
    var_id: int
    expected: str
    observed: str
    frame: int
