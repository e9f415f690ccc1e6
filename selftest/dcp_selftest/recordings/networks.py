"""Recordings of simulated networks, to test ``dcp-conformance check``.

Applications on all nodes create, update and delete variables at random. Any node can be a mutant or a permitted variant
of the reference node. The recorder receives all beacons, unless the situation defines losses.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, Literal

import msgspec
from dcp_conformance.reference.inprocess import MakeNode, plain_node
from dcp_lab.sim.virtual.network import Network, NetworkStation
from dcp_spec.constants import features

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_stack.config import BPConfig, NodeConfig, SRPConfig, VardisConfig
from dcp_stack.control.client import ServiceError
from dcp_stack.virtual.quality import Quality
from dcp_stack.virtual.topology import Full, Grid, Line, Neighbours, Topology
from dcp_stack.virtual.world import node_id

MS: Final = 1_000_000
SECOND: Final = 1000 * MS
Shape = Literal["bus", "line", "grid", "moving"]

#: Identifiers that applications use.
_VARIABLES = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkSituation:
    """Parameters of a simulated network and its events. Equal parameters give equal recordings."""

    profile: str = "dcp-2.0"
    nodes: int = 5
    shape: Shape = "bus"
    loss: float = 0.0
    """Probability that a reception is lost, independently of others, 0..1."""
    seconds: float = 30.0
    busy: float = 1.0
    """Mean number of service requests per node and second."""
    deletes: float = 0.1
    """Share of the service requests that delete a variable, 0..1."""
    restarts: bool = False
    late: bool = False
    """Whether the last node is switched on after half of the recording."""
    clocks: bool = False
    """Whether the wall clocks of nodes are set, forwards and backwards."""
    recorder_loss: float = 0.0
    """Probability that the recorder misses a beacon, 0..1."""
    recorder_clock: bool = False
    """Whether the recorder's clock is set once during the recording."""
    period_ms: int = 100
    seed: int = 1

    def __str__(self) -> str:
        extras = [name for name in ("restarts", "late", "clocks", "recorder_clock") if getattr(self, name)]
        text = f"{self.profile} {self.shape} of {self.nodes}, loss {self.loss:.0%} (recorder {self.recorder_loss:.0%})"
        return " ".join([f"{text}, busy {self.busy:g}, period {self.period_ms} ms, seed {self.seed}", *extras])


@dataclass(frozen=True, slots=True)
class Other:
    """Describes a node that differs from the reference node, in code or configuration."""

    make: MakeNode = plain_node
    config: Callable[[NodeConfig], NodeConfig] = field(default=lambda config: config)


class _Recorder:
    def __init__(self, network: Network) -> None:
        self.frames: list[Frame] = []
        self._network = network
        self._ether_type = (network.codec.profile.link.ether_type or 0x4953).to_bytes(2, "big")

    def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:
        """Record a transmission, with the time of the recorder's clock."""
        del wall, outgoing
        data = b"\xff" * 6 + source + self._ether_type + octets
        self.frames.append(Frame(len(self.frames) + 1, self._network.wall, data, len(data)))


class _MixedStation(NetworkStation):
    """A station whose node can be replaced."""

    make_node: MakeNode = staticmethod(plain_node)

    def make(self) -> Any:
        return self.make_node(self.config, self.rng, self.world.now, self.wall())


class MixedNetwork(Network):
    """Simulated network in which individual nodes can be replaced. Clocks are set by the offset of a station."""

    def __init__(self, count: int, codec: Codec, others: Mapping[int, Other], **options: Any) -> None:
        """``others``: replaced nodes, by their number from 0. Options as for :class:`Network`."""
        self._others = others
        super().__init__(count, codec, share_decoding=False, **options)

    def station(self, index: int, config: NodeConfig, rng: random.Random) -> NetworkStation:
        """Return a new station, for a replaced node with its own configuration."""
        other = self._others.get(index, Other())
        station = _MixedStation(self, index, other.config(config), rng)
        station.make_node = other.make
        return station

    def ask(self, index: int, method: str, /, **params: Any) -> None:
        """Request a service as an application does. Errors of a faulty node are ignored."""
        with suppress(ServiceError):
            self.request(index, method, **params)


