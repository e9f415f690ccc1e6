"""Data of the model: the knowledge about variables, and the findings."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Literal, NamedTuple

import msgspec
from dcp_spec.constants import Features, ICType

from dcp_codec.values import Extra, VarCreate, VarSpec

from .repetitions import Repetitions

State = Literal["unknown", "alive", "deleted"]
#: Versions of a variable that are remembered: what it was a while ago.
VERSIONS = 64
#: A time that never comes, and one that was before all others.
NEVER, EVER = 1 << 62, -(1 << 62)
#: Earlier and later than any creation; times of some profiles are signed.
NO_CREATION, ANY_CREATION = -(1 << 128), 1 << 128


@dataclass(frozen=True, slots=True)
class Limits:
    """The node's parameters that decide what it takes; lengths in octets."""

    max_value_length: int
    max_description_length: int
    max_repetitions: int

    def acceptable(self, record: VarCreate, has: Features) -> bool:
        """Whether a received create may be taken at all (VD-PC-04 to VD-PC-06)."""
        spec, value = record.spec, record.upd.value
        if has.receive_checks_too_long and (
            len(value) > self.max_value_length or len(spec.descr) > self.max_description_length
        ):
            return False
        if has.receive_checks_empty_and_repcnt:
            return bool(value) and bool(spec.descr) and 0 < spec.rep_cnt <= self.max_repetitions
        return True

    def fitting(self, value: bytes, has: Features) -> bool:
        """Whether a received value may be taken at all (VD-PU-04)."""
        if has.receive_checks_too_long and len(value) > self.max_value_length:
            return False
        return bool(value) or not has.receive_checks_empty_and_repcnt


class Version(NamedTuple):
    """A state of a variable from a time on."""

    since: int
    state: State
    spec: VarSpec | None
    seqno: int
    value: bytes
    own: Extra | None = None
    """Values of the fields that the profile adds to VarUpdate; None if they are not known."""


_UNKNOWN = Version(EVER, "unknown", None, 0, b"")


class Variable(msgspec.Struct):
    """The present and earlier states of one variable at the node."""

    versions: deque[Version] = msgspec.field(default_factory=lambda: deque((_UNKNOWN,), VERSIONS))
    repetitions: Repetitions = msgspec.field(default_factory=Repetitions)
    uncertain: bool = False
    settled: int = EVER
    """Time (ns) at which the variable became certain; payloads composed before are not judged."""
    latest: int = NO_CREATION
    """The latest creation that the node may hold of it, where creations have times."""
    foreign: bool = False
    """Whether the node surely has it as the variable of another node, alive or deleted."""
    due: int = NEVER
    """Time (ns) at which the timeout of the variable passes."""

    @property
    def now(self) -> Version:
        """The present state."""
        return self.versions[-1]


class Obligation(msgspec.Struct, frozen=True, gc=False):
    """Something that the node has to say by ``deadline``."""

    deadline: int
    kind: ICType
    var_id: int
    seqno: int
    """For updates and creates: this number or a newer one."""
    requirement: str
    cause: int
    """Number of the frame that asks for it; 0 for a service call."""
    time: int = 0
    """When it was caused, ns."""


class Complaint(NamedTuple):
    """Something that is not as the model has it."""

    requirement: str
    var_id: int
    expected: str
    observed: str
    frame: int
