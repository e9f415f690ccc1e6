"""Follow the variables at all nodes, and find occasions: records that demand a reaction from the nodes that hear them.

The recording does not show whether a node received a beacon that the recorder received. A single missing reaction is
therefore no fault. It is a trial whose outcome depends on the speakers that the node hears, and :mod:`.links` infers
these from all trials together.

An occasion ends with the reaction, or with a later record that excludes it: a node that has taken an update does not
summarise the older number four beacons later. The absence of a record counts only if the payload had room for it.

Sets of nodes are masks of bits. A record is an occasion only for nodes with another number. Most of the time all nodes
have the same number of a variable, so that the cost depends on the changes, and not on the repeated summaries.
"""

from __future__ import annotations

import functools
from bisect import bisect_left
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Final

from dcp_conformance.check.base import MOST_VARIABLES, Context, Seen
from dcp_conformance.check.statements import ASK_UPDATE, CREATE, DELETE, SUMMARY, UPDATE, Statement, statement_of
from dcp_conformance.check.stations import Origin
from dcp_conformance.definitions.circular import Circle

from .demands import Demands
from .following import (
    FRESH,
    Event,
    Exposure,
    Interval,
    Kind,
    Occasions,
    Population,
    Proof,
    Station,
    Trial,
    Variable,
)
from .links import bits
from .records import RecordSizes
from .unrecorded import Unrecorded

#: A reaction is missing if it is not in the first four beacons after the record. The third is the latest one due: one
#: payload may have been composed before, and one may wait for a payload of another protocol.
LATE = 4
#: Number of beacons in which a reaction may still be caused by a record before the previous beacon.
_CARRIED = 3
#: Number of beacons in which a node repeats a record, from one beacon with it to the next; the payload of one between
#: them may be full.
_REPEATED = 3
#: Maximum number of beacons of a speaker that a trial counts: with that many, nearly every link has delivered one.
_EXPOSED = 8
#: Maximum number of open occasions for one node, kind and variable.
_OPEN = 8
#: Number of events that are kept until each node has sent its next beacon.
_EVENTS = 8_192
#: Maximum number of variables with open occasions of a node: only forged beacons, or long gaps, cause more.
MOST_OPEN = 64
#: Maximum number of nodes whose reactions are followed; each one has a bit of a mask.
MOST_NODES = 64
#: Number of beacons that a node is assumed to have sent before if its beacons are not numbered.
_UNKNOWN = 100
#: Payloads up to this length in octets have room: the bearer carries at least 256 octets.
_ROOM = 180
#: No earlier reaction.
_NEVER: Final[tuple[int, Sequence[Interval]]] = (-_CARRIED, ())


#: Reactions whose absence a statement of the variable's number shows.
_STATED = (Kind.TAKE_UPDATE, Kind.ASK_UPDATE, Kind.ANSWER_UPDATE, Kind.TEACH, Kind.ANSWER_CREATE, Kind.TAKE_DELETE)
#: Reactions of a node that does not hold the variable.
_ABSENT = (Kind.TAKE_CREATE, Kind.ASK_CREATE)
#: Reactions that prove the reception of a record (a node may delete a variable because of its timeout, too), and
#: reactions whose absence is a fault if reception is proved.
_PROVES = frozenset({Kind.TAKE_CREATE, Kind.TAKE_UPDATE, Kind.ASK_UPDATE, Kind.ASK_CREATE})
_PROVABLE = frozenset({Kind.TAKE_UPDATE, Kind.TAKE_DELETE, Kind.TAKE_CREATE, Kind.ANSWER_UPDATE, Kind.ANSWER_CREATE})


