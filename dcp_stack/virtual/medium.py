"""A broadcast medium between several stations: which frames arrive where and when, and what happens to them.

Order of calls: :meth:`Medium.broadcast` any number of times, :meth:`Medium.poll_timeout` for the time of the next
arrival, and :meth:`Medium.arrivals` at that time. The medium reads no clock: a simulation passes virtual time, the
relay real time. The results depend only on the seed, the configuration and these calls.

There are two kinds here, and in both the traffic of other stations does not change the outcome for a frame. In a medium
with a radio (``radio.py``) it does.
:class:`SimulatedMedium` is cheap for many stations: each sender has one random generator, which is used for its
receivers in ascending order. In :class:`ImpairedMedium` each direction has its own ``Channel``, which keeps frames in
order and counts them.
"""

from __future__ import annotations

import hashlib
import random
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec

from dcp_codec.common.events import EventQueue
from dcp_codec.impairment import PERFECT as UNIMPAIRED
from dcp_codec.impairment import Channel, Impairment, ImpairmentError

from .quality import PERFECT, Quality
from .topology import Full, Neighbours, Topology

Q = TypeVar("Q", bound=Quality | Impairment)


class Arrival(NamedTuple):
    """The simultaneous arrival of a frame at several stations, also while the frame is in flight.

    ``time`` and ``sent`` (when it was transmitted) are in ns.
    """

    time: int
    sender: int
    receivers: tuple[int, ...]
    """Stations in ascending order; after the flight those that are connected."""
    octets: bytes
    sent: int
    on_air: Any = None
    """The transmission, in a medium with a radio (:mod:`dcp_stack.virtual.radio`)."""


class MediumCounters(msgspec.Struct):
    """Counters of frames. ``expected`` is the number of deliveries of a perfect medium: all neighbours, for each frame.

    ``expected + duplicated == lost + overlapped + missed + delivered`` plus the deliveries still in flight; ``missed``
    are those to stations that were disconnected.
    """

    frames: int = 0
    expected: int = 0
    lost: int = 0
    duplicated: int = 0
    delivered: int = 0
    missed: int = 0
    corrupted: int = 0
    """Of the frames that were not lost, those in which bits were inverted."""
    overlapped: int = 0
    """Lost because another transmission reached the receiver at the same time."""


