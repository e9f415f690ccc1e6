"""Faults in renewing the time stamp of a variable, from which its age is computed."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarCreate, VarSpec, VarUpdate
from dcp_selftest.mutants.family import attributes
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import ALWAYS_ACTIVE, NOT_ANEW, NOT_REPLACED
from dcp_stack.vardis.confirms import Confirm, DescribeVariableConfirm, ReadConfirm
from dcp_stack.vardis.database import Database, DBEntry
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.wire import Extracted

V2 = SpecVersion.V2_0
V1_2 = SpecVersion.V1_2


# -- what renews tStamp ------------------------------------------------------------------------------------------------


class Renews(Receiver):
    """Renews a variable on some records that change nothing."""

    kinds: ClassVar[tuple[str, ...]]
    own: ClassVar[bool] = False
    """Whether it also does so for its own variables."""

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        self._now, self._wall = now, wall
        super().process(extracted, now=now, wall=wall)

    def _seen(self, kind: str, var_id: int) -> None:
        entry = self._database.lookup(var_id)
        if kind in self.kinds and entry is not None and (self.own or entry.spec.prod_id != self._core.own_id):
            entry.refreshed, entry.t_stamp = self._now, self._wall

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.spec.var_id)
        received, stored = record.spec.creation_time, entry.spec.creation_time if entry is not None else None
        if received is not None and stored is not None and received <= stored:
            self._seen("equal-create" if received == stored else "earlier-create", record.spec.var_id)
        super()._create(record, offset, now, wall)

    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.var_id)
        if entry is not None and record.seqno == entry.seqno:
            self._seen("equal-update", record.var_id)
        elif entry is not None and self._core.sequence.received_is_older(record.seqno, entry.seqno):
            self._seen("older-update", record.var_id)
        super()._update(record, offset, now, wall)

    def _summary(self, record: Any, offset: int) -> None:
        self._seen("summary", record.var_id)
        super()._summary(record, offset)

    def _request_update(self, record: Any, offset: int) -> None:
        self._seen("update-request", record.var_id)
        super()._request_update(record, offset)

    def _request_create(self, record: Any, offset: int) -> None:
        self._seen("create-request", record.var_id)
        super()._request_create(record, offset)


# fmt: off
renews = attributes(Renews, __name__)
renews("equal-create-renews", "VD-SCR-06 VD-PC-01 VD-DB-03", "renews tStamp when the same VarCreate is received again",
    since=V2, kinds=("equal-create",))
renews("earlier-create-renews", "VD-SCR-06 VD-PC-01 VD-DB-03", "renews tStamp when an earlier VarCreate is received",
    since=V2, kinds=("earlier-create",))
renews("equal-update-renews", "VD-SCR-06 VD-PU-05 VD-DB-03", "renews tStamp when the same VarUpdate is received again",
    kinds=("equal-update",))
renews("older-update-renews", "VD-SCR-06 VD-PU-06 VD-DB-03", "renews tStamp when an older VarUpdate is received",
    kinds=("older-update",))
renews("summary-renews", "VD-SCR-06 VD-DB-03", "renews tStamp when a VarSumm is received", kinds=("summary",))
renews("update-request-renews", "VD-SCR-06 VD-DB-03", "renews tStamp when a VarReqUpdate is received",
    kinds=("update-request",))
renews("create-request-renews", "VD-SCR-06 VD-DB-03", "renews tStamp when a VarReqCreate is received",
    kinds=("create-request",))
# fmt: on


class RenewsOwn(Renews):
    """Renews only the node's own variables."""

    own = True

    def _seen(self, kind: str, var_id: int) -> None:
        entry = self._database.lookup(var_id)
        if entry is not None and entry.spec.prod_id == self._core.own_id:
            super()._seen(kind, var_id)


renews_own = attributes(RenewsOwn, __name__)
renews_own("own-echo-renews", "VD-SCR-06 VD-DB-03",
    "renews tStamp of its own variable when neighbours forward its records",
    since=V2, kinds=("equal-create", "equal-update", "summary"))  # fmt: skip
renews_own("own-request-renews", "VD-SCR-06 VD-DB-03", "renews tStamp of its own variable when a neighbour requests it",
    kinds=("create-request", "update-request"))  # fmt: skip


@mutant("read-renews", "VD-DB-03 VD-SCR-06", "renews tStamp when RTDB-Read or RTDB-DescribeVariable is called")
class ReadRenews(Vardis):
    _times = (0, 0)

    def handle_timeout(self, now: int, wall: int) -> None:
        self._times = (now, wall)
        super().handle_timeout(now, wall)

    def _renew(self, var_id: int) -> None:
        entry = self._database.lookup(var_id)
        if entry is not None and self._times[0] > entry.refreshed:
            entry.refreshed, entry.t_stamp = self._times

    def read(self, var_id: int) -> ReadConfirm:
        self._renew(var_id)
        return super().read(var_id)

    def describe_variable(self, var_id: int) -> DescribeVariableConfirm:
        self._renew(var_id)
        return super().describe_variable(var_id)


@mutant("refused-update-renews", "VD-DB-03 VD-UPD-08", "renews tStamp when RTDB-Update is rejected")
class RefusedUpdateRenews(Vardis):
    def update(self, var_id: int, value: bytes, *, now: int, wall: int) -> Confirm:
        confirm = super().update(var_id, value, now=now, wall=wall)
        entry = self._database.lookup(var_id)
        if entry is not None and not entry.is_deleted and not confirm.status.is_ok:
            entry.refreshed, entry.t_stamp = now, wall
        return confirm


@mutant(
    "activation-renews",
    "VD-DB-03 VD-MGT-05",
    "renews tStamp of all variables when it is activated",
    unseen=ALWAYS_ACTIVE,
)
class ActivationRenews(Vardis):
    _times = (0, 0)

    def handle_timeout(self, now: int, wall: int) -> None:
        self._times = (now, wall)
        super().handle_timeout(now, wall)

    def activate(self) -> Confirm:
        for entry in self._database.entries.values():
            entry.refreshed, entry.t_stamp = self._times
        return super().activate()


class StaleAge(Database):
    """Keeps the age of a variable that is created again."""

    own: ClassVar[bool]

    def insert(self, spec: VarSpec, value: bytes, seqno: int, *, now: int, wall: int) -> DBEntry:
        before = self.lookup(spec.var_id)
        entry = super().insert(spec, value, seqno, now=now, wall=wall)
        # Only RTDB-Create uses sequence number 0 here; the cases send others.
        if before is not None and (seqno == 0) is self.own and before.spec.prod_id == spec.prod_id:
            entry.refreshed, entry.t_stamp = before.refreshed, before.t_stamp
        return entry


stale_age = attributes(StaleAge, __name__)
stale_age("own-age-kept", "VD-CRE-10 VD-SCR-03 VD-DB-03", "keeps tStamp when its application creates a variable again",
    unseen=NOT_ANEW, own=True)  # fmt: skip
stale_age("age-kept", "VD-PC-07 VD-SCR-03 VD-DB-03", "keeps tStamp when a later VarCreate replaces a variable",
    unseen=NOT_REPLACED, own=False)  # fmt: skip
