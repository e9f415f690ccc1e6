"""Faults in the octets of beacons that BP sends."""

from __future__ import annotations

import zlib

from dcp_codec.values import Payload
from dcp_selftest.mutants.air import Air
from dcp_selftest.mutants.family import after, around, attributes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NO_LENGTH, NO_NETWORK
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.wire import BPWire
from dcp_stack.effects import SendBeacon

Blocks = list[tuple[int, bytes]]


def swapped(number: int) -> int:
    """Return a number of two octets with its octets exchanged."""
    return int.from_bytes(number.to_bytes(2, "little"), "big")


class Wire(BPWire):
    """Builds beacons with a changed field in the header."""

    field = ""

    def build(self, seqno: int, network_id: int | None, blocks: Blocks) -> bytes:
        octets = super().build(seqno, network_id, blocks)
        place = self._places.get(self.field)
        if place is None:
            return octets
        return octets[: place.start] + self.other(octets[place], blocks) + octets[place.stop :]

    def other(self, octets: bytes, blocks: Blocks) -> bytes:
        """Return the octets to be sent in the field; by default in reverse order."""
        return octets[::-1]


other = instead(Wire, Wire.other)
other("two", "BP-HDR-01", "sends version 0x02", lambda self, octets, blocks: b"\x02", field="version")
wire = attributes(Wire, __name__)
wire("swapped", "BP-HDR-02 DATA-01", "sends magicNo little-endian", field="magicNo")
wire("swapped-length", "DATA-01 BP-HDR-06", "sends the length little-endian", unseen=NO_LENGTH, field="length")
wire("swapped-seqno", "DATA-01 BP-HDR-08", "sends the sequence number of beacons little-endian", field="seqno")
wire("swapped-network", "DATA-01 BP-HDR-04", "sends the network identifier little-endian",
    unseen=NO_NETWORK, field="networkId")  # fmt: skip


@mutant("changes", "BP-PAR-09 BP-HDR-03 DATA-04", "sends another senderId in every third beacon")
class OtherSender(Wire):
    field = "senderId"
    count = 0

    def other(self, octets: bytes, blocks: Blocks) -> bytes:
        self.count += 1
        return octets if self.count % 3 else octets[:-1] + bytes([octets[-1] ^ 0x80])


# fmt: off
wire("reversed", "BP-HDR-03", "sends its node identifier in reverse, like an integer of the machine", field="senderId")
other("with-header", "BP-HDR-06", "includes the header in the length in the header",
    lambda self, octets, blocks: (
        (int.from_bytes(octets, self._block_length.order) + self.header_size).to_bytes(2, self._block_length.order)),
    field="length")
other("payloads-only", "BP-HDR-06", "omits the headers of the blocks from the length",
    lambda self, octets, blocks: sum(len(payload) for _, payload in blocks).to_bytes(2, self._block_length.order),
    field="length")
other("first-block", "BP-HDR-06", "includes only the first block in the length",
    lambda self, octets, blocks: self.block_size(blocks[0][1]).to_bytes(2, self._block_length.order), field="length")
other("one", "BP-HDR-07", "always sends numPayloads 1", lambda self, octets, blocks: b"\x01", field="numPayloads")
other("one-more", "BP-HDR-07", "sends a numPayloads that is one too large",
    lambda self, octets, blocks: bytes([(len(blocks) + 1) % 256]), field="numPayloads")
# fmt: on


@mutant("seqno-first", "BP-HDR-10", "sends the sequence number before numPayloads")
class OtherOrder(BPWire):
    def build(self, seqno: int, network_id: int | None, blocks: Blocks) -> bytes:
        octets = super().build(seqno, network_id, blocks)
        start = self.offset("numPayloads")
        number, counter = octets[start : start + 1], octets[start + 1 : start + 5]
        return octets[:start] + counter + number + octets[start + 5 :]


around(BPWire, BPWire.build)("swapped-protocol", "BP-HDR-11 DATA-01", "sends protocol identifiers little-endian",
    lambda self, proceed, seqno, network_id, blocks: (
        proceed(seqno, network_id, [(swapped(number), payload) for number, payload in blocks])))  # fmt: skip


@mutant("block-length-swapped", "DATA-01 BP-HDR-10 BP-FMT-01", "sends block lengths little-endian")
class SwappedBlockLength(BPWire):
    def build(self, seqno: int, network_id: int | None, blocks: Blocks) -> bytes:
        octets = bytearray(super().build(seqno, network_id, blocks))
        offset = self.header_size
        for _, payload in blocks:
            octets[offset + 2 : offset + 4] = octets[offset + 2 : offset + 4][::-1]
            offset += self.block_size(payload)
        return bytes(octets)


@mutant("block-with-header", "BP-FMT-01", "includes the header of a block in the length of the block")
class BlockLengthWithHeader(BPWire):
    def build(self, seqno: int, network_id: int | None, blocks: Blocks) -> bytes:
        octets = bytearray(super().build(seqno, network_id, blocks))
        offset = self.header_size
        for _, payload in blocks:
            octets[offset + 2 : offset + 4] = (len(payload) + 4).to_bytes(2, self._block_length.order)
            offset += self.block_size(payload)
        return bytes(octets)


