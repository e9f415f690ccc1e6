"""What is remembered of nodes and variables: what each node has said, and what it still has to do about others."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from dcp_conformance.check.statements import Statement


class Kind(Enum):
    """What a node has to do about what it hears."""

    TAKE_CREATE = "knows a variable whose create it hears"
    TAKE_UPDATE = "has a newer value that it hears"
    TAKE_DELETE = "deletes a variable whose delete it hears"
    ASK_UPDATE = "asks for a value that is newer by a summary"
    ASK_CREATE = "asks for a variable that it does not know"
    ANSWER_UPDATE = "sends a newer value to who asks for it"
    ANSWER_CREATE = "sends a create to who asks for it"
    TEACH = "sends its value to who has an older one"

    # Members are compared by identity; the hash of the standard library is computed in Python.
    __hash__ = object.__hash__


@dataclass(slots=True, eq=False)
class Interval:
    """What was said between two beacons of a node that it must react to."""

    begin: int
    time: int
    cause: Statement
    speakers: dict[int, int]
    """Who said it (bits), and in how many beacons."""
    late_half: bool
    """Whether all of it stood in the second half of its payload."""
    length: int
    """The length of the shortest payload with it."""
    frame: int
    """The beacon that said it last."""
    beacons: int = 1


Exposure = tuple[tuple[int, int], ...]
"""Speakers (bits, ascending), each with the number of its beacons that gave a node the same reason to react."""


Occasions = dict[Kind, list[Interval]]
"""What a node has to do about a variable, and since when; no list is empty."""


@dataclass(slots=True, eq=False)
class Station:
    """A node whose reactions are followed."""

    node: bytes
    bit: int
    listens: bool
    """Whether it is a node at all, and not a forger of beacons."""
    since: int
    """When it was heard first in this life, ns since 1970."""
    life: int = 0
    beacons: int = 0
    """With VarDis payloads."""
    gap: int = 0
    """The beacon before which some are missing."""
    time: int = 0
    longest: int = 0
    """The longest beacon, in octets."""
    waiting: dict[int, None] = field(default_factory=dict)
    """Variables that it does not have, with open occasions."""
    repetitions: int = 0
    value: int = 0
    description: int = 0
    """The largest that it has shown to take."""
    holds: dict[int, int] = field(default_factory=dict)
    """By variable: the number that it stated last."""
    said: dict[int, int] = field(default_factory=dict)
    """By variable: the beacon in which it did."""
    had: dict[int, int] = field(default_factory=dict)
    """By variable that it has deleted: the latest creation time that it can have had."""
    open: dict[int, Occasions] = field(default_factory=dict)
    """By variable: its open occasions."""
    cursor: int = 0
    """How many occasions of anybody it has looked at."""


class Event(NamedTuple):
    """A record to which nodes have to react if they hear it."""

    whom: int
    """Who has to, as bits."""
    kind: Kind
    var_id: int
    cause: Statement
    speaker: int
    late_half: bool
    """Whether it stands in the second half of its payload."""
    length: int
    """The length of the payload."""
    time: int


class Trial(NamedTuple):
    """An occasion whose outcome is known."""

    time: int
    station: Station
    kind: Kind
    var_id: int
    exposure: Exposure
    hit: bool
    cause: Statement
    late_half: bool
    length: int
    once: bool = False
    """Of a reaction: whether there was a single beacon that it can be due to."""
    delay: int = 0
    """Of a reaction: beacons of the node since the first reason, the one with the reaction included. 0: not known."""
    at_once: Exposure = ()
    """What it is due to if the node composes a payload right before it sends it."""
    ahead: Exposure = ()
    """What it is due to if the node composes it a beacon ahead."""

    @property
    def speakers(self) -> int:
        """Who gave the reason, as bits."""
        return sum(bit for bit, _ in self.exposure)


@dataclass(slots=True, eq=False)
class Variable:
    """What nodes have said of an identifier. Sets of nodes are masks of their bits."""

    var_id: int
    holders: dict[int, int] = field(default_factory=dict)
    """By number: who stated it last."""
    known: int = 0
    """Who holds any number."""
    deleted: int = 0
    """Who has deleted it, and has not stated a number since."""
    producers: set[bytes] = field(default_factory=set)
    produced: int = 0
    """The same, of the nodes that are followed."""
    introducers: int = 0
    """Who was the first to send a number."""
    created: int = 0
    """The latest creation time that was said."""
    born: bool = False
    """Whether the recording shows its first creation, by its producer."""
    value: int = 8
    create: int = 60
    """Octets of its last update and create."""
