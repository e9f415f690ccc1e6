"""Occasions: what a node says that others must react to if they hear it, and whether they do.

Nobody knows whether a node heard a beacon that the recorder heard. So an occasion is not yet a fault or a proof: it is
a trial whose outcome depends on who of the speakers was heard, and :mod:`.links` infers that from all trials together.

An occasion ends with the reaction, or with a later statement that the reaction did not happen: a node that has taken an
update does not summarise the older number four beacons later. Silence alone decides only where payloads had room.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

from dcp_spec.constants import ICType

from dcp_conformance.check.base import MOST_VARIABLES, Context, Seen
from dcp_conformance.check.statements import Statement
from dcp_conformance.check.stations import Origin
from dcp_conformance.model.circular import Circle

from .records import RecordSizes

CREATE, DELETE, UPDATE, SUMMARY = (
    ICType.CREATE_VARIABLES,
    ICType.DELETE_VARIABLES,
    ICType.UPDATES,
    ICType.SUMMARIES,
)
ASK_UPDATE, ASK_CREATE = ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES

#: The reaction to what was heard between two beacons comes with the third after it at the latest: one payload may have
#: been composed before, and one may wait for a payload of another protocol.
LATE = 4
#: For so many beacons a reaction can be due to what was said right before the last one.
_CARRIED = 3
#: Occasions of one node, kind and variable that can be open at the same time.
_OPEN = 8
#: A statement of a node about a variable is believed for so many of its beacons.
_FRESH = 20
#: Nodes whose reactions are followed; a bit of a mask for each.
MOST_NODES = 64
#: Payloads up to this length leave room: the bearer carries 256 octets at least.
_ROOM = 180


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


#: Those whose outcome a statement of the number shows.
_STATED = (Kind.TAKE_UPDATE, Kind.ASK_UPDATE, Kind.ANSWER_UPDATE, Kind.TEACH, Kind.ANSWER_CREATE, Kind.TAKE_DELETE)
_ABSENT = (Kind.TAKE_CREATE, Kind.ASK_CREATE)


@dataclass(slots=True, eq=False)
class Station:
    """A node whose reactions are followed."""

    node: bytes
    bit: int
    listens: bool
    """Whether it is a node at all, and not a forger of beacons."""
    since: int
    """When it was heard first in this life, ns since 1970."""
    early: bool
    """Whether it may have known variables before it was first heard."""
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


@dataclass(slots=True, eq=False)
class Interval:
    """What was said between two beacons of a node that it must react to."""

    begin: int
    time: int
    cause: Statement
    speakers: int
    """Who said it, as bits."""
    late_half: bool
    """Whether all of it stood in the second half of its payload."""
    length: int
    """The length of the shortest payload with it."""
    frame: int
    """The beacon that said it last."""
    beacons: int = 1


class Trial(NamedTuple):
    """An occasion whose outcome is known."""

    time: int
    station: Station
    kind: Kind
    var_id: int
    speakers: int
    hit: bool
    cause: Statement
    late_half: bool
    length: int
    once: bool = False
    """Of a reaction: whether there was a single beacon that it can be due to."""


@dataclass(slots=True, eq=False)
class Variable:
    """What nodes have said of an identifier."""

    holds: dict[int, int] = field(default_factory=dict)
    """Bit of a node -> the number that it stated last."""
    said: dict[int, int] = field(default_factory=dict)
    """Bit of a node -> the beacon in which it did."""
    count: dict[int, int] = field(default_factory=dict)
    """Number -> how many nodes hold it."""
    had: dict[int, int] = field(default_factory=dict)
    """Bit of a node that once had it -> the latest creation time that it can have had."""
    producers: set[bytes] = field(default_factory=set)
    introducers: set[bytes] = field(default_factory=set)
    """Who was the first to send a number."""
    created: int = 0
    """The latest creation time that was said."""
    born: bool = False
    """Whether the recording shows its first creation, by its producer."""
    value: int = 8
    create: int = 60
    """Octets of its last update and create."""
    last_create: Statement | None = None
    open: dict[int, dict[Kind, list[Interval]]] = field(default_factory=dict)
    """Bit of a node -> its open occasions."""


class Observer:
    """Follows what all nodes say; gives :class:`Trial` to ``outcome``."""

    def __init__(self, context: Context, outcome: Callable[[Trial], None]) -> None:
        self._context = context
        self._outcome = outcome
        self._sizes = RecordSizes(context.profile)
        self.circle = Circle(context.profile.types.var_seqno.width)
        self.stations: dict[bytes, Station] = {}
        self._listeners: list[Station] = []
        self.by_bit: dict[int, Station] = {}
        self.variables: dict[int, Variable] = {}
        self._times = context.features.creation_time
        self._carried: dict[tuple[int, int, Kind], tuple[int, int]] = {}
        """(bit, variable, kind) -> the beacon of the last reaction, and who spoke right before it."""
        self._asks_on = context.profile.spec_version >= "1.1"
        """Whether requests for unknown variables make a node ask as well (VD-RC-01, VD-RU-01)."""
        self._first: int | None = None
        self.time = 0
        """A clock that goes on by itself where that of the recorder is set, in ns."""
        self._wall = 0

    # -- input ---------------------------------------------------------------------------------------------------------

    def feed(self, seen: Seen) -> None:
        """A beacon, in the order of the recording."""
        if self._first is None:
            self._first = self._wall = seen.time
        self.time += min(max(seen.time - self._wall, 0), 1_000_000_000)
        self._wall = seen.time
        said = seen.said
        if not said:
            return
        station = self._station(seen)
        if station is None:
            return
        station.beacons += 1
        asked = self._settle(station, said)
        self._decide(station, said, asked, len(seen.heard.octets))
        station.longest = max(station.longest, len(seen.heard.octets))
        self._occasions(station, seen)

    def _station(self, seen: Seen) -> Station | None:
        station = self.stations.get(seen.sender)
        sender = self._context.senders.get(seen.sender)
        if sender is None:
            return None
        if station is None:
            if len(self.stations) >= MOST_NODES:
                return None
            begins = (
                seen.heard.seqno is not None
                and seen.heard.seqno <= self._context.profile.behaviour.first_beacon_seqno + 2
            )
            station = Station(
                seen.sender,
                1 << len(self.stations),
                seen.origin is not Origin.FORGED,
                seen.time,
                not begins,
                sender.life,
            )
            self.stations[seen.sender] = self.by_bit[station.bit] = station
            if station.listens:
                self._listeners.append(station)
        elif sender.life != station.life:
            self._forget(station)
            station.life, station.since = sender.life, seen.time
            station.early = not (seen.heard.seqno is not None and seen.heard.seqno <= 20)
            station.gap = station.beacons + 1
        elif sender.unbroken > station.time:
            self._drop_all(station)
            station.gap = station.beacons + 1
        station.time = sender.time
        return station

    def _forget(self, station: Station) -> None:
        """It was restarted, or may have been."""
        self._drop_all(station)
        for variable in self.variables.values():
            self._hold(variable, station.bit, None)
            variable.said.pop(station.bit, None)
            variable.had.pop(station.bit, None)

    def _drop_all(self, station: Station) -> None:
        for variable in self.variables.values():
            variable.open.pop(station.bit, None)
        station.waiting.clear()

    def _hold(self, variable: Variable, bit: int, number: int | None) -> None:
        before = variable.holds.get(bit)
        if before == number:
            return
        if before is not None:
            left = variable.count[before] - 1
            if left:
                variable.count[before] = left
            else:
                del variable.count[before]
        if number is None:
            del variable.holds[bit]
        else:
            variable.holds[bit] = number
            variable.count[number] = variable.count.get(number, 0) + 1

    def _variable(self, var_id: int) -> Variable | None:
        variable = self.variables.get(var_id)
        if variable is None and len(self.variables) < MOST_VARIABLES:
            variable = self.variables[var_id] = Variable()
        return variable

    # -- reactions -----------------------------------------------------------------------------------------------------

    def _settle(self, station: Station, said: Iterable[Statement]) -> set[tuple[int, ICType]]:
        """What a beacon shows that a node has done; what it says, by variable and kind."""
        bit, stated = station.bit, set()
        for each in said:
            kind, var_id = each.kind, each.var_id
            variable = self.variables.get(var_id) or self._variable(var_id)
            if variable is None:
                continue
            opened = variable.open.get(bit)
            stated.add((var_id, kind))
            if kind is SUMMARY or kind is UPDATE or kind is CREATE:
                self._states(station, variable, each, opened)
            elif kind is DELETE:
                if opened:
                    self._hit(station, var_id, opened, Kind.TAKE_DELETE)
                    variable.open.pop(bit, None)
                if bit in variable.holds:
                    self._hold(variable, bit, None)
                variable.had[bit] = variable.created
                station.waiting.pop(var_id, None)
            elif opened:
                self._hit(station, var_id, opened, Kind.ASK_UPDATE if kind is ASK_UPDATE else Kind.ASK_CREATE)
        return stated

    def _states(
        self, station: Station, variable: Variable, each: Statement, opened: dict[Kind, list[Interval]] | None
    ) -> None:
        """A node states a number."""
        bit, kind = station.bit, each.kind
        record: Any = each.record
        if kind is CREATE:
            number = record.upd.seqno
            self._created(station, variable, each)
        else:
            number = record.seqno
            if kind is UPDATE:
                variable.value = len(record.value)
                station.value = max(station.value, len(record.value))
        had = variable.holds.get(bit)
        if opened:
            if had is None:
                self._hit(station, each.var_id, opened, Kind.TAKE_CREATE)
                opened.clear()
                station.waiting.pop(each.var_id, None)
            elif number != had:
                if self.circle.newer(number, had):
                    self._hit(station, each.var_id, opened, Kind.TAKE_UPDATE)
                # Otherwise it is another creation, of which nothing of this was due.
                opened.clear()
            if kind is UPDATE:
                self._hit(station, each.var_id, opened, Kind.ANSWER_UPDATE)
                self._hit(station, each.var_id, opened, Kind.TEACH)
            elif kind is CREATE:
                self._hit(station, each.var_id, opened, Kind.ANSWER_CREATE)
                opened.pop(Kind.ANSWER_UPDATE, None)
                opened.pop(Kind.TEACH, None)
            if not opened:
                variable.open.pop(bit, None)
        if number != had:
            newest = not any(each == number or self.circle.newer(each, number) for each in variable.count)
            if kind is UPDATE and newest and variable.count:
                variable.introducers.add(station.node)
            self._hold(variable, bit, number)
        variable.said[bit] = station.beacons
        variable.had[bit] = variable.created

    def _created(self, station: Station, variable: Variable, each: Statement) -> None:
        spec, upd = each.record.spec, each.record.upd
        if not variable.producers and not variable.holds and spec.prod_id == station.node and upd.seqno == 0:
            variable.born = True
        variable.producers.add(spec.prod_id)
        variable.created = max(variable.created, spec.creation_time or 0)
        variable.create, variable.value = self._sizes.of(CREATE, each.record), len(upd.value)
        variable.last_create = each
        station.repetitions = max(station.repetitions, spec.rep_cnt)
        station.value = max(station.value, len(upd.value))
        station.description = max(station.description, len(spec.descr))

    def _hit(self, station: Station, var_id: int, opened: dict[Kind, list[Interval]], kind: Kind) -> None:
        intervals = opened.pop(kind, None)
        if not intervals:
            return
        # The payload may have been composed a beacon ago: then what came last is the cause of the next reaction.
        key = (station.bit, var_id, kind)
        before, speakers = self._carried.pop(key, (-_CARRIED, 0))
        if station.beacons - before >= _CARRIED:
            speakers = 0
        once = len(intervals) == 1 and not speakers and intervals[0].beacons == 1
        carried = 0
        for each in intervals:
            speakers |= each.speakers
            if each.begin >= station.beacons - 1:
                carried |= each.speakers
        if carried and len(self._carried) < MOST_VARIABLES:
            self._carried[key] = (station.beacons, carried)
        last = intervals[-1]
        self._outcome(
            Trial(
                last.time, station, kind, var_id, speakers, True, last.cause,
                all(each.late_half for each in intervals), min(each.length for each in intervals), once,
            )
        )  # fmt: skip

    # -- what did not happen -------------------------------------------------------------------------------------------

    def _decide(
        self, station: Station, said: Iterable[Statement], stated: set[tuple[int, ICType]], length: int
    ) -> None:
        """Occasions that this beacon shows to have been missed."""
        bit, now = station.bit, station.beacons
        for each in said:
            if each.kind is not SUMMARY and each.kind is not UPDATE and each.kind is not CREATE:
                continue
            variable = self.variables.get(each.var_id)
            opened = variable.open.get(bit) if variable is not None else None
            if variable is None or not opened:
                continue
            for kind in list(opened):
                if kind not in _STATED or opened[kind][0].begin + LATE > now:
                    continue
                if not self._had_room(station, kind, variable, each.var_id, stated, length):
                    continue
                self._miss(station, each.var_id, opened, kind, now)
            if not opened:
                variable.open.pop(bit, None)
        for var_id in list(station.waiting):
            variable = self.variables[var_id]
            opened = variable.open.get(bit, {})
            for kind in _ABSENT:
                if kind in opened and opened[kind][0].begin + LATE <= now:
                    need = variable.create if kind is Kind.TAKE_CREATE else 4
                    if self._room(station, length, need):
                        self._miss(station, var_id, opened, kind, now)
            if not opened:
                variable.open.pop(bit, None)
                station.waiting.pop(var_id, None)

    def _had_room(
        self,
        station: Station,
        kind: Kind,
        variable: Variable,
        var_id: int,
        stated: set[tuple[int, ICType]],
        length: int,
    ) -> bool:
        """Whether the reaction would have found room in this payload, and is not in it."""
        if kind is Kind.ASK_UPDATE:
            return (var_id, ASK_UPDATE) not in stated and self._room(station, length, 4)
        if kind is Kind.ANSWER_CREATE:
            return (var_id, CREATE) not in stated and self._room(station, length, variable.create)
        if kind in (Kind.ANSWER_UPDATE, Kind.TEACH):
            return (var_id, UPDATE) not in stated and self._room(station, length, variable.value + 8)
        return True

    @staticmethod
    def _room(station: Station, length: int, need: int) -> bool:
        return length + need <= max(_ROOM, station.longest * 0.9)

    def _miss(self, station: Station, var_id: int, opened: dict[Kind, list[Interval]], kind: Kind, now: int) -> None:
        intervals = opened[kind]
        while intervals and intervals[0].begin + LATE <= now:
            each = intervals.pop(0)
            self._outcome(
                Trial(each.time, station, kind, var_id, each.speakers, False, each.cause, each.late_half, each.length)
            )
        if not intervals:
            del opened[kind]

    # -- occasions -----------------------------------------------------------------------------------------------------

    def _occasions(self, speaker: Station, seen: Seen) -> None:
        """What others have to do about a beacon."""
        begins: list[int] | None = None
        total, everybody = 0, len(self._listeners)
        for place, each in enumerate(seen.said):
            variable = self.variables.get(each.var_id)
            if variable is None:
                continue
            kind = each.kind
            if kind is SUMMARY or kind is UPDATE or kind is CREATE:
                number = each.record.upd.seqno if kind is CREATE else each.record.seqno
                if len(variable.count) == 1 and len(variable.holds) >= everybody and number in variable.count:
                    continue
            elif not variable.holds and kind is not ASK_CREATE:
                continue
            for station in self._listeners:
                if station is speaker:
                    continue
                due = self._due(station, variable, each)
                if due is None:
                    continue
                if begins is None:
                    begins, total = self._sizes.starts(seen.said)
                self._open(station, variable, due, each, speaker.bit, 2 * begins[place] >= total, total)

    def _due(self, station: Station, variable: Variable, each: Statement) -> Kind | None:
        """What a node has to do about a record, if it hears it."""
        kind, bit = each.kind, station.bit
        has = variable.holds.get(bit)
        if has is None:
            return self._due_of_unknown(station, variable, each)
        if variable.said[bit] < max(station.gap, station.beacons - _FRESH):
            return None
        produces = station.node in variable.producers
        if kind is ASK_CREATE:
            return Kind.ANSWER_CREATE
        if kind is DELETE:
            return None if produces or not variable.producers else Kind.TAKE_DELETE
        record: Any = each.record
        number = record.upd.seqno if kind is CREATE else record.seqno
        if number == has:
            return None
        if kind is ASK_UPDATE:
            return Kind.ANSWER_UPDATE if self.circle.newer(has, number) else None
        if produces or (not variable.producers and (not variable.introducers or station.node in variable.introducers)):
            return None
        if self.circle.newer(number, has):
            return None if kind is CREATE else Kind.TAKE_UPDATE if kind is UPDATE else Kind.ASK_UPDATE
        if self.circle.newer(has, number) and kind is not CREATE:
            return Kind.TEACH
        return None

    def _due_of_unknown(self, station: Station, variable: Variable, each: Statement) -> Kind | None:
        kind, bit = each.kind, station.bit
        if kind is DELETE or station.node in variable.producers:
            return None
        if kind in (ASK_CREATE, ASK_UPDATE) and not self._asks_on:
            return None
        if bit in variable.had:
            # It had it once, and has deleted it: it need not ask again, and takes nothing but a later creation.
            later = kind is CREATE and self._times and each.record.spec.creation_time > variable.had[bit]
            return Kind.TAKE_CREATE if later else None
        if not variable.born and station.early:
            # It may have had it, and have deleted it, before the recording began.
            return None
        if kind is CREATE:
            return Kind.TAKE_CREATE if each.record.spec.prod_id != station.node else None
        return Kind.ASK_CREATE

    def _open(
        self,
        station: Station,
        variable: Variable,
        kind: Kind,
        each: Statement,
        speaker: int,
        late_half: bool,
        length: int,
    ) -> None:
        opened = variable.open.setdefault(station.bit, {})
        if kind in _ABSENT:
            station.waiting[each.var_id] = None
        intervals = opened.setdefault(kind, [])
        if intervals and intervals[-1].begin == station.beacons:
            last = intervals[-1]
            last.speakers |= speaker
            last.late_half = last.late_half and late_half
            last.length = min(last.length, length)
            last.beacons += each.frame != last.frame
            last.frame = each.frame
            return
        intervals.append(Interval(station.beacons, self.time, each, speaker, late_half, length, each.frame))
        if len(intervals) > _OPEN:
            intervals.pop(0)