class Observer:
    """Follows the records of all nodes, and calls ``outcome`` with each :class:`Trial`."""

    def __init__(self, context: Context, outcome: Callable[[Trial], None]) -> None:
        """``outcome``: called once for each occasion whose result is known."""
        self._context = context
        self._outcome = outcome
        self._sizes = RecordSizes(context.codec)
        self.circle = Circle(context.profile.types.var_seqno.width)
        self.stations: dict[bytes, Station] = {}
        self.by_bit: dict[int, Station] = {}
        self.unrecorded = Unrecorded()
        self.variables: dict[int, Variable] = {}
        self._nodes = Population()
        self._log: dict[tuple[Kind, int], list[Event]] = {}
        """Reaction and variable -> the latest events, in order. A node processes them before its next beacon. The key
        of the last event is the last one."""
        self._logged = self._dropped = 0
        """Number of all events, and of those that have been removed."""
        self._unsettled: set[int] = set()
        """Variables of which not all nodes have stated the same number."""
        self._carried: dict[tuple[int, int, Kind], tuple[int, Sequence[Interval]]] = {}
        """(bit, variable, kind) -> the node's beacon with the last reaction, and its causes right before it."""
        self._proofs: set[frozenset[int]] = set()
        """Frames that reactions in this beacon have proved: further reactions to them prove nothing more."""
        self._demands = Demands(context, self.circle, self._nodes, self.by_bit)
        self._first: int | None = None
        self.time = 0
        """Monotonic clock in ns, starting at 0: a step of the recorder's clock backwards counts as 0, and one forwards
        as at most 1 s."""
        self._wall = 0

    # -- input ---------------------------------------------------------------------------------------------------------

    def feed(self, seen: Seen) -> None:
        """Process the next beacon of the recording."""
        time = seen.time
        if self._first is None:
            self._first = self._wall = time
        self.time += min(max(time - self._wall, 0), 1_000_000_000)
        self._wall = time
        if not seen.parts:
            return
        station = self._station(seen)
        if station is None:
            return
        self._catch_up(station)
        self._proofs.clear()
        station.beacons += 1
        station.times.append(self.time)
        length = len(seen.heard.octets)
        self._settle(station, seen)
        if station.open or station.waiting:
            self._decide(station, seen, length)
        station.longest = max(station.longest, length)
        self._occasions(station, seen)
        # Its own records demand nothing from it.
        station.cursor = self._logged

    def _station(self, seen: Seen) -> Station | None:
        """Return the sender of a beacon, brought up to date after a restart or a gap; None if it is not followed."""
        station = self.stations.get(seen.sender)
        sender = self._context.senders.get(seen.sender)
        if sender is None:
            return None
        number = seen.heard.seqno
        # Number of beacons since the node was started, if this is its first one in the recording or after a restart.
        missed = _UNKNOWN if number is None else number - self._context.profile.behaviour.first_beacon_seqno
        if station is None:
            if len(self.stations) >= MOST_NODES:
                return None
            listens, bit = seen.origin is not Origin.FORGED, 1 << len(self.stations)
            station = Station(seen.sender, bit, listens, seen.time, sender.life)
            station.cursor = self._logged
            if missed > 2:
                self._nodes.early |= bit
            self.unrecorded.before_first(bit, missed, self.time)
            self.stations[seen.sender] = self.by_bit[bit] = station
            self._tell_links(station)
            for variable in self.variables.values():
                if seen.sender in variable.producers:
                    variable.produced |= bit
            if listens:
                self._nodes.listeners |= bit
                self._nodes.count += 1
                for variable in self.variables.values():
                    self._settled(variable)
        elif sender.life != station.life:
            last, before = station.sent_at(station.beacons), station.sent_at(station.beacons - 1)
            self.unrecorded.restart(station.bit, last, before, missed, self.time)
            self._forget(station)
            station.life, station.since = sender.life, seen.time
            self._nodes.early &= ~station.bit
            if number is None or number > 20:
                self._nodes.early |= station.bit
            station.gap = station.beacons + 1
        elif sender.unbroken > station.time:
            self.unrecorded.gap(station.bit, station.sent_at(station.beacons), self.time)
            self._drop_all(station)
            station.gap = station.beacons + 1
        station.time = sender.time
        return station

    def _tell_links(self, new: Station) -> None:
        """Restrict the listeners, and what a new node hears, to the links that the user has told."""
        hears = self._context.hears
        for each in self.stations.values():
            if hears(each.node, new.node) is False:
                each.hears &= ~new.bit
            if hears(new.node, each.node) is False:
                new.hears &= ~each.bit

    def _forget(self, station: Station) -> None:
        """Forget the state of a node that was, or may have been, restarted."""
        self._drop_all(station)
        for var_id in list(station.holds):
            self._hold(station, self.variables[var_id], None)
        for var_id in station.had:
            self.variables[var_id].deleted &= ~station.bit
        station.stated.clear()
        station.sent.clear()
        station.had.clear()

    def _drop_all(self, station: Station) -> None:
        """Drop the open occasions of a node, and skip the events that it has not processed yet."""
        station.open.clear()
        station.waiting.clear()
        station.cursor = self._logged

    def _hold(self, station: Station, variable: Variable, number: int | None) -> None:
        """Record the number of a variable that a node holds; None if it does not hold the variable."""
        bit, holders = station.bit, variable.holders
        before = station.holds.get(variable.var_id)
        if before == number:
            return
        if before is not None:
            left = holders[before] & ~bit
            if left:
                holders[before] = left
            else:
                del holders[before]
        if number is None:
            del station.holds[variable.var_id]
            variable.known &= ~bit
            variable.consumers &= ~bit
            variable.apart &= ~bit
        else:
            station.holds[variable.var_id] = number
            holders[number] = holders.get(number, 0) | bit
            variable.known |= bit
        self._settled(variable)

    def _settled(self, variable: Variable) -> None:
        """Update ``_unsettled`` for a variable."""
        if len(variable.holders) == 1 and variable.known.bit_count() >= self._nodes.count:
            self._unsettled.discard(variable.var_id)
        else:
            self._unsettled.add(variable.var_id)

    def _variable(self, var_id: int) -> Variable | None:
        """Return the state of a variable, created on first use; None if there are too many variables."""
        variable = self.variables.get(var_id)
        if variable is None and len(self.variables) < MOST_VARIABLES:
            variable = self.variables[var_id] = Variable(var_id)
            self._unsettled.add(var_id)
        return variable

    # -- reactions -----------------------------------------------------------------------------------------------------

    def _settle(self, station: Station, seen: Seen) -> None:
        """Process the records of a node's own beacon as reactions and as new statements."""
        for each, _, _ in seen.news:
            kind, var_id = each.kind, each.var_id
            variable = self.variables.get(var_id) or self._variable(var_id)
            if variable is None:
                continue
            opened = station.open.get(var_id)
            if kind is SUMMARY or kind is UPDATE or kind is CREATE:
                self._states(station, variable, each, opened)
            elif kind is DELETE:
                if opened:
                    self._hit(station, variable, each, opened, Kind.TAKE_DELETE, open_cause=variable.expires)
                    station.open.pop(var_id, None)
                if var_id in station.holds:
                    self._hold(station, variable, None)
                station.had[var_id] = variable.created
                variable.deleted |= station.bit
                station.waiting.pop(var_id, None)
            elif opened:
                self._hit(station, variable, each, opened, Kind.ASK_UPDATE if kind is ASK_UPDATE else Kind.ASK_CREATE)
                if not opened:
                    station.open.pop(var_id, None)
        stated = [last for kind, _, _, _, last in seen.parts if kind is SUMMARY or kind is UPDATE or kind is CREATE]
        station.stated.append((station.beacons, stated))

    def _states(self, station: Station, variable: Variable, each: Statement, opened: Occasions | None) -> None:
        """Process a create, update or summary: a node states the number of a variable."""
        kind, number, var_id = each.kind, each.number, each.var_id
        if kind is CREATE:
            self._created(station, variable, each)
        elif kind is UPDATE:
            variable.value = len(each.record.value)
            station.value = max(station.value, variable.value)
        had = station.holds.get(var_id)
        if opened:
            if had is None:
                if kind is not CREATE or each.record.spec.prod_id != station.node:
                    self._hit(station, variable, each, opened, Kind.TAKE_CREATE)
                opened.clear()
                station.waiting.pop(var_id, None)
            elif number != had:
                if self.circle.newer(number, had):
                    self._hit(station, variable, each, opened, Kind.TAKE_UPDATE)
                # An older number belongs to another creation: the open occasions do not apply to it.
                opened.clear()
            if kind is not SUMMARY and opened:
                self._answers(station, variable, each, opened)
            if not opened:
                station.open.pop(var_id, None)
        if number != had:
            holders = variable.holders
            if kind is UPDATE and holders and number not in holders:
                newer = self.circle.newer
                if not any(newer(other, number) for other in holders):
                    variable.introducers |= station.bit
            self._hold(station, variable, number)
        if kind is not SUMMARY:
            station.sent[var_id, kind] = station.beacons
        if var_id in station.had:
            del station.had[var_id]
            variable.deleted &= ~station.bit

    def _answers(self, station: Station, variable: Variable, each: Statement, opened: Occasions) -> None:
        """Process a create or update, with the number that the node had, as an answer.

        A record that the node has sent shortly before may be a repetition, which needs no request.
        """
        before = station.sent.get((variable.var_id, each.kind), -_REPEATED)
        repeats = variable.repetitions != 1 and station.beacons - before < _REPEATED
        for kind in (Kind.ANSWER_UPDATE, Kind.TEACH) if each.kind is UPDATE else (Kind.ANSWER_CREATE,):
            self._hit(station, variable, each, opened, kind, open_cause=repeats)
        if each.kind is CREATE:
            opened.pop(Kind.ANSWER_UPDATE, None)
            opened.pop(Kind.TEACH, None)

    def _created(self, station: Station, variable: Variable, each: Statement) -> None:
        """Update the attributes of a variable, and the limits of the sender, from a create."""
        spec, upd = each.record.spec, each.record.upd
        if not variable.producers and not variable.known and spec.prod_id == station.node and upd.seqno == 0:
            variable.born = True
        if spec.prod_id == station.node:
            variable.consumers &= ~station.bit
        else:
            variable.consumers |= station.bit
            variable.apart &= ~station.bit
        variable.last_create = each.frame
        if spec.prod_id not in variable.producers:
            variable.producers.add(spec.prod_id)
            if (producer := self.stations.get(spec.prod_id)) is not None:
                variable.produced |= producer.bit
        variable.expires = variable.expires or bool(spec.timeout)
        variable.repetitions = max(variable.repetitions, spec.rep_cnt)
        variable.created = max(variable.created, spec.creation_time or 0)
        variable.create, variable.value = self._sizes.create(each.record), len(upd.value)
        station.repetitions = max(station.repetitions, spec.rep_cnt)
        station.value = max(station.value, len(upd.value))
        station.description = max(station.description, len(spec.descr))

    def _hit(
        self,
        station: Station,
        variable: Variable,
        reaction: Statement,
        opened: Occasions,
        kind: Kind,
        *,
        open_cause: bool = False,
    ) -> None:
        """Close the occasions for one kind of reaction with success, and report the trial.

        ``open_cause``: the node may have done the same without hearing a record.
        """
        intervals = opened.pop(kind, None)
        if not intervals:
            return
        var_id = variable.var_id
        # The payload may have been composed one beacon earlier. Then the latest records cause the next reaction.
        key = (station.bit, var_id, kind)
        before, earlier = self._carried.pop(key, _NEVER)
        early = earlier if station.beacons - before < _CARRIED else ()
        delay = 0 if early else station.beacons - intervals[0].begin
        once = len(intervals) == 1 and not early and len(intervals[0].frames) == 1
        latest = [each for each in intervals if each.begin >= station.beacons - 1]
        at_once = speakers = _exposure(intervals)
        ahead: Exposure = ()
        if early or len(latest) < len(intervals):
            ahead = _exposure([*early, *(each for each in intervals if each.begin < station.beacons - 1)])
            speakers = _exposure([*early, *intervals])
        if latest and len(self._carried) < MOST_VARIABLES:
            self._carried[key] = (station.beacons, latest)
        last = intervals[-1]
        late_half, length = last.late_half, last.length
        since = station.sent_at(min(intervals[0].begin, station.beacons - 2))
        if delay == 1:
            station.delays = station.delays[0] + 1, station.delays[1]
        elif delay == 2:
            station.delays = station.delays[0], station.delays[1] + 1
        if kind in _PROVES:
            causes = intervals if station.composes_late else [*early, *intervals]
            self._prove(station, variable, reaction, causes, since)
        for each in intervals:
            late_half, length = late_half and each.late_half, min(length, each.length)
        self._outcome(
            Trial(
                last.time, station, kind, var_id, speakers, True, last.cause, late_half, length, once,
                delay, at_once, ahead, since, self.time, open_cause=open_cause,
            )
        )  # fmt: skip

    def _prove(
        self, station: Station, variable: Variable, reaction: Statement, causes: Sequence[Interval], since: int
    ) -> None:
        """Mark the open occasions of a node whose records were in all frames that can have caused its reaction."""
        provable = [
            intervals for opened in station.open.values() for kind, intervals in opened.items() if kind in _PROVABLE
        ]
        if not provable or variable.produced & station.bit or any(each.cut for each in causes):
            return
        frames = frozenset(chain.from_iterable([each.frames for each in causes]))
        if frames in self._proofs or min(frames) < 0:
            return
        self._proofs.add(frames)
        for intervals in provable:
            if frames.issubset(chain.from_iterable(each.frames for each in intervals)):
                # The node may have received only the last one of them.
                last = next(each for each in reversed(intervals) if not frames.isdisjoint(each.frames))
                last.proof = last.proof or Proof(tuple(sorted(frames)), reaction, since, self.time)

    # -- missing reactions ---------------------------------------------------------------------------------------------

    def _decide(self, station: Station, seen: Seen, length: int) -> None:
        """Report the overdue occasions that this beacon of the node excludes."""
        opened_of, now = station.open, station.beacons
        stated: set[tuple[int, int]] = {(each.var_id, each.kind) for each, _, _ in seen.news}
        for part, _, ids, _, _ in seen.parts:
            if part is not SUMMARY and part is not UPDATE and part is not CREATE:
                continue
            for var_id in [each for each in ids if each in opened_of]:
                opened = opened_of.get(var_id)
                if opened is None:
                    continue
                variable = self.variables[var_id]
                for kind in list(opened):
                    late = kind in _STATED and opened[kind][0].begin + LATE <= now
                    if late and self._had_room(station, kind, variable, stated, length):
                        self._miss(station, var_id, opened, kind, now)
                if not opened:
                    station.open.pop(var_id, None)
        for var_id in list(station.waiting):
            variable = self.variables[var_id]
            opened = opened_of.get(var_id, {})
            for kind in _ABSENT:
                if kind in opened and opened[kind][0].begin + LATE <= now:
                    need = variable.create if kind is Kind.TAKE_CREATE else 4
                    if self._room(station, length, need):
                        self._miss(station, var_id, opened, kind, now)
            if not opened:
                station.open.pop(var_id, None)
                station.waiting.pop(var_id, None)

    def _had_room(
        self, station: Station, kind: Kind, variable: Variable, stated: set[tuple[int, int]], length: int
    ) -> bool:
        """Whether the reaction is missing in this payload although the payload had room for it."""
        var_id = variable.var_id
        if kind is Kind.ASK_UPDATE:
            return (var_id, ASK_UPDATE) not in stated and self._room(station, length, 4)
        if kind is Kind.ANSWER_CREATE:
            return (var_id, CREATE) not in stated and self._room(station, length, variable.create)
        if kind is Kind.ANSWER_UPDATE or kind is Kind.TEACH:
            return (var_id, UPDATE) not in stated and self._room(station, length, variable.value + 8)
        return True

    @staticmethod
    def _room(station: Station, length: int, need: int) -> bool:
        """Whether a beacon of ``length`` octets had room for ``need`` more, compared with the node's longest one."""
        return length + need <= max(_ROOM, station.longest * 0.9)

    def _miss(self, station: Station, var_id: int, opened: Occasions, kind: Kind, now: int) -> None:
        """Close the overdue occasions for one kind of reaction as missed, and report the trials."""
        intervals = opened[kind]
        while intervals and intervals[0].begin + LATE <= now:
            each = intervals.pop(0)
            exposure = _exposure([each])
            proof = each.proof
            if proof and kind is Kind.TAKE_DELETE and self.variables[var_id].last_create >= proof.frames[0]:
                # The variable may have been created again, with the same number.
                proof = None
            self._outcome(
                Trial(
                    each.time, station, kind, var_id, exposure, False, each.cause, each.late_half, each.length,
                    proof=proof, open_cause=kind is Kind.TAKE_DELETE and self.variables[var_id].expires,
                )
            )  # fmt: skip
        if not intervals:
            del opened[kind]

    # -- occasions -----------------------------------------------------------------------------------------------------

    def _occasions(self, speaker: Station, seen: Seen) -> None:
        """Log an event for each record of a beacon that demands a reaction from other nodes."""
        variables, everybody = self.variables, self._nodes.count
        begins: list[range | list[int]] | None = None
        total = 0
        # A beacon may have several records of one variable: process all of them if one is new.
        wanted = {each.var_id for each, _, _ in seen.news}
        wanted |= self._unsettled
        for place, (kind, records, ids, numbers, _) in enumerate(seen.parts):
            if wanted.isdisjoint(ids):
                continue
            for index, var_id in enumerate(ids):
                if var_id not in wanted:
                    continue
                variable = variables.get(var_id)
                if variable is None:
                    continue
                if kind is UPDATE or kind is SUMMARY:
                    holders = variable.holders
                    if len(holders) == 1 and numbers[index] in holders and variable.known.bit_count() >= everybody:
                        # All nodes have this number.
                        continue
                statement: Statement | None = None
                for due, whom in self._demands.of(variable, kind, records[index], speaker.bit):
                    if begins is None:
                        begins, total = self._sizes.starts(seen.parts)
                    if statement is None:
                        statement = statement_of(kind, records[index], seen.heard, seen.sender)
                    late_half = 2 * begins[place][index] >= total
                    frame = seen.number if seen.sound else -seen.number
                    events = self._log[due, var_id] = self._log.pop((due, var_id), [])
                    events.append((self._logged, whom, speaker.bit, statement, late_half, total, self.time, frame))
                    self._logged += 1
        if self._logged - self._dropped > _EVENTS:
            for station in self.stations.values():
                self._catch_up(station)
            self._dropped = self._logged
            self._log.clear()

    def _catch_up(self, station: Station) -> None:
        """Open the occasions of a node from the events since its last beacon."""
        cursor, bit, hears = station.cursor, station.bit, station.hears
        found: list[tuple[int, tuple[Kind, int], list[Event]]] = []
        for key, events in reversed(self._log.items()):
            if events[-1][0] < cursor:
                break
            since = events[bisect_left(events, (cursor,)) :]
            mine = [each for each in since if each[1] & bit]
            if hears != -1:
                mine = [each for each in mine if each[2] & hears]
            if mine:
                found.append((mine[0][0], key, mine))
        for _, key, events in sorted(found):
            if (last := self._open(station, *key)) is not None:
                last.add(events)
        station.cursor = self._logged

    @staticmethod
    def _open(station: Station, kind: Kind, var_id: int) -> Interval | None:
        """Return the interval since the node's last beacon, without frames if it is new.

        None if the records do not count: the node's last statement of the number is too old, beacons of it are missing
        since then, or it has too many open occasions.
        """
        beacons, opened_of = station.beacons, station.open
        opened = opened_of.get(var_id)
        if opened is None and len(opened_of) >= MOST_OPEN:
            return None
        if kind in _ABSENT:
            station.waiting[var_id] = None
        elif not station.has_stated(var_id, max(station.gap, beacons - FRESH)):
            return None
        if opened is None:
            opened = opened_of[var_id] = {}
        intervals = opened.setdefault(kind, [])
        if not intervals or intervals[-1].begin != beacons:
            intervals.append(Interval(beacons))
            if len(intervals) > _OPEN:
                intervals.pop(0)
                intervals[0].cut = True
        return intervals[-1]


def _exposure(intervals: Sequence[Interval]) -> Exposure:
    """Return the speakers of some intervals, each with the number of its beacons, up to ``_EXPOSED``."""
    if len(intervals) == 1 and not intervals[0].again:
        return _one_each(intervals[0].speakers)
    beacons: dict[int, int] = {}
    for each in intervals:
        for bit in bits(each.speakers):
            beacons[bit] = beacons.get(bit, 0) + 1
        for bit, more in (each.again or {}).items():
            beacons[bit] += more
    return tuple(sorted((bit, min(count, _EXPOSED)) for bit, count in beacons.items()))


@functools.lru_cache(maxsize=1 << 12)
def _one_each(speakers: int) -> Exposure:
    """Return the speakers in a mask, each with one beacon. Cached: the same few masks occur often."""
    return tuple((bit, 1) for bit in bits(speakers))
