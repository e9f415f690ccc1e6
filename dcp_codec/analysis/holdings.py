"""The rows of the ledger: one for each state of a variable at a node."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from dcp_codec.jsonform import node_id_text

from .entry import DELETED, UNKNOWN
from .ledger import Ledger

_STATES = {DELETED: "deleted", UNKNOWN: "unknown"}


class Holding(NamedTuple):
    """One state; the names are those of the columns. Times are ns since 1970."""

    node: str
    varId: int
    state: str
    """``held``, ``deleted``, or ``unknown`` (the node requests the create)."""
    seqno: int | None
    producer: str | None
    creationTime: int | None
    since: int
    until: int
    firstFrame: int
    lastFrame: int
    values: int
    """Number of frames with the value."""
    firstValueFrame: int | None
    requests: int
    """Number of requests of the node in this state."""
    lagValues: int | None
    """Number of later values that the producer had sent by ``until``; None if it had not left the state."""
    lag: int | None
    """Time in ns from the producer's change to ``until``; None if it had not left the state."""


def holdings(ledger: Ledger, representation: str) -> Iterator[Holding]:
    """Yield the states in the order of time. ``representation``: the format of node identifiers."""
    for each in ledger.entries():
        producer, created = each.creation or (None, None)
        yield Holding(
            node_id_text(each.node, representation), each.var_id, _STATES.get(each.number, "held"),
            each.number if each.number >= 0 else None,
            None if producer is None else node_id_text(producer, representation), created,
            each.time, each.until, each.frame, each.last, each.values, each.carried[0][0] if each.carried else None,
            each.asked, each.missed if each.age else None, each.age or None,
        )  # fmt: skip
