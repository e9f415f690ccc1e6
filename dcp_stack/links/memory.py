"""A broadcast medium in memory and in virtual time, for tests and for simulations of many nodes.

Order of calls: nodes join, then :meth:`Medium.broadcast` any number of times, :meth:`Medium.poll_timeout` for the time
of the next arrival, and :meth:`Medium.deliver` at that time. The results depend only on the seed, the configuration
and these calls: each sender has its own random generator, which is used for its receivers in ascending order.
Traffic of other nodes therefore does not change the outcome for a frame.
"""

from __future__ import annotations

import hashlib
import heapq
import random
import struct
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from time import time_ns
from typing import NamedTuple

import msgspec

from dcp_codec.impairment import Channel

from .base import LinkCounters, Reception
from .quality import PERFECT, Quality
from .topology import Full, Topology

#: 2026-01-01T00:00:00Z in ns since 1970: the default wall clock at virtual time 0.
WALL_START = 1_767_225_600_000_000_000


class Delivery(NamedTuple):
    """The arrival of a frame at one node. ``time`` and ``sent`` (when it was transmitted) are virtual, in ns."""

    time: int
    sender: int
    receiver: int
    reception: Reception
    sent: int


class Arrival(NamedTuple):
    """The simultaneous arrival of a frame at several nodes. ``time`` and ``sent`` are virtual, in ns."""

    time: int
    sender: int
    receivers: tuple[int, ...]
    """The receiving nodes that have not left, ascending."""
    reception: Reception
    """Shared by all receivers."""
    sent: int

    def deliveries(self) -> Iterator[Delivery]:
        """Yield a :class:`Delivery` for each receiver."""
        for receiver in self.receivers:
            yield Delivery(self.time, self.sender, receiver, self.reception, self.sent)


class MediumCounters(msgspec.Struct):
    """Counters of frames. ``expected`` is the number of deliveries of a perfect medium: all neighbours, for each frame.

    ``expected + duplicated == lost + missed + delivered`` plus the deliveries still in flight; ``missed`` are those to
    nodes that had left.
    """

    frames: int = 0
    expected: int = 0
    lost: int = 0
    duplicated: int = 0
    delivered: int = 0
    missed: int = 0
    corrupted: int = 0
    """Of the frames that were not lost, those in which bits were inverted."""


