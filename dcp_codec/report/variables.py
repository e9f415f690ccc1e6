"""Numbers about variables: which values there were, who passed them on, and how long that took. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .analysis import Time
from .recorded import NUMBER_OCTETS, Column, Recorded
from .series import unwrapped

#: A sequence number that is heard again after so long (ns) is that of another value, as in docs/tables.md.
_SILENCE = 5_000_000_000


@dataclass(frozen=True)
class Values:
    """Each value of each variable when it was first heard, in the order of time; ``time`` in seconds.

    ``node`` said it first, ``number`` is the value as an unsigned number, NaN if it has more than eight octets.
    """

    variable: Column
    seqno: Column
    node: Column
    time: Column
    frame: Column
    number: Column
    size: Column
    #: Time of creation where a CREATE said the value first, 0 if it does not say that time; -1 for an UPDATE.
    creation: Column
    #: Whether the node that said it first is the producer, or the producer is not known.
    from_producer: Column


@dataclass(frozen=True)
class Passings:
    """Each first passing on of a value by another node than the first: when (s), by whom, how long after that (s).

    ``order`` counts the nodes that had said the value before. That is no number of hops: two neighbours of the first
    node are 1 and 2. ``counted`` are those of values that came from their producer.
    """

    variable: Column
    time: Column
    frame: Column
    node: Column
    order: Column
    delay: Column
    counted: Column


@dataclass(frozen=True)
class Sayings:
    """All that was said of values, by variable, number and frame: ``rows`` of the table ``said`` in that order.

    ``value`` numbers the values, ``first`` are the places at which each of them was heard first, ``rank`` is the place
    of each value among those of its variable, in the order in which they were first heard.
    """

    rows: Column
    value: Column
    first: Column
    rank: Column

    def firsts(self, node: Column, nodes: int) -> Column:
        """Where each node says each value for the first time, by value and frame. ``node`` is who says each row."""
        key = self.value * max(1, nodes) + node
        order = np.argsort(key, kind="stable")
        new = np.ones(order.size, bool)
        new[1:] = key[order[1:]] != key[order[:-1]]
        found: Column = np.sort(order[new])
        return found


def sayings(recorded: Recorded) -> Sayings:
    """Tell values apart: a number that is heard again after five seconds of silence is that of another value."""
    said = recorded.tables["said"]
    rows = np.lexsort((said["frame"], said["seqno"], said["variable"]))
    variable, seqno, stamp = (said[name][rows] for name in ("variable", "seqno", "time"))
    new = np.ones(rows.size, bool)
    other = (variable[1:] != variable[:-1]) | (seqno[1:] != seqno[:-1])
    new[1:] = other | (stamp[1:] - stamp[:-1] > _SILENCE)
    first = np.flatnonzero(new)
    order = np.lexsort((said["frame"][rows[first]], variable[first]))
    place = np.arange(first.size)
    rank = np.empty(first.size, np.int64)
    rank[order] = place - np.searchsorted(variable[first][order], variable[first][order], "left")
    return Sayings(rows, np.cumsum(new) - 1, first, rank)


def dissemination(recorded: Recorded, time: Time, found: Sayings | None = None) -> tuple[Values, Passings]:
    """Follow each value of each variable from the node that said it first."""
    said = recorded.tables["said"]
    found = found or sayings(recorded)
    value, first = found.value, found.first
    columns = {name: column[found.rows] for name, column in said.items()}
    node, seconds = columns["node"], time.seconds(columns["time"])
    passing = found.firsts(node, len(recorded.nodes))
    rank = np.arange(passing.size) - np.searchsorted(value[passing], value[passing], "left")
    later = passing[rank > 0]
    variable = columns["variable"][first]
    good = _from_producer(recorded, variable, node[first])
    by_time = np.lexsort((columns["frame"][first], seconds[first]))
    rows = first[by_time]
    values = Values(
        variable=variable[by_time],
        seqno=columns["seqno"][rows],
        node=node[rows],
        time=seconds[rows],
        frame=columns["frame"][rows],
        number=columns["number"][rows],
        size=columns["size"][rows],
        creation=columns["creation"][rows],
        from_producer=good[by_time],
    )
    return values, Passings(
        variable=columns["variable"][later],
        time=seconds[later],
        frame=columns["frame"][later],
        node=node[later],
        order=rank[rank > 0],
        delay=seconds[later] - seconds[first][value[later]],
        counted=good[value[later]],
    )


def counted(recorded: Recorded, values: Values, variable: int) -> tuple[Column, Column, Column]:
    """Rows of one variable, their sequence numbers unwrapped, and where the variable was created again.

    A creation is a new one where its creation time is another, or, in profiles without, where its number goes back.
    """
    rows = np.flatnonzero(values.variable == variable)
    seqno, creation = values.seqno[rows], values.creation[rows]
    created = np.flatnonzero(creation >= 0)
    again = np.zeros(rows.size, bool)
    if created.size > 1:
        stamps = creation[created]
        again[created[1:]] = np.where(
            stamps[1:] | stamps[:-1], stamps[1:] != stamps[:-1], seqno[created[1:]] < seqno[created[:-1]]
        )
    return rows, unwrapped(seqno, recorded.number_modulus, again), again


def _from_producer(recorded: Recorded, variable: Column, node: Column) -> Column:
    senders = set(np.unique(recorded.column("beacons", "node")).tolist())
    producers = {number: known.producer for number, known in recorded.variables.items() if known.producer in senders}
    found = [producers.get(each, who) == who for each, who in zip(variable.tolist(), node.tolist(), strict=True)]
    return np.array(found, bool)


@dataclass(frozen=True)
class VariableLine:
    """One line of the table of variables. Delays in seconds, None if nobody passed anything on."""

    number: int
    producer: int
    description: str
    values: int
    sizes: str
    value: bytes
    median: float | None
    p95: float | None


def lines(recorded: Recorded, values: Values, passed: Passings, many: int) -> list[VariableLine]:
    """The ``many`` variables with most values, those first."""
    numbers, counts = np.unique(values.variable, return_counts=True)
    found = []
    for row in np.lexsort((numbers, -counts))[:many].tolist():
        number = int(numbers[row])
        known = recorded.variables[number]
        sizes = np.unique(values.size[values.variable == number])
        delays = passed.delay[(passed.variable == number) & passed.counted]
        high, low = int(sizes.max()), int(sizes.min())
        found.append(
            VariableLine(
                number=number,
                producer=known.producer,
                description=known.description,
                values=int(counts[row]),
                sizes=str(high) if high == low else f"{low} to {high}",
                value=known.value,
                median=float(np.quantile(delays, 0.5)) if delays.size else None,
                p95=float(np.quantile(delays, 0.95)) if delays.size else None,
            )
        )
    return found


def numeric(values: Values, variable: int) -> bool:
    """Whether all values of a variable have one length that fits a number."""
    sizes = np.unique(values.size[values.variable == variable])
    return sizes.size == 1 and 1 <= int(sizes[0]) <= NUMBER_OCTETS
