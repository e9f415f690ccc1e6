"""Numbers about variables: which values there were, who passed them on, and how long that took. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .analysis import Time
from .recorded import NUMBER_OCTETS, Column, Recorded

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
    number: Column
    size: Column
    #: Whether the node that said it first is the producer, or the producer is not known.
    from_producer: Column


@dataclass(frozen=True)
class Hops:
    """Each first passing on of a value by another node: when (s), by whom, how long after the first (s).

    ``before`` is who said it last before that; ``hop`` counts the nodes that had said it. ``counted`` are those of
    values that came from their producer.
    """

    variable: Column
    time: Column
    node: Column
    before: Column
    hop: Column
    delay: Column
    counted: Column


def dissemination(recorded: Recorded, time: Time) -> tuple[Values, Hops]:
    """Follow each value of each variable from the node that said it first."""
    said = recorded.tables["said"]
    order = np.lexsort((said["frame"], said["seqno"], said["variable"]))
    variable, seqno, node, stamp = (said[name][order] for name in ("variable", "seqno", "node", "time"))
    new = np.ones(order.size, bool)
    if order.size:
        other = (variable[1:] != variable[:-1]) | (seqno[1:] != seqno[:-1])
        new[1:] = other | (stamp[1:] - stamp[:-1] > _SILENCE)
    value = np.cumsum(new) - 1
    first = np.flatnonzero(new)
    seconds = time.seconds(stamp)
    # Rows are in the order of frames within a value, so the first of each (value, node) is its first passing on.
    _, passing = np.unique(value * max(1, len(recorded.nodes)) + node, return_index=True)
    passing = np.sort(passing)
    rank = np.arange(passing.size) - np.searchsorted(value[passing], value[passing], "left")
    hops = passing[rank > 0]
    good = _from_producer(recorded, variable[first], node[first])
    by_time = np.argsort(seconds[first], kind="stable")
    values = Values(
        variable=variable[first][by_time],
        seqno=seqno[first][by_time],
        node=node[first][by_time],
        time=seconds[first][by_time],
        number=said["number"][order][first][by_time],
        size=said["size"][order][first][by_time],
        from_producer=good[by_time],
    )
    return values, Hops(
        variable=variable[hops],
        time=seconds[hops],
        node=node[hops],
        before=node[hops - 1],
        hop=rank[rank > 0],
        delay=seconds[hops] - seconds[first][value[hops]],
        counted=good[value[hops]],
    )


def _from_producer(recorded: Recorded, variable: Column, node: Column) -> Column:
    senders = set(np.unique(recorded.column("beacons", "node")).tolist())
    producers = {number: known.producer for number, known in recorded.variables.items() if known.producer in senders}
    found = [producers.get(each, who) == who for each, who in zip(variable.tolist(), node.tolist(), strict=True)]
    return np.array(found, bool)


def edges(hops: Hops) -> dict[tuple[int, int], int]:
    """How often a node passed on what another had said last: (from, to) -> values."""
    pairs, many = np.unique(np.stack([hops.before, hops.node]), axis=1, return_counts=True)
    return {(int(a), int(b)): int(count) for a, b, count in zip(*pairs, many, strict=True)}


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


def lines(recorded: Recorded, values: Values, hops: Hops, many: int) -> list[VariableLine]:
    """The ``many`` variables with most values, those first."""
    numbers, counts = np.unique(values.variable, return_counts=True)
    found = []
    for row in np.lexsort((numbers, -counts))[:many].tolist():
        number = int(numbers[row])
        known = recorded.variables[number]
        sizes = np.unique(values.size[values.variable == number])
        delays = hops.delay[(hops.variable == number) & hops.counted]
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
