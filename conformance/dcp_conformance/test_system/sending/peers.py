"""Peers: virtual nodes of the tester, each with its own identifier and beacon counter."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Unpack

from dcp_spec.constants import IC_MAX_RECORDS

from dcp_codec.values import ExtendedSafetyData, VarCreate, VardisRecord
from dcp_conformance.frames.builder import Block, FrameBuilder, Lies
from dcp_conformance.test_system.identifiers.allocation import Identifiers
from dcp_conformance.test_system.reception.waiting import Waiting
from dcp_conformance.test_system.sut_properties import SutProperties

from .records import CreationFields, Records
from .transmission import Transmission


@dataclass(eq=False)
class Peer:
    """A virtual node. ``node_id``: its identifier in beacons; ``address``: the source address of its frames."""

    node_id: bytes
    address: bytes
    _transmission: Transmission
    _builder: FrameBuilder
    _records: Records
    _sut: SutProperties
    _waiting: Waiting

    def __post_init__(self) -> None:
        self.seqno = self._sut.profile.behaviour.first_beacon_seqno
        """The sequence number of its next beacon."""
        self.update = self._records.update
        self.delete = self._records.delete
        self.summary = self._records.summary
        self.request_update = self._records.request_update
        self.request_create = self._records.request_create

    def send(
        self,
        *what: Block | VardisRecord | ExtendedSafetyData | bytes,
        lies: Lies | None = None,
        padding: bytes = b"",
        cut: int | None = None,
        sender: bytes | None = None,
        network_id: int | None = None,
    ) -> int:
        """Send one beacon; return the number of its frame in the recording.

        ``what`` becomes payload blocks: consecutive VarDis records and containers (octets) form one block, a state
        report is one block, a :class:`Block` is sent unchanged. ``lies``: wrong field values, see
        :class:`~dcp_conformance.frames.builder.FrameBuilder`. ``padding``: octets after the beacon. ``cut``: number of
        octets after which everything is cut off. ``sender``: another identifier for the header.
        """
        octets = self.beacon(*what, lies=lies, sender=sender, network_id=network_id) + padding
        blocks = max(1, len(self._blocks(what)))
        return self._transmission.send(octets if cut is None else octets[:cut], self.address, blocks)

    def stimulate(self, *what: Block | VardisRecord | ExtendedSafetyData | bytes) -> int:
        """Send one beacon as :meth:`send` does; return the mark before it, for the reactions."""
        mark = self._waiting.mark()
        self.send(*what)
        return mark

    def send_all(self, records: Iterable[VardisRecord]) -> None:
        """Send records in as many beacons as needed: no payload exceeds the implementation's own maximum size."""
        builder = self._builder
        limit = self._sut.parameter("VARDISPAR_MAX_PAYLOAD_SIZE") or 1000
        group: list[VardisRecord] = []
        used = 0
        for record in records:
            size = builder.record_size(record)
            if not group or type(group[-1]) is not type(record):
                size += builder.container_header_size
            if group and (used + size > limit or len(group) == IC_MAX_RECORDS):
                self.send(*group)
                group, used = [], 0
                size = builder.record_size(record) + builder.container_header_size
            group.append(record)
            used += size
        if group:
            self.send(*group)

    def beacon(
        self,
        *what: Block | VardisRecord | ExtendedSafetyData | bytes,
        lies: Lies | None = None,
        sender: bytes | None = None,
        network_id: int | None = None,
    ) -> bytes:
        """Return the octets that :meth:`send` would send, and increase the sequence number."""
        network = self._sut.parameter("BPPAR_NETWORK_ID") if network_id is None else network_id
        octets = self._builder.beacon(
            self.node_id if sender is None else sender,
            self.seqno,
            self._blocks(what),
            network_id=network if self._sut.profile.has_header_field("networkId") else None,
            lies=lies,
        )
        self.seqno = (self.seqno + 1) % (1 << 32)
        return octets

    def send_octets(self, octets: bytes) -> int:
        """Send any octets as a bearer payload; return the number of the frame in the recording."""
        return self._transmission.send(octets, self.address)

    def _blocks(self, what: tuple[Block | VardisRecord | ExtendedSafetyData | bytes, ...]) -> list[Block]:
        builder, blocks = self._builder, []
        run: list[bytes | VardisRecord] = []
        for each in what:
            if isinstance(each, Block | ExtendedSafetyData):
                if run:
                    blocks.append(builder.vardis(*run))
                    run = []
                blocks.append(each if isinstance(each, Block) else builder.srp(each))
            else:
                run.append(each)
        if run:
            blocks.append(builder.vardis(*run))
        return blocks

    # -- records -------------------------------------------------------------------------------------------------------

    def create(self, var_id: int, *, producer: bytes | None = None, **fields: Unpack[CreationFields]) -> VarCreate:
        """Return a VarCreate of this peer or of another producer; other fields: see :meth:`.Records.sample`.

        Value and description are truncated to the implementation's maximum unless ``exact``.
        """
        return self._records.create(var_id, self.node_id if producer is None else producer, **fields)


@dataclass(eq=False)
class Peers:
    """The peers of one case."""

    _transmission: Transmission
    _builder: FrameBuilder
    _records: Records
    _sut: SutProperties
    _identifiers: Identifiers
    _waiting: Waiting
    made: list[Peer] = field(default_factory=list, init=False)
    """The peers so far."""

    def new(self) -> Peer:
        """Return a virtual node that has not sent anything before. Raises ``NamesUsedUp``."""
        node_id, address = self._identifiers.new_node()
        peer = Peer(node_id, address, self._transmission, self._builder, self._records, self._sut, self._waiting)
        self.made.append(peer)
        return peer
