"""Nodes on a simulated medium, in virtual time. One loop processes all events, in the same order for the same seed."""

from __future__ import annotations

import logging
import random
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import msgspec

from dcp_codec.codec import Codec
from dcp_codec.common.garbage import few_collections
from dcp_lab.sim.scenario.requests import answer
from dcp_stack.config import BPConfig, NodeConfig, SRPConfig, VardisConfig
from dcp_stack.effects import Effect, NeighbourExpired, SendBeacon, VariableChanged
from dcp_stack.links.base import Watcher
from dcp_stack.node import Node
from dcp_stack.positions.base import PositionSource, Sample
from dcp_stack.positions.fields import SafetyFields
from dcp_stack.positions.tracks import Track
from dcp_stack.virtual.medium import Arrival, SimulatedMedium, TraceDigest
from dcp_stack.virtual.quality import PERFECT, Quality
from dcp_stack.virtual.radio import Radio, RadioMedium
from dcp_stack.virtual.topology import Positions, Topology
from dcp_stack.virtual.world import Station, World, node_id

from .hearing import HearingNode, Parsed, Parser, ReceivedBeacon
from .sharing import SharedCodec

log = logging.getLogger(__name__)

T = TypeVar("T")
Listener = Callable[[int, int, Any], None]
"""A function that is called with the virtual time in ns, the number of the node, and the effect."""


class NetworkStation(Station):
    """One node of the network. It has the fast path for known beacons unless the network has plain nodes."""

    def __init__(self, network: Network, index: int, config: NodeConfig, rng: random.Random) -> None:
        """Initialise a station that is switched off. Only :class:`Network` creates stations."""
        super().__init__(network, config, rng)
        self.index = index
        self.network = network
        self.address = b"\x02\x00" + index.to_bytes(4, "big")
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

    def make(self) -> Node:
        """Return a new node."""
        kind = HearingNode if self.network.parse is not None else Node
        return kind(self.config, rng=self.rng, now=self.world.now, wall=self.wall())

    def switch_on(self) -> None:
        """Switch the node on now, with empty memory. No effect if it is already on."""
        if self.node is not None:
            return
        self.network.medium.switch(self.index, up=True)
        self.up_since = self.world.now
        super().switch_on()
        if isinstance(self.node, HearingNode):
            self.hearing = self.node
            self.hearing.look()

    def switch_off(self) -> None:
        """Switch the node off now, without any further message."""
        super().switch_off()
        self.hearing = self.up_since = None
        self.network.medium.switch(self.index, up=False)

    def fail(self, error: Exception) -> None:
        """Switch off a node that raised an exception, and note the exception."""
        log.error("node %d at %.6f s: %s", self.index, self.world.now / 1e9, error, exc_info=error)
        self.switch_off()
        self.failure = f"at {self.world.now / 1e9:.6f} s: {type(error).__name__}: {error}"

    def wake(self) -> None:
        """Submit the samples of tracks if a beacon is due, and process the timeouts of the node."""
        self.guarded(self._timeout, self.node, self.world.now, self.wall())

    def _timeout(self, node: Node, now: int, wall: int) -> None:
        if self.tracks:
            beacon = node.bp.poll_timeout()
            if beacon is not None and beacon <= now:
                for track in self.tracks:
                    self.submit(self.sample(track))
        node.handle_timeout(now, wall)

    def apply(self, effects: Sequence[Effect]) -> None:
        """Broadcast beacons, and call the listeners of the network."""
        listeners, now = self.network.listeners, self.world.now
        for effect in effects:
            if isinstance(effect, SendBeacon):
                self._send(effect.octets)
            # Most effects are drops without a listener, so they must be cheap.
            for listener in listeners.get(type(effect), ()):
                listener(now, self.index, effect)

    def _send(self, octets: bytes) -> None:
        """Broadcast a frame."""
        self.beacons_sent += 1
        self.octets_sent += len(octets)
        for watchers in (self.network.watchers, self.watchers):
            for watcher in watchers:
                watcher.saw(octets, self.world.wall, outgoing=True, source=self.address)
        self.network.medium.broadcast(self.index, octets, self.world.now)

    def show(self, arrival: Arrival) -> None:
        """Show a received frame to the watchers."""
        source = self.network.stations[arrival.sender].address
        for watcher in self.watchers:
            watcher.saw(arrival.octets, self.world.wall, outgoing=False, source=source)

    def deliver(self, arrival: Arrival) -> None:
        """Process a frame completely."""
        self.beacons_received += 1
        self.show(arrival)
        if self.node is not None:
            self.guarded(self.node.handle_frame, arrival.octets, now=self.world.now, wall=self.wall())

    def poll(self, source: PositionSource) -> None:
        """Submit the current samples of a source to the node, and schedule the next poll."""
        samples = self.sample(source)
        if samples:
            self.guarded(self.submit, samples)
        due = source.poll_timeout()
        if due is not None and not source.finished:
            self.world.at(due, lambda: self.poll(source))

    def sample(self, source: PositionSource) -> list[Sample]:
        """Return the current samples of a source; the station moves there, also while it is switched off."""
        samples = source.poll(self.world.now, self.world.wall)
        for sentence in source.take_complaints():
            log.warning("node %d: %s", self.index, sentence)
        if samples:
            self.network.move(self.index, samples[-1])
        return samples

    def submit(self, samples: list[Sample]) -> None:
        """Submit samples to SRP; the effects are carried out with the current step of the node."""
        now, wall = self.world.now, self.wall()
        if self.node.srp is not None:
            for sample in samples:
                self.node.srp.update_safety_data(sample, now=now, wall=wall)
        self.node.settle(now, wall)


