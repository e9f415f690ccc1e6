"""Faults of SRP after an expiry, a record of its own, a discarded record, and with two records in a beacon."""

from __future__ import annotations

from typing import Literal

from dcp_spec.constants import BP_PROTID_SRP
from dcp_spec.status import BPStatus
from msgspec.structs import replace

from dcp_codec.errors import DecodeError
from dcp_codec.values import ExtendedSafetyData
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.bp.receive import Receiver
from dcp_stack.bp.wire import Block
from dcp_stack.srp.entity import StateReporting
from dcp_stack.srp.neighbour_table import NeighbourTable, NeighbourTableEntry


@mutant("again-when-alone", "SRP-SEQ-01", "numbers its records from 0 again when the last neighbour has expired")
class AgainWhenAlone(StateReporting):
    def handle_timeout(self, now: int, wall: int) -> None:
        before = len(self._table)
        super().handle_timeout(now, wall)
        if before and not len(self._table):
            self._seqno = 0


@mutant("own-record-counts", "SRP-SEQ-01 SRP-RX-02", "continues the numbers of a received record with its own nodeId")
class OwnRecordCounts(StateReporting):
    def handle_payload(self, payload: bytes, sender_id: bytes, *, now: int, wall: int) -> None:
        try:
            report = self._config.codec.decode_report(payload)
        except DecodeError:
            report = None
        if report is not None and report.node_id == self._node_id:
            self._seqno = max(self._seqno, report.seqno + 1)
        super().handle_payload(payload, sender_id, now=now, wall=wall)


@mutant(
    "moved-data",
    "SRP-RUN-02 SRP-NT-01 SRP-NT-02",
    "moves the last entry to the place of an expired one, not its identifier",
)
class MovedData(NeighbourTable):
    def expire(self, now: int, timeout: int) -> list[bytes]:
        before = list(self._entries)
        gone = super().expire(now, timeout)
        for node_id in gone:
            last = next(reversed(self._entries), None)
            if last is not None and before.index(last) > before.index(node_id):
                self._entries[node_id] = replace(self._entries.pop(last), node_id=node_id)
        return gone


@mutant(
    "long-record-renews",
    "SRP-RX-01 SRP-RUN-02",
    "renews the age of an entry before it discards a record that is too long",
)
class LongRecordRenews(StateReporting):
    def handle_payload(self, payload: bytes, sender_id: bytes, *, now: int, wall: int) -> None:
        place = self._node_id_offset
        entry = self._table.lookup(payload[place : place + len(self._node_id)])
        if entry is not None and len(payload) > self.record_size:
            self._table._entries[entry.node_id] = replace(entry, received_at=now, reception_time=wall)
        super().handle_payload(payload, sender_id, now=now, wall=wall)


@mutant("first-of-beacon", "SRP-RX-03 BP-RX-07", "processes only the first SRP payload of a beacon")
class FirstOfBeacon(Receiver):
    def receive(self, octets: bytes, now: int) -> None:
        self.reports = 0
        super().receive(octets, now)

    def _deliver(self, block: Block, sender: bytes) -> None:
        self.reports += block.protocol_id == BP_PROTID_SRP
        if block.protocol_id != BP_PROTID_SRP or self.reports == 1:
            super()._deliver(block, sender)


@mutant("remembered", "SRP-NT-01 SRP-RUN-02", "still finds the entry that it has found last after it was removed")
class Remembered(NeighbourTable):
    def lookup(self, node_id: bytes) -> NeighbourTableEntry | None:
        found: NeighbourTableEntry | None = self.__dict__.get("found")
        entry = super().lookup(node_id)
        if entry is None and found is not None and found.node_id == node_id:
            return found
        self.found = entry
        return entry

    def clear(self) -> None:
        self.found = None
        super().clear()


@mutant("last-ends", "SRP-RUN-01 SRP-RUN-02", "traverses its table no more once it has become empty by an expiry")
class LastEnds(StateReporting):
    _ended = False

    def start(self, now: int, wall: int) -> BPStatus:
        self._ended = False
        return super().start(now, wall)

    def handle_timeout(self, now: int, wall: int) -> None:
        before = len(self._table)
        if not self._ended:
            super().handle_timeout(now, wall)
            self._ended = before > len(self._table) == 0

    def poll_timeout(self) -> int | None:
        return None if self._ended else super().poll_timeout()


@mutant(
    "entry-of-sender",
    "SRP-NT-01 SRP-RX-05",
    "keeps a second entry for a node whose records come in beacons of another sender than before",
)
class EntryOfSender(NeighbourTable):
    def record(
        self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int
    ) -> Literal["new", "replaced", "full"]:
        former = self._entries.get(report.node_id)
        outcome = super().record(report, sender_id, now=now, wall=wall)
        if former is not None and former.sender_id != sender_id:
            self._entries[report.node_id + former.sender_id] = former
        return outcome