def record(
    situation: NetworkSituation, others: Mapping[int, Other] | None = None, *, codec: Codec | None = None
) -> list[Frame]:
    """Simulate a network and return its recording. ``codec`` replaces the codec of the profile.

    Raises :class:`RuntimeError` if a reference node raises an exception; exceptions of ``others`` are ignored.
    """
    codec = codec or _codec(situation.profile)
    srp = SRPConfig() if codec.profile.srp.record else None
    topology, moves = _topology(situation)
    network = MixedNetwork(
        situation.nodes, codec, others or {}, seed=situation.seed, topology=topology,
        quality=Quality(loss=situation.loss), bp=BPConfig(beacon_period_ms=situation.period_ms), srp=srp,
        vardis=VardisConfig(),
    )  # fmt: skip
    recorder = _Recorder(network)
    network.watchers.append(recorder)
    rng = random.Random(f"traffic/{situation.seed}")  # noqa: S311 - to be repeatable is the point
    end = round(situation.seconds * SECOND)
    for index in range(situation.nodes):
        late = situation.late and index == situation.nodes - 1
        network.at(rng.randrange(300) * MS + (end // 2 if late else 0), partial(network.start, index))
    for index in range(situation.nodes):
        _applications(network, index, rng, situation, end)
        if srp is not None:
            network.at(500 * MS, partial(_move, network, index, rng, end))
    _disturb(network, situation, rng, end)
    for time, move in moves:
        network.at(time, move)
    network.run_until(end)
    for station in network.stations:
        if station.failure and station.index not in (others or {}):
            raise RuntimeError(f"node {station.index} of {situation}: {station.failure}")
    return _as_recorded(recorder.frames, situation)


def _codec(profile: str) -> Codec:
    return Codec(profile)


def _topology(situation: NetworkSituation) -> tuple[Topology, list[tuple[int, Callable[[], None]]]]:
    """Return the connections between nodes, and the times of their changes."""
    match situation.shape:
        case "bus":
            return Full(), []
        case "line":
            return Line(), []
        case "grid":
            return Grid(3), []
        case "moving":
            return _moving(situation)


def _moving(situation: NetworkSituation) -> tuple[Topology, list[tuple[int, Callable[[], None]]]]:
    """Return a topology whose links appear and disappear at random; about half of them exist at any time."""
    rng = random.Random(f"links/{situation.seed}")  # noqa: S311
    nodes = range(situation.nodes)
    there = {(a, b) for a in nodes for b in nodes if a < b and (b == a + 1 or rng.random() < 0.5)}
    topology = Neighbours({a: [b for b in nodes if (min(a, b), max(a, b)) in there] for a in nodes})
    moves: list[tuple[int, Callable[[], None]]] = []
    time = 0.0
    while (time := time + rng.expovariate(0.4)) < situation.seconds:
        a, b = rng.sample(list(nodes), 2)
        pair = (min(a, b), max(a, b))
        change = topology.disconnect if pair in there else topology.connect
        there ^= {pair}

        def move(change: Callable[[int, int], None] = change, a: int = a, b: int = b) -> None:
            change(a, b)
            change(b, a)

        moves.append((round(time * SECOND), move))
    return topology, moves


def _applications(network: MixedNetwork, index: int, rng: random.Random, situation: NetworkSituation, end: int) -> None:
    time = 0
    while (time := time + round(rng.expovariate(situation.busy) * SECOND)) < end - 3 * SECOND:
        network.at(time, lambda: _something(network, index, rng, situation.deletes))


def _something(network: MixedNetwork, index: int, rng: random.Random, deletes: float) -> None:
    """Request a random service; the node may reject the request."""
    if network.stations[index].node is None:
        return
    var_id, value = rng.randrange(_VARIABLES), rng.randbytes(rng.randrange(1, 20)).hex()
    action = rng.random()
    if action < 0.35:
        timeout = rng.choice([0, 0, 0, 2500])
        more = {"timeout": timeout} if features(network.codec.profile.spec_version).creation_time else {}
        network.ask(
            index, "RTDB-Create", varId=var_id, repCnt=rng.randrange(1, 4), descr=f"v{var_id}", value=value, **more
        )
    elif action < 1.0 - deletes:
        network.ask(index, "RTDB-Update", varId=var_id, value=value)
    else:
        network.ask(index, "RTDB-Delete", varId=var_id)


def _move(network: MixedNetwork, index: int, rng: random.Random, end: int) -> None:
    """Submit new safety data every 100 ms."""
    if network.stations[index].node is not None:
        layout = network.codec.profile.srp.safety_data
        data = {each.name: rng.randrange(100) for each in layout if hasattr(each, "type")}
        network.ask(index, "SRP-UpdateSafetyData", sData=data)
    if network.now < end - SECOND:
        network.at(network.now + 100 * MS, lambda: _move(network, index, rng, end))


def _disturb(network: MixedNetwork, situation: NetworkSituation, rng: random.Random, end: int) -> None:
    """Schedule the restarts and clock changes of a situation."""
    for number in range(3 if situation.restarts else 0):
        time, index = round((4 + 5 * number) * SECOND), rng.randrange(situation.nodes)
        network.at(time, partial(network.stop, index))
        network.at(time + rng.randrange(200, 2500) * MS, partial(network.start, index))
    for _ in range(4 if situation.clocks else 0):
        index, offset = rng.randrange(situation.nodes), rng.choice([-86_400, -60, -2, 2, 60, 86_400]) * SECOND

        def set_clock(index: int = index, offset: int = offset) -> None:
            network.stations[index].offset += offset

        network.at(rng.randrange(end), set_clock)


def _as_recorded(frames: Iterable[Frame], situation: NetworkSituation) -> list[Frame]:
    """Return the frames that the recorder receives."""
    rng = random.Random(f"recorder/{situation.seed}")  # noqa: S311
    kept = [frame for frame in frames if rng.random() >= situation.recorder_loss]
    if situation.recorder_clock and kept:
        place, step = rng.randrange(len(kept)), rng.choice([-3600, -5, 5, 3600]) * SECOND
        kept = [
            msgspec.structs.replace(frame, time_ns=frame.time_ns + (step if number >= place else 0))
            for number, frame in enumerate(kept)
        ]
    return [msgspec.structs.replace(frame, number=number) for number, frame in enumerate(kept, 1)]


def identifier(profile: str, index: int) -> bytes:
    """Return the node identifier of a node by its number from 0."""
    return node_id(_codec(profile).profile, index)
