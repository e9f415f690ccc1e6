"""Nodes on a simulated medium, in virtual time. One loop processes all events, in the same order for the same seed."""

from __future__ import annotations

import heapq
import logging
import random
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import msgspec
from dcp_spec.profile.definition import Profile

from dcp_codec.codec import Codec
from dcp_codec.common.garbage import few_collections
from dcp_stack.config import BPConfig, NodeConfig, SRPConfig, VardisConfig
from dcp_stack.effects import Effect, NeighbourExpired, SendBeacon, VariableChanged
from dcp_stack.links.base import Watcher
from dcp_stack.links.memory import WALL_START, Arrival, Delivery, Medium, MemoryLink, TraceDigest
from dcp_stack.links.quality import PERFECT, Quality
from dcp_stack.links.topology import Positions, Topology
from dcp_stack.node import Node
from dcp_stack.positions import PositionSource, SafetyFields
from dcp_stack.positions.base import Sample
from dcp_stack.positions.tracks import Track
from dcp_stack.sim.scenario.requests import answer

from .hearing import MOST_WAITING, HearingNode, Parsed, Parser, ReceivedBeacon
from .sharing import SharedCodec

log = logging.getLogger(__name__)

#: Maximum number of timeouts of a node at one moment; more indicate a defect of the node.
MOST_CALLS = 1000

T = TypeVar("T")
Listener = Callable[[int, int, Any], None]
"""A function that is called with the virtual time in ns, the number of the node, and the effect."""


def node_id(profile: Profile, index: int) -> bytes:
    """Return the identifier of a simulated node: a locally administered MAC address that ends with its number."""
    layout = profile.types.node_id
    mac = b"\x02" + index.to_bytes(5, "big")
    if layout.length is not None:
        return mac.hex(":").encode()
    return mac if layout.width == len(mac) else (index + 1).to_bytes(layout.width, "big")


class Station:
    """One node of the network with its link. It exists also while the node is switched off."""

    def __init__(self, index: int, link: MemoryLink, config: NodeConfig, rng: random.Random) -> None:
        """Initialise a station that is switched off. Only :class:`Network` creates stations."""
        self.index = index
        self.link = link
        self.config = config
        self.rng = rng
        self.node: Node | None = None
        self.hearing: HearingNode | None = None
        """The node, if it has the fast path for known beacons."""
        self.failure = ""
        """Time and text of the exception that stopped the node; empty without one."""
        self.sources: list[PositionSource] = []
        self.tracks: list[Track] = []
        """The sources that are polled only when a beacon is due."""
        self.watchers: list[Watcher] = []
        self.beacons_sent = 0
        self.octets_sent = 0
        self.beacons_received = 0
        self.up_since: int | None = None
        self.due = -1
        self.called = -1
        self.calls = 0


