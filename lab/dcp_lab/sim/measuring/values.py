"""Tracking of each value from its producer to the nodes that store it.

A sequence number does not identify a value: one of 8 bits repeats after 256 updates, and with a long delay or after a
partition both values can be in flight at once. Here the identity of a value consists of its producer, its variable,
the creation to which it belongs, and its number since then, which never wraps. To identify a received value, the log
searches the history of the beacon's sender for the value that it held with this sequence number when it sent.

Times are virtual ns, nodes are numbers from 0.
"""

from __future__ import annotations

import statistics
from array import array
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

import msgspec

from dcp_lab.sim.scenario.definition import NS_PER_MS

from .reach import UNREACHABLE, Reach

#: Length of a history from which on entries that are no longer needed are removed.
_TIDY_FROM = 64
#: Maximum length of a history: enough for a beacon's delay of 1.8 h at 10 updates/s.
LONGEST_HISTORY = 1 << 16
#: Number of examples kept of newer values that were replaced by older ones.
_EXAMPLES = 3

Kind = Literal["creation", "update"]


class Content(NamedTuple):
    """The properties of a value that nodes know; they do not identify it. ``creation_time``: in the profile's units."""

    producer: int
    var_id: int
    creation_time: int | None
    seqno: int
    octets: bytes


class Series(msgspec.Struct, eq=False):
    """A variable from one creation to its next creation. ``ordinal``: number of the creation, from 0."""

    producer: int
    var_id: int
    ordinal: int
    last: Value | None = None


class Value(msgspec.Struct, eq=False):
    """One value of a variable. ``number`` is 0 for the value of the creation, counts up and never wraps.

    ``reach``: the nodes at which the value is counted; None to track it without counting.
    """

    series: Series
    number: int
    content: Content
    born: int
    reach: Reach | None
    received: int = 0
    """The nodes that stored it, as bits."""
    arrivals: dict[int, int] | None = None
    """The times at which counted nodes first stored it, if the log keeps them."""

    @property
    def kind(self) -> Kind:
        """``creation`` for the value of the creation, otherwise ``update``."""
        return "update" if self.number else "creation"


class Reception(NamedTuple):
    """One value at one node at which it was due."""

    producer: int
    variable: int
    creation: int
    """Number of the creation of the variable by this producer, from 0."""
    number: int
    """Number of the value since the creation, which is 0; it never wraps."""
    seqno: int
    born: int
    """Time at which it was produced, ns."""
    node: int
    hops: int | None
    """Shortest path when it was produced; None without a path."""
    arrived: int | None
    """Time at which the node first stored it, ns; None if it never did."""


class DelayRow(msgspec.Struct, frozen=True):
    """Reception of the values of one kind at nodes of one distance. Times are in ms, None without any reception.

    ``received + missed == due``.
    """

    kind: Kind
    hops: int | None
    """Length of the shortest path over connections that carried frames when the value was produced; None without a
    path."""
    due: int
    """Number of values, each counted once per other node that was switched on when it was produced."""
    received: int
    missed: int
    share: float
    """``received / due``."""
    mean_ms: float | None = None
    median_ms: float | None = None
    sd_ms: float | None = None
    """Sample standard deviation; None below two receptions."""
    p95_ms: float | None = None
    """The smallest delay that 95 % of the receptions do not exceed."""
    max_ms: float | None = None
    node: int | None = None
    """The node of a row about one node; None for all nodes of this distance."""


class ValueTotals(msgspec.Struct, frozen=True):
    """Totals of all values produced after the warm-up. ``received + missed == due``."""

    produced: int = 0
    due: int = 0
    received: int = 0
    missed: int = 0
    missed_newest: int = 0
    """The part of ``missed`` that are newest values of alive variables, which could still arrive after the end."""
    wrapped: int = 0
    """Number of times that a sequence number of a producer wrapped around."""
    older_for_newer: int = 0
    """Number of times that a node replaced a newer value by an older one of the same producer."""
    unidentified: int = 0
    """Number of receptions whose value could not be identified; delays and shares do not include them."""
    notes: list[str] = []


class _Group:
    """Expected receptions and measured delays (ns) of the values of one kind at one distance."""

    __slots__ = ("delays", "due")

    def __init__(self) -> None:
        self.due = 0
        self.delays = array("q")


class _History(NamedTuple):
    """The values of a variable that a node held, in order, with the times at which it stored them."""

    times: list[int]
    values: list[Value]


