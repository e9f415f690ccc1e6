"""Faults in what VarDis stores of received records, and in its queues."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarCreate, VarSpec, VarSumm, VarUpdate
from dcp_selftest.mutants.entries import drop, on_entry
from dcp_selftest.mutants.family import assign, attributes, instead, skips
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import ALWAYS_ACTIVE, NO_TIMES, NOT_REPLACED, PURGED
from dcp_selftest.mutants.vardis.records import present
from dcp_stack.vardis.core import Core
from dcp_stack.vardis.database import Database, DBEntry
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver

# -- what is stored ----------------------------------------------------------------------------------------------------


class Stores(Receiver):
    """Changes the VarCreate to be stored."""

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        super()._create(self.record(record, wall), offset, now, wall)

    def record(self, record: VarCreate, wall: int) -> VarCreate:
        """Return the record to be stored."""
        return record

    def changed(self, record: VarCreate, **members: Any) -> VarCreate:
        """Return the record with changed members of its VarSpec, except those that its version lacks."""
        return VarCreate(msgspec.structs.replace(record.spec, **present(record.spec, members)), record.upd)


record = instead(Stores, Stores.record)
record("seqno-zero", "VD-PC-07", "stores variables of other nodes with sequence number 0",
    lambda self, record, wall: VarCreate(record.spec, VarUpdate(record.upd.var_id, 0, record.upd.value)))  # fmt: skip
record("nul-value", "VD-PC-07 DATA-06", "stores values only up to the first zero octet",
    lambda self, record, wall: (
        VarCreate(record.spec, VarUpdate(record.upd.var_id, record.upd.seqno,
        record.upd.value[:1] + record.upd.value[1:].partition(b"\0")[0]))))  # fmt: skip
record("producer", "VD-PC-10 VD-TYP-06", "forwards variables with itself as the producer",
    lambda self, record, wall: (
        record if record.spec.prod_id == self._core.own_id
        else self.changed(record, prod_id=self._core.own_id[:-1] + b"\x77")))  # fmt: skip


@mutant("creation-time", "VD-PC-10 VD-TYP-06", "forwards variables with its own creationTime", unseen=NO_TIMES)
class OtherTime(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:
        entry = self._database.lookup(record.spec.var_id)
        fresh = entry is None or self._is_later(record, entry)
        return self.changed(record, creation_time=self._core.clock.stamp(wall)) if fresh else record


# fmt: off
record("repcnt-down", "VD-TYP-06 VD-PC-09", "forwards variables with a decremented repCnt, like a hop count",
    lambda self, record, wall: (
        self.changed(record, rep_cnt=max(record.spec.rep_cnt - 1, 1)) if record.spec.rep_cnt <= 15 else record))
record("timeout-lost", "VD-TYP-06 VD-TYP-04", "forwards variables without their timeout",
    lambda self, record, wall: self.changed(record, timeout=0), unseen=NO_TIMES)
record("descr-nul", "DATA-07 VD-TYP-06", "forwards descriptions only up to the first zero octet",
    lambda self, record, wall: self.changed(record, descr=record.spec.descr.partition(b"\0")[0] or record.spec.descr),
    since=SpecVersion.V1_1)
record("descr-short", "VD-TYP-06", "forwards at most 16 octets of a description",
    lambda self, record, wall: (
        self.changed(record, descr=record.spec.descr[:16])
        if len(record.spec.descr) <= self._parameters.longest_description else record))
# fmt: on


class Inserts(Database):
    """Leaves a variable in a queue when it is stored, updated or deleted."""

    forgets: ClassVar[str] = ""
    """The queue from which the variable is not removed when it is stored again or deleted."""
    at: ClassVar[str] = "create"

    def insert(self, spec: VarSpec, value: bytes, seqno: int, *, now: int, wall: int) -> DBEntry:
        kept = self.at == "create" and spec.var_id in self.queues.get(self.forgets, ())
        old = self.lookup(spec.var_id)
        entry = super().insert(spec, value, seqno, now=now, wall=wall)
        if kept:
            self.queues[self.forgets].append(spec.var_id)
            entry.count_update = max(entry.count_update, 0 if old is None else old.count_update)
            entry.count_delete = 0 if old is None else old.count_delete
        return entry

    def mark_deleted(self, entry: DBEntry) -> None:
        var_id, update, create = entry.spec.var_id, entry.count_update, entry.count_create
        kept = self.at == "delete" and var_id in self.queues.get(self.forgets, ())
        super().mark_deleted(entry)
        if kept:
            self.queues[self.forgets].append(var_id)
            entry.count_update = update if self.forgets == "updateQ" else 0
            entry.count_create = create if self.forgets == "createQ" else 0


CREATED = "VD-PC-08 VD-CRE-11"
DELETED = "VD-PD-04 VD-DEL-05"


# fmt: off
inserts = attributes(Inserts, __name__)
inserts("deleteQ", CREATED, "leaves a variable in deleteQ when it is created again",
    unseen=NOT_REPLACED, forgets="deleteQ")
inserts("updateQ", CREATED, "leaves a variable in updateQ when it is created again",
    unseen=NOT_REPLACED, forgets="updateQ")
inserts("reqUpdQ", CREATED, "leaves a variable in reqUpdQ when it is created again",
    unseen=NOT_REPLACED, forgets="reqUpdQ")
inserts("reqCreateQ", CREATED, "continues to request a variable that it has received", forgets="reqCreateQ")
inserts("createQ", DELETED, "leaves a variable in createQ when it is deleted", forgets="createQ", at="delete")
inserts("updateQ", DELETED, "leaves a variable in updateQ when it is deleted", forgets="updateQ", at="delete")
inserts("summaryQ", DELETED + " VD-CMP-05", "leaves a variable in summaryQ when it is deleted",
    unseen=PURGED, forgets="summaryQ", at="delete")
inserts("reqUpdQ", DELETED, "leaves a variable in reqUpdQ when it is deleted",
    unseen=PURGED, forgets="reqUpdQ", at="delete")
# fmt: on


@mutant(
    "counters-kept",
    "VD-PC-07",
    "keeps countUpdate and countDelete of a variable when a later VarCreate replaces it",
    unseen=NOT_REPLACED,
)
class CountersKept(Database):
    def insert(self, spec: VarSpec, value: bytes, seqno: int, *, now: int, wall: int) -> DBEntry:
        before = self.lookup(spec.var_id)
        entry = super().insert(spec, value, seqno, now=now, wall=wall)
        # Only RTDB-Create uses sequence number 0 here; the cases send others.
        if before is not None and seqno:
            entry.count_update, entry.count_delete = before.count_update, before.count_delete
        return entry


@mutant("request-kept", "VD-PU-08", "requests an update that it has received")
class RequestKept(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        asked = record.var_id in self._database.req_upd_q
        super()._update(record, offset, now, wall)
        if asked:
            self._database.req_upd_q.append(record.var_id)


# fmt: off
on_create = on_entry(Receiver, Receiver._create)
on_create("own-only", "VD-PC-09 VD-SCP-02", "does not forward variables of other nodes",
    lambda self, entry, before: drop(self._database.create_q, entry, count_create=0))
on_create("once", "VD-PC-09 VD-SCP-02", "forwards variables of other nodes once, whatever the repCnt",
    lambda self, entry, before: assign(entry, count_create=1))
on_create("not-summarised", "VD-PC-09", "does not summarise variables of other nodes",
    lambda self, entry, before: drop(self._database.summary_q, entry))
skips(Receiver, Receiver._update)("same-value", "VD-PU-07", "ignores a VarUpdate with the stored value",
    lambda self, record, offset, now, wall: (
        (entry := self._database.lookup(record.var_id)) is not None and entry.value == record.value))
on_update = on_entry(Receiver, Receiver._update)
on_update("not-sent-on", "VD-PU-07 VD-SCP-02", "stores updates of other nodes without forwarding them",
    lambda self, entry, before: drop(self._database.update_q, entry, when=entry.seqno != before.seqno, count_update=0))
on_update("number-kept", "VD-PU-07", "stores the value of a VarUpdate, but keeps its old sequence number",
    lambda self, entry, before: assign(entry, seqno=before.seqno))
on_update("value-kept", "VD-PU-07", "stores the sequence number of a VarUpdate, but not its value",
    lambda self, entry, before: assign(entry, value=before.value))
on_update("stamp-kept", "VD-DB-03 VD-PU-07 VD-REA-04",
    "keeps the time stamp of the creation when it receives an update",
    lambda self, entry, before: assign(entry, t_stamp=before.t_stamp))
on_entry(Receiver, Receiver._delete)("not-sent-on", "VD-PD-04 VD-SCP-02",
    "deletes variables of other nodes without forwarding the VarDelete",
    lambda self, entry, before: (
        drop(self._database.delete_q, entry, when=entry.is_deleted and not before.is_deleted, count_delete=0)))
# fmt: on


@mutant(
    "forgets",
    "VD-DB-02 VD-PD-04 VD-DEL-06",
    "removes variables from the database when they are deleted",
    since=SpecVersion.V2_0,
)
class ForgetsDeleted(Core):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.database.remove_deleted = True


@mutant("remembers", "VD-DEL-08", "keeps deleted variables in the database, as in later versions")
class RemembersDeleted(Core):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.database.remove_deleted = False


# -- single hop --------------------------------------------------------------------------------------------------------


@mutant("summary-copied", "VD-SCP-01 VD-CMP-04", "copies the number of a summary into its own summaries")
class CopiesSummaries(Receiver):
    def _summary(self, record: VarSumm, offset: int) -> None:
        super()._summary(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and not entry.is_deleted and entry.spec.prod_id != self._core.own_id:
            entry.seqno = record.seqno


# fmt: off
on_entry(Receiver, Receiver._request_update)("request-relayed", "VD-SCP-01",
    "forwards requests for updates that it can answer",
    lambda self, entry, before: self._database.req_upd_q.append(entry.spec.var_id) if not entry.is_deleted else None)
on_entry(Receiver, Receiver._request_create)("create-request-relayed", "VD-SCP-01 VD-RC-03",
    "forwards requests for variables that it can answer",
    lambda self, entry, before: self._database.req_create_q.append(entry.spec.var_id))
instead(Vardis, Vardis.handle_payload)("while-inactive", "VD-MGT-03", "processes payloads while it is inactive",
    lambda self, payload, *, now, wall: self._receiver.process(self._extractor.extract(payload), now=now, wall=wall),
    unseen=ALWAYS_ACTIVE)
# fmt: on


@mutant(
    "later", "VD-MGT-03", "processes payloads received while it was inactive when it is activated", unseen=ALWAYS_ACTIVE
)
class ReceivesLater(Vardis):
    def __init__(self, *args: Any, **times: Any) -> None:
        super().__init__(*args, **times)
        self._kept: list[bytes] = []

    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        if not self.active:
            self._kept.append(payload)
            return
        for each in (*self._kept, payload):
            super().handle_payload(each, now=now, wall=wall)
        self._kept = []