class TraceDigest:
    """A hash of all arrivals in order; equal digests mean the same arrivals at the same times."""

    _RECORD = struct.Struct("<QIII")
    """Time, sender, number of receivers, octets of the frame; then the receivers (4 octets each) and the frame."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self.deliveries = 0

    def __call__(self, arrival: Arrival) -> None:
        """Add one arrival to the hash."""
        octets, receivers = arrival.reception.octets, arrival.receivers
        self._hash.update(self._RECORD.pack(arrival.time, arrival.sender, len(receivers), len(octets)))
        self._hash.update(struct.pack(f"<{len(receivers)}I", *receivers))
        self._hash.update(octets)
        self.deliveries += len(receivers)

    def hexdigest(self) -> str:
        """Return the SHA-256 of the arrivals so far."""
        return self._hash.hexdigest()


class _Flight(NamedTuple):
    """A frame in flight to receivers that it reaches at the same time; ordered by time, then by order of sending."""

    time: int
    number: int
    sender: int
    receivers: tuple[int, ...]
    octets: bytes
    sent: int


class Medium:
    """The simulated medium. Nodes have numbers from 0, in the order in which they joined.

    ``observer`` is called with every arrival in order (:class:`TraceDigest` is one). ``wall_start`` is the wall clock
    at time 0 in ns since 1970. With ``clock`` (ns, monotonic) the medium runs in real time: its links deliver by
    themselves and use the real wall clock. Without it the user calls :meth:`deliver` or :meth:`advance`.
    """

    def __init__(
        self,
        seed: int,
        *,
        quality: Quality = PERFECT,
        topology: Topology | None = None,
        max_packet_size: int = 1500,
        wall_start: int | None = None,
        observer: Callable[[Arrival], None] | None = None,
        clock: Callable[[], int] | None = None,
    ) -> None:
        self.max_packet_size = max_packet_size
        self.counters = MediumCounters()
        self.now = 0
        self.topology: Topology = Full() if topology is None else topology
        self._seed = seed
        self._quality = quality
        self._qualities: dict[int, dict[int, Quality]] = {}
        self._channels: dict[tuple[int, int], Channel] = {}
        """By sender and receiver: the state of connections whose losses come in bursts, or that corrupt frames."""
        if wall_start is None:
            wall_start = WALL_START if clock is None else time_ns() - clock()
        self._wall_start = wall_start
        self._observer = observer
        self._clock = clock
        self._nodes: list[MemoryLink] = []
        self._generators: list[random.Random] = []
        self._groups: dict[int, int] | None = None
        self._rows: dict[int, tuple[int, ...]] = {}
        self._rows_of = (-1, -1)
        self._flights: list[_Flight] = []
        self._number = 0

    # -- nodes and neighbourhoods ----------------------------------------------------------------------------------

    def join(self, *, name: str = "", source: bytes | None = None) -> MemoryLink:
        """Add a node; return its link. ``source`` is the address of its frames, by default 02:00 and its number."""
        index = len(self._nodes)
        link = MemoryLink(self, index, name or f"memory:{index}", source or b"\x02\x00" + index.to_bytes(4, "big"))
        self._nodes.append(link)
        self._generators.append(random.Random(f"{self._seed}/{index}"))  # noqa: S311 - has to be repeatable
        return link

    def __len__(self) -> int:
        return len(self._nodes)

    def set_quality(self, sender: int, receiver: int, quality: Quality | None) -> None:
        """Set the quality from ``sender`` to ``receiver``; None restores the quality of the medium.

        ``Quality(loss=1)`` in one direction makes a connection asymmetric.
        """
        special = self._qualities.setdefault(sender, {})
        if quality is None:
            special.pop(receiver, None)
        else:
            special[receiver] = quality
        if not special:
            del self._qualities[sender]

    def partition(self, *groups: Iterable[int]) -> None:
        """Restrict frames to the group of their sender from now on; nodes in none of ``groups`` form another group.

        Frames in flight still arrive. Raises ``ValueError`` for a node in two groups.
        """
        members: dict[int, int] = {}
        for number, group in enumerate(groups, start=1):
            for node in group:
                if node in members:
                    raise ValueError(f"node {node} is in two groups")
                members[node] = number
        self._groups = members
        self._rows.clear()

    def heal(self) -> None:
        """End the partition: frames cross groups again."""
        self._groups = None
        self._rows.clear()

    def neighbours(self, sender: int) -> tuple[int, ...]:
        """Return the nodes in range of ``sender`` now, ascending."""
        state = (self.topology.version, len(self._nodes))
        if state != self._rows_of:
            self._rows.clear()
            self._rows_of = state
        row = self._rows.get(sender)
        if row is None:
            count = len(self._nodes)
            found = {node for node in self.topology.neighbours(sender, count) if 0 <= node < count and node != sender}
            if self._groups is not None:
                own = self._groups.get(sender, 0)
                found = {node for node in found if self._groups.get(node, 0) == own}
            row = self._rows[sender] = tuple(sorted(found))
        return row

    def carried_to(self, sender: int) -> tuple[int, ...]:
        """Return the nodes that can receive from ``sender`` now: in range, not closed, with a loss below 1."""
        special = self._qualities.get(sender, {})
        usual = self._quality
        return tuple(
            node
            for node in self.neighbours(sender)
            if not self._nodes[node].closed and special.get(node, usual).loss < 1
        )

    # -- frames ----------------------------------------------------------------------------------------------------

    def broadcast(self, sender: int, octets: bytes, now: int) -> None:
        """Transmit from ``sender`` at ``now`` (ns, virtual); raises ValueError if an earlier call had a later time."""
        self._go_to(now)
        receivers = self.neighbours(sender)
        counters = self.counters
        counters.frames += 1
        counters.expected += len(receivers)
        generator, quality = self._generators[sender], self._quality
        special = self._qualities.get(sender)
        if special is None and quality.uniform:
            # A single entry for all receivers: large simulations spend most of their time here.
            if quality.loss:
                loss, draw = quality.loss, generator.random
                heard = tuple([receiver for receiver in receivers if draw() >= loss])
                counters.lost += len(receivers) - len(heard)
                receivers = heard
            if receivers:
                self._schedule(now + quality.delay, sender, receivers, octets)
            return
        for receiver in receivers:
            self._send_to(receiver, sender, octets, (special or {}).get(receiver, quality))

    def _send_to(self, receiver: int, sender: int, octets: bytes, quality: Quality) -> None:
        """Schedule the arrivals of a frame at one receiver: none, one, or two for a duplicate."""
        generator = self._generators[sender]
        if quality.has_memory:
            copies = self._channel(sender, receiver, quality).offer(octets, self.now).copies
            if not copies:
                self.counters.lost += 1
                return
            self.counters.corrupted += copies[0].octets != octets
            octets = copies[0].octets
        elif quality.loss and generator.random() < quality.loss:
            self.counters.lost += 1
            return
        self._schedule(self.now + quality.draw(generator), sender, (receiver,), octets)
        if quality.duplicate and generator.random() < quality.duplicate:
            self.counters.duplicated += 1
            self._schedule(self.now + quality.draw(generator), sender, (receiver,), octets)

    def _channel(self, sender: int, receiver: int, quality: Quality) -> Channel:
        wanted = quality.channel()
        channel = self._channels.get((sender, receiver))
        if channel is None:
            channel = self._channels[sender, receiver] = Channel(wanted, self._seed, f"{sender}>{receiver}")
        elif channel.impairment != wanted:
            channel.change(wanted)
        return channel

    def _schedule(self, time: int, sender: int, receivers: tuple[int, ...], octets: bytes) -> None:
        """Add a frame in flight that arrives at ``time`` (virtual ns), but not before now."""
        # The number is unique, so the heap compares nothing after it, and frames of equal time keep the order of
        # sending.
        heapq.heappush(self._flights, _Flight(max(time, self.now), self._number, sender, receivers, octets, self.now))
        self._number += 1

    def oldest_in_flight(self) -> int:
        """Return when the oldest frame in flight was sent (virtual ns); the current time if there is none."""
        return min((flight.sent for flight in self._flights), default=self.now)

    def poll_timeout(self) -> int | None:
        """Return the virtual time of the next arrival in ns; None if no frame is in flight."""
        return self._flights[0].time if self._flights else None

    def deliver(self, now: int) -> list[Delivery]:
        """Return the deliveries up to ``now``: by time of arrival, then in the order of sending, then by receiver."""
        return [delivery for arrival in self.arrivals(now) for delivery in arrival.deliveries()]

    def arrivals(self, now: int) -> list[Arrival]:
        """Return the same as :meth:`deliver`, with all simultaneous receivers of a frame in one :class:`Arrival`."""
        self._go_to(now)
        arrivals: list[Arrival] = []
        flights, nodes, observer = self._flights, self._nodes, self._observer
        while flights and flights[0].time <= now:
            time, _, sender, receivers, octets, sent = heapq.heappop(flights)
            # One object for all receivers.
            reception = Reception(octets, self._wall_start + time, nodes[sender].source)
            there = tuple([receiver for receiver in receivers if not nodes[receiver].closed])
            self.counters.missed += len(receivers) - len(there)
            self.counters.delivered += len(there)
            if there:
                arrival = Arrival(time, sender, there, reception, sent)
                arrivals.append(arrival)
                if observer is not None:
                    observer(arrival)
        return arrivals

    def advance(self, now: int) -> None:
        """Deliver all frames up to ``now`` to the links, where :meth:`MemoryLink.receive` returns them."""
        for delivery in self.deliver(now):
            self._nodes[delivery.receiver].put(delivery.reception)

    def tick(self) -> int:
        """Advance to the time of the clock, if there is one; return the current virtual time in ns."""
        if self._clock is not None:
            self.advance(max(self.now, self._clock()))
        return self.now

    def _go_to(self, now: int) -> None:
        if now < self.now:
            raise ValueError(f"virtual time cannot go back from {self.now} to {now} ns")
        self.now = now


class MemoryLink:
    """The link of one node of a :class:`Medium`. It has no descriptor; :meth:`poll_timeout` returns the next arrival.

    Received frames wait here until :meth:`receive`. At most ``inbox_limit`` frames wait; more are dropped and counted
    in ``kernel_drops``, as in the buffer of a socket.
    """

    def __init__(self, medium: Medium, index: int, name: str, source: bytes, inbox_limit: int = 65_536) -> None:
        """Called by :meth:`Medium.join` only."""
        self.name = name
        self.counters = LinkCounters()
        self.max_packet_size = medium.max_packet_size
        self.index = index
        self.source = source
        self.closed = False
        self._medium = medium
        self._inbox: deque[Reception] = deque()
        self._inbox_limit = inbox_limit

    @property
    def up(self) -> bool:
        """Whether the link is open."""
        return not self.closed

    def fileno(self) -> int:
        """Return -1: the medium has no descriptor to wait for."""
        return -1

    def poll_timeout(self) -> int | None:
        """Return the time at which to call :meth:`receive`, in ns of the medium's time; None: not before a send."""
        return self._medium.now if self._inbox else self._medium.poll_timeout()

    def put(self, reception: Reception) -> None:
        """Add an arriving frame to the inbox (called by the medium)."""
        if len(self._inbox) >= self._inbox_limit:
            self.counters.kernel_drops += 1
        else:
            self._inbox.append(reception)

    def receive(self) -> list[Reception]:
        """Return the frames that have arrived by the medium's time."""
        if self.closed:
            return []
        self._medium.tick()
        receptions = list(self._inbox)
        self._inbox.clear()
        self.counters.received += len(receptions)
        return receptions

    def send(self, octets: bytes) -> bool:
        """Broadcast at the medium's time; return False if the link is closed or the packet too long."""
        if self.closed or len(octets) > self.max_packet_size:
            self.counters.send_errors += 1
            return False
        self._medium.broadcast(self.index, octets, self._medium.tick())
        self.counters.sent += 1
        return True

    def close(self) -> None:
        """Leave the medium: the node receives no more frames."""
        self.closed = True
        self._inbox.clear()