class ValueLog:
    """The values of all variables of a network. Call its methods for each change at any node, in order of time."""

    def __init__(self, nodes: int, *, oldest_in_flight: Callable[[], int], held_back: int) -> None:
        """``oldest_in_flight`` returns the time at which the oldest frame in flight was sent.

        ``held_back``: longest time (ns) that a payload can wait at its node before it is sent. Values that were
        replaced earlier than both together are removed from the histories.
        """
        self._oldest_in_flight = oldest_in_flight
        self._held_back = held_back
        self._series: dict[tuple[int, int], Series] = {}
        self._histories: list[dict[int, _History]] = [{} for _ in range(nodes)]
        self._tidy_at: dict[tuple[int, int], int] = {}
        self._held: list[dict[int, Value]] = [{} for _ in range(nodes)]
        self._groups: dict[tuple[Kind, int], _Group] = {}
        self._produced = self._wrapped = self._older = self._unidentified = 0
        self._wraps: Counter[int] = Counter()
        self._examples: list[str] = []
        self._kept: list[Value] | None = None
        self._nodes: dict[tuple[Kind, int, int], _Group] | None = None
        """By kind, distance and node, if they are counted by node."""

    def count_by_node(self) -> None:
        """Count by node as well, for :meth:`node_rows`. Call it before the first value."""
        self._nodes = {}

    def keep_receptions(self) -> None:
        """Keep all values and their receptions for :meth:`receptions`. Call it before the first value."""
        self._kept = []

    def receptions(self) -> Iterator[Reception]:
        """Yield a row for each counted value and each node at which it was due, in order of production."""
        for value in self._kept or ():
            series, reach, arrivals = value.series, value.reach, value.arrivals
            assert reach is not None
            assert arrivals is not None
            for node in _bits(reach.mask):
                yield Reception(
                    series.producer, series.var_id, series.ordinal, value.number, value.content.seqno, value.born, node,
                    reach.hops.get(node), arrivals.get(node),
                )  # fmt: skip

    def held(self, node: int, var_id: int) -> Value | None:
        """Return the value of a variable at a node; None if the variable is unknown or deleted."""
        return self._held[node].get(var_id)

    def newest(self, producer: int, var_id: int) -> Value | None:
        """Return the last value of a variable from this producer; None if it never created it."""
        series = self._series.get((producer, var_id))
        return None if series is None else series.last

    # -- changes -------------------------------------------------------------------------------------------------------

    def born(self, now: int, content: Content, *, created: bool, reach: Reach | None) -> Value:
        """Note that a producer created or updated a variable; returns the new value.

        ``reach``: the nodes at which it is counted; None to track it without counting.
        """
        producer, var_id = content.producer, content.var_id
        series = self._series.get((producer, var_id))
        if created or series is None:
            ordinal = 0 if series is None else series.ordinal + 1
            series = self._series[producer, var_id] = Series(producer, var_id, ordinal)
        last = series.last
        value = series.last = Value(series, 0 if last is None else last.number + 1, content, now, reach)
        if last is not None and content.seqno < last.content.seqno and reach is not None:
            self._wrapped += 1
            self._wraps[var_id] += 1
        if reach is not None:
            self._produced += 1
            for hops, count in reach.by_hops.items():
                self._group(value.kind, hops).due += count
            if self._nodes is not None:
                for node in _bits(reach.mask):
                    self._node_group(value.kind, reach.hops.get(node, UNREACHABLE), node).due += 1
            if self._kept is not None:
                value.arrivals = {}
                self._kept.append(value)
        self._hold(now, producer, value)
        return value

    def taken(self, now: int, node: int, content: Content, *, sender: int, sent: int) -> Value | None:
        """Note that a node stored a value from a frame that ``sender`` had sent at ``sent``.

        Returns the value, None if it cannot be identified.
        """
        value = self._identify(content, sender, sent)
        if value is None:
            self._unidentified += 1
            self._held[node].pop(content.var_id, None)
            return None
        before = self._held[node].get(content.var_id)
        if before is not None and before.series.producer == content.producer:
            self._compare(now, node, before, value)
        self._hold(now, node, value)
        bit = 1 << node
        if value.reach is not None and value.reach.mask & bit and not value.received & bit:
            value.received |= bit
            if value.arrivals is not None:
                value.arrivals[node] = now
            hops = value.reach.hops.get(node, UNREACHABLE)
            self._group(value.kind, hops).delays.append(now - value.born)
            if self._nodes is not None:
                self._node_group(value.kind, hops, node).delays.append(now - value.born)
        return value

    def lost(self, node: int, var_id: int) -> None:
        """Note that a node deleted a variable."""
        self._held[node].pop(var_id, None)

    def switched_off(self, node: int) -> None:
        """Note that a node lost its memory. Its history stays, because its frames may still be in flight."""
        self._held[node].clear()

    # -- results -------------------------------------------------------------------------------------------------------

    def rows(self) -> list[DelayRow]:
        """Return delays and shares: creations before updates, each by distance, nodes without a path last."""
        order = sorted(self._groups, key=lambda key: (key[0], key[1] == UNREACHABLE, key[1]))
        return [_row(kind, hops, self._groups[kind, hops]) for kind, hops in order]

    def node_rows(self) -> list[DelayRow]:
        """Return the same for each node; none without :meth:`count_by_node`."""
        found = self._nodes or {}
        order = sorted(found, key=lambda key: (key[0], key[1] == UNREACHABLE, key[1:]))
        return [
            msgspec.structs.replace(_row(kind, hops, found[kind, hops, node]), node=node) for kind, hops, node in order
        ]

    def totals(self) -> ValueTotals:
        """Return the totals, with notes that restrict the meaning of the delays."""
        due = sum(group.due for group in self._groups.values())
        received = sum(len(group.delays) for group in self._groups.values())
        return ValueTotals(
            produced=self._produced,
            due=due,
            received=received,
            missed=due - received,
            missed_newest=sum(self._missed_newest(series) for series in self._series.values()),
            wrapped=self._wrapped,
            older_for_newer=self._older,
            unidentified=self._unidentified,
            notes=self._notes(),
        )

    def _missed_newest(self, series: Series) -> int:
        """Return the number of counted nodes without the newest value of an alive variable, otherwise 0."""
        last = series.last
        if last is None or last.reach is None or self._held[series.producer].get(series.var_id) is not last:
            return 0
        return (last.reach.mask & ~last.received).bit_count()

    def _notes(self) -> list[str]:
        """Return a sentence each about wrapped sequence numbers, older values and unidentified values, if any."""
        notes = []
        if self._wraps:
            which = ", ".join(f"{var_id} ({times})" for var_id, times in sorted(self._wraps.items())[:8])
            more = f", and {len(self._wraps) - 8} more" if len(self._wraps) > 8 else ""
            notes.append(f"sequence numbers wrapped {self._wrapped} times; by variable: {which}{more}")
        if self._older:
            notes.append(
                f"{self._older} times a node replaced a newer value by an older one (serial number comparison); "
                + "; ".join(self._examples)
            )
        if self._unidentified:
            notes.append(f"{self._unidentified} received values could not be identified: delays do not contain them")
        return notes

    # -- internals -----------------------------------------------------------------------------------------------------

    def _group(self, kind: Kind, hops: int) -> _Group:
        """Return the group of a kind and a distance; create it if necessary."""
        group = self._groups.get((kind, hops))
        if group is None:
            group = self._groups[kind, hops] = _Group()
        return group

    def _node_group(self, kind: Kind, hops: int, node: int) -> _Group:
        assert self._nodes is not None
        return self._nodes.setdefault((kind, hops, node), _Group())

    def _identify(self, content: Content, sender: int, sent: int) -> Value | None:
        """Return the latest value with this content that the sender held at ``sent``, None without one."""
        history = self._histories[sender].get(content.var_id)
        if history is None:
            return None
        # The latest matching value is the right one: a payload is composed shortly before it is sent.
        for index in range(bisect_right(history.times, sent) - 1, -1, -1):
            if history.values[index].content == content:
                return history.values[index]
        return None

    def _compare(self, now: int, node: int, before: Value, value: Value) -> None:
        """Count, with an example, if a node replaced a newer value by an older one."""
        if (value.series.ordinal, value.number) >= (before.series.ordinal, before.number):
            return
        if value.reach is None:
            return
        self._older += 1
        if len(self._examples) < _EXAMPLES:
            self._examples.append(
                f"at {now / 1e9:.3f} s node {node} took value {value.number} of variable {value.series.var_id} "
                f"(sequence number {value.content.seqno}) for value {before.number} ({before.content.seqno})"
            )

    def _hold(self, now: int, node: int, value: Value) -> None:
        """Add a value to the history of a node, as the one that it holds from now on."""
        var_id = value.series.var_id
        self._held[node][var_id] = value
        history = self._histories[node].get(var_id)
        if history is None:
            history = self._histories[node][var_id] = _History([], [])
        history.times.append(now)
        history.values.append(value)
        if len(history.times) > self._tidy_at.get((node, var_id), _TIDY_FROM):
            self._tidy(node, var_id, history)

    def _tidy(self, node: int, var_id: int, history: _History) -> None:
        """Remove the values of a history that no frame in flight can contain.

        The last value from before the oldest possible frame is kept.
        """
        first = bisect_right(history.times, self._oldest_in_flight() - self._held_back) - 1
        first = max(first, len(history.times) - LONGEST_HISTORY, 0)
        del history.times[:first], history.values[:first]
        self._tidy_at[node, var_id] = max(_TIDY_FROM, 2 * len(history.times))


def _bits(mask: int) -> Iterator[int]:
    """Yield the numbers of the bits that are set."""
    return (number for number in range(mask.bit_length()) if mask >> number & 1)


def _row(kind: Kind, hops: int, group: _Group) -> DelayRow:
    """Return the row of a group, with the statistics of its delays."""
    delays, received = sorted(group.delays), len(group.delays)
    found = DelayRow(
        kind=kind,
        hops=None if hops == UNREACHABLE else hops,
        due=group.due,
        received=received,
        missed=group.due - received,
        share=received / group.due if group.due else 0.0,
    )
    if not delays:
        return found
    mean = statistics.fmean(delays)
    return msgspec.structs.replace(
        found,
        mean_ms=mean / NS_PER_MS,
        median_ms=statistics.median(delays) / NS_PER_MS,
        sd_ms=statistics.stdev(map(float, delays), mean) / NS_PER_MS if received > 1 else None,
        p95_ms=delays[-(-received * 95 // 100) - 1] / NS_PER_MS,
        max_ms=delays[-1] / NS_PER_MS,
    )
