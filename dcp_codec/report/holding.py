"""Compare the sequence number that each node holds of each variable, according to its beacons, with the producer's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from dcp_codec.analysis.entry import DELETED

from .analysis import Time, times_of
from .recorded import Column, Recorded
from .series import usual_interval

#: Maximum numbers of nodes and variables that are compared: those with the most records.
_NODES, _VARIABLES = 60, 200
#: Time in seconds, and number of its beacons, without a record about a variable after which a node's state is unknown.
_FORGOTTEN, _FORGOTTEN_BEACONS = 10.0, 20
#: Minimum duration of a listed difference: in seconds, and in beacons of the node.
_PATIENCE, _PATIENCE_BEACONS = 2.0, 10

Span = tuple[float, float]


@dataclass
class Pair:
    """One node and one variable of another node. Spans are in seconds since the first frame.

    ``known``: spans in which the node's sequence number is known. ``differs``: spans in which it is not the producer's,
    or the node has not sent any. ``stale``: the stale part of them, which begins two seconds, and ten beacons of the
    node, after the producer left the node's number. ``held`` and ``produced`` are the last numbers of node and
    producer: DELETED, or None without any. ``values`` is the number of values of the producer that the node could have
    sent, ``sent`` the number of those that it has sent.
    """

    variable: int
    node: int
    producer: int
    known: list[Span] = field(default_factory=list)
    differs: list[Span] = field(default_factory=list)
    stale: list[Span] = field(default_factory=list)
    #: The longest lag in seconds, and the largest one in values.
    age: float = 0.0
    numbers: int = 0
    held: int | None = None
    produced: int | None = None
    values: int = 0
    sent: int = 0
    #: Whether the last numbers differ, and have differed for long while the node sent beacons.
    differs_at_end: bool = False
    #: The claims of the node (None: none) and of the producer.
    claims: tuple[_Claims | None, _Claims] | None = None

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
class Divergence:
    """A long difference between the numbers of a node and of the producer.

    ``start`` is the time at which the producer left the node's number, ``age`` the longest lag. ``missed`` is
    the number of the producer's values that the node did not send. ``frame`` is the frame in which the producer sent
    the first of them. ``produced`` is the producer's number at the end of the difference.
    """

    variable: int
    node: int
    producer: int
    start: float
    end: float
    age: float
    to_the_end: bool
    held: int | None
    produced: int
    missed: int
    frame: int


@dataclass
class Holding:
    """The comparison of all nodes. ``left_out`` is the number of pairs of node and variable that were not compared."""

    pairs: list[Pair] = field(default_factory=list)
    divergences: list[Divergence] = field(default_factory=list)
    #: Variables without a received VarCreate, or without a record of their producer.
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


def holding(recorded: Recorded, time: Time) -> Holding:
    """Compare the sequence numbers that nodes hold with those of the producers."""
    held, found = recorded.tables["held"], Holding()
    claims = dict(_claims(held, time))
    spoken, chatter = np.unique(held["node"], return_counts=True)
    about, words = np.unique(held["variable"], return_counts=True)
    nodes = spoken[np.argsort(-chatter, kind="stable")][:_NODES].tolist()
    variables = about[np.argsort(-words, kind="stable")][:_VARIABLES].tolist()
    found.left_out = max(0, spoken.size * about.size - len(nodes) * len(variables))
    beacons = {node: times_of(recorded, time, "beacons", node) for node in nodes}
    for variable in variables:
        known = recorded.variables.get(variable)
        producer = known.producer if known is not None else -1
        if (variable, producer) not in claims:
            found.without_producer.append(variable)
            continue
        produced = claims[variable, producer].changes()
        for node in nodes:
            if node != producer and beacons[node].size:
                pair = Pair(variable, node, producer)
                found.divergences += _compare(pair, produced, claims.get((variable, node)), beacons[node])
                found.pairs.append(pair)
    found.divergences.sort(key=lambda each: (not each.to_the_end, -each.age))
    return found


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


def _compare(pair: Pair, produced: _Claims, claimed: _Claims | None, beacons: Column) -> list[Divergence]:
    """Set the fields of the pair; return the long differences."""
    end, interval = float(beacons[-1]), usual_interval(beacons)
    pair.produced = int(produced.number[-1])
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
    patience = max(_PATIENCE, _PATIENCE_BEACONS * interval)
    apart = pieces[differs]
    left, numbers = _left(apart, produced, claimed)
    # The number of a state is old from the change of the producer on; the pieces of one state have one such time.
    late = apart[:, 1] > left + patience
    if late.any():
        pair.stale = _joined(np.stack([np.maximum(apart[:, 0], left + patience), apart[:, 1]], axis=1)[late])
        pair.age, pair.numbers = float((apart[:, 1] - left).max()), int(numbers[late].max())
    # The last beacon may end the difference.
    final = np.array([end])
    agrees = (
        claimed is not None and not _differ(claimed.number[claimed.at(final)], produced.number[produced.at(final)])[0]
    )
    open_end = bool(len(pieces) and differs[-1] and pieces[-1, 1] == end and not agrees)
    found = []
    for since, stop in pair.stale:
        to_the_end = open_end and stop == end
        pair.differs_at_end |= to_the_end
        of_this = (apart[:, 1] > since) & (apart[:, 0] < stop)
        start = float(left[of_this].min())
        inside = (produced.time >= start) & (produced.time < stop)
        missed = inside & ~heard
        # The first missed value was sent before the start of the difference, or during it.
        first = int(np.argmax(missed)) if missed.any() else int(max(produced.at(np.array([start]))[0], 0))
        last = int(claimed.at(np.array([stop - 1e-9]))[0]) if claimed is not None else -1
        found.append(
            Divergence(
                variable=pair.variable,
                node=pair.node,
                producer=pair.producer,
                start=start,
                end=stop,
                age=float((apart[of_this, 1] - left[of_this]).max()),
                to_the_end=to_the_end,
                held=int(claimed.number[last]) if claimed is not None and last >= 0 else None,
                produced=int(produced.number[max(int(produced.at(np.array([stop - 1e-9]))[0]), 0)]),
                missed=int(missed.sum()),
                frame=int(produced.frame[first]),
            )
        )
    return found


def _left(pieces: Column, produced: _Claims, claimed: _Claims | None) -> tuple[Column, Column]:
    """Return for each piece when the producer left the number of the node, and the lag in values at its end.

    If the producer has not shown this number before, the piece counts from its own start, or that of the pieces that
    are adjacent to it.
    """
    if not len(pieces):
        return np.zeros(0), np.zeros(0, np.int64)
    joined = np.concatenate([[True], pieces[1:, 0] != pieces[:-1, 1]])
    begin = np.maximum.accumulate(np.where(joined, pieces[:, 0], -np.inf))
    values = np.concatenate([[0], np.cumsum(produced.number >= 0)])
    now = np.searchsorted(produced.time, pieces[:, 1], "left")
    if claimed is None:
        return begin, values[now]
    held = claimed.number[claimed.at(pieces[:, 0])]
    order = np.lexsort((produced.time, produced.number))
    span = max(float(produced.time[-1]), float(pieces[-1, 1])) + 1
    keys = (produced.number[order] + 3) * span + produced.time[order]
    place = np.searchsorted(keys, (held + 3) * span + pieces[:, 0], "right") - 1
    same = order[np.maximum(place, 0)]
    known = (place >= 0) & (produced.number[same] == held) & (same + 1 < produced.time.size)
    left = np.where(known, produced.time[np.minimum(same + 1, produced.time.size - 1)], begin)
    return left, np.where(known, values[now] - values[np.minimum(same + 1, len(values) - 1)], 1)


def _differ(held: Column, produced: Column) -> Column:
    """Return whether numbers differ. A deleted variable and an unknown one count as equal."""
    found: Column = (held != produced) & ((held >= 0) | (produced >= 0))
    return found


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
    differs = _differ(claimed.number[row], produced.number[np.maximum(theirs, 0)])
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
