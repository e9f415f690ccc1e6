"""Compare the sequence number that each node holds of each variable, according to its beacons, with the producer's.

The ledger decides which states are stale (:meth:`dcp_codec.analysis.ledger.Ledger.stale`), for this page and for
``dcp-conformance check``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from dcp_spec.constants import ICType, features

from dcp_codec.analysis.entry import DELETED, Entry
from dcp_codec.analysis.lag import patience
from dcp_codec.analysis.ledger import Ledger

from .analysis import Time, times_of
from .recorded import Column, Recorded
from .series import usual_interval

#: Maximum numbers of nodes and variables that are compared: those with the most records.
_NODES, _VARIABLES = 60, 200
#: Time in seconds, and number of its beacons, without a record about a variable after which a node's state is unknown.
_FORGOTTEN, _FORGOTTEN_BEACONS = 10.0, 20
_SECOND = 1_000_000_000

Span = tuple[float, float]


@dataclass
class Pair:
    """One node and one variable of another node. Spans are in seconds since the first frame.

    ``known``: spans in which the node's sequence number is known. ``differs``: spans in which it is not the producer's,
    or the node has not sent any. ``stale``: spans in which its state was stale. ``held`` and ``produced`` are the last
    numbers of node and producer: DELETED, or None without any. ``values`` is the number of values of the producer that
    the node could have sent, ``sent`` the number of those that it has sent.
    """

    variable: int
    node: int
    producer: int
    known: list[Span] = field(default_factory=list)
    differs: list[Span] = field(default_factory=list)
    stale: list[Span] = field(default_factory=list)
    #: The longest lag of a stale state in seconds, and the largest one in values.
    age: float = 0.0
    numbers: int = 0
    held: int | None = None
    produced: int | None = None
    #: Time of the last beacon of the node in seconds.
    last: float = 0.0
    values: int = 0
    sent: int = 0
    #: Whether the last state of the node is stale.
    stale_at_end: bool = False
    #: The claims of the node (None: none) and of the producer.
    claims: tuple[_Claims | None, _Claims] | None = None

    @property
    def absent(self) -> bool:
        """True if the producer has the variable, and the node has sent no record about it."""
        return self.held is None and bool(self.differs)

    def at(self, second: float) -> tuple[int | None, int | None]:
        """Return the last numbers of node and producer before this time; None without any."""
        assert self.claims is not None
        rows = [-1 if each is None else int(np.searchsorted(each.time, second, "left")) - 1 for each in self.claims]
        held, produced = (
            None if each is None or row < 0 else int(each.number[row])
            for each, row in zip(self.claims, rows, strict=True)
        )
        return held, produced


@dataclass(frozen=True)
class Stale:
    """A stale state of a node.

    ``start`` is the time at which the producer left the number ``held``, in frame ``frame``; the node stated it for the
    last time at ``end``. ``produced`` is the producer's state at that time, ``missed`` the number of its values that
    the node had not followed.
    """

    variable: int
    node: int
    producer: int
    start: float
    end: float
    to_the_end: bool
    held: int
    produced: int
    missed: int
    frame: int

    @property
    def age(self) -> float:
        """The lag in seconds."""
        return self.end - self.start


@dataclass
class Holding:
    """The comparison of all nodes. ``left_out`` is the number of pairs of node and variable that were not compared."""

    pairs: list[Pair] = field(default_factory=list)
    stale: list[Stale] = field(default_factory=list)
    #: Variables without a received VarCreate, with several producers, or without a record of their producer.
    without_producer: list[int] = field(default_factory=list)
    left_out: int = 0


@dataclass(frozen=True)
class _Claims:
    """The claims of one node about one variable: ascending times (s), sequence numbers, and frames."""

    time: Column
    number: Column
    frame: Column

    def changes(self) -> _Claims:
        """Return the claims that differ from the one before."""
        new = np.ones(self.number.size, bool)
        new[1:] = self.number[1:] != self.number[:-1]
        return _Claims(self.time[new], self.number[new], self.frame[new])

    def at(self, times: Column) -> Column:
        """Return the index of the last claim at each time; -1 before the first."""
        found: Column = np.searchsorted(self.time, times, "right") - 1
        return found


def ledger_of(recorded: Recorded) -> Ledger:
    """Return the ledger of a recording; nodes have the octets of their names."""
    table, ledger = recorded.tables["held"], Ledger()
    names = [name.encode() for name in recorded.nodes]
    order = np.lexsort((table["frame"], table["node"], table["variable"]))
    node, variable, number = (table[each][order] for each in ("node", "variable", "seqno"))
    turns = np.ones(order.size + 1, bool)
    turns[1:-1] = (node[1:] != node[:-1]) | (variable[1:] != variable[:-1]) | (number[1:] != number[:-1])
    turns[:-1] |= table["producer"][order] >= 0
    kept = order[turns[:-1] | turns[1:]]
    kept = kept[np.argsort(table["frame"][kept], kind="stable")]
    kinds = {int(each): each for each in ICType}
    timed = features(recorded.codec.profile.spec_version).creation_time
    columns = ("frame", "time", "node", "kind", "variable", "seqno", "producer", "creation")
    for frame, time, who, kind, about, held, producer, creation in zip(
        *(table[name][kept].tolist() for name in columns), strict=True
    ):
        created = None if producer < 0 else (names[producer], creation if timed else None)
        ledger.follow(frame, time, names[who], kinds[kind], about, held, created)
    return ledger


def holding(recorded: Recorded, time: Time) -> Holding:
    """Compare the sequence numbers that nodes hold with those of the producers."""
    held, found, ledger = recorded.tables["held"], Holding(), ledger_of(recorded)
    numbers = {name.encode(): place for place, name in enumerate(recorded.nodes)}
    claims = dict(_claims(held, time))
    spoken, chatter = np.unique(held["node"], return_counts=True)
    about, words = np.unique(held["variable"], return_counts=True)
    nodes = spoken[np.argsort(-chatter, kind="stable")][:_NODES].tolist()
    variables = about[np.argsort(-words, kind="stable")][:_VARIABLES].tolist()
    found.left_out = max(0, spoken.size * about.size - len(nodes) * len(variables))
    beacons = {node: times_of(recorded, time, "beacons", node) for node in nodes}
    period = max((usual_interval(each) for each in beacons.values()), default=0.0) * _SECOND
    stale: dict[tuple[int, int], list[Entry]] = {}
    for each in ledger.stale(period):
        stale.setdefault((each.var_id, numbers[each.node]), []).append(each)
    for variable in variables:
        producer = numbers.get(ledger.producers.get(variable, b""), -1)
        if variable not in ledger.compared or (variable, producer) not in claims:
            found.without_producer.append(variable)
            continue
        produced = claims[variable, producer].changes()
        for node in nodes:
            if node != producer and beacons[node].size:
                pair = Pair(variable, node, producer)
                _compare(pair, produced, claims.get((variable, node)), beacons[node])
                for each in stale.get((variable, node), ()):
                    _add(found, pair, each, ledger, time, patience(period))
                found.pairs.append(pair)
    found.stale.sort(key=lambda each: (not each.to_the_end, -each.age))
    return found


def _add(found: Holding, pair: Pair, state: Entry, ledger: Ledger, time: Time, least: int) -> None:
    """Add a stale state to the results; ``least`` is the age in ns from which it is stale."""
    left, newest = state.left, state.newest
    assert left is not None
    assert newest is not None
    start, end = (float(each) for each in time.seconds(np.array([left.time, state.until])))
    last = time.first_ns + round(pair.last * _SECOND)
    to_the_end = ledger.held(state.node, state.var_id) is state and last - state.until <= least
    pair.stale.append((start + least / _SECOND, end))
    pair.age, pair.numbers = max(pair.age, end - start), max(pair.numbers, state.missed)
    pair.stale_at_end |= to_the_end
    produced = DELETED if state.deleted else newest.number
    found.stale.append(
        Stale(
            pair.variable, pair.node, pair.producer, start, end, to_the_end, state.number, produced, state.missed,
            left.frame,
        )
    )  # fmt: skip


def _claims(held: dict[str, Column], time: Time) -> Iterator[tuple[tuple[int, int], _Claims]]:
    order = np.lexsort((held["frame"], held["node"], held["variable"]))
    variable, node = held["variable"][order], held["node"][order]
    # The clock of the recorder may have been set back: make the times of claims ascend.
    seconds, number, frame = time.seconds(held["time"][order]), held["seqno"][order], held["frame"][order]
    turns = np.flatnonzero((np.diff(variable) != 0) | (np.diff(node) != 0)) + 1
    for start, end in zip([0, *turns.tolist()], [*turns.tolist(), order.size], strict=True):
        if start < end:
            yield (
                (int(variable[start]), int(node[start])),
                _Claims(np.maximum.accumulate(seconds[start:end]), number[start:end], frame[start:end]),
            )


def _compare(pair: Pair, produced: _Claims, claimed: _Claims | None, beacons: Column) -> None:
    """Set the fields of the pair that do not depend on stale states."""
    end, interval = float(beacons[-1]), usual_interval(beacons)
    pair.produced, pair.last = int(produced.number[-1]), end
    heard = np.zeros(produced.time.size, bool)
    if claimed is None:
        start = max(float(produced.time[0]), float(beacons[0]))
        missing = end > start and pair.produced >= 0
        pieces = np.array([(start, end)] if missing else [], np.float64).reshape(-1, 2)
        differs = np.ones(len(pieces), bool)
    else:
        claimed = _with_deletions(claimed, produced, end)
        heard = _heard(produced, claimed)
        pair.held = int(claimed.number[-1])
        forgotten = max(_FORGOTTEN, _FORGOTTEN_BEACONS * interval)
        pieces, differs = _pieces(produced, claimed, end, forgotten)
        pair.known = _joined(pieces)
    pair.claims = claimed, produced
    could = (produced.time <= end) & (produced.time >= float(beacons[0])) & (produced.number >= 0)
    pair.values, pair.sent = int(could.sum()), int((could & heard).sum())
    pair.differs = _joined(pieces[differs])


def _with_deletions(claimed: _Claims, produced: _Claims, end: float) -> _Claims:
    """Add a deletion to the claims of a node that sends no record about a variable after the producer deleted it.

    ``end`` is the time of the node's last beacon.
    """
    times, frames = [], []
    ends = [*produced.time[1:].tolist(), np.inf]
    for at, until, number in zip(produced.time.tolist(), ends, produced.number.tolist(), strict=True):
        if number != DELETED:
            continue
        inside = np.flatnonzero((claimed.time > at) & (claimed.time < until))
        before = np.flatnonzero(claimed.time <= at)
        if (claimed.number[inside] == DELETED).any() or not (inside.size or before.size):
            continue
        last = inside[-1] if inside.size else before[-1]
        silent = max(at, float(claimed.time[last]) + 1e-9)
        if silent < end and (inside.size or claimed.number[last] != DELETED):
            times.append(silent)
            frames.append(int(claimed.frame[last]))
    if not times:
        return claimed
    stamps = np.concatenate([claimed.time, times])
    order = np.argsort(stamps, kind="stable")
    number = np.concatenate([claimed.number, np.full(len(times), DELETED)])
    return _Claims(stamps[order], number[order], np.concatenate([claimed.frame, frames])[order])


def _pieces(produced: _Claims, claimed: _Claims, end: float, forgotten: float) -> tuple[Column, Column]:
    """Return the spans (start, end) in which the node's number is known, and whether it differs in each."""
    gaps = np.append(claimed.time[1:], max(end, float(claimed.time[-1]))) - claimed.time
    silent = (gaps > forgotten) & (claimed.number != DELETED)
    times = np.concatenate(
        [produced.time, claimed.changes().time, claimed.time[silent], claimed.time[silent] + forgotten]
    )
    times = np.sort(times[times < end])
    times = np.append(times[np.diff(times, prepend=-np.inf) > 0], end)
    mine, theirs = claimed.at(times[:-1]), produced.at(times[:-1])
    row = np.maximum(mine, 0)
    known = (mine >= 0) & (theirs >= 0) & ~(silent[row] & (times[:-1] >= claimed.time[row] + forgotten))
    held, wanted = claimed.number[row], produced.number[np.maximum(theirs, 0)]
    # A deleted variable and an unknown one count as equal.
    differs = (held != wanted) & ((held >= 0) | (wanted >= 0))
    return np.stack([times[:-1], times[1:]], axis=1)[known], differs[known]


