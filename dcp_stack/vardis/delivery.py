"""Signs that what this node says of variables does not get through to its neighbours.

The specification has no acknowledgements, and a node whose records are all refused works like any other. The reasons
are settings that differ (a neighbour drops payloads or repetition counts beyond its own limits, and says nothing), and
clocks that are behind. What is heard tells: requests that go on although they are answered, summaries that stay behind,
and a later creation of a variable that this node believes to produce.

Nothing here changes what the node does, except that a creation becomes later than any that was heard (X38).
Times are monotonic ns.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Literal

import msgspec

if TYPE_CHECKING:
    from .core import Sequence

ASKED_OFTEN: Final = 20
"""Requests of one neighbour for one variable, all of them answered, that are no bad luck: half of all frames lost would
do it once in a million times."""
BEHIND_OFTEN: Final = 10
"""Summaries of an older number, and none of the newer one, before somebody is told."""
PATIENCE: Final = 10_000_000_000
"""ns that an update has to appear in the summaries of others, the time over many hops."""
MOST_ENTRIES: Final = 256
"""Pairs of neighbour and variable that are counted: nothing received may use up memory."""

Kind = Literal["asked-again", "unconfirmed", "superseded"]


class Obstacle(msgspec.Struct, frozen=True, rename="camel"):
    """One variable that does not get through.

    ``asked-again``: ``peer`` has asked ``count`` times for what was sent each time. ``unconfirmed``: ``count``
    summaries have shown an older value than this node's, and none its update of ``for_ms`` ago. ``superseded``: others
    know a creation with a later time, and ignore this one.
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
                    f"{self.peer} asked {self.count} times for variable {self.var_id}, which was sent each time: "
                    "its record is longer, or repeated more often, than that node takes"
                )
            case "unconfirmed":
                return (
                    f"variable {self.var_id}: no neighbour shows the update of {self.for_ms / 1000:.0f} s ago, "
                    f"and {self.count} summaries show an older one"
                )
            case "superseded":
                return (
                    f"variable {self.var_id}: others know a creation with a later time and ignore this one; "
                    "create it again, and look at the clock"
                )


class _Waiting:
    """An own update that no summary has shown yet."""

    __slots__ = ("behind", "seqno", "since")

    def __init__(self, seqno: int, since: int) -> None:
        self.seqno = seqno
        self.since = since
        self.behind = 0


class Delivery:
    """What one VarDis entity has heard of its own variables. Bounded memory."""

    def __init__(self, sequence: Sequence) -> None:
        self.peer = b""
        """Who has sent the payload that is being processed."""
        self._sequence = sequence
        self._asked: dict[tuple[bytes, int], int] = {}
        self._waiting: dict[int, _Waiting] = {}
        self._created: dict[int, int] = {}
        self._superseded: set[int] = set()

    def clear(self) -> None:
        """Forget everything."""
        self._asked.clear()
        self._waiting.clear()
        self._created.clear()
        self._superseded.clear()

    # -- what happens here --------------------------------------------------------------------------------------

    def created(self, var_id: int) -> None:
        """This node has created the variable anew."""
        self._forget(var_id)

    def updated(self, var_id: int, seqno: int, now: int) -> None:
        """This node has given the variable a new value. What others have to show is the oldest one not shown yet."""
        if var_id not in self._waiting:
            self._waiting[var_id] = _Waiting(seqno, now)

    def deleted(self, var_id: int) -> None:
        """The variable is gone, whoever has deleted it or taken it over."""
        self._forget(var_id)

    def _forget(self, var_id: int) -> None:
        self._waiting.pop(var_id, None)
        self._superseded.discard(var_id)
        for key in [key for key in self._asked if key[1] == var_id]:
            del self._asked[key]

    # -- what is heard ------------------------------------------------------------------------------------------

    def asked(self, var_id: int) -> None:
        """The neighbour has asked for a variable, or for a newer value, and gets it."""
        key = (self.peer, var_id)
        count = self._asked.pop(key, 0) + 1
        if len(self._asked) >= MOST_ENTRIES:
            # The pair that was silent for longest.
            del self._asked[next(iter(self._asked))]
        self._asked[key] = count

    def asked_by(self, peer: bytes) -> bool:
        """Whether a neighbour has asked for something that it has not shown to have."""
        return any(asking == peer for asking, _ in self._asked)

    def has(self, var_id: int) -> None:
        """The neighbour has shown that it knows the variable with the value that this node has."""
        if self._asked:
            self._asked.pop((self.peer, var_id), None)

    def summary_of_own(self, var_id: int, seqno: int) -> None:
        """A neighbour has summarised a variable of this node."""
        waiting = self._waiting.get(var_id)
        if waiting is None:
            return
        if self._sequence.received_is_older(seqno, waiting.seqno):
            waiting.behind += 1
        else:
            del self._waiting[var_id]

    def own_creation(self, var_id: int, creation_time: int | None, known: int | None) -> None:
        """A VarCreate with this node as producer was heard; ``known`` is the creation time that this node knows."""
        if creation_time is None:
            return
        self._created[var_id] = max(creation_time, self._created.get(var_id, 0))
        if known is not None and creation_time > known:
            self._superseded.add(var_id)

    def latest_creation(self, var_id: int) -> int | None:
        """The latest creation time of the variable, with this node as producer, that was heard."""
        return self._created.get(var_id)

    # -- looking ------------------------------------------------------------------------------------------------

    def obstacles(self, now: int) -> list[Obstacle]:
        """What does not get through as of ``now``."""
        return sorted(self._found(now), key=lambda each: (each.kind, each.var_id, each.peer))

    def _found(self, now: int) -> Iterator[Obstacle]:
        for (peer, var_id), count in self._asked.items():
            if count >= ASKED_OFTEN:
                yield Obstacle("asked-again", var_id, peer.hex(":"), count)
        for var_id, waiting in self._waiting.items():
            age = now - waiting.since
            if waiting.behind >= BEHIND_OFTEN and age >= PATIENCE:
                yield Obstacle("unconfirmed", var_id, count=waiting.behind, for_ms=age // 1_000_000)
        for var_id in self._superseded:
            yield Obstacle("superseded", var_id)
