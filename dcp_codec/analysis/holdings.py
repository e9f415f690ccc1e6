"""Who holds what: the number of each variable that each node last said it has, over the time of a recording.

Every VarDis record says something about the database of the node that sends it (dcp-vardis.md, "Basic Transmissible
Data Types"): a create, an update, a summary and a request for an update carry the sequence number that the node has, a
delete says that the node has deleted the variable, a request for a create that it does not know the variable.

:class:`Holdings` follows beacons and yields what changes. :class:`History` keeps the changes for a page, in bounded
memory. What a node holds is known only from what it says: a value that it has taken shows with its next beacon about
the variable.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from dcp_codec.jsonform import node_id_text
from dcp_codec.values import Beacon, VarCreate, VarDelete, VarReqCreate

DELETED: Final = -1
"""In place of a number: the node has deleted the variable."""
UNKNOWN: Final = -2
"""In place of a number: the node has asked for the variable's creation, or has never spoken of it."""

Creation = tuple[bytes, int | None]
"""The identity of a creation: prodId, and creationTime (None before 2.0)."""

#: Pairs of node and variable that are followed; others are left out.
MOST_PAIRS = 1 << 18
#: Changes that a history keeps exactly.
MOST_CHANGES = 60_000


class Held(NamedTuple):
    """What a node holds of a variable.

    ``number`` is its sequence number, or :data:`DELETED` or :data:`UNKNOWN`; ``creation`` what the node last said in a
    create, None if it never did. ``time`` (ns since 1970) and ``frame`` are those of the beacon that first said so.
    """

    number: int
    creation: Creation | None
    time: int
    frame: int


class Change(NamedTuple):
    """A node says something new about a variable."""

    node: bytes
    var_id: int
    before: Held | None
    """None: the node had not spoken of it."""
    now: Held


def records_of(beacon: Beacon) -> Iterator[Any]:
    """All VarDis records of a beacon, in their order."""
    for payload in beacon.payloads:
        for container in payload.vardis or ():
            yield from container.records


class Holdings:
    """Follows the beacons of a recording, in their order."""

    def __init__(self, most: int = MOST_PAIRS) -> None:
        """``most`` pairs of node and variable are followed."""
        self._most = most
        self._held: dict[bytes, dict[int, Held]] = {}
        self._pairs = 0
        self.producers: dict[int, bytes] = {}
        """By variable: the prodId of the creation that was said last."""

    def feed(self, frame: int, time_ns: int, node: bytes, beacon: Beacon) -> list[Change]:
        """What the next beacon changes. ``node`` is its sender."""
        return self.feed_records(frame, time_ns, node, records_of(beacon))

    def feed_records(self, frame: int, time_ns: int, node: bytes, records: Iterable[Any]) -> list[Change]:
        """As :meth:`feed`, by the VarDis records of the beacon; those that say the same again may be left out."""
        changes: list[Change] = []
        held = self._held.get(node)
        if held is None:
            held = self._held[node] = {}
        for record in records:
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
            kind = type(record)
            number = DELETED if kind is VarDelete else UNKNOWN if kind is VarReqCreate else record.seqno
        if before is None:
            if self._pairs >= self._most:
                return
            self._pairs += 1
        elif before.number == number and before.creation == creation:
            return
        now = held[var_id] = Held(number, creation, time_ns, frame)
        changes.append(Change(node, var_id, before, now))

    def held(self, node: bytes, var_id: int) -> Held | None:
        """What a node last said of a variable; None if nothing."""
        return self._held.get(node, {}).get(var_id)

    def of(self, node: bytes) -> Mapping[int, Held]:
        """All that a node last said, by variable."""
        return self._held.get(node, {})

    @property
    def nodes(self) -> list[bytes]:
        """All senders, in the order in which they were met."""
        return list(self._held)

    def differs(self, node: bytes, var_id: int) -> bool:
        """Whether a node holds another number than the producer of the variable, as far as both have said."""
        producer = self.producers.get(var_id)
        mine, its = self.held(node, var_id), None if producer is None else self.held(producer, var_id)
        return mine is not None and its is not None and mine.number != its.number


class History:
    """All changes of a recording, compact enough for a page.

    Beyond ``most`` changes time gets coarser: of each interval only the last state is kept, and the interval doubles
    whenever there are too many. ``interval`` is its length in ns. A quarter of ``most`` pairs of node and variable are
    followed.
    """

    def __init__(self, representation: str, most: int = MOST_CHANGES) -> None:
        """``representation``: how node identifiers are written (``profile.types.node_id.representation``)."""
        self._representation, self._most = representation, most
        # Each pair keeps one state at least, however coarse time is.
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
        """The state after the last beacon."""
        return self._holdings

    def feed(self, frame: int, time_ns: int, node: bytes, beacon: Beacon) -> list[Change]:
        """Take the next beacon; also what it changes. Times that go back count as no time."""
        return self.feed_records(frame, time_ns, node, records_of(beacon))

    def feed_records(self, frame: int, time_ns: int, node: bytes, records: Iterable[Any]) -> list[Change]:
        """As :meth:`feed`, by the VarDis records of the beacon; those that say the same again may be left out."""
        if self._begin is None:
            self._begin = self._end = time_ns
        self._end = max(self._end, time_ns)
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
            # In the order of time, so that the last state of an interval wins.
            self._states = {(at // 2, node, each): number for (at, node, each), number in self._states.items()}
            self._producers = {(at // 2, each): node for (at, each), node in self._producers.items()}

    def as_json(self) -> dict[str, Any]:
        """For programs and pages: times in intervals since ``begin``, nodes and variables by index.

        ``changes`` are rows of delta of time, node, variable, number (:data:`DELETED`, :data:`UNKNOWN`);
        ``producers`` rows of time, variable, node.
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
        """Node, variable and number of everything that is held at a moment, to the precision of ``interval``."""
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