class TraceDigest:
    """A hash of all arrivals in order; equal digests mean the same arrivals at the same times."""

    _RECORD = struct.Struct("<QIII")
    """Time, sender, number of receivers, octets of the frame; then the receivers (4 octets each) and the frame."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self.deliveries = 0

    def __call__(self, arrival: Arrival) -> None:
        """Add one arrival to the hash."""
        octets, receivers = arrival.octets, arrival.receivers
        self._hash.update(self._RECORD.pack(arrival.time, arrival.sender, len(receivers), len(octets)))
        self._hash.update(struct.pack(f"<{len(receivers)}I", *receivers))
        self._hash.update(octets)
        self.deliveries += len(receivers)

    def hexdigest(self) -> str:
        """Return the SHA-256 of the arrivals so far."""
        return self._hash.hexdigest()


class Medium(ABC, Generic[Q]):
    """A medium between the stations 0..``stations`` - 1. Times are ns since the start.

    ``observer`` is called with every arrival in order (:class:`TraceDigest` is one). Frames in flight wait in
    ``queue``; a user that adds events of its own calls :meth:`land` for each :class:`Arrival` in it. Methods raise
    ``ImpairmentError`` (a ``ValueError``) for stations that do not exist.
    """

    def __init__(
        self,
        stations: int,
        quality: Q,
        *,
        seed: int = 1,
        topology: Topology | None = None,
        observer: Callable[[Arrival], None] | None = None,
    ) -> None:
        self.stations = stations
        self.topology: Topology = Full() if topology is None else topology
        self.queue: EventQueue[Any] = EventQueue()
        self._seed = seed
        self._quality = quality
        self._qualities: dict[int, dict[int, Q]] = {}
        self._channels: dict[tuple[int, int], Channel] = {}
        """By sender and receiver: the state of directions that need one."""
        self._observer = observer
        self._groups: dict[int, int] = {}
        self._off: set[int] = set()
        self._rows: dict[int, tuple[int, ...]] = {}
        self._rows_of = -1

    # -- stations and neighbourhoods -----------------------------------------------------------------------------------

    def set_quality(self, quality: Q | None, sender: int | None = None, receiver: int | None = None) -> None:
        """Set the quality of one direction; None restores that of the medium.

        With one of the two stations: of all directions from this sender, or to this receiver. With neither: of the
        medium, that is of all directions that have none of their own.
        """
        if sender is None and receiver is None:
            assert quality is not None
            self._quality = quality
            return
        self._known(each for each in (sender, receiver) if each is not None)
        for each in range(self.stations) if sender is None else [sender]:
            special = self._qualities.setdefault(each, {})
            for other in self.reach(each) if receiver is None else [receiver]:
                if quality is None:
                    special.pop(other, None)
                else:
                    special[other] = quality
            if not special:
                del self._qualities[each]

    def quality(self, sender: int, receiver: int) -> Q:
        """Return the quality of one direction."""
        return self._qualities.get(sender, {}).get(receiver, self._quality)

    def partition(self, groups: Iterable[Iterable[int]] = ()) -> None:
        """Restrict frames to the group of their sender from now on; the stations in no group form another one.

        Without groups the partition ends. Frames in flight still arrive. Raises ``ImpairmentError`` for a station in
        two groups.
        """
        members: dict[int, int] = {}
        for number, group in enumerate(groups, start=1):
            for station in group:
                self._known([station])
                if station in members:
                    raise ImpairmentError(f"partition: station {station} is in two groups")
                members[station] = number
        self._groups = members
        self._rows.clear()

    def switch(self, station: int, *, up: bool) -> None:
        """Connect or disconnect a station; a disconnected station neither sends nor receives."""
        self._known([station])
        (self._off.discard if up else self._off.add)(station)

    def reach(self, sender: int) -> list[int]:
        """Return the stations in range of ``sender`` now, ascending, without regard to partitions."""
        count = self.stations
        found = {each for each in self.topology.neighbours(sender, count) if 0 <= each < count and each != sender}
        return sorted(found)

    def neighbours(self, sender: int) -> tuple[int, ...]:
        """Return the stations in range of ``sender`` and in its group now, ascending."""
        if self.topology.version != self._rows_of:
            self._rows.clear()
            self._rows_of = self.topology.version
        row = self._rows.get(sender)
        if row is None:
            group = self._groups.get
            row = tuple(each for each in self.reach(sender) if group(each, 0) == group(sender, 0))
            self._rows[sender] = row
        return row

    # -- frames --------------------------------------------------------------------------------------------------------

    @abstractmethod
    def broadcast(self, sender: int, octets: bytes, now: int) -> None:
        """Transmit from ``sender`` at ``now``, which must not be before the time of the last call."""

    def poll_timeout(self) -> int | None:
        """Return the time of the next arrival; None if no frame is in flight."""
        return self.queue.next_time()

    def arrivals(self, now: int) -> Iterator[Arrival]:
        """Yield the arrivals up to ``now``: by time, then in the order of sending."""
        for flight in self.queue.due(now):
            if (arrival := self.land(flight)) is not None:
                yield arrival

    def land(self, flight: Arrival) -> Arrival | None:
        """Return the arrival of a frame that was in flight; None if all of its receivers are disconnected."""
        arrival = flight
        if not self._off.isdisjoint(flight.receivers):
            arrival = flight._replace(receivers=tuple([each for each in flight.receivers if each not in self._off]))
        self._count_arrival(flight, arrival.receivers)
        if not arrival.receivers:
            return None
        if self._observer is not None:
            self._observer(arrival)
        return arrival

    @abstractmethod
    def _count_arrival(self, flight: Arrival, there: tuple[int, ...]) -> None:
        """Count an arrival at the stations ``there``."""

    def _schedule(self, time: int, now: int, sender: int, receivers: tuple[int, ...], octets: bytes) -> None:
        """Add a frame in flight that was sent ``now`` and arrives at ``time``, but not before now."""
        time = max(time, now)
        self.queue.push(time, Arrival(time, sender, receivers, octets, now))

    def _channel(self, sender: int, receiver: int, wanted: Impairment) -> Channel:
        """Return the channel of a direction, with this impairment from now on."""
        channel = self._channels.get((sender, receiver))
        if channel is None:
            channel = self._channels[sender, receiver] = Channel(wanted, self._seed, f"{sender}>{receiver}")
        elif channel.impairment != wanted:
            channel.change(wanted)
        return channel

    def _known(self, stations: Iterable[int]) -> None:
        for each in stations:
            if not 0 <= each < self.stations:
                raise ImpairmentError(f"station {each}: there are 0..{self.stations - 1}")


class SimulatedMedium(Medium[Quality]):
    """A medium for simulations of many nodes, whose directions have a :class:`Quality`."""

    def __init__(self, stations: int, quality: Quality = PERFECT, **options: Any) -> None:
        """``options``: those of :class:`Medium`."""
        super().__init__(stations, quality, **options)
        self.counters = MediumCounters()
        self._last = 0
        """Time of the last broadcast."""
        # Simulations have to be repeatable.
        self._generators = [random.Random(f"{self._seed}/{index}") for index in range(stations)]  # noqa: S311

    def carried_to(self, sender: int) -> tuple[int, ...]:
        """Return the stations that can receive from ``sender`` now: neighbours, connected, with a loss below 1."""
        return tuple(
            each for each in self.neighbours(sender) if each not in self._off and self.quality(sender, each).loss < 1
        )

    def oldest_in_flight(self) -> int:
        """Return when the oldest frame in flight was sent; the time of the last broadcast if there is none."""
        return min((each.sent for each in self.queue if type(each) is Arrival), default=self._last)

    def broadcast(self, sender: int, octets: bytes, now: int) -> None:
        """See :meth:`Medium.broadcast`. Raises ``ValueError`` if an earlier call had a later time."""
        if now < self._last:
            raise ValueError(f"time cannot go back from {self._last} to {now} ns")
        self._last = now
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
                self._schedule(now + quality.delay, now, sender, receivers, octets)
            return
        for receiver in receivers:
            self._send_to(receiver, sender, octets, (special or {}).get(receiver, quality), now)

    def _send_to(self, receiver: int, sender: int, octets: bytes, quality: Quality, now: int) -> None:
        """Schedule the arrivals of a frame at one receiver: none, one, or two for a duplicate."""
        generator = self._generators[sender]
        if quality.has_memory:
            copies = self._channel(sender, receiver, quality.channel()).offer(octets, now).copies
            if not copies:
                self.counters.lost += 1
                return
            self.counters.corrupted += copies[0].octets != octets
            octets = copies[0].octets
        elif quality.loss and generator.random() < quality.loss:
            self.counters.lost += 1
            return
        self._schedule(now + quality.draw(generator), now, sender, (receiver,), octets)
        if quality.duplicate and generator.random() < quality.duplicate:
            self.counters.duplicated += 1
            self._schedule(now + quality.draw(generator), now, sender, (receiver,), octets)

    def _count_arrival(self, flight: Arrival, there: tuple[int, ...]) -> None:
        self.counters.missed += len(flight.receivers) - len(there)
        self.counters.delivered += len(there)


class ImpairedMedium(Medium[Impairment]):
    """A medium whose directions have an ``Impairment``, in real or virtual time."""

    def __init__(
        self,
        stations: int,
        quality: Impairment = UNIMPAIRED,
        *,
        pairs: Iterable[tuple[int, int]] | None = None,
        **options: Any,
    ) -> None:
        """``pairs``: connections (sender, receiver); None for all. ``options``: others of :class:`Medium`."""
        super().__init__(stations, quality, **options)
        if pairs is not None:
            self.topology = topology = Neighbours({})
            for sender, receiver in pairs:
                self._known([sender, receiver])
                topology.connect(sender, receiver)

    def set_quality(self, quality: Impairment | None, sender: int | None = None, receiver: int | None = None) -> None:
        """See :meth:`Medium.set_quality`. Raises ``ImpairmentError`` for a direction that does not exist."""
        if sender is not None and receiver is not None and receiver not in self.reach(sender):
            raise ImpairmentError(f"link {sender}>{receiver}: station {receiver} is not in reach of {sender}")
        super().set_quality(quality, sender, receiver)

    def broadcast(self, sender: int, octets: bytes, now: int, start: int = 0) -> None:
        """See :meth:`Medium.broadcast`. Octets before ``start`` are not corrupted."""
        neighbours = () if sender in self._off else self.neighbours(sender)
        for receiver in self.reach(sender):
            channel = self.direction(sender, receiver)
            if receiver not in neighbours or receiver in self._off:
                channel.counters.offered += 1
                channel.counters.down += 1
                continue
            for copy in channel.offer(octets, now, start).copies:
                self._schedule(copy.time, now, sender, (receiver,), copy.octets)

    def direction(self, sender: int, receiver: int) -> Channel:
        """Return the channel of one direction."""
        return self._channel(sender, receiver, self.quality(sender, receiver))

    def directions(self) -> dict[str, Any]:
        """Return the counters of all directions by ``"SENDER>RECEIVER"``, as plain data for JSON."""
        return {
            f"{a}>{b}": msgspec.to_builtins(self.direction(a, b).counters)
            for a in range(self.stations)
            for b in self.reach(a)
        }

    def _count_arrival(self, flight: Arrival, there: tuple[int, ...]) -> None:
        for receiver in flight.receivers:
            counters = self._channels[flight.sender, receiver].counters
            if receiver in there:
                counters.delivered += 1
            else:
                counters.down += 1
