"""Encoding and decoding of bearer payloads for BP: header, blocks and faults (dcp-bp.md, "Packet Format" and
"Receive Path"). Client payloads stay octets."""

from __future__ import annotations

from itertools import starmap

import msgspec

from dcp_codec.errors import DecodeError, Problem
from dcp_codec.plan.layout import read_scalar
from dcp_codec.plan.measures import largest, least_size, member, places, record
from dcp_codec.plan.tree import Fill, Scalar
from dcp_codec.values import Beacon, BPHeader, Payload
from dcp_stack.config import NodeConfig


class Block(msgspec.Struct, frozen=True, gc=False):
    """A payload block; ``offset`` is where its header starts in the bearer payload."""

    protocol_id: int
    payload: bytes
    offset: int


class Fault(msgspec.Struct, frozen=True, gc=False):
    """A decoding fault: reason of ``dcp_spec.reasons``, requirement to ignore the octets, offset in octets."""

    reason: str
    requirement: str
    offset: int


class Reception(msgspec.Struct, frozen=True, gc=False):
    """The decoded part of a bearer payload.

    ``header`` is None if the profile sends none, or if it was refused: then there is only a ``fault``.
    ``blocks`` are the blocks before the fault. ``count_agrees`` is False if numPayloads is not the number of blocks.
    """

    header: BPHeader | None
    blocks: tuple[Block, ...] = ()
    fault: Fault | None = None
    refused: bool = False
    count_agrees: bool = True


