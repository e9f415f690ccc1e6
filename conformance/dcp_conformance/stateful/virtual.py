"""Execute sequences on a node of this process, in virtual time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec

from dcp_conformance.oracle.judgement import MS, Timing
from dcp_conformance.reference.inprocess import InProcess, MakeNode, VirtualUpperTester, plain_node
from dcp_conformance.upper_tester import Answer
from dcp_stack.config import NodeConfig

from .executor import TWIN, Event, special, twin
from .steps import EPOCH, OWN

#: Identifiers in which counters, signs and table indices are likely to fail, then the others.
_EDGES: Final = (1, 0, 127, 128, 255, 2)
#: Identifiers that are equal in one octet, or in the same octets in another order.
_PROTOCOLS: Final = (0x4001, 0x0101, 0xFFFF, 0x0003, 0x0140, 0x4002)
_HOUR_NS: Final = 3_600_000_000_000


class VirtualNames:
    """Names for a node that has just started."""

    def __init__(self, sut: InProcess) -> None:
        profile = sut.config.profile
        self._profile = profile
        self._own_id = sut.config.node_id
        top = (1 << 8 * min(profile.types.var_id.width, 2)) - 1
        edges = [*_EDGES, top] if top > 255 else list(_EDGES)
        taken = set(edges)
        self._variables = edges + [each for each in range(min(top + 1, 600)) if each not in taken]
        stamp = profile.types.timestamp
        self._unit = stamp.per_second
        since = sut.now if stamp.epoch_ns is None else sut.wall() - stamp.epoch_ns
        self._base = since * stamp.per_second // 1_000_000_000

    def protocol(self, number: int) -> int:
        """Return a protocol identifier."""
        return _PROTOCOLS[number % len(_PROTOCOLS)]

    def variable(self, number: int) -> int:
        """Return an identifier of a variable."""
        return self._variables[number % len(self._variables)]

    def neighbour(self, number: int) -> tuple[bytes, bytes]:
        """Return node identifier and address of a neighbour."""
        if number < OWN:
            node_id, address = named(self._profile, -number)
            return special(node_id, number) if node_id == address else node_id, address
        return twin(self._own_id) if number == TWIN and len(self._own_id) == 6 else named(self._profile, number)

    def creation(self, number: int) -> int:
        """Return a creation time in ticks."""
        if number == EPOCH:
            return 0
        ahead = _HOUR_NS * self._unit // 1_000_000_000 if number >= 8 else 0
        return self._base + ahead + max(1, self._unit // 1000) * number


def named(profile: Any, number: int) -> tuple[bytes, bytes]:
    """Return identifier and address of a neighbour; 0 and 1 are equal in their last octets."""
    group, place = divmod(number, 2)
    address = bytes((0x02, 0xDC, 0x10 + place)) + (0x0A0000 + group).to_bytes(3, "big")
    layout = profile.types.node_id
    if layout.representation == "text":
        return address.hex(":").encode(), address
    if layout.width == len(address):
        return address, address
    return (number + 2).to_bytes(layout.width, "big"), address


class VirtualExecutor:
    """A new reference node, or a mutant of it, for each sequence."""

    alone = True
    looks = True
    crowds = 256
    lossy_services = False
    confirms = True

    def __init__(
        self,
        config: NodeConfig,
        *,
        make: MakeNode = plain_node,
        seed: int = 1,
        timing: Timing | None = None,
        readings: Mapping[str, str] | None = None,
    ) -> None:
        """``timing``: None for a node that reacts at once."""
        self.codec = config.codec
        period = config.bp.beacon_period_ms * MS
        self.timing = timing or Timing(period=period, patience=12 * period, clock=5 * MS, whole=True)
        self.readings = msgspec.to_builtins(config.selected_readings) if readings is None else readings
        self._sut = InProcess(config, seed=seed, make=make)
        self._upper = VirtualUpperTester(self._sut)
        self.methods = self._upper.methods
        self.own_id = config.node_id
        self.hears_vardis = config.vardis is not None
        self.names = VirtualNames(self._sut)

    def parameters(self) -> dict[str, Any]:
        """Return the values of all parameters."""
        found: dict[str, Any] = {}
        for name in ("BP-GetParameters", "SRP-GetParameters", "VD-GetParameters"):
            if name in self.methods:
                found |= self._upper.call(name, {}).result.get("parameters", {})
        return found

    def now(self) -> int:
        """Return virtual ns."""
        return self._sut.now

    def wall(self) -> int:
        """Return virtual ns since 1970."""
        return self._sut.wall()

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a service."""
        return self._upper.call(method, params)

    def send(self, octets: bytes, source: bytes, blocks: int) -> None:  # noqa: ARG002
        """Deliver a beacon to the node."""
        self._sut.deliver(octets)

    def wait(self, duration: int) -> list[Event]:
        """Let virtual time pass."""
        sut, events = self._sut, []
        until = sut.now + duration
        while True:
            sut.advance(until)
            while sut.arrivals:
                arrival = sut.arrivals.popleft()
                events.append(Event(arrival.time, arrival.octets))
            if sut.died:
                break
            events += [Event(each.time, b"", each.method, each.params) for each in self._upper.poll()]
            if sut.now >= until:
                break
        return events

    def died(self) -> str:
        """Return the exception that ended the node."""
        return self._sut.died


__all__ = ["VirtualExecutor", "VirtualNames", "named"]
