"""A broadcast medium in memory and in virtual time, for tests and for simulations of many nodes.

Order of calls: nodes join, then :meth:`Medium.broadcast` any number of times, :meth:`Medium.poll_timeout` for the time
of the next arrival, and :meth:`Medium.deliver` at that time. What happens depends on the seed, on the configuration
and on these calls alone: each sender has a random generator of its own, which is asked for receivers in ascending
order. Another node's traffic therefore does not change what becomes of a frame.
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

#: 2026-01-01T00:00:00Z in ns since 1970: the wall clock at virtual time 0, unless said otherwise.
WALL_START = 1_767_225_600_000_000_000


class Delivery(NamedTuple):
    """A frame arrives at one node. ``time`` and ``sent`` (when it was transmitted) are virtual, in ns."""

    time: int
    sender: int
    receiver: int
    reception: Reception
    sent: int


class Arrival(NamedTuple):
    """A frame arrives at several nodes at one moment. ``time`` and ``sent`` are virtual, in ns."""

    time: int
    sender: int
    receivers: tuple[int, ...]
    """Those that are there, ascending."""
    reception: Reception
    """Shared by all receivers."""
    sent: int

    def deliveries(self) -> Iterator[Delivery]:
        """The same for each receiver."""
        for receiver in self.receivers:
            yield Delivery(self.time, self.sender, receiver, self.reception, self.sent)


class MediumCounters(msgspec.Struct):
    """``expected`` is what a perfect medium would have delivered: neighbours of the sender, for each frame.

    ``expected + duplicated == lost + missed + delivered`` and what is still under way; ``missed`` came to a node that
    had left.
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
    """A hash of all arrivals in their order; equal digests mean that the same things happened at the same times."""

    _RECORD = struct.Struct("<QIII")
    """Time, sender, number of receivers, octets of the frame; then the receivers (4 octets each) and the frame."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self.deliveries = 0

    def __call__(self, arrival: Arrival) -> None:
        """Take note of one frame and whom it reached."""
        octets, receivers = arrival.reception.octets, arrival.receivers
        self._hash.update(self._RECORD.pack(arrival.time, arrival.sender, len(receivers), len(octets)))
        self._hash.update(struct.pack(f"<{len(receivers)}I", *receivers))
        self._hash.update(octets)
        self.deliveries += len(receivers)

    def hexdigest(self) -> str:
        """SHA-256 of what was seen so far."""
        return self._hash.hexdigest()


class _Flight(NamedTuple):
    """A frame under way to receivers whom it reaches at the same time; compared by time, then by order of sending."""

    time: int
    number: int
    sender: int
    receivers: tuple[int, ...]
    octets: bytes
    sent: int


class Medium:
    """The medium. Nodes have numbers from 0, in the order in which they joined.

    ``observer`` sees every arrival in order (:class:`TraceDigest` is one). ``wall_start`` is the wall clock at time 0
    in ns since 1970. ``clock`` (ns, monotonic) makes the links of this medium run by themselves, for programs in real
    time, and the wall clock the real one; without it somebody calls :meth:`deliver` or :meth:`advance`.
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

    # -- who is there, and who hears whom --------------------------------------------------------------------------

    def join(self, *, name: str = "", source: bytes | None = None) -> MemoryLink:
        """Add a node; its link. ``source`` is the address of its frames, by default 02:00 and its number."""
        index = len(self._nodes)
        link = MemoryLink(self, index, name or f"memory:{index}", source or b"\x02\x00" + index.to_bytes(4, "big"))
        self._nodes.append(link)
        self._generators.append(random.Random(f"{self._seed}/{index}"))  # noqa: S311 - to be repeatable is the point
        return link

    def __len__(self) -> int:
        return len(self._nodes)

    def set_quality(self, sender: int, receiver: int, quality: Quality | None) -> None:
        """Give one direction between two nodes a quality of its own; None takes it back.

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
        """From now on frames stay inside their group; nodes in none of ``groups`` form one more together.

        What is under way still arrives. Raises ``ValueError`` for a node in two groups.
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
        """End the partition."""
        self._groups = None
        self._rows.clear()

    def neighbours(self, sender: int) -> tuple[int, ...]:
        """The nodes in reach of ``sender`` now, ascending."""
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
        """The nodes that can hear ``sender`` now: in reach, switched on, and not over a connection that loses all."""
        special = self._qualities.get(sender, {})
        usual = self._quality
        return tuple(
            node
            for node in self.neighbours(sender)
            if not self._nodes[node].closed and special.get(node, usual).loss < 1
        )

    # -- frames ----------------------------------------------------------------------------------------------------

    def broadcast(self, sender: int, octets: bytes, now: int) -> None:
        """``sender`` transmits at ``now`` (ns, virtual; never before the last time given)."""
        self._go_to(now)
        receivers = self.neighbours(sender)
        counters = self.counters
        counters.frames += 1
        counters.expected += len(receivers)
        generator, quality = self._generators[sender], self._quality
        special = self._qualities.get(sender)
        if special is None and quality.uniform:
            # One entry for all, however many.
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
        # The number is unique, so that a heap never compares further, and equal times keep the order of sending.
        heapq.heappush(self._flights, _Flight(max(time, self.now), self._number, sender, receivers, octets, self.now))
        self._number += 1

    def oldest_in_flight(self) -> int:
        """When the oldest frame that is still under way was sent (virtual ns); now, if none is."""
        return min((flight.sent for flight in self._flights), default=self.now)

    def poll_timeout(self) -> int | None:
        """The virtual time of the next arrival in ns, None when nothing is under way."""
        return self._flights[0].time if self._flights else None

    def deliver(self, now: int) -> list[Delivery]:
        """What has arrived by ``now``: by time of arrival, then in the order of sending, then by receiver."""
        return [delivery for arrival in self.arrivals(now) for delivery in arrival.deliveries()]

    def arrivals(self, now: int) -> list[Arrival]:
        """As :meth:`deliver`, with all receivers of a frame at one moment together."""
        self._go_to(now)
        arrivals: list[Arrival] = []
        flights, nodes, observer = self._flights, self._nodes, self._observer
        while flights and flights[0].time <= now:
            time, _, sender, receivers, octets, sent = heapq.heappop(flights)
            # Shared by all whom it reaches.
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
        """Deliver to the links, for those who use them: :meth:`MemoryLink.receive` then has it."""
        for delivery in self.deliver(now):
            self._nodes[delivery.receiver].put(delivery.reception)

    def tick(self) -> int:
        """Advance to the time of the clock, if there is one; the time of now."""
        if self._clock is not None:
            self.advance(max(self.now, self._clock()))
        return self.now

    def _go_to(self, now: int) -> None:
        if now < self.now:
            raise ValueError(f"virtual time cannot go back from {self.now} to {now} ns")
        self.now = now


