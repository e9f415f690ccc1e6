"""Numbers on variables: their values, the nodes that forwarded them, and the delays. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .analysis import Time
from .recorded import NUMBER_OCTETS, Column, Recorded
from .series import unwrapped

#: A sequence number that is received again after this time (ns) is that of another value, as in docs/tables.md.
_SILENCE = 5_000_000_000


@dataclass(frozen=True)
class Values:
    """The first reception of each value of each variable, in the order of time (``time`` in seconds).

    ``node`` is the node that sent the value first. ``number`` is the value as an unsigned number; NaN if it has more
    than eight octets.
    """

    variable: Column
    seqno: Column
    node: Column
    time: Column
    frame: Column
    number: Column
    size: Column
    #: Creation time if the first record of the value is a VarCreate (0 without creation time); -1 for a VarUpdate.
    creation: Column
    #: Whether the node that sent the value first is the producer, or the producer is unknown.
    from_producer: Column


@dataclass(frozen=True)
class Passings:
    """The first time that each node forwarded a value: time (s), node, and delay after the first node (s).

    ``order`` is the number of nodes that had sent the value before. It is not a number of hops: two neighbours of the
    first node have 1 and 2. ``counted``: whether the value was first sent by its producer.
    """

    variable: Column
    time: Column
    frame: Column
    node: Column
    order: Column
    delay: Column
    counted: Column


@dataclass(frozen=True)
class Transmissions:
    """All records with values: ``rows`` are those of the table ``values``, sorted by variable, number and frame.

    ``value`` is the number of the value of each row. ``first`` is the index of the first row of each value. ``rank`` is
    the position of each value among those of its variable, in the order of their first reception.
    """

    rows: Column
    value: Column
    first: Column
    rank: Column

    def firsts(self, node: Column, nodes: int) -> Column:
        """Return the index of the first row of each value and node, by value and frame. ``node``: senders of rows."""
        key = self.value * max(1, nodes) + node
        order = np.argsort(key, kind="stable")
        new = np.ones(order.size, bool)
        new[1:] = key[order[1:]] != key[order[:-1]]
        found: Column = np.sort(order[new])
        return found


def transmissions(recorded: Recorded) -> Transmissions:
    """Number the values: a sequence number that is received again after five seconds of silence is another value."""
    records = recorded.tables["values"]
    rows = np.lexsort((records["frame"], records["seqno"], records["variable"]))
    variable, seqno, stamp = (records[name][rows] for name in ("variable", "seqno", "time"))
    new = np.ones(rows.size, bool)
    other = (variable[1:] != variable[:-1]) | (seqno[1:] != seqno[:-1])
    new[1:] = other | (stamp[1:] - stamp[:-1] > _SILENCE)
    first = np.flatnonzero(new)
    order = np.lexsort((records["frame"][rows[first]], variable[first]))
    place = np.arange(first.size)
    rank = np.empty(first.size, np.int64)
    rank[order] = place - np.searchsorted(variable[first][order], variable[first][order], "left")
    return Transmissions(rows, np.cumsum(new) - 1, first, rank)


def dissemination(recorded: Recorded, time: Time, found: Transmissions | None = None) -> tuple[Values, Passings]:
    """Return the values of all variables, and their forwarding by nodes after the first."""
    records = recorded.tables["values"]
    found = found or transmissions(recorded)
    value, first = found.value, found.first
    columns = {name: column[found.rows] for name, column in records.items()}
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
    """Return the rows of one variable, their unwrapped sequence numbers, and where the variable was created again.

    It was created again if a VarCreate has another creation time or, in profiles without it, a lower sequence number.
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
    """One row of the table of variables. Delays are in seconds; None if no node forwarded a value."""

    number: int
    producer: int
    description: str
    values: int
    sizes: str
    value: bytes
    median: float | None
    p95: float | None


def lines(recorded: Recorded, values: Values, passed: Passings, many: int) -> list[VariableLine]:
    """Return the ``many`` variables with the most values, in descending order."""
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
    """Return whether all values of a variable have the same length of 1 to 8 octets."""
    sizes = np.unique(values.size[values.variable == variable])
    return sizes.size == 1 and 1 <= int(sizes[0]) <= NUMBER_OCTETS
