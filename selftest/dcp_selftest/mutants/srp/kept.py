"""Faults of SRP in state that must not change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import msgspec

from dcp_codec.values import ExtendedSafetyData, SafetyData
from dcp_selftest.mutants.family import around, assign, then
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import BP_ALWAYS_ACTIVE
from dcp_stack.srp.entity import StateReporting, UpdateSafetyDataConfirm
from dcp_stack.srp.neighbour_table import NeighbourTable

then(NeighbourTable, NeighbourTable.record)("touches-others", "SRP-RX-03",
    "renews the entries of all neighbours with every report",
    lambda self, result, report, sender_id, *, now, wall: (
        assign(self, _entries={node_id: msgspec.structs.replace(entry, reception_time=wall, received_at=now)
        for node_id, entry in self._entries.items()})))  # fmt: skip


@mutant("one-stamp", "SRP-RX-03", "stores the tStamp of the last report for all neighbours")
class OneStamp(NeighbourTable):
    def record(
        self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int
    ) -> Literal["new", "replaced", "full"]:
        outcome = super().record(report, sender_id, now=now, wall=wall)
        for node_id, entry in self._entries.items():
            other = msgspec.structs.replace(entry.ext_sd, t_stamp=report.t_stamp)
            self._entries[node_id] = msgspec.structs.replace(entry, ext_sd=other)
        return outcome


# fmt: off
around(NeighbourTable, NeighbourTable.record)("number-as-byte", "SRP-TYP-01 SRP-RX-03",
    "stores only the last two octets of received sequence numbers",
    lambda self, proceed, report, sender_id, *, now, wall: (
        proceed(msgspec.structs.replace(report, seqno=report.seqno % (1 << 16)), sender_id, now=now, wall=wall)))
# fmt: on


@mutant(
    "paused-forgets", "SRP-RX-03 SRP-RUN-02", "removes its neighbours when BP is deactivated", unseen=BP_ALWAYS_ACTIVE
)
class PausedForgets(StateReporting):
    @property
    def neighbours(self) -> NeighbourTable:
        table = super().neighbours
        # SRP uses BP through the client port.
        port: Any = self._bp
        if not port._bp.active:
            table.clear()
        return table


@mutant("paused-stands", "SRP-SEQ-01", "does not count submissions while BP is deactivated", unseen=BP_ALWAYS_ACTIVE)
class PausedStands(StateReporting):
    def update_safety_data(
        self, data: SafetyData | Mapping[str, Any], *, now: int, wall: int
    ) -> UpdateSafetyDataConfirm | None:
        before = self._seqno
        confirm = super().update_safety_data(data, now=now, wall=wall)
        # SRP uses BP through the client port.
        port: Any = self._bp
        if not port._bp.active:
            self._seqno = before
        return confirm
