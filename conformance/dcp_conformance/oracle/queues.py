"""Order in the queues of VarDis (dcp-vardis.md: Queues, Composing Payloads).

A queue is served from its head, and records that are repeated return to its tail. When a payload was composed is known
only within bounds, so the model knows of some pairs of entries which one is ahead, and judges only those.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import NamedTuple

from dcp_spec.constants import ICType

from .knowledge import NEVER


class Place(NamedTuple):
    """The last time at which an entry was put at the tail of its queue."""

    appended: int | None
    """Time of an event that appended it, ns; None if it returned there after it was sent."""
    event: int
    """Number of the event, in the order of events."""
    payload: int
    """Number of the last received payload at that time, or of the payload that contained it."""
    position: int = 0
    """Position in the container of that payload, or in the container whose record appended it."""
    requirement: str = ""
    container: ICType | None = None
    """Type of the received container whose record appended it; None for a service."""
    renewed: bool = False
    """True if the entry may have had another place in the queue before."""


class Order:
    """The places of the entries of the six queues of one node."""

    def __init__(self, late: int, *, in_order: bool) -> None:
        """``late``: longest time from the reception of a payload to its processing, ns.

        ``in_order``: whether the records of a container are processed in their order (VD-RX-09).
        """
        self._late = late
        self._in_order = in_order
        self._places: dict[ICType, dict[int, Place]] = {kind: {} for kind in ICType}
        self._composed: dict[int, int] = {}
        """Earliest time of the composition of each payload, ns."""
        self._payload = 0
        self._count = 0
        self._container: ICType | None = None
        self._position = 0

    def next_event(self) -> None:
        """Begin an event whose entries come after all others."""
        self._count += 1

    def next_record(self, container: ICType | None, position: int = 0) -> None:
        """Begin with a record of a received payload; None: with a service."""
        self._container, self._position = container, position

    def append(
        self, kind: ICType, var_id: int, time: int, requirement: str, *, waiting: bool, renewed: bool = False
    ) -> None:
        """Record an event that appends an entry. ``waiting``: it may be in the queue already, and stays where it is.

        ``renewed``: it may have been there, and was removed.
        """
        self._count += self._container is None
        places = self._places[kind]
        if waiting:
            # Whether it was still there is not known.
            places.pop(var_id, None)
            return
        places[var_id] = Place(
            time, self._count, self._payload, self._position, requirement, self._container, renewed
        )  # fmt: skip

    def remove(self, var_id: int, *kinds: ICType) -> None:
        """Record that an entry has left these queues, or all."""
        for kind in kinds or ICType:
            self._places[kind].pop(var_id, None)

    def forget(self) -> None:
        """Record that places are not known any more."""
        for places in self._places.values():
            places.clear()

    def payload(
        self,
        kind: ICType,
        var_ids: Sequence[int],
        since: int,
        queued: Callable[[int, int], bool],
        shown: Collection[int] = (),
        *,
        whole: bool = False,
    ) -> Iterator[tuple[int, int, Place, bool]]:
        """Yield (entry that was passed over, entry that came before it, place of the latter) of a container.

        The fourth value is whether records of one container appended both.

        ``since``: earliest time of the composition. ``queued`` returns whether an entry was surely queued, given its
        identifier and that time. ``shown``: entries of which the payload shows that it was composed after they were
        appended last. ``whole``: whether no payload is composed between the records of a received one.
        """
        places = self._places[kind]
        there = {var_id: place for place, var_id in enumerate(var_ids)}
        for var_id, position in there.items():
            mine = places.get(var_id)
            early = mine is not None and mine.renewed and mine.appended is not None and mine.appended >= since
            if mine is None or (early and var_id not in shown):
                # The payload may have been composed before the entry left its former place.
                continue
            for other, place in places.items():
                if other == var_id or there.get(other, 1 << 30) < position or not self._ahead(place, mine):
                    continue
                together = mine.container is not None and place.event == mine.event
                if queued(other, NEVER if together and whole and var_id in shown else since):
                    yield other, var_id, mine, together
                    break

    def sent(self, kind: ICType, var_ids: Sequence[int], since: int, shown: Collection[int] = ()) -> None:
        """Record that the entries of a container composed at ``since`` or later were put at the tail, or removed.

        ``shown``: see :meth:`payload`.
        """
        places = self._places[kind]
        for position, var_id in enumerate(var_ids):
            self._count += 1
            before = places.pop(var_id, None)
            if (
                before is None
                or not before.renewed
                or var_id in shown
                or (before.appended or since) + self._late < since
            ):
                places[var_id] = Place(None, self._count, self._payload, position)
            # Otherwise the payload may have been composed before the entry was appended.

    def next_payload(self, since: int) -> None:
        """Count a received payload that was composed at ``since`` (ns) or later."""
        self._payload += 1
        self._composed[self._payload] = since

    def _ahead(self, one: Place, other: Place) -> bool:
        """Return whether ``one`` is surely nearer to the head than ``other``."""
        if one.appended is not None and other.appended is not None:
            if one.event == other.event:
                # Records of different types are processed in an order that is not known in all versions.
                same = one.container is other.container and one.container is not None and self._in_order
                return same and one.position < other.position
            # A payload may be processed after a later call of a service.
            same = (one.container is None) is (other.container is None)
            return one.event < other.event and (same or one.appended + self._late < other.appended)
        if one.appended is None and other.appended is None:
            return (one.payload, one.position) < (other.payload, other.position)
        if one.appended is None:
            # The other was appended after the payload of this one was received.
            return one.payload <= other.payload
        return one.appended + self._late < self._composed.get(other.payload, -1)
