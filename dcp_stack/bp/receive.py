"""The receive path of an active BP entity (dcp-bp.md, "Receive Path"; C.6 of the protocol reference)."""

from __future__ import annotations

from collections.abc import Callable

from dcp_codec.values import BPHeader
from dcp_stack.drops import DROPS
from dcp_stack.effects import Dropped, Effect, PayloadReceived
from dcp_stack.readings import Readings

from .clients import ClientList
from .parameters import BPParameters
from .statistics import Counters, LossTable
from .wire import Block, BPWire, Fault


class Receiver:
    """The receive path of one entity. All ignored octets are counted and emitted as ``Dropped``."""

    def __init__(
        self,
        wire: BPWire,
        clients: ClientList,
        parameters: BPParameters,
        *,
        node_id: bytes,
        counters: Counters,
        losses: LossTable,
        readings: Readings,
        emit: Callable[[Effect], None],
    ) -> None:
        self._wire = wire
        self._clients = clients
        self._parameters = parameters
        self._node_id = node_id
        self._counters = counters
        self._losses = losses
        self._emit = emit
        self._ignores_empty = readings.empty_block == "ignore-empty"
        self._discards_miscounted = readings.miscounted_blocks == "discard-beacon" and wire.count_tells
        self._discards_larger = readings.oversized_payload == "discard-larger"

    def receive(self, octets: bytes, now: int) -> None:
        """Deliver the blocks of a bearer payload to the clients that are registered for them. Never raises."""
        found = self._wire.parse(octets)
        if found.refused and found.fault is not None:
            self._faulty(found.fault)
            return
        if found.header is not None and not self._for_this_node(found.header):
            return
        sender = b"" if found.header is None else found.header.sender_id
        if found.fault is not None and found.fault.reason == "beacon-overrun":
            self._faulty(found.fault)
            return
        self._counters.count("beacons-received")
        if not found.count_agrees:
            self._counters.count("beacons-with-other-count")
        ##= BP-RX-12
        if self._discards_miscounted and (not found.count_agrees or found.fault is not None):
            self.drop("other-count", self._wire.offset("numPayloads"))
            return
        ##= BP-RX-10 BP-RX-11
        if found.header is not None:
            self._losses.record(sender, found.header.seqno, now)
        ##= BP-RX-07
        for block in found.blocks:
            self._deliver(block, sender)
        if found.fault is not None:
            self._faulty(found.fault)

    def _for_this_node(self, header: BPHeader) -> bool:
        ##= BP-RX-05
        network = self._parameters.network_id
        if network is not None and header.network_id != network:
            self.drop("foreign-network", self._wire.offset("networkId"))
            return False
        ##= BP-RX-06
        if header.sender_id == self._node_id:
            self.drop("own-beacon", self._wire.offset("senderId"))
            return False
        return True

    def _deliver(self, block: Block, sender: bytes) -> None:
        ##= BP-RX-08 BP-RXP-03 BP-LST-05
        client = self._clients.get(block.protocol_id)
        if client is None:
            self.drop("unregistered-protocol", block.offset)
            return
        if not block.payload and self._ignores_empty:
            self.drop("empty-payload", block.offset)
            return
        if self._discards_larger and len(block.payload) > client.registration.max_payload_size:
            self.drop("larger-than-registered", block.offset)
            return
        self._counters.count(f"payloads-received/{block.protocol_id}")
        ##= BP-RXP-01 BP-RXP-02
        self._emit(PayloadReceived(block.protocol_id, block.payload, sender))

    def drop(self, reason: str, offset: int = -1) -> None:
        """Count and emit that well-formed octets are ignored, for a reason of ``dcp_stack.drops``."""
        self._faulty(Fault(reason, DROPS[reason][0], offset))

    def _faulty(self, fault: Fault) -> None:
        self._counters.count(f"drops/{fault.reason}")
        self._emit(Dropped("bp", fault.reason, fault.requirement, fault.offset))
