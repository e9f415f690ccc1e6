"""Reactions between nodes: does a node send a new value after only one other node has sent it?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .recorded import Column, Recorded
from .variables import Transmissions

#: Maximum number of examined values; of more values, every n-th is examined.
_VALUES = 20_000
#: Maximum delay of a reaction after the next beacon, in beacons.
_LONGEST_WAIT = 3
#: Minimum number of trials for a conclusion; minimum share for "reacts"; maximum share for "does not react".
ENOUGH, REACTS, DEAF = 5, 0.5, 0.1


@dataclass(frozen=True)
class Reactions:
    """Counts by [node, other].

    A trial is an interval between two beacons of the node in which only the other node sent a value that was new to the
    node. It has a reaction if the second beacon shows that the node has the value. Values that several nodes sent in an
    interval are not counted.
    """

    trials: Column
    reacted: Column

    def share(self, node: int, other: int) -> float | None:
        """Return the share of trials with a reaction; None with fewer than ``ENOUGH`` trials."""
        many = int(self.trials[node, other])
        return int(self.reacted[node, other]) / many if many >= ENOUGH else None

    def reacts(self, node: int) -> list[int]:
        """Return the indices of the nodes to which the node reacts mostly."""
        return [other for other, share in self._known(node) if share >= REACTS]

    def hears(self, node: int) -> list[int]:
        """Return the indices of the nodes to which the node reacts at least sometimes."""
        return [other for other, share in self._known(node) if share > DEAF]

    def _known(self, node: int) -> Iterator[tuple[int, float]]:
        """Yield the other nodes whose share is known."""
        for other in range(len(self.trials)):
            if (share := self.share(node, other)) is not None:
                yield other, share


def reactions(recorded: Recorded, transmissions: Transmissions, nodes: list[int]) -> Reactions:
    """Count trials and reactions among ``nodes``; the result is indexed like this list."""
    records, held, beacons = (recorded.tables[name] for name in ("values", "held", "beacons"))
    trials, reacted = np.zeros((2, len(nodes), len(nodes)), np.int64)
    if not records["frame"].size:
        return Reactions(trials, reacted)
    every = -(-transmissions.first.size // _VALUES)
    chosen = transmissions.value % every == 0
    rows = transmissions.rows[chosen]
    frame, node, variable = records["frame"][rows], records["node"][rows], records["variable"][rows]
    rank = transmissions.rank[transmissions.value[chosen]]
    place = np.full(len(recorded.nodes) + 1, -1)
    place[nodes] = np.arange(len(nodes))
    levels = _ranks(records, held, transmissions)
    producers = {number: known.producer for number, known in recorded.variables.items()}
    names, kind = np.unique(variable, return_inverse=True)
    producer = np.array([producers.get(int(each), -1) for each in names])[kind]
    waits = _waits(recorded, transmissions)
    for number, each in enumerate(nodes):
        sent = np.sort(beacons["frame"][beacons["node"] == each])
        own = held["node"] == each
        if not sent.size or not own.any():
            continue
        level = _Level(held["variable"][own], held["frame"][own], levels[own])
        after = np.searchsorted(sent, frame, "right")
        wait = waits.get(each, 0)
        open_ = (node != each) & (producer != each) & (after + wait < sent.size) & (after > 0)
        after = np.minimum(after, sent.size - 1 - wait)
        new = open_ & (rank > level.at(variable, sent[np.maximum(after + wait - 1, 0)]))
        # Use only the newest value of each variable in an interval.
        where = np.flatnonzero(new)
        order = where[np.lexsort((place[node[where]], rank[where], after[where], variable[where]))]
        if not order.size:
            continue
        group = np.concatenate([[True], (np.diff(variable[order]) != 0) | (np.diff(after[order]) != 0)])
        starts = np.flatnonzero(group)
        ends = np.append(starts[1:], order.size) - 1
        newest = rank[order] == np.repeat(rank[order[ends]], np.diff(np.append(starts, order.size)))
        senders = place[node[order]]
        low = np.minimum.reduceat(np.where(newest, senders, len(nodes)), starts)
        high = np.maximum.reduceat(np.where(newest, senders, -1), starts)
        alone = (low == high) & (low >= 0)
        last = order[ends[alone]]
        done = level.at(variable[last], sent[after[last] + wait]) >= rank[last]
        np.add.at(trials[number], low[alone], 1)
        np.add.at(reacted[number], low[alone], done.astype(np.int64))
    return Reactions(trials, reacted)


def _waits(recorded: Recorded, transmissions: Transmissions) -> dict[int, int]:
    """Return the usual number of beacons that each node sends after receiving a value before one that shows it.

    Some implementations compose a beacon before they send the previous one. The number is derived from values that only
    one other node had sent before.
    """
    records, beacons = recorded.tables["values"], recorded.tables["beacons"]
    frame, node = records["frame"][transmissions.rows], records["node"][transmissions.rows]
    first = transmissions.firsts(node, len(recorded.nodes))
    starts = np.searchsorted(transmissions.value[first], np.arange(transmissions.first.size), "left")
    seconds = starts[(starts + 1 < np.append(starts[1:], first.size))] + 1
    found = {}
    for each in np.unique(node[first[seconds]]).tolist():
        own = first[seconds[node[first[seconds]] == each]]
        before = first[seconds[node[first[seconds]] == each] - 1]
        sent = np.sort(beacons["frame"][beacons["node"] == each])
        passed = np.searchsorted(sent, frame[own]) - np.searchsorted(sent, frame[before], "right")
        found[each] = int(np.clip(np.median(passed), 0, _LONGEST_WAIT))
    return found


def _ranks(records: dict[str, Column], held: dict[str, Column], transmissions: Transmissions) -> Column:
    """Return the rank of the value of each claim: the last value with this variable and number up to the claim."""
    first = transmissions.rows[transmissions.first]
    keys = np.stack([records["variable"][first], records["seqno"][first], records["frame"][first]])
    claims = np.stack([held["variable"], held["seqno"], held["frame"]])
    # Sort both together; of equal keys, the value comes before the claim.
    both = np.concatenate([keys, claims], axis=1)
    claim = np.arange(both.shape[1]) >= first.size
    order = np.lexsort((claim, both[2], both[1], both[0]))
    last = np.maximum.accumulate(np.where(claim[order], -1, np.arange(order.size)))
    known = order[np.maximum(last, 0)]
    same = (last >= 0) & (both[:2, known] == both[:2, order]).all(axis=0)
    found = np.full(order.size, -1)
    found[order] = np.where(same, transmissions.rank[np.minimum(known, max(first.size - 1, 0))], -1)
    return found[first.size :]


class _Level:
    """The highest rank of each variable that a node has shown up to a frame."""

    def __init__(self, variable: Column, frame: Column, rank: Column) -> None:
        order = np.lexsort((frame, variable))
        self._variable, self._frame = variable[order], frame[order]
        self._span = int(frame.max()) + 2
        top = int(rank.max()) + 2
        names, kind = np.unique(self._variable, return_inverse=True)
        self._names = names
        self._keys = kind * self._span + self._frame
        self._rank = np.maximum.accumulate(kind * top + rank[order] + 1) % top - 1

    def at(self, variable: Column, frame: Column) -> Column:
        """Return the rank of each variable that was shown in or before the frame; -1 for none."""
        kind = np.minimum(np.searchsorted(self._names, variable), self._names.size - 1)
        known = self._names[kind] == variable
        place = np.searchsorted(self._keys, kind * self._span + np.minimum(frame, self._span - 1), "right") - 1
        good = known & (place >= 0) & (self._variable[np.maximum(place, 0)] == variable)
        return np.where(good, self._rank[np.maximum(place, 0)], -1)
