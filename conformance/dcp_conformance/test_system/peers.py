"""Virtual stations: each has an identifier and a beacon counter, and says what a case tells it to."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from dcp_spec.constants import IC_MAX_RECORDS

from dcp_codec.values import (
    ExtendedSafetyData,
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSumm,
    VarUpdate,
)
from dcp_conformance.frames.builder import Block, Lies

if TYPE_CHECKING:
    from .bench import Bench


class Peer:
    """A station of the tester's: ``node_id`` is its identifier in beacons, ``address`` the source of its frames."""

    def __init__(self, bench: Bench, node_id: bytes, address: bytes) -> None:
        self._bench = bench
        self.node_id = node_id
        self.address = address
        self.seqno = bench.profile.behaviour.first_beacon_seqno

    def send(
        self,
        *what: Block | VardisRecord | ExtendedSafetyData | bytes,
        lies: Lies | None = None,
        padding: bytes = b"",
        cut: int | None = None,
        sender: bytes | None = None,
        network_id: int | None = None,
    ) -> int:
        """Send one beacon; the number of its frame.

        ``what`` becomes blocks: VarDis records and containers (octets) that follow each other share one, a state report
        is one, a :class:`Block` is taken as it is. ``lies``: see
        :class:`~dcp_conformance.frames.builder.FrameBuilder`. ``padding``
        follows the beacon, ``cut`` keeps so many octets of it all, ``sender`` is another identifier in the header.
        """
        octets = self.beacon(*what, lies=lies, sender=sender, network_id=network_id) + padding
        blocks = max(1, len(self._blocks(what)))
        return self._bench.transmit(octets if cut is None else octets[:cut], self.address, blocks)

    def send_all(self, records: Iterable[VardisRecord]) -> None:
        """Send records in as many beacons as they need: no payload is larger than the implementation's own may be."""
        builder = self._bench.builder
        limit = self._bench.parameter("VARDISPAR_MAX_PAYLOAD_SIZE") or 1000
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
        """The octets that :meth:`send` would send; counts the beacon."""
        bench = self._bench
        network = bench.parameter("BPPAR_NETWORK_ID") if network_id is None else network_id
        octets = bench.builder.beacon(
            self.node_id if sender is None else sender,
            self.seqno,
            self._blocks(what),
            network_id=network if bench.profile.has_header_field("networkId") else None,
            lies=lies,
        )
        self.seqno = (self.seqno + 1) % (1 << 32)
        return octets

    def send_octets(self, octets: bytes) -> int:
        """Send a bearer payload that is made up completely; the number of its frame."""
        return self._bench.transmit(octets, self.address)

    def _blocks(self, what: tuple[Block | VardisRecord | ExtendedSafetyData | bytes, ...]) -> list[Block]:
        builder, blocks = self._bench.builder, []
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

    # -- records, for short ------------------------------------------------------------------------------------

    def create(
        self,
        var_id: int,
        *,
        value: bytes = b"value",
        seqno: int = 0,
        rep_cnt: int = 1,
        descr: bytes = b"tester",
        creation_time: int | None = None,
        timeout: int = 0,
        producer: bytes | None = None,
        exact: bool = False,
    ) -> VarCreate:
        """A VarCreate of which this peer is the producer, unless another is named.

        Value and description are cut to what the implementation takes, unless ``exact``.
        """
        return self._bench.create(
            var_id,
            self.node_id if producer is None else producer,
            value=value,
            seqno=seqno,
            rep_cnt=rep_cnt,
            descr=descr,
            creation_time=creation_time,
            timeout=timeout,
            exact=exact,
        )

    def update(self, var_id: int, seqno: int, value: bytes = b"newer", *, exact: bool = False) -> VarUpdate:
        """A VarUpdate; the value is cut to what the implementation takes, unless ``exact``."""
        return VarUpdate(var_id, seqno, value if exact else self._bench.value(value))

    def delete(self, var_id: int) -> VarDelete:
        """A VarDelete."""
        return VarDelete(var_id)

    def summary(self, var_id: int, seqno: int) -> VarSumm:
        """A VarSumm."""
        return VarSumm(var_id, seqno)

    def request_update(self, var_id: int, seqno: int) -> VarReqUpdate:
        """A VarReqUpdate; ``seqno`` is what this peer claims to have."""
        return VarReqUpdate(var_id, seqno)

    def request_create(self, var_id: int) -> VarReqCreate:
        """A VarReqCreate."""
        return VarReqCreate(var_id)
