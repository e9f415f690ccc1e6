"""The ledger of a recording: for each node and variable the states that its beacons show, and for how long.

Every VarDis record tells something about the database of its sender (dcp-vardis.md, "Basic Transmissible Data
Types"): a create, an update, a summary and a request for an update carry the sequence number that the node has, a
delete means that the node has deleted the variable, a request for a create that it does not know the variable.

:class:`Ledger` follows beacons in their order. An :class:`Entry` is one state of a variable at a node: since when and
until when the node has stated it, with frames, the frames in which it sent the value, and its requests. A newly
accepted value shows with the node's next beacon about the variable. Memory is bounded: with too many entries, the
resolution of time decreases.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import repeat
from operator import attrgetter
from typing import Any

import msgspec
from dcp_spec.constants import ICType

from dcp_codec.jsonform import node_id_text
from dcp_codec.values import Beacon, VarSumm

from .entry import DELETED, UNKNOWN, Creation, Entry, Stamp
from .lag import PATIENCE, Production, patience

CREATE, UPDATE, SUMMARY = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES
DELETE, ASK_UPDATE, ASK_CREATE = ICType.DELETE_VARIABLES, ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES
"""Local aliases: access to enum members costs more time than most rules."""

#: Maximum number of pairs of node and variable that are followed, and of entries that are kept exactly.
MOST_PAIRS, MOST_ENTRIES = 1 << 18, 60_000
#: Maximum number of stale states that are kept.
_STALE = 10_000
#: Maximum number of parts with summaries that are kept.
_PARTS = 512
_BY_VARIABLE = attrgetter("var_id", "time", "frame")


class Statement(msgspec.Struct, frozen=True, gc=False):
    """A record of a VarDis payload with its sender, frame number and time, but without the frame."""

    kind: ICType
    record: Any
    frame: int
    """Number of the frame in the recording."""
    time: int
    """ns since 1970."""
    sender: bytes
    var_id: int
    """Variable identifier; of a VarCreate the one in its VarSpec (X14)."""
    number: int
    """Sequence number of the variable in the record; -1 if it has none."""


News = tuple[Statement, Statement | None, Stamp | None]
"""A record other than a summary that repeats the sequence number which the node stated last; the node's previous create
or update of the variable, or first summary with a number: None if there is none, if beacons of the node are missing
since then, or if the node has deleted the variable since then; and the last summary that has repeated its number, see
:func:`latest`."""

Part = tuple[ICType, Sequence[Any], list[int], list[int], dict[int, int]]
"""The type and the records of a container, their variable identifiers in the same order, their sequence numbers (-1 for
deletes and requests for creates), and the last number by variable."""

_known: dict[int, Part] = {}
"""By the ``id`` of the records: parts with summaries, whose records the decoder returns again for equal octets. A part
refers to its records, so that no other object has their ``id``."""


def part_of(records: Sequence[Any]) -> Part | None:
    """Return the records of a container; None for an empty one, and for a type that a profile adds."""
    if (part := _known.get(id(records))) is not None:
        return part
    if not records or (kind := records[0].IC_TYPE) is None:
        return None
    if kind is CREATE:
        ids, numbers = [each.spec.var_id for each in records], [each.upd.seqno for each in records]
    else:
        ids = [each.var_id for each in records]
        numbers = [-1] * len(ids) if kind is DELETE or kind is ASK_CREATE else [each.seqno for each in records]
    part = kind, records, ids, numbers, dict(zip(ids, numbers, strict=True))
    if kind is SUMMARY:
        if len(_known) >= _PARTS:
            _known.clear()
        _known[id(records)] = part
    return part


def parts_of(beacon: Beacon) -> list[Part]:
    """Return the VarDis records of a beacon by container."""
    containers = (each for payload in beacon.payloads for each in payload.vardis or ())
    return [part for each in containers if (part := part_of(each.records)) is not None]


def statement(kind: ICType, record: Any, frame: int, time: int, sender: bytes) -> Statement:
    """Return a record as a statement of ``sender``."""
    if kind is CREATE:
        return Statement(kind, record, frame, time, sender, record.spec.var_id, record.upd.seqno)
    number = -1 if kind is DELETE or kind is ASK_CREATE else record.seqno
    return Statement(kind, record, frame, time, sender, record.var_id, number)


def latest(before: Statement, again: Stamp | None) -> Statement:
    """Return the last record before one of the news: the last summary that has repeated ``before``, if any."""
    if again is None:
        return before
    summary = VarSumm(before.var_id, before.number)
    return Statement(SUMMARY, summary, *again, before.sender, before.var_id, before.number)


class _Voice:
    """The statements of one node since the last gap in its beacons, and its entries."""

    __slots__ = ("again", "entries", "held", "last", "numbers", "odd", "unbroken")

    def __init__(self, unbroken: int) -> None:
        self.unbroken = unbroken
        """Time since which no beacon of the node is missing."""
        self.numbers: dict[int, int] = {}
        """Variable -> the sequence number that the node stated last."""
        self.last: dict[int, Statement] = {}
        """Variable -> the first record with that number, or a later one that is not a summary."""
        self.again: dict[int, Stamp] = {}
        """Variable -> the last summary that repeats that number after the record in ``last``."""
        self.entries: dict[int, Entry] = {}
        """Variable -> its present state at the node."""
        self.held = 0
        """Number of variables that the node holds."""
        self.odd: set[int] = set()
        """Variables that the node has requested although it holds them, until it states their numbers again."""


class Ledger:
    """The states of all variables at all nodes of a recording."""

    def __init__(self, pairs: int = MOST_PAIRS, entries: int = MOST_ENTRIES) -> None:
        """``pairs``: maximum number of pairs of node and variable. ``entries``: number of states kept exactly."""
        self._most, self._room = pairs, entries
        self._pairs = 0
        self._voices: dict[bytes, _Voice] = {}
        self._ended: list[Entry] = []
        self._begun: list[Entry] = []
        """The states that the last beacon begins."""
        self.producers: dict[int, bytes] = {}
        """By variable: the prodId of the most recent creation."""
        self._productions: dict[int, Production] = {}
        """By variable: the states of its producer. Variables whose creates name several producers have none."""
        self._stale: list[Entry] = []
        """Ended states that were stale."""
        self._changes: list[tuple[int, int, bytes]] = []
        """Changes of producers: time, variable, node."""
        self.interval = 1_000_000
        """Resolution of time in ns: only the last state of a pair in an interval is kept."""
        self.begin: int | None = None
        """Time of the first beacon, ns since 1970; None before. Users set it if earlier beacons have no records."""
        self.end = 0

    # -- input ---------------------------------------------------------------------------------------------------------

    def feed(self, frame: int, time: int, node: bytes, beacon: Beacon) -> list[Entry]:
        """Process the next beacon of a node; return the states that it begins. Missing beacons do not matter."""
        self.feed_parts(frame, time, node, parts_of(beacon))
        return self._begun

    def feed_parts(
        self, frame: int, time: int, node: bytes, parts: Sequence[Part], unbroken: int = 0
    ) -> tuple[Sequence[News], int]:
        """Process the VarDis records of the next beacon.

        ``time``: ns since 1970. ``unbroken``: the time since which no beacon of the node is missing. Return the records
        without repeated summaries, in their order, and the number of these. Most records of a recording are repeated
        summaries.
        """
        if self.begin is None:
            self.begin = self.end = time
        if time > self.end:
            self.end = time
        self._begun = []
        voice = self._voices.get(node)
        if voice is None:
            voice = self._voices[node] = _Voice(unbroken)
        elif voice.unbroken != unbroken:
            self._forget(voice, unbroken)
        numbers, stamp, count = voice.numbers, (frame, time), 0
        news: list[News] = []
        for kind, records, ids, numbers_now, _ in parts:
            if kind is not SUMMARY:
                for each in records:
                    news.append(self._news(statement(kind, each, frame, time, node), voice))
                continue
            if [*map(numbers.get, ids)] == numbers_now and not voice.odd:
                voice.again.update(dict.fromkeys(ids, stamp))
                count += len(ids)
                continue
            for record, var_id, number in zip(records, ids, numbers_now, strict=True):
                # The container may have several records of a variable.
                if numbers.get(var_id) == number:
                    voice.again[var_id] = stamp
                    count += 1
                    if var_id in voice.odd:
                        self._state(frame, time, node, kind, var_id, number, None, voice)
                else:
                    news.append(self._news(Statement(kind, record, *stamp, node, var_id, number), voice))
        return news, count

    def _news(self, each: Statement, voice: _Voice) -> News:
        """Return a record together with the node's previous one, and store it."""
        kind, var_id = each.kind, each.var_id
        before = voice.last.get(var_id)
        again = voice.again.get(var_id)
        number, created = each.number, None
        entry = voice.entries.get(var_id)
        if kind is UPDATE and entry is not None and entry.number == number and not voice.odd:
            # The most frequent record: the update that the node has sent before, or one with the number of its summary.
            entry.last, entry.until = each.frame, each.time
            entry.carry(each.frame, each.time)
        else:
            if kind is CREATE:
                created = each.record.spec.prod_id, each.record.spec.creation_time
            elif kind is DELETE:
                number = DELETED
            elif kind is ASK_CREATE:
                number = UNKNOWN
            self._state(each.frame, each.time, each.sender, kind, var_id, number, created, voice)
        if kind is SUMMARY or kind is UPDATE or kind is CREATE:
            if var_id in voice.entries:
                voice.last[var_id], voice.numbers[var_id] = each, each.number
            if again is not None:
                del voice.again[var_id]
        elif kind is DELETE and before is not None:
            del voice.last[var_id], voice.numbers[var_id]
            voice.again.pop(var_id, None)
        return each, before, again

    def follow(
        self, frame: int, time: int, node: bytes, kind: ICType, var_id: int, number: int, creation: Creation | None
    ) -> None:
        """Process a record by its fields: only the first and the last one of each state, and all creates, are needed.

        ``number``: as in :class:`Entry`. ``creation``: of a create. Records of a variable must be in order.
        """
        if self.begin is None:
            self.begin = self.end = time
        self.end = max(self.end, time)
        voice = self._voices.get(node)
        if voice is None:
            voice = self._voices[node] = _Voice(0)
        self._state(frame, time, node, kind, var_id, number, creation, voice)

    def _state(
        self,
        frame: int,
        time: int,
        node: bytes,
        kind: ICType,
        var_id: int,
        number: int,
        created: Creation | None,
        voice: _Voice,
    ) -> None:
        """Begin an entry, or continue the present one."""
        entry = voice.entries.get(var_id)
        creation = created if created is not None or entry is None else entry.creation
        if created is not None and self.producers.get(var_id) != created[0]:
            self._produced(var_id, created[0])
        # The first create of a state tells which creation it belongs to.
        if entry is not None and entry.number == number and (entry.creation == creation or entry.creation is None):
            entry.creation, entry.last, entry.until = creation, frame, time
        else:
            if entry is not None:
                self._close(entry, voice)
                voice.held -= entry.number >= 0
            elif self._pairs < self._most:
                self._pairs += 1
            else:
                return
            entry = voice.entries[var_id] = Entry(node, var_id, number, creation, kind, frame, time, frame, time)
            voice.held += number >= 0
            self._begun.append(entry)
            if (production := self._productions.get(var_id)) is not None:
                production.begins(entry)
                if production.full:
                    self._present(var_id)
                    production.forget()
        if kind is UPDATE or kind is CREATE:
            entry.carry(frame, time)
        elif kind is ASK_UPDATE or kind is ASK_CREATE:
            entry.asked += 1
            entry.last_asked = (frame, time)
            if var_id in voice.numbers and (kind is ASK_CREATE or voice.numbers[var_id] != number):
                voice.odd.add(var_id)
            return
        if voice.odd:
            voice.odd.discard(var_id)

    def _produced(self, var_id: int, producer: bytes) -> None:
        """Process a create with another producer than the ones before."""
        self._changes.append((self.end, var_id, producer))
        if var_id in self.producers:
            self._productions.pop(var_id, None)
        else:
            production = Production(producer)
            for each in self.entries(var_id):
                production.begins(each)
                if production.full:
                    production.forget()
            for each in self._ended:
                if each.var_id == var_id:
                    self._compare(production, each)
            self._productions[var_id] = production
        self.producers[var_id] = producer

    def _close(self, entry: Entry, voice: _Voice) -> None:
        """End the present state of a variable at a node."""
        self._reach(entry, voice)
        self._ended.append(entry)
        if entry.left is not None and (production := self._productions.get(entry.var_id)) is not None:
            self._compare(production, entry)
        if len(self._ended) > self._room:
            self._coarser()

    def _compare(self, production: Production, ended: Entry) -> None:
        """Compare an ended state with the producer's, and keep it if it was stale."""
        production.compare(ended)
        if ended.newest is not None and ended.age >= PATIENCE and len(self._stale) < _STALE:
            self._stale.append(ended)

    @staticmethod
    def _reach(entry: Entry, voice: _Voice) -> None:
        """Take the last repeated summary into account."""
        again = voice.again.get(entry.var_id)
        if again is not None and again[1] >= entry.until and voice.numbers.get(entry.var_id) == entry.number:
            entry.last, entry.until = again

    def _coarser(self) -> None:
        """Keep only the last state of each pair in an interval, which is doubled until half of the room is free."""
        begin = self.begin or 0
        while len(self._ended) > self._room // 2:
            self.interval *= 2
            kept = {((each.time - begin) // self.interval, each.node, each.var_id): each for each in self._ended}
            self._ended = list(kept.values())
            if self.interval > 1 << 62:
                break
        self._changes = list({(at // self.interval, var): (at, var, who) for at, var, who in self._changes}.values())

    def _forget(self, voice: _Voice, unbroken: int) -> None:
        """Forget a node's statements after missing beacons: it may have changed any number in between."""
        for var_id in voice.again:
            if (entry := voice.entries.get(var_id)) is not None:
                self._reach(entry, voice)
        voice.unbroken = unbroken
        voice.numbers.clear()
        voice.last.clear()
        voice.again.clear()
        voice.odd.clear()

    # -- queries -------------------------------------------------------------------------------------------------------

    @property
    def nodes(self) -> list[bytes]:
        """Return all senders, in the order of their first beacon."""
        return list(self._voices)

    def _present(self, var_id: int | None = None) -> list[Entry]:
        """Return the present states of a variable (default: all), up to date."""
        found = []
        for voice in self._voices.values():
            for entry in voice.entries.values() if var_id is None else filter(None, [voice.entries.get(var_id)]):
                self._reach(entry, voice)
                if entry.left is not None and (production := self._productions.get(entry.var_id)) is not None:
                    production.compare(entry)
                found.append(entry)
        return found

    def held(self, node: bytes, var_id: int) -> Entry | None:
        """Return the present state of a variable at a node; None if it has sent no record about it."""
        voice = self._voices.get(node)
        entry = None if voice is None else voice.entries.get(var_id)
        if entry is not None and voice is not None:
            self._reach(entry, voice)
        return entry

    def number(self, node: bytes, var_id: int) -> int | None:
        """Return the present number of a variable at a node, or DELETED or UNKNOWN; None without a record about it."""
        entry = self.held(node, var_id)
        return None if entry is None else entry.number

    def holds(self, node: bytes) -> int:
        """Return the number of variables that a node holds at present."""
        voice = self._voices.get(node)
        return 0 if voice is None else voice.held

    def entries(self, var_id: int | None = None) -> list[Entry]:
        """Return the states of a variable (default: all) at all nodes, in the order of time."""
        found = [*self._ended, *self._present(var_id)]
        if var_id is not None:
            found = [each for each in found if each.var_id == var_id]
        return sorted(found, key=attrgetter("time", "frame"))

    def count(self) -> int:
        """Return the number of states with a sequence number."""
        return sum([each.number >= 0 for each in self._ended]) + sum(voice.held for voice in self._voices.values())

    @property
    def compared(self) -> frozenset[int]:
        """The variables whose states are compared: those whose creates name one producer."""
        return frozenset(self._productions)

    def lag(self, entry: Entry) -> int | None:
        """Return the present lag of a state in values of the producer; None if that is not known."""
        production = self._productions.get(entry.var_id)
        return None if production is None else production.lag(entry)

    def stale(self, period_ns: float = 0) -> list[Entry]:
        """Return the states that nodes have kept for too long after the producer had left them, by variable and time.

        ``period_ns``: the longest beacon period of the nodes in ns. A state is stale from three seconds, and ten
        beacons, after the producer has left it. Variables whose creates name several producers have no stale states.
        """
        least = patience(period_ns)
        found = [each for each in (*self._stale, *self._present()) if each.newest is not None and each.age >= least]
        return sorted((each for each in found if each.var_id in self._productions), key=_BY_VARIABLE)

    def as_json(
        self,
        representation: str,
        came: Iterable[tuple[Entry | None, int]] | None = None,
        period_ns: float = 0,
        entries: Sequence[Entry] | None = None,
    ) -> dict[str, Any]:
        """Return the states for programs and pages: times in intervals since ``begin``, nodes and variables by index.

        ``representation``: the format of node identifiers. ``came``: source and frame of all states; None: unknown.
        ``period_ns``: as in :meth:`stale`. ``entries``: the result of :meth:`entries`, if known. ``changes`` are rows
        of time difference, node, variable, number (:data:`DELETED`, :data:`UNKNOWN`), frame, number of
        requests, index of the row of the state from which it came, number of the frame that brought it (-1 and 0 if
        there is none, :func:`.chain.sources`), and the number of values of the producer up to this one (-1: unknown).
        If the producer has left the state, the time of that, the time of the node's last record with the state, and the
        time from which it was stale (-1: never) follow.
        ``producers`` are rows of time, variable, node.
        """
        begin, rows, last, least = self.begin or 0, [], 0, patience(period_ns)
        nodes: dict[bytes, int] = {}
        variables: dict[int, int] = {}
        entries = self.entries() if entries is None else entries
        index = {id(each): place for place, each in enumerate(entries)}
        for each, (source, frame) in zip(entries, came or repeat((None, 0), len(entries)), strict=True):
            at = max(each.time - begin, 0) // self.interval
            place = nodes.setdefault(each.node, len(nodes)), variables.setdefault(each.var_id, len(variables))
            row = -1 if source is None else index[id(source)]
            compared = each.var_id in self._productions
            lag = [each.count if compared else -1]
            if compared and each.left is not None:
                stale = -1 if each.newest is None or each.age < least else each.left.time + least
                lag += [max(t - begin, 0) // self.interval for t in (each.left.time, each.until)]
                lag.append(-1 if stale < 0 else max(stale - begin, each.time - begin) // self.interval)
            rows.append((at - last, *place, each.number, each.frame, each.asked, row, frame, *lag))
            last = at
        producers = [
            ((at - begin) // self.interval, variables[var_id], nodes.setdefault(node, len(nodes)))
            for at, var_id, node in self._changes
            if var_id in variables
        ]
        return {
            "begin_ns": begin,
            "end_ns": self.end,
            "interval_ns": self.interval,
            "nodes": [node_id_text(node, representation) for node in nodes],
            "variables": list(variables),
            "patience_ns": least,
            "changes": rows,
            "producers": producers,
        }
