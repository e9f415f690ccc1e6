"""The measurements of one simulated network, fed with its events."""

from __future__ import annotations

from dcp_stack.links.memory import Delivery, Medium
from dcp_stack.vardis.database import DBEntry

from .consistency import Consistency
from .reach import Reach, distances
from .values import ValueLog


class Measurements:
    """Follows values and their newest holders; nodes are numbers from 0, times virtual ns."""

    def __init__(self, medium: Medium, numbers: dict[bytes, int], *, warm_up: int, held_back: int) -> None:
        """``numbers`` are the nodes by identifier. Values born before ``warm_up`` (ns) are not counted.
        ``held_back`` is how long (ns) a payload can wait at its node before it is sent."""
        self._medium = medium
        self._numbers = numbers
        self._warm_up = warm_up
        self.values = ValueLog(len(numbers), oldest_in_flight=medium.oldest_in_flight, held_back=held_back)
        self.consistency = Consistency(len(numbers))
        self._on: set[int] = set()
        self._reaches: dict[int, Reach] = {}
        self._topology_version = -1

    def on(self, node: int) -> None:
        """A node was switched on."""
        self._on.add(node)
        self._reaches.clear()

    def off(self, now: int, node: int) -> None:
        """A node was switched off; its memory is lost."""
        self._on.discard(node)
        self._reaches.clear()
        self.values.switched_off(node)
        self.consistency.forget(now, node)

    def connections_changed(self) -> None:
        """Links or partitions are others from now on."""
        self._reaches.clear()

    def stored(self, now: int, node: int, var_id: int, entry: DBEntry, delivery: Delivery | None, event: str) -> None:
        """A node has a value: its own (``delivery`` None) or that of a frame. ``event``: ``created``, ``updated``."""
        producer = self._numbers.get(entry.spec.prod_id)
        if producer is None:
            return
        created = entry.spec.creation_time
        if delivery is None:
            if node != producer:
                return
            value = self.values.born(
                now,
                producer,
                var_id,
                created,
                entry.seqno,
                entry.value,
                created=event == "created",
                reach=self._reach(producer) if now >= self._warm_up else None,
            )
            self.consistency.born(now, producer, var_id, value)
            return
        taken = self.values.taken(
            now, node, var_id, producer, created, entry.seqno, entry.value, sender=delivery.sender, sent=delivery.sent
        )
        self.consistency.holds(now, node, producer, var_id, taken)

    def deleted(self, now: int, node: int, var_id: int) -> None:
        """A variable is deleted at a node."""
        self.values.lost(node, var_id)
        self.consistency.lost(now, node, var_id)

    def _reach(self, producer: int) -> Reach:
        """Where a value of this producer can get to now."""
        if self._topology_version != self._medium.topology.version:
            self._topology_version = self._medium.topology.version
            self._reaches.clear()
        reach = self._reaches.get(producer)
        if reach is None:
            hops = distances(producer, self._medium.carried_to)
            reach = self._reaches[producer] = Reach(producer, self._on, hops)
        return reach
