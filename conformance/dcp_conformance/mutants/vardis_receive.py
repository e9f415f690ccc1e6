"""Faults in taking VarDis payloads apart, in the order of processing, and in what is left in the queues."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.errors import DecodeError
from dcp_codec.values import Container, VarCreate, VarDelete, VarSpec, VarSumm, VarUpdate
from dcp_stack.vardis import Vardis
from dcp_stack.vardis_core import Core
from dcp_stack.vardis_db import Database, DBEntry
from dcp_stack.vardis_receive import Receiver
from dcp_stack.vardis_wire import Extracted, Extractor

from .mutant import mutant

C, D, U = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.UPDATES
S, RC, RU = ICType.SUMMARIES, ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES

# -- extraction --------------------------------------------------------------------------------------------------------


class Containers(Extractor):
    """Takes other containers out of a payload."""

    def _collect(
        self, containers: tuple[Container, ...], offset: int, records: dict[ICType, list[tuple[int, Any]]]
    ) -> int:
        end = offset
        for container in containers:
            end += self._sizes.ic_header
            end += sum(self._sizes.record(self._kinds[container.ic_type], each) for each in container.records)
        super()._collect(tuple(self.chosen(containers)), offset, records)
        return end

    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        """The containers that are processed."""
        return containers


@mutant("first-half", "VD-RX-04", "processes only the first half of the containers of a payload")
class FirstHalf(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return containers[: (len(containers) + 1) // 2]


@mutant("first-only", "VD-RX-04 VD-RX-03", "processes only the first container of a payload")
class FirstContainer(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return containers[:1]


@mutant("octets", "VD-RX-04", "processes what starts in the first half of the octets of a payload")
class FirstHalfOctets(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        half = (len(payload) + 1) // 2
        records = {kind: [each for each in listed if each[0] < half] for kind, listed in found.records.items()}
        return Extracted(records, found.problems)


@mutant("last-octets", "VD-RX-04", "stops when three octets of a payload or fewer are left")
class LastOctets(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        start = self._sizes.ic_header
        records = {
            kind: [each for each in listed if each[0] <= start or each[0] - start + 3 < len(payload)]
            for kind, listed in found.records.items()
        }
        return Extracted(records, found.problems)


@mutant("same-type-ignored", "VD-RX-03", "ignores a second container of a type", since=SpecVersion.V1_1)
class SameTypeIgnored(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return tuple({each.ic_type: each for each in reversed(containers)}.values())[::-1]


@mutant("last-of-type", "VD-RX-03", "processes only the last container of a type", since=SpecVersion.V1_1)
class LastOfType(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return tuple({each.ic_type: each for each in containers}.values())


@mutant("adjacent-merged", "VD-RX-03", "takes two neighbouring containers of a type for one", since=SpecVersion.V1_1)
class AdjacentIgnored(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return containers[:1] + tuple(b for a, b in pairwise(containers) if a.ic_type != b.ic_type)


@mutant("sending-order", "VD-RX-02", "ignores containers that do not follow the order of composing")
class SendingOrder(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        order = (C, D, RC, S, U, RU)
        taken: list[Container] = []
        for each in containers:
            place = order.index(self._kinds[each.ic_type])
            if not taken or place >= order.index(self._kinds[taken[-1].ic_type]):
                taken.append(each)
        return tuple(taken)


@mutant("first-record", "VD-RX-09 VD-IC-01", "processes only the first record of a container")
class FirstRecord(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return tuple(Container(each.ic_type, each.records[:1], each.extra) for each in containers)


@mutant("backwards", "VD-RX-09", "processes the records of a container from the last to the first")
class Backwards(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return tuple(Container(each.ic_type, each.records[::-1], each.extra) for each in containers)


@mutant("signed-count", "VD-RX-09 VD-PAY-05 VD-IC-01", "takes icNumRecords above 127 for negative")
class SignedCount(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return tuple(each for each in containers if len(each.records) < 128)


class Fragile(Extractor):
    """Dies of some problem."""

    reasons: ClassVar[tuple[str, ...]] = ()

    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        for problem in found.problems:
            if problem.reason in self.reasons:
                raise IndexError(f"{problem.reason} at {problem.path}")
        return found


@mutant("dies-of-type", "VD-ROB-01 VD-RX-05", "dies of a container type that does not exist")
class DiesOfType(Fragile):
    reasons = ("unknown-type",)


@mutant("dies-of-zero", "VD-ROB-01 VD-RX-06", "dies of a container without records")
class DiesOfZero(Fragile):
    reasons = ("zero-count",)


@mutant("dies-of-end", "VD-ROB-01 VD-RX-07", "dies of a record that is cut off")
class DiesOfEnd(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        if any(problem.reason not in ("unknown-type", "zero-count") for problem in found.problems):
            raise IndexError("a read beyond the payload")
        return found


@mutant("dies-of-text", "VD-ROB-01", "dies of a description that is not UTF-8")
class DiesOfText(Receiver):
    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        record.spec.descr.decode()
        super()._create(record, offset, now, wall)


@mutant("mute", "VD-ROB-01", "ignores everything after ten payloads with an error")
class Mute(Extractor):
    errors = 0

    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        self.errors += bool(found.problems)
        return Extracted({kind: [] for kind in ICType}) if self.errors > 10 else found


@mutant("half-record", "VD-ROB-01 VD-RX-07", "processes a VarUpdate that is cut off with what is there of its value")
class HalfRecord(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        try:
            self._codec.decode_containers(payload)
        except DecodeError:
            for more in range(1, 40):
                try:
                    self._codec.decode_containers(payload + bytes(more))
                except DecodeError:
                    continue
                return super().extract(payload + bytes(more))
        return super().extract(payload)


# -- the order of processing -------------------------------------------------------------------------------------------


class Order(Receiver):
    """Processes types in another order."""

    order: ClassVar[tuple[ICType, ...]] = (C, D, U, S, RC, RU)

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        for kind in self.order:
            records = {each: extracted.records[each] if each is kind else [] for each in ICType}
            super().process(Extracted(records), now=now, wall=wall)


@mutant("payload-order", "VD-RX-01 VD-RX-08 VD-RX-02", "processes each container before it extracts the next")
class PayloadOrder(Receiver):
    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        listed = [(offset, kind, record) for kind, each in extracted.records.items() for offset, record in each]
        for offset, kind, record in sorted(listed, key=lambda each: each[0]):
            records = {each: [(offset, record)] if each is kind else [] for each in ICType}
            super().process(Extracted(records), now=now, wall=wall)


@mutant("updates-first", "VD-RX-08 VD-RX-01", "processes updates before creations")
class UpdatesFirst(Order):
    order = (U, C, D, S, RC, RU)


@mutant("deletes-first", "VD-RX-08", "processes deletions before creations")
class DeletesFirst(Order):
    order = (D, C, U, S, RC, RU)


@mutant("deletes-last", "VD-RX-08", "processes deletions after updates")
class DeletesLast(Order):
    order = (C, U, D, S, RC, RU)


@mutant("summaries-first", "VD-RX-08", "processes summaries before updates")
class SummariesFirst(Order):
    order = (C, D, S, U, RC, RU)


@mutant("requests-first", "VD-RX-08", "processes requests before creations and updates")
class RequestsFirst(Order):
    order = (RC, RU, C, D, U, S)


# -- what is stored ----------------------------------------------------------------------------------------------------


class Stores(Receiver):
    """Stores another creation."""

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        super()._create(self.record(record, wall), offset, now, wall)

    def record(self, record: VarCreate, wall: int) -> VarCreate:  # noqa: ARG002 - for those that look at it
        """What is stored instead."""
        return record

    def changed(self, record: VarCreate, **members: Any) -> VarCreate:
        """With other members of its VarSpec."""
        return VarCreate(msgspec.structs.replace(record.spec, **members), record.upd)


@mutant("seqno-zero", "VD-PC-07", "stores variables of others with sequence number 0")
class SeqnoZero(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:  # noqa: ARG002 - as above
        return VarCreate(record.spec, VarUpdate(record.upd.var_id, 0, record.upd.value))


@mutant("nul-value", "VD-PC-07 DATA-06", "stores values up to the first octet that is zero")
class NulValue(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:  # noqa: ARG002 - as above
        value = record.upd.value.partition(b"\0")[0] or record.upd.value
        return VarCreate(record.spec, VarUpdate(record.upd.var_id, record.upd.seqno, value))


@mutant(
    "producer",
    "VD-PC-10 VD-TYP-06",
    "puts itself as the producer into variables that it sends on",
    since=SpecVersion.V1_0,
)
class OtherProducer(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:  # noqa: ARG002 - as above
        own = record.spec.prod_id == self._core.own_id
        return record if own else self.changed(record, prod_id=self._core.own_id[:-1] + b"\x77")


@mutant(
    "creation-time",
    "VD-PC-10 VD-TYP-06",
    "gives variables that it sends on a creationTime of its own",
    since=SpecVersion.V2_0,
)
class OtherTime(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:
        entry = self._database.lookup(record.spec.var_id)
        fresh = entry is None or self._is_later(record, entry)
        return self.changed(record, creation_time=self._core.clock.stamp(wall)) if fresh else record


@mutant("repcnt-down", "VD-TYP-06 VD-PC-09", "sends variables on with a lower repCnt, as if it was a hop count")
class CountsHops(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:  # noqa: ARG002 - as above
        return self.changed(record, rep_cnt=max(record.spec.rep_cnt - 1, 1)) if record.spec.rep_cnt <= 15 else record


@mutant("timeout-lost", "VD-TYP-06 VD-TYP-04", "sends variables on without their timeout", since=SpecVersion.V2_0)
class TimeoutLost(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:  # noqa: ARG002 - as above
        return self.changed(record, timeout=0)


@mutant(
    "descr-nul", "DATA-07 VD-TYP-06", "sends descriptions on up to the first octet that is zero", since=SpecVersion.V1_1
)
class DescriptionNul(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:  # noqa: ARG002 - as above
        return self.changed(record, descr=record.spec.descr.partition(b"\0")[0] or record.spec.descr)


@mutant("descr-short", "VD-TYP-06", "sends at most 16 octets of a description on")
class DescriptionShort(Stores):
    def record(self, record: VarCreate, wall: int) -> VarCreate:  # noqa: ARG002 - as above
        longest = self._parameters.longest_description
        return self.changed(record, descr=record.spec.descr[:16]) if len(record.spec.descr) <= longest else record


class Inserts(Database):
    """Leaves another state behind when a variable is stored, updated or deleted."""

    forgets: ClassVar[str] = ""
    """The queue that is forgotten when a variable is stored anew or deleted."""
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


@mutant("deleteQ", CREATED, "leaves a variable in deleteQ that is created anew", since=SpecVersion.V2_0)
class CreateKeepsDelete(Inserts):
    forgets = "deleteQ"


@mutant("updateQ", CREATED, "leaves a variable in updateQ that is created anew", since=SpecVersion.V2_0)
class CreateKeepsUpdate(Inserts):
    forgets = "updateQ"


@mutant("reqUpdQ", CREATED, "leaves a variable in reqUpdQ that is created anew", since=SpecVersion.V2_0)
class CreateKeepsRequest(Inserts):
    forgets = "reqUpdQ"


@mutant("reqCreateQ", CREATED, "goes on requesting a variable that it has got")
class CreateKeepsCreate(Inserts):
    forgets = "reqCreateQ"


@mutant("createQ", DELETED, "leaves a variable in createQ that is deleted", since=SpecVersion.V1_3)
class DeleteKeepsCreate(Inserts):
    forgets, at = "createQ", "delete"


@mutant("updateQ", DELETED, "leaves a variable in updateQ that is deleted", since=SpecVersion.V1_3)
class DeleteKeepsUpdate(Inserts):
    forgets, at = "updateQ", "delete"


@mutant("summaryQ", DELETED + " VD-CMP-05", "leaves a variable in summaryQ that is deleted", since=SpecVersion.V2_0)
class DeleteKeepsSummary(Inserts):
    forgets, at = "summaryQ", "delete"


@mutant("reqUpdQ", DELETED, "leaves a variable in reqUpdQ that is deleted", since=SpecVersion.V2_0)
class DeleteKeepsRequest(Inserts):
    forgets, at = "reqUpdQ", "delete"


@mutant("request-kept", "VD-PU-08", "requests an update although it has come")
class RequestKept(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        asked = record.var_id in self._database.req_upd_q
        super()._update(record, offset, now, wall)
        if asked:
            self._database.req_upd_q.append(record.var_id)


@mutant("own-only", "VD-PC-09 VD-SCP-02", "does not send variables of others on")
class NotSentOn(Receiver):
    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        before = self._database.lookup(record.spec.var_id)
        super()._create(record, offset, now, wall)
        entry = self._database.lookup(record.spec.var_id)
        if entry is not None and entry is not before:
            entry.count_create = 0
            self._database.create_q.remove(record.spec.var_id)


@mutant("once", "VD-PC-09 VD-SCP-02", "sends variables of others on once, whatever repCnt is")
class SentOnOnce(Receiver):
    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        before = self._database.lookup(record.spec.var_id)
        super()._create(record, offset, now, wall)
        entry = self._database.lookup(record.spec.var_id)
        if entry is not None and entry is not before:
            entry.count_create = 1


@mutant("not-summarised", "VD-PC-09", "does not summarise variables of others")
class NotSummarised(Receiver):
    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        super()._create(record, offset, now, wall)
        entry = self._database.lookup(record.spec.var_id)
        if entry is not None and entry.spec.prod_id != self._core.own_id:
            self._database.summary_q.remove(record.spec.var_id)


@mutant("not-sent-on", "VD-PU-07 VD-SCP-02", "stores updates of others and does not send them on")
class UpdateNotSentOn(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.var_id)
        before = None if entry is None else entry.seqno
        super()._update(record, offset, now, wall)
        if entry is not None and entry.seqno != before:
            entry.count_update = 0
            self._database.update_q.remove(record.var_id)


@mutant("number-kept", "VD-PU-07", "stores the value of an update and keeps its own number")
class NumberKept(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.var_id)
        before = None if entry is None else entry.seqno
        super()._update(record, offset, now, wall)
        if entry is not None and before is not None:
            entry.seqno = before


@mutant("value-kept", "VD-PU-07", "stores the number of an update, and not its value")
class ValueKept(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.var_id)
        before = None if entry is None else entry.value
        super()._update(record, offset, now, wall)
        if entry is not None and before is not None:
            entry.value = before


@mutant("stamp-kept", "VD-DB-03 VD-PU-07 VD-REA-04", "keeps the time of the creation when an update comes")
class StampKept(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.var_id)
        before = None if entry is None else entry.t_stamp
        super()._update(record, offset, now, wall)
        if entry is not None and before is not None:
            entry.t_stamp = before


@mutant("not-sent-on", "VD-PD-04 VD-SCP-02", "deletes variables of others and does not send that on")
class DeleteNotSentOn(Receiver):
    def _delete(self, record: VarDelete, offset: int) -> None:
        entry = self._database.lookup(record.var_id)
        known = entry is not None and not entry.is_deleted
        super()._delete(record, offset)
        if known and entry is not None and entry.is_deleted:
            entry.count_delete = 0
            self._database.delete_q.remove(record.var_id)


@mutant("forgets", "VD-DB-02 VD-PD-04 VD-DEL-06", "forgets variables when they are deleted", since=SpecVersion.V2_0)
class ForgetsDeleted(Core):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.database.remove_deleted = True


@mutant(
    "remembers",
    "VD-DEL-06 VD-DB-02",
    "keeps deleted variables, as only later versions do",
    since=SpecVersion.V1_0,
    until=SpecVersion.V1_3,
)
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


@mutant("request-relayed", "VD-SCP-01", "sends requests for updates on that it can answer")
class RelaysRequests(Receiver):
    def _request_update(self, record: Any, offset: int) -> None:
        super()._request_update(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and not entry.is_deleted:
            self._database.req_upd_q.append(record.var_id)


@mutant("create-request-relayed", "VD-SCP-01 VD-RC-03", "sends requests for variables on that it can answer")
class RelaysCreateRequests(Receiver):
    def _request_create(self, record: Any, offset: int) -> None:
        super()._request_create(record, offset)
        if self._database.lookup(record.var_id) is not None:
            self._database.req_create_q.append(record.var_id)


@mutant("while-inactive", "VD-MGT-03", "processes payloads while it is inactive", since=SpecVersion.V1_2)
class ReceivesInactive(Vardis):
    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        self._receiver.process(self._extractor.extract(payload), now=now, wall=wall)


@mutant("later", "VD-MGT-03", "processes what came while it was inactive when it is activated", since=SpecVersion.V1_2)
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
