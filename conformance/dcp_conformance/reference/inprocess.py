"""Reference node in this process and in virtual time, with its lower tester, upper tester and control."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from dcp_codec.codec import Codec
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.lower_tester import Arrival, LinkHealth
from dcp_conformance.upper_tester import Answer, Notification
from dcp_conformance.upper_tester.jsonrpc import answer_of, notification_of, request_line
from dcp_stack.config import BPConfig, NodeConfig, SRPConfig
from dcp_stack.control.server import ControlServer
from dcp_stack.effects import Effect, SendBeacon
from dcp_stack.node import Node
from dcp_stack.virtual.world import Station, World

NODE_ID = b"\x02\x00\x00\x00\x00\x01"
ADDRESS = NODE_ID

MakeNode = Callable[[NodeConfig, random.Random, int, int], Any]


def plain_node(config: NodeConfig, rng: random.Random, now: int, wall: int) -> Node:
    """Return an unmodified reference node."""
    return Node(config, rng=rng, now=now, wall=wall)


class InProcess(Station):
    """Runs a node in virtual time. ``make`` creates the node or a mutant of it."""

    def __init__(
        self,
        config: NodeConfig,
        *,
        seed: int = 1,
        make: MakeNode = plain_node,
        now: int = 0,
        world: World | None = None,
    ) -> None:
        """``now``: virtual time in ns at which the node starts. ``world``: None makes one."""
        # A restart does not take the numbers back: intervals between beacons differ from start to start.
        super().__init__(world or World(now=now), config, random.Random(seed))  # noqa: S311 - jitter, no secret
        self._make = make
        self._header = b"\xff" * 6 + ADDRESS + _ether_type(config).to_bytes(2, "big")
        self._sessions: list[VirtualUpperTester] = []
        self.arrivals: deque[Arrival] = deque()
        self.died = ""
        """Exception that ended the node; empty while it runs."""
        self.linked = True
        """Whether the node's link is up."""
        self.switch_on()

    def switch_on(self) -> None:
        """Start a new node, and open all connections again."""
        self.died = ""
        self.arrivals.clear()
        super().switch_on()
        for session in self._sessions:
            session.connect()

    def make(self) -> Any:
        """Return a new node."""
        node = self._make(self.config, self.rng, self.now, self.wall())
        self.server = ControlServer(node)
        return node

    @property
    def now(self) -> int:
        """Virtual ns since the start."""
        return self.world.now

    # -- driving the node --------------------------------------------------------------------------------------

    @property
    def on(self) -> bool:
        """Whether the node runs."""
        return not self.died

    def apply(self, effects: Sequence[Effect]) -> None:
        """Execute effects of the node: send frames, deliver notifications."""
        for effect in effects:
            if isinstance(effect, SendBeacon) and self.linked:
                self.send(effect.octets)
        self.server.indicate(effects, now=self.now, wall=self.wall())

    def send(self, octets: bytes) -> None:
        """Transmit a beacon of the node; the tester receives it at once."""
        self.arrivals.append(Arrival(self.now, self.world.wall, octets, self._header + octets, ADDRESS))

    def fail(self, error: Exception) -> None:
        """Note the exception that ended the node."""
        self.died = f"{type(error).__name__}: {error}"
        self.arrivals.clear()

    def deliver(self, octets: bytes) -> None:
        """Deliver a frame to the node, if its link is up."""
        if self.linked:
            self.guarded(self.node.handle_frame, octets, now=self.now, wall=self.wall())

    def advance(self, until: int) -> None:
        """Advance the time until a frame arrives at the tester, at most to ``until`` (ns)."""
        if not self.arrivals:
            self.world.run_until(until, stop=lambda: bool(self.arrivals))

    def elapse(self, duration: int) -> None:
        """Advance the time by this duration (ns). Frames that arrive at the tester are kept."""
        self.world.run_until(self.now + duration)

    # -- SutControl --------------------------------------------------------------------------------------------

    can_restart = True

    def alive(self) -> bool:
        """Whether the node runs."""
        return not self.died

    def why_dead(self) -> str:
        """Return the exception that ended the node."""
        return self.died

    def switch_link(self, up: bool) -> None:
        """Switch the node's link on or off; while it is off, no frames pass in either direction."""
        self.linked = up

    def restart(self) -> None:
        """Replace the node by a new one, and open all connections again."""
        self.switch_on()

    def close(self) -> None:
        """Has no effect: there are no resources to release."""

    def lower_tester(self) -> VirtualLowerTester:
        """Return a lower tester for the node."""
        return VirtualLowerTester(self)

    def upper_tester(self) -> VirtualUpperTester:
        """Return a connection to the node's services."""
        return VirtualUpperTester(self)

    def register(self, session: VirtualUpperTester) -> None:
        """Add a connection that is opened again after a restart."""
        self._sessions.append(session)

    def unregister(self, session: VirtualUpperTester) -> None:
        """Remove a connection that was closed."""
        if session in self._sessions:
            self._sessions.remove(session)


