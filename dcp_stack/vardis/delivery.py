"""Signs that neighbours do not accept the variables of this node.

The specification has no acknowledgements, so a node does not notice by itself that its records are ignored. The causes
are different settings (a neighbour drops payloads or repetition counts beyond its own limits, without a message) and
slow clocks. Received records show them: requests that continue although they are answered, summaries that keep an
older sequence number, and a later creation of a variable that this node produces.

These signs do not change the behaviour of the node, with one exception: a creation time is later than any that was
received for the variable (X38). Times are monotonic ns.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Literal

import msgspec

if TYPE_CHECKING:
    from .core import Sequence
    from .database import DBEntry

ASKED_OFTEN: Final = 20
"""Answered requests of one neighbour for one variable that are reported. Frame loss of one half would cause as many
requests in one of a million trials."""
BEHIND_OFTEN: Final = 10
"""Summaries with an older sequence number, and none with the newer one, that are reported."""
PATIENCE: Final = 10_000_000_000
"""Time in ns before a missing summary of an update is reported; enough for many hops."""
MOST_ENTRIES: Final = 256
"""Maximum number of counted pairs of neighbour and variable, so that received records cannot exhaust memory."""

Kind = Literal["asked-again", "unconfirmed", "superseded", "taken-over"]


class Obstacle(msgspec.Struct, frozen=True, rename="camel"):
    """A sign that neighbours do not accept one variable.

    ``asked-again``: ``peer`` (its node identifier in hexadecimal) has requested the variable ``count`` times, and it
    was sent each time. ``unconfirmed``: ``count`` summaries had an older sequence number, and none has had that of the
    update ``for_ms`` ms ago. ``superseded``: other nodes have a creation with a later time and ignore this one.
    ``taken-over``: node ``peer`` has created the variable again, and is its producer now (H4).
    """

    kind: Kind
    var_id: int
    peer: str = ""
    count: int = 0
    for_ms: int = 0

    def __str__(self) -> str:
        match self.kind:
            case "asked-again":
                return (
                    f"{self.peer} requested variable {self.var_id} {self.count} times, and it was sent each time: "
                    "its record is longer, or its repetition count higher, than that node accepts"
                )
            case "unconfirmed":
                return (
                    f"variable {self.var_id}: no summary of a neighbour has the update of {self.for_ms / 1000:.0f} s "
                    f"ago, and {self.count} summaries have an older sequence number"
                )
            case "superseded":
                return (
                    f"variable {self.var_id}: other nodes have a creation with a later time and ignore this one; "
                    "create it again, and check the clock"
                )
            case "taken-over":
                return (
                    f"variable {self.var_id}: {self.peer} has created it again and is its producer now; "
                    "this node cannot update it any more"
                )


class _Waiting:
    """An update by this node that no summary of a neighbour has confirmed yet."""

    __slots__ = ("behind", "seqno", "since")

    def __init__(self, seqno: int, since: int) -> None:
        self.seqno = seqno
        self.since = since
        self.behind = 0


class DeliveryState(msgspec.Struct, frozen=True, gc=False):
    """Saved signs. ``created`` alone has an effect on the behaviour of the node: (variable, creation time) pairs."""

    created: tuple[tuple[int, int], ...] = ()
    asked: tuple[tuple[tuple[bytes, int], int], ...] = ()
    waiting: tuple[tuple[int, int, int, int], ...] = ()
    superseded: tuple[int, ...] = ()
    taken: tuple[tuple[int, bytes], ...] = ()


class Delivery:
    """Received requests, summaries and creations of the variables of one VarDis entity, in bounded memory."""

    def __init__(self, sequence: Sequence) -> None:
        self.peer = b""
        """Node identifier of the sender of the payload that is being processed."""
        self._sequence = sequence
        self._asked: dict[tuple[bytes, int], int] = {}
        self._waiting: dict[int, _Waiting] = {}
        self._created: dict[int, int] = {}
        self._superseded: set[int] = set()
        self._taken: dict[int, bytes] = {}

    def clear(self) -> None:
        """Forget all variables."""
        self._asked.clear()
        self._waiting.clear()
        self._created.clear()
        self._superseded.clear()
        self._taken.clear()

    # -- changes at this node -----------------------------------------------------------------------------------

    def created(self, var_id: int) -> None:
        """Note that this node has created the variable."""
        self._forget(var_id)
        self._taken.pop(var_id, None)

    def updated(self, var_id: int, seqno: int, now: int) -> None:
        """Note that this node has updated the variable. Neighbours have to confirm the oldest unconfirmed update."""
        if var_id not in self._waiting:
            self._waiting[var_id] = _Waiting(seqno, now)

    def deleted(self, var_id: int) -> None:
        """Note that the variable was deleted, or that another node now produces it."""
        self._forget(var_id)

    def _forget(self, var_id: int) -> None:
        """Remove requests, the unconfirmed update and the later creation of a variable."""
        self._waiting.pop(var_id, None)
        self._superseded.discard(var_id)
        if self._asked:
            for key in [key for key in self._asked if key[1] == var_id]:
                del self._asked[key]

    # -- received records ---------------------------------------------------------------------------------------

    def asked(self, var_id: int) -> None:
        """Count a request of the neighbour :attr:`peer` for a variable or a newer value, which is answered."""
        key = (self.peer, var_id)
        count = self._asked.pop(key, 0) + 1
        if len(self._asked) >= MOST_ENTRIES:
            # The first pair is the one whose last request is oldest.
            del self._asked[next(iter(self._asked))]
        self._asked[key] = count

    def asked_by(self, peer: bytes) -> bool:
        """Return whether a request of a neighbour is open, that is, no record has shown that it has the value."""
        return any(asking == peer for asking, _ in self._asked)

    def has(self, var_id: int) -> None:
        """Note that the neighbour :attr:`peer` has the variable with the same sequence number as this node."""
        if self._asked:
            self._asked.pop((self.peer, var_id), None)

    def awaits(self, var_id: int) -> bool:
        """Return whether an update of this node waits for a summary of it."""
        return var_id in self._waiting

    def summary_of_own(self, var_id: int, seqno: int) -> None:
        """Process the sequence number in a neighbour's summary of a variable of this node."""
        waiting = self._waiting.get(var_id)
        if waiting is None:
            return
        if self._sequence.received_is_older(seqno, waiting.seqno):
            waiting.behind += 1
        else:
            del self._waiting[var_id]

    def own_creation(self, var_id: int, creation_time: int | None, known: int | None) -> None:
        """Process a received VarCreate that names this node as producer.

        ``creation_time`` is that of the record, ``known`` that of the stored variable, both in the profile's units.
        """
        if creation_time is None:
            return
        self._created[var_id] = max(creation_time, self._created.get(var_id, 0))
        if known is not None and creation_time > known:
            self._superseded.add(var_id)

    def adopted(self, before: DBEntry | None, after: DBEntry, own_id: bytes) -> None:
        """Process the creation by another node that has replaced the entry ``before``; ``own_id`` is this node."""
        if before is not None and not before.is_deleted and before.spec.prod_id == own_id:
            self._taken[after.spec.var_id] = after.spec.prod_id

    def latest_creation(self, var_id: int) -> int | None:
        """Return the latest received creation time of a variable with this node as producer, None without any."""
        return self._created.get(var_id)

    # -- saving -------------------------------------------------------------------------------------------------

    def save(self) -> DeliveryState:
        """Return the signs as a value."""
        waiting = tuple((var_id, each.seqno, each.since, each.behind) for var_id, each in self._waiting.items())
        return DeliveryState(
            tuple(self._created.items()),
            tuple(self._asked.items()),
            waiting,
            tuple(sorted(self._superseded)),
            tuple(self._taken.items()),
        )

    def restore(self, state: DeliveryState) -> None:
        """Replace the signs by saved ones."""
        self.clear()
        self._created.update(state.created)
        self._asked.update(state.asked)
        self._superseded.update(state.superseded)
        self._taken.update(state.taken)
        for var_id, seqno, since, behind in state.waiting:
            self._waiting[var_id] = each = _Waiting(seqno, since)
            each.behind = behind

    # -- result -------------------------------------------------------------------------------------------------

    def obstacles(self, now: int) -> list[Obstacle]:
        """Return the signs found up to ``now``, sorted by kind, variable and neighbour."""
        return sorted(self._found(now), key=lambda each: (each.kind, each.var_id, each.peer))

    def _found(self, now: int) -> Iterator[Obstacle]:
        """Yield the signs found up to ``now``, in no particular order."""
        for (peer, var_id), count in self._asked.items():
            if count >= ASKED_OFTEN:
                yield Obstacle("asked-again", var_id, peer.hex(":"), count)
        for var_id, waiting in self._waiting.items():
            age = now - waiting.since
            if waiting.behind >= BEHIND_OFTEN and age >= PATIENCE:
                yield Obstacle("unconfirmed", var_id, count=waiting.behind, for_ms=age // 1_000_000)
        for var_id in self._superseded:
            yield Obstacle("superseded", var_id)
        for var_id, producer in self._taken.items():
            yield Obstacle("taken-over", var_id, producer.hex(":"))
