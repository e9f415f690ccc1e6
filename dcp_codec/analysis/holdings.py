"""Holdings of the nodes over time: the sequence number of each variable that each node last reported.

Every VarDis record contains information about the database of its sender (dcp-vardis.md, "Basic Transmissible Data
Types"): a create, an update, a summary and a request for an update carry the sequence number that the node has, a
delete means that the node has deleted the variable, a request for a create that it does not know the variable.

:class:`Holdings` follows beacons and returns the changes. :class:`History` keeps the changes for a page, in bounded
memory. Holdings are known only from beacons: a newly accepted value shows with the node's next beacon about the
variable.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from dcp_codec.jsonform import node_id_text
from dcp_codec.values import Beacon, VarCreate, VarDelete, VarReqCreate

DELETED: Final = -1
"""In place of a sequence number: the node has deleted the variable."""
UNKNOWN: Final = -2
"""In place of a sequence number: the node has asked for the variable's creation, or has sent no record about it."""

Creation = tuple[bytes, int | None]
"""The identity of a creation: prodId, and creationTime (None before 2.0)."""

#: Maximum number of tracked pairs of node and variable; others are ignored.
MOST_PAIRS = 1 << 18
#: Number of changes that a history keeps exactly.
MOST_CHANGES = 60_000


class Held(NamedTuple):
    """The state of a variable at a node.

    ``number`` is its sequence number, or :data:`DELETED` or :data:`UNKNOWN`; ``creation`` is from the node's last
    create, None if it sent none. ``time`` (ns since 1970) and ``frame`` are those of the first beacon with this state.
    """

    number: int
    creation: Creation | None
    time: int
    frame: int


class Change(NamedTuple):
    """A node reports a new state of a variable."""

    node: bytes
    var_id: int
    before: Held | None
    """None: the node had sent no record about the variable."""
    now: Held


def records_of(beacon: Beacon) -> Iterator[Any]:
    """Yield all VarDis records of a beacon, in their order."""
    for payload in beacon.payloads:
        for container in payload.vardis or ():
            yield from container.records


class Holdings:
    """Tracks the beacons of a recording, in their order."""

    def __init__(self, most: int = MOST_PAIRS) -> None:
        """``most``: the maximum number of tracked pairs of node and variable."""
        self._most = most
        self._held: dict[bytes, dict[int, Held]] = {}
        self._pairs = 0
        self.producers: dict[int, bytes] = {}
        """By variable: the prodId of the most recent creation."""

    def feed(self, frame: int, time_ns: int, node: bytes, beacon: Beacon) -> list[Change]:
        """Process the next beacon, sent by ``node``; return the changes."""
        return self.feed_records(frame, time_ns, node, records_of(beacon))

    def feed_records(self, frame: int, time_ns: int, node: bytes, records: Iterable[Any]) -> list[Change]:
        """Process the VarDis records of a beacon, like :meth:`feed`; records without news may be omitted."""
        changes: list[Change] = []
        held = self._held.get(node)
        if held is None:
            held = self._held[node] = {}
        for record in records:
            if record.IC_TYPE is not None:
                self._record(record, held, frame, time_ns, node, changes)
        return changes

    def _record(
        self, record: Any, held: dict[int, Held], frame: int, time_ns: int, node: bytes, changes: list[Change]
    ) -> None:
        if isinstance(record, VarCreate):
            var_id, number = record.spec.var_id, record.upd.seqno
            creation: Creation | None = (record.spec.prod_id, record.spec.creation_time)
            self.producers[var_id] = record.spec.prod_id
            before = held.get(var_id)
        else:
            var_id = record.var_id
            before = held.get(var_id)
            creation = None if before is None else before.creation
            deleted = isinstance(record, VarDelete)
            number = DELETED if deleted else UNKNOWN if isinstance(record, VarReqCreate) else record.seqno
        if before is None:
            if self._pairs >= self._most:
                return
            self._pairs += 1
        elif before.number == number and before.creation == creation:
            return
        now = held[var_id] = Held(number, creation, time_ns, frame)
        changes.append(Change(node, var_id, before, now))

    def held(self, node: bytes, var_id: int) -> Held | None:
        """Return the last reported state of a variable at a node; None if there is no report."""
        return self._held.get(node, {}).get(var_id)

    def of(self, node: bytes) -> Mapping[int, Held]:
        """Return the last reported states of a node, by variable."""
        return self._held.get(node, {})

    @property
    def nodes(self) -> list[bytes]:
        """Return all senders, in the order of their first beacon."""
        return list(self._held)

    def differs(self, node: bytes, var_id: int) -> bool:
        """Return whether a node reported another number than the producer of the variable; False if either is
        missing.
        """
        producer = self.producers.get(var_id)
        mine, its = self.held(node, var_id), None if producer is None else self.held(producer, var_id)
        return mine is not None and its is not None and mine.number != its.number