class BPWire:
    """Encoder and decoder of bearer payloads of a profile, with sizes and offsets in octets."""

    def __init__(self, config: NodeConfig) -> None:
        self._codec = config.codec
        self._node_id = config.node_id
        plan = config.codec.envelope_plan
        header, block = record(plan, "BPHeader"), record(plan, "Payload")
        assert block is not None
        self._header = (
            {} if header is None else {each.name: each for each in header.members if isinstance(each, Scalar)}
        )
        self._places = {} if header is None else places(header)
        self.header_size = 0 if header is None else least_size(header)
        """Octets of BPHeaderT, 0 where the profile sends none."""
        self.block_header_size = sum(each.size for each in block.members if isinstance(each, Scalar))
        """Octets of BPPayloadHeaderT."""
        self._area = next((each.total for each in block.members if isinstance(each, Fill)), None)
        length = member(block, "length")
        assert isinstance(length, Scalar)
        self._block_length, self._block_length_place = length, places(block)["length"]
        self.max_payload = min(largest(length), self._area or largest(length))
        """Octets of the longest client payload that a block can hold."""
        self.max_blocks: int | None = None
        """Octets of all blocks that the header can announce, None without such a field."""
        announced = self._header.get("length")
        if announced is not None and announced.derived is not None:
            self.max_blocks = largest(announced)
        readings = config.selected_readings
        self._frame_is_end = self.max_blocks is not None and readings.beacon_end == "frame-size"
        self._count_is_end = announced is not None or readings.beacon_end_without_length == "counted-blocks"
        self.count_tells = not self._frame_is_end and self._count_is_end
        """Whether numPayloads is compared with the blocks: not if padding is parsed as blocks (X02, X47)."""

    def offset(self, field: str) -> int:
        """Return the offset of a header field in the bearer payload (octets), -1 if there is no such field."""
        place = self._places.get(field)
        return -1 if place is None else place.start

    def block_size(self, payload: bytes) -> int:
        """Return the size of the block that carries ``payload``, in octets."""
        return self.block_header_size + (self._area or len(payload))

    def build(self, seqno: int, network_id: int | None, blocks: list[tuple[int, bytes]]) -> bytes:
        """Encode a bearer payload with these 1 to 255 blocks (protocol id, client payload)."""
        ##= BP-HDR-03 BP-HDR-04 DATA-04
        header = BPHeader(self._node_id, seqno, network_id) if self._places else None
        # The schema of the profile derives the other header fields from the blocks.
        payloads = tuple(starmap(Payload, blocks))
        return self._codec.encode_envelope(Beacon(header, payloads))

    def parse(self, octets: bytes) -> Reception:
        """Decode a bearer payload. Never raises, for any octets.

        The header is checked in the order of the specification. The last check is for a length beyond the end of the
        frame (C.6), so the result has both header and fault.
        """
        ##= BP-RX-16
        if self._frame_is_end:
            octets = self._announcing_frame(octets)
        elif not self._count_is_end:
            octets = self._counting_frame(octets)
        try:
            beacon, _ = self._codec.decode_envelope(octets)
        except DecodeError as error:
            return self._faulty(octets, error)
        return Reception(beacon.bp, self._blocks(beacon))

    def _faulty(self, octets: bytes, error: DecodeError) -> Reception:
        problem, beacon = error.problem, error.partial
        if not isinstance(beacon, Beacon):
            fault = _fault(problem, in_header=True)
            if problem.reason == "beacon-overrun":
                return Reception(self._refused_header(octets), fault=fault)
            return Reception(None, fault=fault, refused=True)
        blocks = self._blocks(beacon)
        end = blocks[-1].offset + self.block_size(blocks[-1].payload) if blocks else self.header_size
        ##= BP-RX-12
        # A wrong numPayloads does not affect the blocks; it is only counted.
        if problem.reason == "count-mismatch" or end == len(octets):
            return Reception(beacon.bp, blocks, count_agrees=False)
        ##= BP-RX-09
        return Reception(beacon.bp, blocks, fault=_fault(problem, in_header=False))

    def _blocks(self, beacon: Beacon) -> tuple[Block, ...]:
        found: list[Block] = []
        offset = self.header_size
        for block in beacon.payloads:
            payload = block.content
            # An envelope has client payloads as octets.
            assert isinstance(payload, bytes)
            found.append(Block(block.protocol_id, payload, offset))
            offset += self.block_header_size + (self._area or len(payload))
        return tuple(found)

    def _refused_header(self, octets: bytes) -> BPHeader:
        """Decode sender and network of a complete header."""
        network = self._header.get("networkId")
        network_id = None if network is None else read_scalar(network, octets[self._places["networkId"]])
        return BPHeader(octets[self._places["senderId"]], 0, network_id)

    def _announcing_frame(self, octets: bytes) -> bytes:
        """Return the octets with the header's length set to that of the frame (reading X02 ``frame-size``)."""
        place, body = self._places["length"], len(octets) - self.header_size
        # A length of zero remains a reason to discard the beacon (BP-RX-03).
        if body <= 0 or body > (self.max_blocks or 0) or not any(octets[place]):
            return octets
        return (
            octets[: place.start]
            + body.to_bytes(place.stop - place.start, self._header["length"].order)
            + octets[place.stop :]
        )

    def _counting_frame(self, octets: bytes) -> bytes:
        """Return the octets with numPayloads set to the blocks of the frame (reading X47 ``whole-frame``)."""
        place, start, count = self._places.get("numPayloads"), self.header_size, 0
        # A count of zero remains a reason to discard the beacon (BP-RX-04).
        if place is None or not any(octets[place]):
            return octets
        length = self._block_length_place
        while start + self.block_header_size <= len(octets):
            announced = read_scalar(self._block_length, octets[start + length.start : start + length.stop])
            start += self.block_header_size + (self._area or announced)
            count += start <= len(octets)
        number = self._header["numPayloads"]
        counted = min(max(count, 1), largest(number)).to_bytes(number.size, number.order)
        return octets[: place.start] + counted + octets[place.stop :]


def _fault(problem: Problem, *, in_header: bool) -> Fault:
    requirement = problem.requirement
    if problem.reason == "truncated":
        # The codec reports the requirement of the truncated field; BP needs the one of its reaction.
        requirement = "BP-RX-16" if in_header else "BP-RX-09"
    return Fault(problem.reason, requirement or "BP-RX-16", problem.offset)
