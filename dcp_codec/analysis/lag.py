"""The lag of nodes relative to the producers of their variables: in sequence numbers, and in time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

from .ledger import DELETED, Entry


class Lag(NamedTuple):
    """A state that a node keeps although the producer of the variable has left it."""

    held: Entry
    """The state of the node."""
    newest: Entry
    """The last state of the producer with a number when the node stated its own for the last time."""
    left: Entry
    """The state with which the producer left that of the node."""
    numbers: int
    """Number of values of the producer that the node has not followed."""
    deleted: Entry | None
    """The state of the producer at that time if it has deleted the variable."""

    @property
    def age(self) -> int:
        """Time in ns from the producer's change to the node's last record with the old state."""
        return self.held.until - self.left.time


def lags(entries: Iterable[Entry], producers: Mapping[int, bytes]) -> Iterator[Lag]:
    """Yield the stale states of nodes, by variable and time.

    ``entries``: in the order of time. ``producers``: by variable.

    Variables whose creates name several producers are left out, and so are states that the producer has not shown
    before.
    """
    for var_id, group in groupby(sorted(entries, key=attrgetter("var_id")), key=attrgetter("var_id")):
        of_variable = list(group)
        producer = producers.get(var_id)
        if producer is not None and all(not each.creation or each.creation[0] == producer for each in of_variable):
            yield from _of_variable(of_variable, producer)


def _of_variable(entries: Iterable[Entry], producer: bytes) -> Iterator[Lag]:
    """Yield the lags of one variable; ``entries`` are in the order of time."""
    own: list[Entry] = []
    place: dict[int, int] = {}
    """Number -> the last state of the producer with it."""
    found: list[tuple[Entry, int]] = []
    for each in entries:
        if each.node == producer:
            place[each.number] = len(own)
            own.append(each)
        elif each.number >= 0 and each.number in place:
            found.append((each, place[each.number]))
    for held, at in found:
        if at + 1 == len(own) or own[at + 1].time >= held.until:
            continue
        last = at + 1
        while last + 1 < len(own) and own[last + 1].time < held.until:
            last += 1
        since = own[at : last + 1]
        newest = next(each for each in reversed(since) if each.number >= 0)
        missed = sum(each.number >= 0 for each in since[1:])
        yield Lag(held, newest, own[at + 1], missed, own[last] if own[last].number == DELETED else None)