class History:
    """All changes of a recording, compact enough for a page.

    Beyond ``most`` changes the resolution of time decreases: only the last state of each interval is kept, and the
    interval doubles whenever there are too many changes. ``interval`` is its length in ns. Up to a quarter of ``most``
    pairs of node and variable are tracked.
    """

    def __init__(self, representation: str, most: int = MOST_CHANGES) -> None:
        """``representation``: the format of node identifiers (``profile.types.node_id.representation``)."""
        self._representation, self._most = representation, most
        # Each pair keeps at least one state, at any resolution.
        self._holdings = Holdings(most // 4)
        self._nodes: dict[bytes, int] = {}
        self._variables: dict[int, int] = {}
        self._states: dict[tuple[int, int, int], int] = {}
        self._producers: dict[tuple[int, int], int] = {}
        self._known_producer: dict[int, bytes] = {}
        self.interval = 1_000_000
        self._begin: int | None = None
        self._end = 0

    @property
    def holdings(self) -> Holdings:
        """Return the state after the last beacon."""
        return self._holdings

    def feed(self, frame: int, time_ns: int, node: bytes, beacon: Beacon) -> list[Change]:
        """Process the next beacon; return the changes. A time before that of the last beacon counts as equal to it."""
        return self.feed_records(frame, time_ns, node, records_of(beacon))

    def feed_records(self, frame: int, time_ns: int, node: bytes, records: Iterable[Any]) -> list[Change]:
        """Process the VarDis records of a beacon, like :meth:`feed`; records without news may be omitted."""
        if self._begin is None:
            self._begin = self._end = time_ns
        if time_ns > self._end:
            self._end = time_ns
        changes = self._holdings.feed_records(frame, time_ns, node, records)
        if changes:
            place = (self._end - self._begin) // self.interval
            sender = self._nodes.setdefault(node, len(self._nodes))
            for each in changes:
                variable = self._variables.setdefault(each.var_id, len(self._variables))
                self._states[place, sender, variable] = each.now.number
                producer = self._holdings.producers.get(each.var_id)
                if producer is not None and self._known_producer.get(each.var_id) != producer:
                    self._known_producer[each.var_id] = producer
                    self._producers[place, variable] = self._nodes.setdefault(producer, len(self._nodes))
            if len(self._states) > self._most:
                self._coarser()
        return changes

    def _coarser(self) -> None:
        while len(self._states) > self._most // 2:
            self.interval *= 2
            # In the order of time, so that the last state of an interval is kept.
            self._states = {(at // 2, node, each): number for (at, node, each), number in self._states.items()}
            self._producers = {(at // 2, each): node for (at, each), node in self._producers.items()}

    def as_json(self) -> dict[str, Any]:
        """Return the history for programs and pages: times in intervals since ``begin``, nodes and variables by index.

        ``changes`` are rows of time difference, node, variable, number (:data:`DELETED`, :data:`UNKNOWN`);
        ``producers`` are rows of time, variable, node.
        """
        rows, last = [], 0
        for (at, node, variable), number in sorted(self._states.items(), key=lambda item: item[0][0]):
            rows.append((at - last, node, variable, number))
            last = at
        return {
            "begin_ns": self._begin or 0,
            "end_ns": self._end,
            "interval_ns": self.interval,
            "nodes": [node_id_text(node, self._representation) for node in self._nodes],
            "variables": list(self._variables),
            "changes": rows,
            "producers": [(at, variable, node) for (at, variable), node in sorted(self._producers.items())],
        }

    def states(self, time_ns: int) -> Iterator[tuple[str, int, int]]:
        """Yield node, variable and number of all holdings at a time, to the precision of ``interval``."""
        told = self.as_json()
        until, at = (time_ns - told["begin_ns"]) // self.interval, 0
        now: dict[tuple[int, int], int] = {}
        for step, node, variable, number in told["changes"]:
            at += step
            if at > until:
                break
            now[node, variable] = number
        for (node, variable), number in now.items():
            yield told["nodes"][node], told["variables"][variable], number
