"""The virtual Ethernet of a testbed: bridges and veth pairs in network namespaces.

A node has one interface, ``dcp0``. A broadcast there reaches exactly the node's neighbours:

* On a bus ``dcp0`` is one end of a veth pair, and the other ends are ports of one bridge. If single links have their
  own quality, a bus is built like the other topologies.
* In any other topology ``dcp0`` is a bridge of the node, with a veth pair to the bridge of each neighbour. All ports
  are *isolated*: the kernel does not forward frames between them, so the node receives the frames of its neighbours,
  and its own frames leave through all ports. One interface per neighbour would not be a broadcast medium: a node would
  send each beacon several times. One common bridge with isolated ports would separate all nodes from all others.

As a result each direction between two nodes (on a bus each receiver) has its own queue, where tc can lose and delay
frames.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Protocol

from dcp_codec.network.namespaces import NamespaceError, batch, run
from dcp_lab.sim.scenario.definition import PERFECT, LinkQuality, Scenario, ScenarioError, SetLink

from .namespaces import create
from .place import INTERFACE, cable_to_hub, place_names


class Air(Protocol):
    """The links of a testbed."""

    @property
    def namespaces(self) -> Sequence[str]:
        """The namespaces of the nodes, each with an interface :data:`INTERFACE`."""
        ...

    def set_quality(self, direction: tuple[int, int] | None, quality: LinkQuality) -> None:
        """Change the quality from one node to another, or (None) of all links that have none of their own."""
        ...

    def partition(self, groups: Sequence[Sequence[int]]) -> None:
        """Restrict frames to the groups; nodes in no group form another one. Without groups the partition ends."""
        ...

    def close(self) -> None:
        """End the program that carries frames; the namespaces remain."""
        ...


MakeAir = Callable[[Scenario, str, Sequence[bytes]], Air]
"""Builds the links of a scenario, with the prefix of its namespaces and the addresses of its interfaces."""

_BRIDGE = "type bridge stp_state 0 mcast_snooping 0"
_SINK = "sink"


class Fabric:
    """The virtual Ethernet of one scenario."""

    def __init__(self, scenario: Scenario, prefix: str, addresses: Sequence[bytes]) -> None:
        """Create namespaces, interfaces and bridges. ``addresses``: MAC addresses of the nodes' interfaces.

        Raises NamespaceError if a command fails, ScenarioError for a link quality that this machine cannot provide.
        """
        self._count = scenario.nodes
        # A port of one common bridge carries the frames of all senders: a quality of single links needs a veth pair
        # for each pair of nodes.
        single = any(isinstance(event, SetLink) and event.sender is not None for event in scenario.events)
        self._bus = scenario.topology.kind == "full" and not scenario.links and not single
        self._pairs = scenario.topology.pairs(scenario.nodes)
        self.namespaces = place_names(prefix, self._count)
        self._ether = f"{prefix}-bus"
        self._bridges = 1
        self._own: set[tuple[int, int]] = set()
        self._shaper = Shaper()
        create([*self.namespaces, self._ether] if self._bus else self.namespaces)
        if self._bus:
            batch("ip", self._ether, _bridge_lines("bus0"))
            cable_to_hub(self._ether, self.namespaces, addresses, bridge="bus0")
        else:
            self._build_cables(addresses)
        self.set_quality(None, scenario.link)
        for link in scenario.links:
            for direction in link.directions:
                self.set_quality(direction, link.quality)

    def set_quality(self, direction: tuple[int, int] | None, quality: LinkQuality) -> None:
        """Set the quality of one direction (sender, receiver), or with None of all directions without their own.

        Raises ScenarioError for one direction of a bus, or for a quality that this machine cannot provide.
        """
        if direction is not None:
            if self._bus:
                raise ScenarioError(
                    "on a bus, a single link cannot get its own quality; list the link in [[links]] from the start"
                )
            self._own.add(direction)
            self._shape(direction, quality)
            return
        if self._bus:
            for node in range(self._count):
                self._shaper.shape(self._ether, f"p{node}", quality)
            return
        for pair in self._pairs:
            for each in (pair, pair[::-1]):
                if each not in self._own:
                    self._shape(each, quality)

    def close(self) -> None:
        """Do nothing: the interfaces are removed with their namespaces."""

    def partition(self, groups: Sequence[Sequence[int]]) -> None:
        """Restrict frames to the groups; nodes in no group form another one. Without groups the partition ends."""
        member = {node: number for number, group in enumerate(groups, start=1) for node in group}
        if self._bus:
            new = range(self._bridges, len(groups) + 1)
            batch("ip", self._ether, [line for number in new for line in _bridge_lines(f"bus{number}")])
            self._bridges = max(self._bridges, len(groups) + 1)
            ports = [f"link set p{node} master bus{member.get(node, 0)}" for node in range(self._count)]
            batch("ip", self._ether, ports)
            return
        lines: dict[int, list[str]] = defaultdict(list)
        for a, b in self._pairs:
            state = "up" if member.get(a, 0) == member.get(b, 0) else "down"
            # It suffices to set one end down: the other end loses its carrier.
            lines[a].append(f"link set to{b} {state}")
        for node, commands in lines.items():
            batch("ip", self.namespaces[node], commands)

    def _build_cables(self, addresses: Sequence[bytes]) -> None:
        """Create a bridge for each node, with a veth pair for each pair of neighbours."""
        for name, address in zip(self.namespaces, addresses, strict=True):
            batch("ip", name, _bridge_lines(INTERFACE, f"address {address[:6].hex(':')} "))
        ports: dict[int, list[str]] = defaultdict(list)
        for a, b in self._pairs:
            cable = f"link add to{b} type veth peer name to{a} netns {self.namespaces[b]}"
            run(["ip", "-n", self.namespaces[a], *cable.split()])
            ports[a].append(f"to{b}")
            ports[b].append(f"to{a}")
        for node, names in ports.items():
            up = [f"link set {name} addrgenmode none master {INTERFACE} up" for name in names]
            batch("ip", self.namespaces[node], up)
            isolate = [f"link set dev {name} isolated on learning off" for name in names]
            batch("bridge", self.namespaces[node], isolate)

    def _shape(self, direction: tuple[int, int], quality: LinkQuality) -> None:
        """Set the quality of a direction, if the topology has this connection."""
        sender, receiver = direction
        if (min(direction), max(direction)) in self._pairs:
            self._shaper.shape(self.namespaces[sender], f"to{receiver}", quality)


def _bridge_lines(name: str, address: str = "") -> list[str]:
    """Return the commands of ``ip`` that create a bridge."""
    return [f"link add {name} {address}{_BRIDGE}", f"link set {name} addrgenmode none up"]


class Shaper:
    """Applies the quality of a connection to the frames that leave an interface, by means of tc.

    netem provides all of it. A kernel without the module sch_netem can still lose frames: a classifier draws a random
    number for each frame, and redirects the lost ones to an interface without a receiver.
    """

    def __init__(self) -> None:
        self._shaped: set[tuple[str, str]] = set()
        self._sinks: set[str] = set()
        self._netem: bool | None = None

    def shape(self, namespace: str, interface: str, quality: LinkQuality) -> None:
        """Set the quality of an interface. Raises ScenarioError if this machine cannot provide it."""
        if (namespace, interface) in self._shaped:
            kind = "root" if self._netem else "clsact"
            run(["tc", "-n", namespace, "qdisc", "delete", "dev", interface, kind])
            self._shaped.remove((namespace, interface))
        if quality == PERFECT or quality == LinkQuality(reorder_delay_ms=quality.reorder_delay_ms):
            return
        if self._netem is None or self._netem:
            self._netem = self._with_netem(namespace, interface, quality)
        if not self._netem:
            self._with_classifier(namespace, interface, quality)
        self._shaped.add((namespace, interface))

    def _with_netem(self, namespace: str, interface: str, quality: LinkQuality) -> bool:
        """Set the quality by netem; returns False if the kernel does not have it."""
        command = f"tc -n {namespace} qdisc add dev {interface} root netem {netem_options(quality)}"
        try:
            run(command.split())
        except NamespaceError as error:
            if "unknown" in str(error) or "No such file" in str(error):
                return False
            raise
        return True

    def _with_classifier(self, namespace: str, interface: str, quality: LinkQuality) -> None:
        """Set the loss by a classifier. Raises ScenarioError for any other quality, or without cls_bpf."""
        if quality != LinkQuality(loss=quality.loss, reorder_delay_ms=quality.reorder_delay_ms):
            raise ScenarioError(
                "this kernel lacks netem (module sch_netem); without it the kernel can lose frames, but cannot delay, "
                "duplicate or reorder them. Load the module, or use --links relay"
            )
        if namespace not in self._sinks:
            lines = [f"link add {_SINK} type veth peer name drain"]
            lines += [f"link set {name} addrgenmode none up" for name in (_SINK, "drain")]
            batch("ip", namespace, lines)
            self._sinks.add(namespace)
        try:
            run(["tc", "-n", namespace, "qdisc", "add", "dev", interface, "clsact"])
            match = ["protocol", "all", "bpf", "bytecode", chance(quality.loss)]
            redirect = ["action", "mirred", "egress", "redirect", "dev", _SINK]
            run(["tc", "-n", namespace, "filter", "add", "dev", interface, "egress", *match, *redirect])
        except NamespaceError as error:
            raise ScenarioError(f"this kernel can lose frames neither by netem nor by cls_bpf: {error}") from None


def netem_options(quality: LinkQuality) -> str:
    """Return a quality as options of netem. Raises ScenarioError for a combination that netem cannot provide."""
    if quality.quality().has_memory:
        raise ScenarioError("the kernel cannot lose frames in bursts or corrupt them here; use --links relay")
    # netem draws from delay - jitter to delay + jitter, a scenario from delay to delay + jitter.
    half = quality.jitter_ms / 2
    options = [f"delay {quality.delay_ms + half:.3f}ms {half:.3f}ms"] if quality.delay_ms or half else []
    if quality.reorder:
        if options:
            raise ScenarioError("in a testbed, reorder cannot be combined with delay_ms or jitter_ms")
        # Reversed: netem sends the given share at once, and delays the rest.
        options = [f"delay {quality.reorder_delay_ms:.3f}ms", f"reorder {(1 - quality.reorder) * 100:.4f}%"]
    if quality.loss:
        options.append(f"loss {quality.loss * 100:.4f}%")
    if quality.duplicate:
        options.append(f"duplicate {quality.duplicate * 100:.4f}%")
    return " ".join(options)


def chance(probability: float) -> str:
    """Return a classic BPF program for tc that matches frames with this probability."""
    if probability >= 1:
        return "1,6 0 0 4294967295,"
    threshold = round(probability * (1 << 32))
    # Load a random number (SKF_AD_OFF + SKF_AD_RANDOM); at least the threshold: no match (0), below it: match (-1).
    return f"4,32 0 0 {0xFFFFF000 + 56},53 0 1 {min(threshold, 0xFFFFFFFF)},6 0 0 0,6 0 0 4294967295,"
