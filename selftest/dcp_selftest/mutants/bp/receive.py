"""Faults in the processing of received beacons by BP."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from dcp_codec.values import BPHeader
from dcp_selftest.mutants.air import Air
from dcp_selftest.mutants.family import after, around, attributes, crashes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NO_LENGTH
from dcp_stack.bp.receive import Receiver
from dcp_stack.bp.wire import Block, BPWire, Reception
from dcp_stack.effects import PayloadReceived


class Lenient(BPWire):
    """Repairs beacons that BP should reject."""

    def parse(self, octets: bytes) -> Reception:
        if len(octets) < self.header_size:
            return super().parse(octets)
        return super().parse(bytes(self.repaired(bytearray(octets))))

    def repaired(self, octets: bytearray) -> bytearray:
        """Return the octets to be processed."""
        return octets

    def number(self, octets: bytearray, field: str) -> int:
        """Return an integer of the header."""
        return int.from_bytes(octets[self._places[field]], "big")

    def put(self, octets: bytearray, field: str, value: int) -> bytearray:
        """Set an integer of the header, and return the octets."""
        place = self._places[field]
        octets[place] = value.to_bytes(place.stop - place.start, "big")
        return octets


# fmt: off
repaired = instead(Lenient, Lenient.repaired)
repaired("any", "BP-RX-01", "accepts beacons of any version", lambda self, octets: self.put(octets, "version", 1))
repaired("newer", "BP-RX-01", "accepts beacons of newer versions",
    lambda self, octets: self.put(octets, "version", min(self.number(octets, "version"), 1)))
repaired("any", "BP-RX-02", "accepts beacons with any magicNo",
    lambda self, octets: self.put(octets, "magicNo", 0x497E))
repaired("swapped", "BP-RX-02", "also accepts beacons with a little-endian magicNo",
    lambda self, octets: self.put(octets, "magicNo", 0x497E) if self.number(octets, "magicNo") == 0x7E49 else octets)
repaired("first-octet", "BP-RX-02", "checks only the first octet of magicNo",
    lambda self, octets: self.put(octets, "magicNo", 0x497E) if self.number(octets, "magicNo") >> 8 == 0x49 else octets)
repaired("whole-frame", "BP-RX-03", "treats length 0 as the length of the frame",
    lambda self, octets: (
        octets if self.number(octets, "length") else self.put(octets, "length", len(octets) - self.header_size)))
repaired("processed", "BP-RX-04", "accepts beacons with numPayloads 0",
    lambda self, octets: octets if self.number(octets, "numPayloads") else self.put(octets, "numPayloads", 1))
repaired("by-count", "BP-RX-14", "parses blocks after the end that length gives if numPayloads counts more than one",
    lambda self, octets: (
        self.put(octets, "length", len(octets) - self.header_size)
        if self.number(octets, "numPayloads") > 1 else octets), unseen=NO_LENGTH)
around_for_this_node = around(Receiver, Receiver._for_this_node)
around_for_this_node("any", "BP-RX-05", "accepts beacons of any network",
    lambda self, proceed, header: proceed(BPHeader(header.sender_id, header.seqno, self._parameters.network_id)))
around_for_this_node("zero", "BP-RX-05", "treats network 0 as any network",
    lambda self, proceed, header: (
        proceed(BPHeader(header.sender_id, header.seqno, (header.network_id or self._parameters.network_id)))))
# fmt: on


@mutant("low-octet", "BP-RX-05", "compares only the low octet of network identifiers")
class LowOctet(Receiver):
    def _for_this_node(self, header: BPHeader) -> bool:
        own = self._parameters.network_id
        network = header.network_id
        if own is not None and network is not None and network & 0xFF == own & 0xFF:
            network = own
        return super()._for_this_node(BPHeader(header.sender_id, header.seqno, network))


@mutant("first-network", "BP-RX-05 BP-PAR-05 BP-PAR-02", "keeps accepting beacons of its initial network")
class FirstNetwork(Receiver):
    def __init__(self, *parts: Any, **more: Any) -> None:
        super().__init__(*parts, **more)
        self._first = self._parameters.network_id

    def _for_this_node(self, header: BPHeader) -> bool:
        network = header.network_id
        if network == self._first:
            network = self._parameters.network_id
        return super()._for_this_node(BPHeader(header.sender_id, header.seqno, network))


# fmt: off
around_for_this_node("processed", "BP-RX-06", "accepts beacons with its own senderId",
    lambda self, proceed, header: proceed(BPHeader(b"", header.seqno, header.network_id)))
around_for_this_node("reserved-senders", "DATA-04", "ignores senders whose identifier has the group bit or is all zero",
    lambda self, proceed, header: (any(header.sender_id) and not header.sender_id[0] & 1) and proceed(header))
around_for_this_node("sender-prefix", "BP-RX-06 DATA-04",
    "treats senders with the same first octets as its own identifier as itself",
    lambda self, proceed, header: header.sender_id[:3] != self._node_id[:3] and proceed(header))
# fmt: on


# -- blocks ------------------------------------------------------------------------------------------------------------


class Blocks(BPWire):
    """Changes the blocks that are processed."""

    def parse(self, octets: bytes) -> Reception:
        found = super().parse(octets)
        return Reception(found.header, self.chosen(found.blocks), found.fault, found.refused, found.count_agrees)

    def chosen(self, blocks: tuple[Block, ...]) -> tuple[Block, ...]:
        """Return the blocks to be processed."""
        return blocks


chosen = instead(Blocks, Blocks.chosen)
chosen("first-only", "BP-RX-07", "processes only the first block of a beacon", lambda self, blocks: blocks[:1])
chosen("not-the-last", "BP-RX-07", "does not process the last of several blocks",
    lambda self, blocks: blocks[:-1] if len(blocks) > 1 else blocks)  # fmt: skip
chosen("one-of-each", "BP-RX-07", "processes one block of each protocol",
    lambda self, blocks: tuple({block.protocol_id: block for block in reversed(blocks)}.values()))  # fmt: skip
chosen("twice", "BP-RXP-02", "delivers every payload twice",
    lambda self, blocks: tuple(block for each in blocks for block in (each, each)))  # fmt: skip


class Ends(Receiver):
    """Stops at some blocks."""

    stopped = False

    def receive(self, octets: bytes, now: int) -> None:
        self.stopped = False
        super().receive(octets, now)

    def _deliver(self, block: Block, sender: bytes) -> None:
        self.stopped = self.stopped or self.ends(block)
        if not self.stopped:
            super()._deliver(block, sender)

    def ends(self, block: Block) -> bool:
        """Return whether this block and those after it are not delivered."""
        return block.protocol_id not in self._clients


attributes(Ends, __name__)("unknown-ends", "BP-RX-08", "stops at a block of an unregistered protocol")


chosen("unknown-drops", "BP-RX-08", "ignores beacons with a block of an unregistered protocol",
    lambda self, blocks: () if any(block.protocol_id > 0x1000 for block in blocks) else blocks)  # fmt: skip


@mutant("cut-delivered", "BP-RX-09", "delivers the available part of a block that extends past the end")
class CutDelivered(BPWire):
    def parse(self, octets: bytes) -> Reception:
        found = super().parse(octets)
        if found.fault is None or found.refused or found.header is None or found.fault.reason == "beacon-overrun":
            return found
        start = (
            found.blocks[-1].offset + self.block_size(found.blocks[-1].payload) if found.blocks else self.header_size
        )
        rest = octets[start:]
        if len(rest) <= 4:
            return found
        block = Block(int.from_bytes(rest[:2], "big"), rest[4:], start)
        return Reception(found.header, (*found.blocks, block), None, count_agrees=found.count_agrees)


after_parse = after(BPWire, BPWire.parse)
after_parse("loop-bound", "BP-RX-07", "ends the loop over the blocks at the length, which lacks the header",
    lambda self, found, octets: msgspec.structs.replace(found, blocks=tuple(
        each for each in found.blocks if each.offset < sum(self.block_size(one.payload) for one in found.blocks)))
    )  # fmt: skip
after_parse("all-dropped", "BP-RX-09", "ignores all blocks before one that extends past the end",
    lambda self, found, octets: (
        found if found.fault is None else Reception(found.header, (), found.fault, found.refused)))  # fmt: skip


@mutant("repeated-dropped", "BP-RX-10", "ignores beacons with the same sequence number as the one before")
class RepeatedDropped(Receiver):
    last: tuple[bytes, int] = (b"", 0)

    def _for_this_node(self, header: BPHeader) -> bool:
        last, self.last = self.last, (header.sender_id, header.seqno)
        return last != self.last and super()._for_this_node(header)


@mutant("older-dropped", "BP-RX-10", "ignores beacons with a lower sequence number than the one before")
class OlderDropped(Receiver):
    last: tuple[bytes, int] = (b"", 0)

    def _for_this_node(self, header: BPHeader) -> bool:
        last, self.last = self.last, (header.sender_id, header.seqno)
        older = last[0] == header.sender_id and header.seqno < last[1]
        return not older and super()._for_this_node(header)


# fmt: off
instead(Lenient, Lenient.repaired)("padding-refused", "BP-RX-14", "ignores frames with padding after the beacon",
    lambda self, octets: octets if self.number(octets, "length") == len(octets) - self.header_size else octets[:4])
crashes(Lenient, Lenient.repaired, IndexError("a read past the end of the frame"))("dies", "BP-RX-15",
    "crashes on a length past the end of the frame",
    lambda self, octets: self.number(octets, "length") > len(octets) - self.header_size)
crashes(BPWire, BPWire.parse, IndexError("a read past the end of the frame"))("dies-of-short", "BP-RX-16",
    "crashes on a frame shorter than the header",
    lambda self, octets: len(octets) < self.header_size)
chosen("dies-of-empty", "BP-RX-16", "crashes on a block without a payload",
    lambda self, blocks: tuple(block for block in blocks if block.payload[0] >= 0))
crashes(BPWire, BPWire.parse, IndexError("a read of an empty frame"))("dies-of-nothing", "BP-RX-16",
    "crashes on an empty frame",
    lambda self, octets: not octets)
# fmt: on


@mutant("mute", "BP-RX-16", "receives nothing after 20 frames that are not beacons")
class Mute(BPWire):
    wrong = 0

    def parse(self, octets: bytes) -> Reception:
        found = super().parse(octets)
        self.wrong += found.refused
        return super().parse(b"") if self.wrong > 20 else found


# -- indications -------------------------------------------------------------------------------------------------------


class Deliveries(Receiver):
    """Changes the octets delivered to clients outside of the node."""

    def _deliver(self, block: Block, sender: bytes) -> None:
        payload = self.payload(block.payload) if block.protocol_id > 2 else block.payload
        super()._deliver(Block(block.protocol_id, payload, block.offset), sender)

    def payload(self, payload: bytes) -> bytes:
        """Return the octets to be delivered."""
        return payload


payload = instead(Deliveries, Deliveries.payload)
payload("nul-cut", "BP-RXP-01", "delivers payloads up to the first octet that is zero",
    lambda self, payload: payload.partition(b"\0")[0] or payload)  # fmt: skip
payload("limited", "BP-RXP-01", "delivers at most 255 octets of a payload", lambda self, payload: payload[:255])
payload("aligned", "BP-RXP-01", "delivers payloads padded to a multiple of four octets",
    lambda self, payload: payload + bytes(-len(payload) % 4))  # fmt: skip


@mutant("wildcard", "BP-RXP-03", "delivers the payloads of all protocols to a client registered as 0xFFFF")
class Wildcard(Receiver):
    def _deliver(self, block: Block, sender: bytes) -> None:
        super()._deliver(block, sender)
        if block.protocol_id != 0xFFFF and 0xFFFF in self._clients:
            self._emit(PayloadReceived(0xFFFF, block.payload, sender))


@mutant("everybody", "BP-RXP-03", "delivers payloads to all clients")
class DeliversToAllClients(Receiver):
    def _deliver(self, block: Block, sender: bytes) -> None:
        super()._deliver(block, sender)
        if block.protocol_id > 2 and block.protocol_id in self._clients:
            for client in self._clients:
                if client.protocol_id not in (1, 2, block.protocol_id):
                    self._emit(PayloadReceived(client.protocol_id, block.payload, sender))


# fmt: off
chosen("low-octet", "BP-RXP-03 BP-RX-08 BP-HDR-11", "checks only the low octet of protocol identifiers",
    lambda self, blocks: tuple(Block(block.protocol_id & 0xFF, block.payload, block.offset) for block in blocks))
# fmt: on


@mutant("late", "BP-RXP-02", "delivers the last payload again with the next beacon")
class Again(Air):
    last = b""

    def hears(self, octets: bytes) -> Iterable[bytes]:
        if self.last:
            yield self.last
        self.last = octets
        yield octets
