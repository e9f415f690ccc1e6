"""Faults of SRP that show with many neighbours, with clocks that are set back, or while BP is inactive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from dcp_spec.status import SRPStatus

from dcp_codec.values import ExtendedSafetyData, SafetyData
from dcp_selftest.mutants.family import assign, before, then
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import BP_ALWAYS_ACTIVE, OTHERS_ACTIVE
from dcp_stack.srp.entity import StateReporting, UpdateSafetyDataConfirm
from dcp_stack.srp.neighbour_table import NeighbourTable


@mutant("stamp-filter", "SRP-RX-03", "ignores a report whose tStamp is older than that of the entry")
class StampFilter(NeighbourTable):
    def record(
        self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int
    ) -> Literal["new", "replaced", "full"]:
        old = self.lookup(report.node_id)
        if old is not None and report.t_stamp < old.ext_sd.t_stamp:
            return "replaced"
        return super().record(report, sender_id, now=now, wall=wall)


before(NeighbourTable, NeighbourTable.record)("four", "SRP-RX-03 SRP-NT-02", "stores at most four neighbours",
    lambda self, report, sender_id, *, now, wall: assign(self, capacity=4))  # fmt: skip


@mutant("bp-inactive", "SRP-SRV-01 SRP-SRV-03", "answers INACTIVE while BP is deactivated", unseen=BP_ALWAYS_ACTIVE)
class InactiveWithBP(StateReporting):
    def update_safety_data(
        self, data: SafetyData | Mapping[str, Any], *, now: int, wall: int
    ) -> UpdateSafetyDataConfirm | None:
        # SRP uses BP through the client port.
        port: Any = self._bp
        if not port._bp.active:
            return UpdateSafetyDataConfirm(SRPStatus.INACTIVE)
        return super().update_safety_data(data, now=now, wall=wall)


then(StateReporting, StateReporting.handle_payload)("postponed", "SRP-RUN-01 SRP-RUN-02",
    "starts a new interval between traversals with each report",
    lambda self, result, payload, sender_id, *, now, wall: assign(self, _traversed=now))  # fmt: skip


@mutant(
    "on-the-side",
    "SRP-RUN-01 SRP-RUN-02",
    "traverses the table only when another protocol is active",
    unseen=OTHERS_ACTIVE,
)
class OnTheSide(StateReporting):
    def poll_timeout(self) -> int | None:
        return None

    def handle_timeout(self, now: int, wall: int) -> None:
        self._table.expire(now, self._timeout)


@mutant("stumbles", "SRP-NT-02", "fails with an internal error when the neighbour table to be listed is empty")
class StumblesOverNothing(StateReporting):
    @property
    def neighbours(self) -> NeighbourTable:
        if not self._table:
            raise RuntimeError("nothing to list")
        return super().neighbours


then(StateReporting, StateReporting.set_parameter)("takes-anyway", "SRP-PAR-01", "uses a timeout that it has rejected",
    lambda self, violation, name, value: (
        assign(self, _timeout_ms=value) if violation is not None and isinstance(value, int) else None))  # fmt: skip
