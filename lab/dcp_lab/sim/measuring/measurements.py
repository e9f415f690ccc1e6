"""The measurements of one simulated network, updated by its events."""

from __future__ import annotations

from dcp_stack.vardis.database import DBEntry
from dcp_stack.virtual.medium import Arrival, SimulatedMedium

from .consistency import Consistency
from .reach import Reach, distances
from .values import Content, ValueLog


class Measurements:
    """Measures delays and consistency. Nodes are numbers from 0, times virtual ns."""

    def __init__(self, medium: SimulatedMedium, numbers: dict[bytes, int], *, warm_up: int, held_back: int) -> None:
        """``numbers``: number of each node by its identifier.

        Values produced before ``warm_up`` (ns) are not counted. ``held_back``: longest time (ns) that a payload can
        wait at its node before it is sent.
        """
        self._medium = medium
        self._numbers = numbers
        self._warm_up = warm_up
        self.values = ValueLog(len(numbers), oldest_in_flight=medium.oldest_in_flight, held_back=held_back)
        self.consistency = Consistency(len(numbers))
        self._on: set[int] = set()
        self._reaches: dict[int, Reach] = {}
        self._topology_version = -1

    def on(self, node: int) -> None:
        """Note that a node was switched on."""
        self._on.add(node)
        self._reaches.clear()

    def off(self, now: int, node: int) -> None:
        """Note that a node was switched off, which clears its memory."""
        self._on.discard(node)
        self._reaches.clear()
        self.values.switched_off(node)
        self.consistency.forget(now, node)

    def connections_changed(self) -> None:
        """Note that links or partitions changed."""
        self._reaches.clear()

    def stored(self, now: int, node: int, var_id: int, entry: DBEntry, delivery: Arrival | None, event: str) -> None:
        """Note that a node stored a value. ``event``: ``created`` or ``updated``.

        ``delivery``: the frame that carried the value; None if the node produced it.
        """
        producer = self._numbers.get(entry.spec.prod_id)
        if producer is None:
            return
        content = Content(producer, var_id, entry.spec.creation_time, entry.seqno, entry.value)
        if delivery is None:
            if node != producer:
                return
            reach = self._reach(producer) if now >= self._warm_up else None
            value = self.values.born(now, content, created=event == "created", reach=reach)
            self.consistency.born(now, producer, var_id, value)
            return
        taken = self.values.taken(now, node, content, sender=delivery.sender, sent=delivery.sent)
        self.consistency.holds(now, node, producer, var_id, taken)

    def deleted(self, now: int, node: int, var_id: int) -> None:
        """Note that a node deleted a variable."""
        self.values.lost(node, var_id)
        self.consistency.lost(now, node, var_id)

    def _reach(self, producer: int) -> Reach:
        """Return the nodes that a value of this producer can reach now."""
        if self._topology_version != self._medium.topology.version:
            self._topology_version = self._medium.topology.version
            self._reaches.clear()
        reach = self._reaches.get(producer)
        if reach is None:
            hops = distances(producer, self._medium.carried_to)
            reach = self._reaches[producer] = Reach(producer, self._on, hops)
        return reach