class VirtualLowerTester:
    """Lower tester for a node in process, without loss and delay."""

    name = "in process"

    def __init__(self, sut: InProcess) -> None:
        self._sut = sut
        self._world = sut.world

    def now(self) -> int:
        """Return virtual ns since the start."""
        return self._world.now

    def wall(self) -> int:
        """Return virtual ns since 1970."""
        return self._world.wall

    def framed(self, octets: bytes, source: bytes) -> bytes:
        """Return the broadcast frame of a bearer payload."""
        return b"\xff" * 6 + source + _ether_type(self._sut.config).to_bytes(2, "big") + octets

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Deliver a beacon to the node at once."""
        self._sut.deliver(octets)
        return self.framed(octets, source)

    def send_frame(self, frame: bytes) -> None:
        """Deliver the payload of a frame to the node, if EtherType and destination match."""
        if frame[:6] == b"\xff" * 6 and int.from_bytes(frame[12:14], "big") == _ether_type(self._sut.config):
            self._sut.deliver(frame[14:])

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:  # noqa: ARG002 - nothing to wait on
        """Return the next beacon of the node."""
        if not self._sut.arrivals:
            self._sut.advance(until)
        return self._sut.arrivals.popleft() if self._sut.arrivals else None

    def take_in(self) -> None:
        """Has no effect: the queue of received frames is not limited."""

    def health(self) -> LinkHealth:
        """Return that no frames were lost."""
        return LinkHealth()

    def close(self) -> None:
        """Has no effect: there are no resources to release."""


class VirtualUpperTester:
    """Connection to the services of a node in process, with the same messages as over a socket."""

    def __init__(self, sut: InProcess, *, greet: bool = True) -> None:
        """``greet``: call UT-Hello at once; otherwise the methods are unknown."""
        self.name = "in process"
        self._sut = sut
        self._last_id = 0
        self._waiting: list[Notification] = []
        sut.register(self)
        self.connect()
        self.about: dict[str, Any] = {}
        self.methods: frozenset[str] = frozenset({"UT-Hello"})
        if greet:
            self.about = self.call("UT-Hello", {}).result
            self.methods = frozenset(self.about.get("methods", ()))

    def connect(self) -> None:
        """Open the connection; also called after a restart of the node."""
        self._session = self._sut.server.open()

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a method; no virtual time passes."""
        self._last_id += 1
        sut, line = self._sut, request_line(self._last_id, method, params)
        answers = bytearray()

        def step() -> None:
            answers.extend(self._session.feed(line, now=sut.now, wall=sut.wall()))

        sut.guarded(step)
        answer: Answer | None = None
        for each in bytes(answers).splitlines():
            message = msgspec.json.decode(each)
            if "method" in message:
                self._waiting.append(notification_of(message, sut.now))
            else:
                answer = answer_of(message)
        if sut.died or answer is None:
            raise UpperTesterError(f"{method}: the node has closed the connection")
        return answer

    def poll(self) -> list[Notification]:
        """Return the notifications received so far."""
        output = bytes(self._session.output)
        if output:
            self._session.sent(len(output))
            self._waiting += [notification_of(msgspec.json.decode(line), self._sut.now) for line in output.splitlines()]
        taken, self._waiting = self._waiting, []
        return taken

    def filenos(self) -> tuple[int, ...]:
        """Return no descriptors: nothing is received from outside."""
        return ()

    def another(self) -> VirtualUpperTester:
        """Return another connection to the same node."""
        return VirtualUpperTester(self._sut)

    def close(self) -> None:
        """Close the connection."""
        self._sut.unregister(self)
        self._sut.server.forget(self._session)


def _ether_type(config: NodeConfig) -> int:
    return config.profile.link.ether_type or 0x4953


def reference_config(codec: Codec, *, beacon_period_ms: int = 100, node_id: bytes | None = None) -> NodeConfig:
    """Return the default SUT of the suite: a reference node with all features and default settings.

    Without ``node_id`` the node has :data:`NODE_ID`, or 1 if the identifiers of the profile have another width.
    """
    layout = codec.profile.types.node_id
    if node_id is None:
        standard = layout.length is not None or layout.width == len(NODE_ID)
        node_id = NODE_ID if standard else (1).to_bytes(layout.width, "big")
    if layout.representation == "text" and len(node_id) == len(NODE_ID):
        node_id = node_id.hex(":").encode()
    bp = BPConfig(beacon_period_ms=beacon_period_ms)
    return NodeConfig(node_id=node_id, codec=codec, bp=bp, srp=SRPConfig() if codec.profile.srp.is_report else None)