class Network:
    """A simulated network: nodes and medium. All times are virtual ns from 0.

    Use: :meth:`start` nodes, :meth:`call` their services, and let time pass with :meth:`run_until`, in any order.
    ``seed`` determines everything random: each node, and each sender of the medium, has its own generator.
    """

    def __init__(
        self,
        count: int,
        codec: Codec,
        *,
        seed: int = 1,
        topology: Topology | None = None,
        quality: Quality = PERFECT,
        bp: BPConfig | None = None,
        srp: SRPConfig | None = None,
        vardis: VardisConfig | None = None,
        readings: Mapping[str, str] | None = None,
        share_decoding: bool = True,
    ) -> None:
        """Create ``count`` nodes that are switched off. ``srp`` or ``vardis`` None leaves the protocol out.

        ``share_decoding`` False decodes a broadcast once per receiver and uses plain nodes, which is slower and has
        the same outcome. Raises ValueError for parameters out of bounds.
        """
        self._places = topology if isinstance(topology, Positions) else None
        self._fields = SafetyFields(codec.profile)
        self.codec: Codec = SharedCodec(codec) if share_decoding else codec
        self.digest = TraceDigest()
        self.medium = Medium(seed, topology=topology, quality=quality, observer=self.digest)
        self._listeners: dict[type[Effect], list[Listener]] = {}
        self.watchers: list[Watcher] = []
        """Watchers of the medium; each gets every transmission once."""
        self.stations: list[Station] = []
        self.now = 0
        self._parse: Callable[[bytes], Parsed | None] | None = None
        self.delivering: Delivery | None = None
        """The frame that causes the effects of the current calls of listeners; None for services and timers."""
        # Entries are (time, number, station) and (time, number, action). The unique number keeps the order of entries.
        self._heap: list[tuple[int, int, Station | Callable[[], None]]] = []
        self._number = 0
        for index in range(count):
            link = self.medium.join()
            config = NodeConfig(
                node_id=node_id(codec.profile, index),
                codec=self.codec,
                bp=bp or BPConfig(),
                srp=srp,
                vardis=vardis,
                readings=readings or {},
            )
            rng = random.Random(f"{seed}/node/{index}")  # noqa: S311 - runs have to be repeatable
            link.closed = True
            self.stations.append(Station(index, link, config, rng))
        if share_decoding and self.stations:
            # Its cache makes that of the shared codec superfluous.
            self._parse = Parser(msgspec.structs.replace(self.stations[0].config, codec=codec)).parse

    def __len__(self) -> int:
        return len(self.stations)

    @property
    def wall(self) -> int:
        """The wall clock of all nodes, ns since 1970."""
        return WALL_START + self.now

    # -- nodes ---------------------------------------------------------------------------------------------------------

    def node(self, index: int) -> Node:
        """Return a node by its number. Raises LookupError while it is switched off."""
        node = self.stations[index].node
        if node is None:
            raise LookupError(f"node {index} is switched off")
        return node

    def start(self, index: int) -> None:
        """Switch a node on now, with empty memory. No effect if it is already on."""
        station = self.stations[index]
        if station.node is not None:
            return
        if self._parse is None:
            station.node = Node(station.config, rng=station.rng, now=self.now, wall=self.wall)
        else:
            station.node = station.hearing = HearingNode(station.config, rng=station.rng, now=self.now, wall=self.wall)
        station.link.closed = False
        station.up_since = self.now
        self._guarded(station, lambda node: node.start(self.now, self.wall))
        if station.hearing is not None:
            station.hearing.look()

    def stop(self, index: int) -> None:
        """Switch a node off now, without any further message, as when its battery is empty."""
        station = self.stations[index]
        station.node = station.hearing = None
        station.link.closed = True
        station.up_since = None
        # Cancels its pending timeout.
        station.due = -1

    def attach(self, index: int, source: PositionSource) -> None:
        """Let a node get its safety data from ``source`` from now on.

        In a topology of :class:`Positions` the node moves accordingly, even while it is switched off.
        """
        station = self.stations[index]
        station.sources.append(source)
        if isinstance(source, Track) and self._places is None and not station.config.bp.triggered:
            # A track is a function of time, so it is computed only when a beacon carries the sample. The first poll
            # starts it.
            station.tracks.append(source)
            source.poll(self.now, self.wall)
        else:
            self.at(self.now, lambda: self._poll(station, source))

    def call(self, index: int, service: Callable[[Node, int, int], T]) -> T:
        """Call ``service(node, now, wall)``, execute the effects at that node, and return the result of the service.

        Raises LookupError while the node is switched off.
        """
        node = self.node(index)
        station = self.stations[index]
        answer = service(node, self.now, self.wall)
        self._guarded(station, lambda node: node.settle(self.now, self.wall))
        if station.hearing is not None:
            station.hearing.look()
        return answer

    def request(self, index: int, method: str, /, **params: Any) -> dict[str, Any]:
        """Send a request to the control interface of a node; returns the answer as ``ControlClient.call`` does.

        Raises LookupError while the node is switched off, and ServiceError if the node answers with an error.
        """
        return self.call(index, lambda node, now, wall: answer(node, method, params, now, wall))

    def listen(self, kind: type[Effect], listener: Listener) -> None:
        """Call ``listener`` for all effects of one kind, of all nodes, in the order in which they occur.

        Call it before nodes start: without a listener the fast path processes known beacons without effects.
        """
        self._listeners.setdefault(kind, []).append(listener)
        if kind not in (VariableChanged, NeighbourExpired, SendBeacon):
            self._parse = None
            for station in self.stations:
                if station.hearing is not None:
                    station.hearing.forget_all()
                    station.hearing.ready = False
                    station.hearing = None

    # -- time ----------------------------------------------------------------------------------------------------------

    def at(self, time: int, action: Callable[[], None]) -> None:
        """Call ``action`` at a future time, after the arrivals of that time and in the order of these calls."""
        self._push(max(time, self.now), action)

    def run_until(self, end: int, *, stop: Callable[[], bool] | None = None) -> bool:
        """Let virtual time pass up to ``end``, and process all events until then.

        Calls ``stop`` after each event. Returns True as soon as it returns True, otherwise False at ``end``.
        """
        with few_collections():
            return self._run_until(end, stop)

    def _run_until(self, end: int, stop: Callable[[], bool] | None) -> bool:
        heap, medium = self._heap, self.medium
        while True:
            flight = medium.poll_timeout()
            if flight is not None and flight <= end and (not heap or flight <= heap[0][0]):
                self.now = flight
                for arrival in medium.arrivals(flight):
                    self._arrive(arrival)
            elif heap and heap[0][0] <= end:
                time, _, subject = heapq.heappop(heap)
                self.now = time
                if not isinstance(subject, Station):
                    subject()
                elif subject.due == time and subject.node is not None:
                    subject.due = -1
                    self._wake(subject)
            else:
                self.now = end
                return False
            if stop is not None and stop():
                return True

    def close(self) -> None:
        """Close the position sources."""
        for station in self.stations:
            for source in station.sources:
                source.close()

    # -- internals -----------------------------------------------------------------------------------------------------

    def _push(self, time: int, subject: Station | Callable[[], None]) -> None:
        """Schedule the timeout of a station, or an action."""
        heapq.heappush(self._heap, (time, self._number, subject))
        self._number += 1

    def _wake(self, station: Station) -> None:
        """Process the timeout of a node; stop the node if its timeouts do not end at one moment."""
        station.calls = station.calls + 1 if station.called == self.now else 0
        station.called = self.now
        if station.calls > MOST_CALLS:
            # Otherwise virtual time would never advance again.
            self._fail(station, RuntimeError(f"handle_timeout was called {MOST_CALLS} times and is still due"))
        else:
            self._guarded(station, lambda node: self._timeout(station, node))

    def _timeout(self, station: Station, node: Node) -> None:
        """Submit the samples of tracks if a beacon is due, and call ``handle_timeout`` of the node."""
        now, wall = self.now, self.wall
        if station.tracks:
            beacon = node.bp.poll_timeout()
            if beacon is not None and beacon <= now:
                for track in station.tracks:
                    self._submit(node, self._sample(station, track))
        node.handle_timeout(now, wall)

    def _arrive(self, arrival: Arrival) -> None:
        """Process a frame at all its receivers, on the fast path where possible."""
        stations, reception = self.stations, arrival.reception
        beacon = self._parse(reception.octets) if self._parse is not None else None
        if beacon is None:
            for delivery in arrival.deliveries():
                station = stations[delivery.receiver]
                if station.hearing is not None:
                    # The frame may contain a request; the node then has to process the sender's next beacon completely.
                    station.hearing.forget_all()
                self._deliver(station, delivery)
            return
        heard = ReceivedBeacon(beacon, self.now, reception.wall)
        sender, payload, network = beacon.sender_id, beacon.vardis, beacon.network_id
        for receiver in arrival.receivers:
            station = stations[receiver]
            node = station.hearing
            if node is not None:
                # Inlined from node.hear(): nearly all deliveries of a large network end here, and the call would
                # double their cost.
                waiting = node.waiting.get(sender)
                if waiting and payload in node.known and network == node.network_id and len(waiting) < MOST_WAITING:
                    waiting.append(heard)
                elif not node.hear(heard):
                    # The waiting beacons of this sender arrived earlier.
                    node.settle_one(sender)
                    node = None
            if node is not None:
                station.beacons_received += 1
                for watcher in station.watchers:
                    watcher.saw(reception.octets, reception.wall, outgoing=False, source=reception.source)
                continue
            self._deliver(station, Delivery(arrival.time, arrival.sender, receiver, reception, arrival.sent))
            if station.hearing is not None:
                station.hearing.handled(beacon)

    def _deliver(self, station: Station, delivery: Delivery) -> None:
        """Process a frame completely at one receiver."""
        station.beacons_received += 1
        reception = delivery.reception
        for watcher in station.watchers:
            watcher.saw(reception.octets, reception.wall, outgoing=False, source=reception.source)
        node = station.node
        if node is None:
            return
        self.delivering = delivery
        try:
            node.handle_frame(reception.octets, now=self.now, wall=reception.wall)
        except Exception as error:  # received octets must never raise: report it, and continue with the other nodes
            self._fail(station, error)
        else:
            self._follow_up(station, node)
        self.delivering = None

    def _guarded(self, station: Station, step: Callable[[Node], None]) -> None:
        """Call ``step`` and execute the effects of the node; stop the node if it raises an exception."""
        node = station.node
        if node is None:
            return
        try:
            step(node)
        except Exception as error:  # as above
            self._fail(station, error)
        else:
            self._follow_up(station, node)

    def _fail(self, station: Station, error: Exception) -> None:
        """Stop a node that raised an exception, and note the exception."""
        log.error("node %d at %.6f s: %s", station.index, self.now / 1e9, error, exc_info=error)
        self.stop(station.index)
        station.failure = f"at {self.now / 1e9:.6f} s: {type(error).__name__}: {error}"

    def _follow_up(self, station: Station, node: Node) -> None:
        """Execute the effects of a node, call listeners, and schedule its next timeout."""
        listeners = self._listeners
        for effect in node.take_effects():
            kind = type(effect)
            if isinstance(effect, SendBeacon):
                self._send(station, effect.octets)
            # Most effects are drops without a listener, so they must be cheap.
            for listener in listeners.get(kind, ()):
                listener(self.now, station.index, effect)
        due = node.poll_timeout()
        if due is not None and due != station.due:
            station.due = due = max(due, self.now)
            self._push(due, station)

    def _send(self, station: Station, octets: bytes) -> None:
        """Broadcast a frame of a node."""
        station.beacons_sent += 1
        station.octets_sent += len(octets)
        for watchers in (self.watchers, station.watchers):
            for watcher in watchers:
                watcher.saw(octets, self.wall, outgoing=True, source=station.link.source)
        self.medium.broadcast(station.index, octets, self.now)

    def _poll(self, station: Station, source: PositionSource) -> None:
        """Submit the current samples of a source to its node, and schedule the next poll."""
        samples = self._sample(station, source)
        if samples:
            self._guarded(station, lambda node: self._submit(node, samples))
        due = source.poll_timeout()
        if due is not None and not source.finished:
            self.at(due, lambda: self._poll(station, source))

    def _sample(self, station: Station, source: PositionSource) -> list[Sample]:
        """Return the current samples of a source.

        In a topology of positions the node moves there, even while it is switched off.
        """
        samples = source.poll(self.now, self.wall)
        for sentence in source.take_complaints():
            log.warning("node %d: %s", station.index, sentence)
        if self._places is not None and samples:
            place = self._fields.place(samples[-1])
            if place is not None:
                self._places.move(station.index, place)
        return samples

    def _submit(self, node: Node, samples: list[Sample]) -> None:
        """Submit samples to SRP; the effects are executed with the next step of the node."""
        if node.srp is not None:
            for sample in samples:
                node.srp.update_safety_data(sample, now=self.now, wall=self.wall)
        node.settle(self.now, self.wall)