class Network(World):
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
        radio: Radio | None = None,
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
        self.digest = TraceDigest()
        self.medium: SimulatedMedium
        if radio is None:
            self.medium = SimulatedMedium(count, quality, seed=seed, topology=topology, observer=self.digest)
        else:
            self.medium = RadioMedium(count, radio, quality, seed=seed, topology=topology, observer=self.digest)
        super().__init__(self.medium, self.arrive)
        self._places = topology if isinstance(topology, Positions) else None
        self._fields = SafetyFields(codec.profile)
        self.codec: Codec = SharedCodec(codec) if share_decoding else codec
        self.listeners: dict[type[Effect], list[Listener]] = {}
        """Functions by the kind of effect; see :meth:`listen`."""
        self.watchers: list[Watcher] = []
        """Watchers of the medium; each gets every transmission once."""
        self.parse: Callable[[bytes], Parsed | None] | None = None
        """The parser of the fast path; None: nodes are plain."""
        self.delivering: Arrival | None = None
        """The frame that causes the effects of the current calls of listeners; None for services and timers."""
        self.stations: list[NetworkStation] = []
        for index in range(count):
            config = NodeConfig(
                node_id=node_id(codec.profile, index),
                codec=self.codec,
                bp=bp or BPConfig(),
                srp=srp,
                vardis=vardis,
                readings=readings or {},
            )
            rng = random.Random(f"{seed}/node/{index}")  # noqa: S311 - runs have to be repeatable
            self.stations.append(self.station(index, config, rng))
            self.medium.switch(index, up=False)
        if share_decoding and self.stations:
            plain = msgspec.structs.replace(self.stations[0].config, codec=codec)
            self.parse = Parser(plain, self.codec).parse

    def station(self, index: int, config: NodeConfig, rng: random.Random) -> NetworkStation:
        """Return a new station."""
        return NetworkStation(self, index, config, rng)

    def __len__(self) -> int:
        return len(self.stations)

    # -- nodes ---------------------------------------------------------------------------------------------------------

    def node(self, index: int) -> Node:
        """Return a node by its number. Raises LookupError while it is switched off."""
        node: Node | None = self.stations[index].node
        if node is None:
            raise LookupError(f"node {index} is switched off")
        return node

    def start(self, index: int) -> None:
        """Switch a node on now, with empty memory. No effect if it is already on."""
        self.stations[index].switch_on()

    def stop(self, index: int) -> None:
        """Switch a node off now, without any further message, as when its battery is empty."""
        self.stations[index].switch_off()

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
            self.at(self.now, lambda: station.poll(source))

    def move(self, index: int, sample: Sample) -> None:
        """Move a node to the position of a sample, in a topology of :class:`Positions`."""
        place = None if self._places is None else self._fields.place(sample)
        if self._places is not None and place is not None:
            self._places.move(index, place)

    def call(self, index: int, service: Callable[[Node, int, int], T]) -> T:
        """Call ``service(node, now, wall)``, execute the effects at that node, and return the result of the service.

        Raises LookupError while the node is switched off.
        """
        node, station = self.node(index), self.stations[index]
        answer = service(node, self.now, station.wall())
        station.guarded(node.settle, self.now, station.wall())
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
        self.listeners.setdefault(kind, []).append(listener)
        if kind not in (VariableChanged, NeighbourExpired, SendBeacon):
            self.parse = None
            for station in self.stations:
                if station.hearing is not None:
                    station.hearing.forget_all()
                    station.hearing.ready = False
                    station.hearing = None

    # -- time ----------------------------------------------------------------------------------------------------------

    def run_until(self, end: int, *, stop: Callable[[], bool] | None = None) -> bool:
        """Let virtual time pass as :meth:`World.run_until` does."""
        with few_collections():
            return super().run_until(end, stop=stop)

    def close(self) -> None:
        """Close the position sources."""
        for station in self.stations:
            for source in station.sources:
                source.close()

    def arrive(self, arrival: Arrival) -> None:
        """Process a frame at all its receivers, on the fast path where possible."""
        stations, octets = self.stations, arrival.octets
        beacon = self.parse(octets) if self.parse is not None else None
        if beacon is None:
            self.delivering = arrival
            for receiver in arrival.receivers:
                station = stations[receiver]
                if station.hearing is not None:
                    # The frame may contain a request; the node then has to process the sender's next beacon completely.
                    station.hearing.forget_all()
                station.deliver(arrival)
            self.delivering = None
            return
        now, wall = self.now, self.wall
        heard = ReceivedBeacon(beacon, now, wall)
        self.delivering = arrival
        for receiver in arrival.receivers:
            station = stations[receiver]
            node = station.hearing
            if node is not None:
                offset = station.offset
                try:
                    effects = node.hear(ReceivedBeacon(beacon, now, wall + offset) if offset else heard)
                    # Updates and summaries change no timer.
                    if effects:
                        station.apply(effects)
                except Exception as error:  # the other stations continue
                    station.fail(error)
                    continue
                if effects is not None:
                    station.beacons_received += 1
                    if station.watchers:
                        station.show(arrival)
                    continue
                # The waiting beacons of this sender arrived earlier.
                node.settle_one(beacon.sender_id)
            station.deliver(arrival)
            if station.hearing is not None:
                station.hearing.handled(beacon)
        self.delivering = None