def _heard(produced: _Claims, claimed: _Claims) -> Column:
    """Return which values of the producer the node has sent after the producer."""
    order = np.lexsort((produced.time, produced.number))
    span = max(float(produced.time[-1]), float(claimed.time[-1])) + 1
    known = (produced.number[order] + 1) * span + produced.time[order]
    place = np.searchsorted(known, (claimed.number + 1) * span + claimed.time, "right") - 1
    good = (place >= 0) & (produced.number[order[np.maximum(place, 0)]] == claimed.number)
    heard = np.zeros(produced.time.size, bool)
    heard[order[place[good]]] = True
    return heard


def _joined(pieces: Column) -> list[Span]:
    """Join adjacent spans."""
    apart = pieces[1:, 0] != pieces[:-1, 1]
    starts = pieces[np.concatenate([[True], apart])[: len(pieces)], 0]
    ends = pieces[np.concatenate([apart, [True]])[: len(pieces)], 1]
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def shares(spans: list[Span], edges: Column) -> Column:
    """Return the share of each interval of ``edges`` that the spans cover, 0 to 1."""
    if not spans:
        return np.zeros(edges.size - 1)
    ends = np.array(spans).ravel()
    covered = np.concatenate([[0.0], np.cumsum(np.diff(ends) * (np.arange(ends.size - 1) % 2 == 0))])
    found: Column = np.diff(np.interp(edges, ends, covered)) / np.diff(edges)
    return found
