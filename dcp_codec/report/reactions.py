"""Who reacts to whom: what a node says next after only one other node has said something new to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .recorded import Column, Recorded
from .variables import Sayings

#: Values that are looked at; of more, evenly chosen ones.
_VALUES = 20_000
#: Beacons by which reactions may come later than the next one.
_LONGEST_WAIT = 3
#: Trials from which something is concluded; shares from which on a node reacts, and up to which it does not.
ENOUGH, REACTS, DEAF = 5, 0.5, 0.1


@dataclass(frozen=True)
class Reactions:
    """Counts by [node, other]. A trial is an interval between two beacons of the node in which, of all others, only
    the other one sent a value that was new to the node; a reaction is that the second beacon shows that the node has
    it. Values that several had sent in an interval tell nothing about one of them.
    """

    trials: Column
    reacted: Column

    def share(self, node: int, other: int) -> float | None:
        """The share of trials with a reaction; None where there are too few to say."""
        many = int(self.trials[node, other])
        return int(self.reacted[node, other]) / many if many >= ENOUGH else None

    def hears(self, node: int) -> list[int]:
        """Those to whom the node reacts, at least sometimes."""
        shares = ((other, self.share(node, other)) for other in range(len(self.trials)))
        return [other for other, share in shares if share is not None and share > DEAF]


def reactions(recorded: Recorded, sayings: Sayings, nodes: list[int]) -> Reactions:
    """Count trials and reactions among ``nodes``; the places in that list are the indices of the result."""
    said, held, beacons = (recorded.tables[name] for name in ("said", "held", "beacons"))
    trials, reacted = np.zeros((2, len(nodes), len(nodes)), np.int64)
    if not said["frame"].size:
        return Reactions(trials, reacted)
    every = -(-sayings.first.size // _VALUES)
    chosen = sayings.value % every == 0
    rows = sayings.rows[chosen]
    frame, node, variable = said["frame"][rows], said["node"][rows], said["variable"][rows]
    rank = sayings.rank[sayings.value[chosen]]
    place = np.full(len(recorded.nodes) + 1, -1)
    place[nodes] = np.arange(len(nodes))
    levels = _ranks(said, held, sayings)
    producers = {number: known.producer for number, known in recorded.variables.items()}
    names, kind = np.unique(variable, return_inverse=True)
    producer = np.array([producers.get(int(each), -1) for each in names])[kind]
    waits = _waits(recorded, sayings)
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
        # What matters of an interval and a variable is the newest value in it.
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


def _waits(recorded: Recorded, sayings: Sayings) -> dict[int, int]:
    """How many beacons of each node leave after it heard something before one shows it, as a rule.

    Some implementations prepare the next beacon before they send the last. It is seen from values that one node alone
    had said.
    """
    said, beacons = recorded.tables["said"], recorded.tables["beacons"]
    frame, node = said["frame"][sayings.rows], said["node"][sayings.rows]
    first = sayings.firsts(node, len(recorded.nodes))
    starts = np.searchsorted(sayings.value[first], np.arange(sayings.first.size), "left")
    seconds = starts[(starts + 1 < np.append(starts[1:], first.size))] + 1
    found = {}
    for each in np.unique(node[first[seconds]]).tolist():
        own = first[seconds[node[first[seconds]] == each]]
        before = first[seconds[node[first[seconds]] == each] - 1]
        sent = np.sort(beacons["frame"][beacons["node"] == each])
        passed = np.searchsorted(sent, frame[own]) - np.searchsorted(sent, frame[before], "right")
        found[each] = int(np.clip(np.median(passed), 0, _LONGEST_WAIT))
    return found


def _ranks(said: dict[str, Column], held: dict[str, Column], sayings: Sayings) -> Column:
    """The rank of the value that each claim is about: the last of that variable and number that was heard by then."""
    first = sayings.rows[sayings.first]
    keys = np.stack([said["variable"][first], said["seqno"][first], said["frame"][first]])
    claims = np.stack([held["variable"], held["seqno"], held["frame"]])
    # Both in one order; of equal ones the value comes before the claim.
    both = np.concatenate([keys, claims], axis=1)
    claim = np.arange(both.shape[1]) >= first.size
    order = np.lexsort((claim, both[2], both[1], both[0]))
    last = np.maximum.accumulate(np.where(claim[order], -1, np.arange(order.size)))
    known = order[np.maximum(last, 0)]
    same = (last >= 0) & (both[:2, known] == both[:2, order]).all(axis=0)
    found = np.full(order.size, -1)
    found[order] = np.where(same, sayings.rank[np.minimum(known, max(first.size - 1, 0))], -1)
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
        """The rank shown in or before the frame, -1 for none."""
        kind = np.minimum(np.searchsorted(self._names, variable), self._names.size - 1)
        known = self._names[kind] == variable
        place = np.searchsorted(self._keys, kind * self._span + np.minimum(frame, self._span - 1), "right") - 1
        good = known & (place >= 0) & (self._variable[np.maximum(place, 0)] == variable)
        return np.where(good, self._rank[np.maximum(place, 0)], -1)