class MemoryLink:
    """The link of one node of a :class:`Medium`. Has no descriptor; :meth:`poll_timeout` says when to look.

    Received frames wait here until they are taken; ``inbox_limit`` of them at most, then they are lost as in the
    buffer of a socket (``kernel_drops``).
    """

    def __init__(self, medium: Medium, index: int, name: str, source: bytes, inbox_limit: int = 65_536) -> None:
        """Made by :meth:`Medium.join`."""
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
        """Whether it is open."""
        return not self.closed

    def fileno(self) -> int:
        """There is none."""
        return -1

    def poll_timeout(self) -> int | None:
        """When to call :meth:`receive`, in the medium's time."""
        return self._medium.now if self._inbox else self._medium.poll_timeout()

    def put(self, reception: Reception) -> None:
        """A frame arrives (called by the medium)."""
        if len(self._inbox) >= self._inbox_limit:
            self.counters.kernel_drops += 1
        else:
            self._inbox.append(reception)

    def receive(self) -> list[Reception]:
        """What has arrived by the medium's time."""
        if self.closed:
            return []
        self._medium.tick()
        receptions = list(self._inbox)
        self._inbox.clear()
        self.counters.received += len(receptions)
        return receptions

    def send(self, octets: bytes) -> bool:
        """Broadcast at the medium's time; False if the link is closed or the packet too long."""
        if self.closed or len(octets) > self.max_packet_size:
            self.counters.send_errors += 1
            return False
        self._medium.broadcast(self.index, octets, self._medium.tick())
        self.counters.sent += 1
        return True

    def close(self) -> None:
        """Leave: from now on this node hears nothing."""
        self.closed = True
        self._inbox.clear()