@mutant("all-swapped", "DATA-01", "sends all integers of the headers little-endian")
class AllSwapped(SwappedBlockLength):
    def build(self, seqno: int, network_id: int | None, blocks: Blocks) -> bytes:
        octets = super().build(seqno, network_id, [(swapped(number), payload) for number, payload in blocks])
        for field in ("magicNo", "networkId", "length", "seqno"):
            place = self._places.get(field)
            if place is not None:
                octets = octets[: place.start] + octets[place][::-1] + octets[place.stop :]
        return octets


@mutant("gap", "BP-FMT-01 BP-HDR-06", "aligns blocks to four octets with padding between them")
class Aligned(BPWire):
    def build(self, seqno: int, network_id: int | None, blocks: Blocks) -> bytes:
        octets = super().build(seqno, network_id, blocks)
        result, offset = octets[: self.header_size], self.header_size
        for _, payload in blocks:
            size = self.block_size(payload)
            result += octets[offset : offset + size] + bytes(-size % 4)
            offset += size
        return result


after(BPWire, BPWire.build)("checksum", "UWB-04 BP-FMT-01", "appends a checksum to each beacon",
    lambda self, octets, seqno, network_id, blocks: octets + zlib.crc32(octets).to_bytes(4, "big"))  # fmt: skip


@mutant("checksum-in-length", "BP-FMT-01 UWB-04 BP-HDR-06", "appends a checksum to each beacon and counts it in length")
class CountedChecksum(Wire):
    field = "length"

    def other(self, octets: bytes, blocks: Blocks) -> bytes:
        return (int.from_bytes(octets, self._block_length.order) + 4).to_bytes(2, self._block_length.order)

    def build(self, seqno: int, network_id: int | None, blocks: Blocks) -> bytes:
        octets = super().build(seqno, network_id, blocks)
        return octets + zlib.crc32(octets).to_bytes(4, "big")


# -- the sequence number -----------------------------------------------------------------------------------------------


class Numbers(BPWire):
    """Changes the sequence numbers of beacons."""

    def build(self, seqno: int, network_id: int | None, blocks: Blocks) -> bytes:
        return super().build(self.number(seqno), network_id, blocks)

    def number(self, seqno: int) -> int:
        """Return the sequence number to be sent."""
        return seqno


number = instead(Numbers, Numbers.number)
number("starts-at-two", "BP-HDR-12 BP-INI-02", "starts with sequence number 2", lambda self, seqno: seqno + 2)
number("starts-at-zero", "BP-HDR-13 BP-INI-02",
    "starts with sequence number 0, although 1.0 increments it before sending",
    lambda self, seqno: seqno - 1)  # fmt: skip
number("by-two", "BP-HDR-08", "increments the sequence number of beacons by two", lambda self, seqno: 2 * seqno)
number("twice", "BP-HDR-08", "uses each sequence number for two beacons", lambda self, seqno: seqno // 2)
number("constant", "BP-HDR-08", "always sends sequence number 0", lambda self, seqno: 0)
number("one-octet", "BP-HDR-08", "counts beacons in a single octet", lambda self, seqno: seqno % 256)


@mutant("idle", "BP-HDR-09", "uses up a sequence number when it has nothing to send")
class IdleConsumed(BeaconingProtocol):
    def handle_timeout(self, now: int, wall: int) -> None:
        due = self.active and now >= self._schedule.due
        before = self._seqno
        super().handle_timeout(now, wall)
        if due and self._seqno == before:
            self._seqno += 1


@mutant("survives", "BP-INI-02 BP-HDR-12 BP-HDR-13", "continues the sequence numbers of beacons after a reset")
class Survives(Air):
    def reset(self, now: int, wall: int) -> None:
        seqno = self.bp._seqno
        super().reset(now, wall)
        self.bp._seqno = seqno


# -- what is in a beacon -----------------------------------------------------------------------------------------------


instead(BeaconingProtocol, BeaconingProtocol._room)("no-limit", "BP-FMT-02 BP-PAR-02",
    "fills beacons up to the bearer's limit, whatever the maximum packet size",
    lambda self: self._parameters.uwb_max_packet_size - self._wire.header_size)  # fmt: skip


@mutant("empty-beacons", "BP-FMT-03 BP-HDR-07 BP-HDR-09", "sends beacons without payloads when it has nothing to send")
class EmptyBeacons(BeaconingProtocol):
    def handle_timeout(self, now: int, wall: int) -> None:
        due = self.active and now >= self._schedule.due
        before = self._seqno
        super().handle_timeout(now, wall)
        if due and self._seqno == before:
            octets = bytearray(self._wire.build(before, self._parameters.network_id, [(0xFFFF, b"nothing")]))
            del octets[self._wire.header_size :]
            octets[self._wire.offset("numPayloads")] = 0
            place = self._wire.offset("length")
            if place >= 0:
                octets[place : place + 2] = b"\0\0"
            self._seqno += 1
            self._emit(SendBeacon(bytes(octets), before, 0))


# fmt: off
instead(Air, Air.blocks)("wrong-place", "BP-HDR-11", "exchanges the protocol identifiers of SRP and VarDis",
    lambda self, beacon: (
        [Payload({1: 2, 2: 1}.get(each.protocol_id, each.protocol_id), each.content) for each in beacon.payloads]))
# fmt: on
