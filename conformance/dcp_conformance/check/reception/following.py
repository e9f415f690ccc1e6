"""Data types for nodes, variables, and the reactions that are due: the state of :class:`.observer.Observer`."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from operator import itemgetter
from typing import Final, NamedTuple

import msgspec
from dcp_spec.constants import ICType

from dcp_conformance.check.statements import Statement

#: Number of beacons for which a number that a node has stated is assumed to be valid.
FRESH = 20
#: Number of beacons of a node whose times are kept: the causes of a reaction are not older.
_TIMES = 16
#: Reactions with the same delay that show when a node composes payloads, if they are ``MOSTLY`` times as many as those
#: with the other delay.
DELAYS, MOSTLY = 4, 3
#: Maximum number of frames of an interval that are kept.
_FRAMES = 32


NOTHING: Final = Statement(ICType.SUMMARIES, None, 0, 0, b"", 0, -1)
"""A record that stands for none."""


class Kind(Enum):
    """The reactions that the specification demands from a node that hears a record."""

    TAKE_CREATE = "stores a variable after hearing its create"
    TAKE_UPDATE = "stores a newer value after hearing its update"
    TAKE_DELETE = "deletes a variable after hearing its delete"
    ASK_UPDATE = "requests the update after hearing a summary with a newer number"
    ASK_CREATE = "requests the create after hearing another record of an unknown variable"
    ANSWER_UPDATE = "sends an update after hearing a request with an older number"
    ANSWER_CREATE = "sends a create after hearing a request for it"
    TEACH = "sends an update after hearing a summary or update with an older number"

    # Members are compared by identity; the hash of the standard library is computed in Python.
    __hash__ = object.__hash__


class Proof(NamedTuple):
    """Proof that a node has received a frame: it reacted to a record that only this frame, or these frames, carried.

    Times are ns of :attr:`Observer.time`: the proof is void if the recorder missed a beacon of another node between
    them.
    """

    frames: tuple[int, ...]
    """The frames that can have caused the reaction; the node has received at least one of them."""
    reaction: Statement
    """The record that shows the reaction."""
    since: int
    until: int


Event = tuple[int, int, int, Statement, bool, int, int, int]
"""A record that demands a reaction: the number of earlier events; the nodes that must react, as a mask of bits; the bit
of its sender; the record; whether it is in the second half of its payload; the length of the VarDis payload in octets;
the time in ns of :attr:`Observer.time`; the number of the frame, negative if it has errors."""
_SPEAKER, _LATE_HALF, _LENGTH, _FRAME = map(itemgetter, (2, 4, 5, 7))


@dataclass(slots=True, eq=False)
class Interval:
    """The records between two successive beacons of a node that call for one kind of reaction to one variable."""

    begin: int
    """Number of beacons that the node had sent before them."""
    time: int = 0
    """Time of the first of them, ns of :attr:`Observer.time`."""
    cause: Statement = NOTHING
    """The first of them."""
    speakers: int = 0
    """Their senders, as a mask of bits."""
    late_half: bool = True
    """Whether each of them was in the second half of its payload."""
    length: int = 0
    """Length of the shortest VarDis payload with one of them, in octets."""
    frames: list[int] = field(default_factory=list)
    """Numbers of the frames with one of them; negative for a frame with errors, which a node may ignore."""
    cut: bool = False
    """Whether earlier intervals, or frames, were dropped to save memory."""
    proof: Proof | None = None
    """Proof that the node has received a record of this interval."""
    again: dict[int, int] | None = None
    """Senders (bits) of several beacons with one of them, each with the number of its further beacons."""

    def add(self, events: Sequence[Event]) -> None:
        """Add records, in order."""
        speakers = sum(map(_SPEAKER, events))
        if not self.frames:
            _, _, _, self.cause, _, self.length, self.time, _ = events[0]
            if speakers.bit_count() == len(events) <= _FRAMES:
                # The sum of different bits: each speaker has sent one record.
                self.speakers, self.frames = speakers, [*map(_FRAME, events)]
                self.late_half, self.length = all(map(_LATE_HALF, events)), min(map(_LENGTH, events))
                return
        for _, _, speaker, _, late_half, length, _, frame in events:
            self.late_half = self.late_half and late_half
            self.length = min(self.length, length)
            if self.frames and frame == self.frames[-1]:
                continue
            if self.speakers & speaker:
                self.again = self.again or {}
                self.again[speaker] = self.again.get(speaker, 0) + 1
            self.speakers |= speaker
            if len(self.frames) < _FRAMES:
                self.frames.append(frame)
            else:
                self.frames[-1], self.cut = frame, True


Exposure = tuple[tuple[int, int], ...]
"""Speakers (bits, ascending), each with the number of its beacons that gave a node the same reason to react."""


Occasions = dict[Kind, list[Interval]]
"""The reactions to one variable that a node owes, by kind, with the intervals that caused them; no list is empty."""


@dataclass(slots=True, eq=False)
class Station:
    """A node whose reactions are followed."""

    node: bytes
    """Node identifier."""
    bit: int
    """The bit of the node in masks of nodes."""
    listens: bool
    """Whether reactions can be expected: False for the sender of forged beacons."""
    since: int
    """Time of its first beacon in this life, ns since 1970."""
    life: int = 0
    """Number of its restarts (:meth:`Senders.life`)."""
    hears: int = -1
    """The nodes that it hears according to the user, as a mask of bits; all if the user has told nothing."""
    beacons: int = 0
    """Number of its beacons with VarDis records."""
    gap: int = 0
    """Value of ``beacons`` at the first beacon after the last gap."""
    time: int = 0
    """Time of its last beacon, ns since 1970."""
    longest: int = 0
    """Length of its longest beacon, in octets."""
    waiting: dict[int, None] = field(default_factory=dict)
    """Variables with open occasions that it does not hold."""
    repetitions: int = 0
    """The largest repCnt that it has sent."""
    value: int = 0
    """The longest value that it has sent, in octets."""
    description: int = 0
    """The longest description that it has sent, in octets."""
    holds: dict[int, int] = field(default_factory=dict)
    """Variable -> the sequence number that it stated last."""
    stated: deque[tuple[int, list[dict[int, int]]]] = field(default_factory=lambda: deque(maxlen=FRESH + 1))
    """Its latest beacons: value of ``beacons``, and the variables in the creates, updates and summaries."""
    sent: dict[tuple[int, ICType], int] = field(default_factory=dict)
    """Variable and CREATE or UPDATE -> value of ``beacons`` when it sent such a record last."""
    had: dict[int, int] = field(default_factory=dict)
    """Variable that it has deleted -> the latest creation time that it can have known."""
    open: dict[int, Occasions] = field(default_factory=dict)
    """Variable -> its open occasions."""
    delays: tuple[int, int] = (0, 0)
    """Number of its reactions in its first, and in its second beacon after the cause."""
    cursor: int = 0
    """Number of events (of all nodes) that it has processed."""
    times: deque[int] = field(default_factory=lambda: deque(maxlen=_TIMES))
    """Times of its latest beacons, ns of :attr:`Observer.time`."""

    @property
    def composes_late(self) -> bool:
        """Whether it composes its payloads immediately before it sends them, as its reactions show."""
        first, second = self.delays
        return first >= DELAYS and first >= MOSTLY * second

    def has_stated(self, var_id: int, since: int) -> bool:
        """Return whether the node has stated the number of a variable in its beacon ``since`` or a later one.

        Only its last ``FRESH`` beacons are known.
        """
        for number, stated in reversed(self.stated):
            if number < since:
                return False
            for each in stated:
                if var_id in each:
                    return True
        return False

    def sent_at(self, number: int) -> int:
        """Return the time of its beacon ``number`` (from 1), ns; if that is not kept, the time of the oldest kept one.

        0 if it has sent none.
        """
        times = self.times
        if not times:
            return 0
        return times[max(len(times) - 1 - (self.beacons - number), 0)]


@dataclass(slots=True, eq=False)
class Population:
    """Sets of the nodes that are followed, as masks of their bits."""

    listeners: int = 0
    """The nodes from which reactions can be expected."""
    count: int = 0
    """The number of these nodes."""
    early: int = 0
    """The nodes that may have known variables before their first beacon in the recording."""


class Trial(msgspec.Struct, frozen=True, gc=False):
    """An occasion with a known outcome."""

    time: int
    """ns of :attr:`Observer.time`."""
    station: Station
    """The node that had to react."""
    kind: Kind
    var_id: int
    exposure: Exposure
    hit: bool
    """Whether the node reacted."""
    cause: Statement
    """One of these records."""
    late_half: bool
    """Whether each of them was in the second half of its payload."""
    length: int
    """Length of the shortest payload with one of them, in octets."""
    once: bool = False
    """Whether only one beacon can be the cause of the reaction."""
    delay: int = 0
    """Of a reaction: number of beacons of the node since the first cause, including the one with the reaction; 0: not
    known."""
    at_once: Exposure = ()
    """The causes of the reaction if the node composes a payload immediately before it sends it."""
    ahead: Exposure = ()
    """The causes of the reaction if the node composes a payload one beacon ahead."""
    since: int = 0
    """Of a reaction: the earliest time at which its cause may have been sent, ns of :attr:`Observer.time`."""
    until: int = 0
    """Of a reaction: the time of the beacon with it, ns of :attr:`Observer.time`."""
    proof: Proof | None = None
    """Of a missing reaction: proof that the node has received the record."""
    open_cause: bool = False
    """True if a repetition or a timeout can cause the reaction, without a received record."""

    @property
    def speakers(self) -> int:
        """The senders of the records that called for the reaction, as a mask of bits."""
        return sum(bit for bit, _ in self.exposure)


@dataclass(slots=True, eq=False)
class Variable:
    """The state of a variable identifier at all nodes. Sets of nodes are masks of their bits."""

    var_id: int
    holders: dict[int, int] = field(default_factory=dict)
    """Sequence number -> the nodes that stated it last."""
    known: int = 0
    """The nodes that hold any number."""
    deleted: int = 0
    """The nodes that have deleted the variable and have not stated a number since."""
    producers: set[bytes] = field(default_factory=set)
    """The producers named in creates."""
    produced: int = 0
    """The producers among the nodes that are followed."""
    introducers: int = 0
    """The nodes that were the first to send some number."""
    consumers: int = 0
    """The nodes whose last create names another node as the producer."""
    apart: int = 0
    """The nodes that hold a newer number than a known producer states, and may therefore be producers themselves."""
    created: int = 0
    """The latest creation time in a create."""
    repetitions: int = 0
    """The largest repCnt in a create; 0 if no create was heard."""
    expires: bool = False
    """True if a create has a timeout: nodes then delete the variable without a VarDelete."""
    born: bool = False
    """Whether the recording shows the first creation by the producer."""
    last_create: int = 0
    """Number of the last frame with a create."""
    value: int = 8
    """Length of the last value, in octets."""
    create: int = 60
    """Size of the last create, in octets."""
