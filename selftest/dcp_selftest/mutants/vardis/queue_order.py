"""Faults of VarDis in the order of its queues, and heuristics that limit requests and answers."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate
from dcp_selftest.mutants.entries import on_entry
from dcp_selftest.mutants.family import assign, attributes, instead, then
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NOT_REPLACED
from dcp_stack.config import MS
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.confirms import Confirm
from dcp_stack.vardis.database import Database, IdQueue
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.wire import ContainerType, Extracted

QUEUES = {
    ICType.CREATE_VARIABLES: "create_q",
    ICType.DELETE_VARIABLES: "delete_q",
    ICType.UPDATES: "update_q",
    ICType.SUMMARIES: "summary_q",
    ICType.REQUEST_VARCREATES: "req_create_q",
    ICType.REQUEST_VARUPDATES: "req_upd_q",
}


# -- order -------------------------------------------------------------------------------------------------------------


class Stays(Composer):
    """Leaves a record with repetitions left at its place in the queue instead of moving it to the tail."""

    kind: ClassVar[ICType]

    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, used = super()._fitting(kind, queue, room, largest)
        self.first = chosen if kind is self.kind else []
        return chosen, used

    def _take(self, kind: ContainerType, var_id: int) -> Any:
        record = super()._take(kind, var_id)
        if kind is self.kind and var_id == self.first[-1]:
            queue: IdQueue = getattr(self._database, QUEUES[kind])
            for each in reversed(self.first):
                if each in queue:
                    queue.move_to_end(each, last=False)
        return record


# fmt: off
stays = attributes(Stays, __name__)
stays("deletes-stay", "VD-CMP-10", "leaves a VarDelete with repetitions left at the head of deleteQ",
    kind=ICType.DELETE_VARIABLES)
# fmt: on


class Arranged(Composer):
    """Reads a queue in another order."""

    kind: ClassVar[ICType]

    def compose(self, room: int) -> Any:
        queue: IdQueue = getattr(self._database, QUEUES[self.kind])
        for var_id in self.arranged([*queue]):
            queue.move_to_end(var_id)
        return super().compose(room)

    def arranged(self, ids: list[int]) -> list[int]:
        """Return the identifiers of the queue in the order in which they are sent."""
        return sorted(ids)


# fmt: off
arranged = attributes(Arranged, __name__)
arranged("deletes-sorted", "VD-CMP-10 VD-DEL-05", "sends VarDeletes in the order of identifiers",
    kind=ICType.DELETE_VARIABLES)
backwards = instead(Arranged, Arranged.arranged)
backwards("requests-backwards", "VD-CMP-12 VD-PS-01 DATA-12", "sends the newest requests for variables first",
    lambda self, ids: ids[::-1], kind=ICType.REQUEST_VARCREATES)
backwards("update-requests-backwards", "VD-CMP-11 VD-PS-04 DATA-12", "sends the newest requests for updates first",
    lambda self, ids: ids[::-1], kind=ICType.REQUEST_VARUPDATES)
then(Database, Database.insert)("summary-first", "VD-CRE-12 VD-PC-09",
    "puts a new variable at the head of summaryQ",
    lambda self, entry, spec, value, seqno, *, now, wall: self.summary_q.move_to_end(spec.var_id, last=False))
then(Database, Database.insert)("create-first", "VD-CRE-12 VD-PC-09",
    "puts a new variable at the head of createQ",
    lambda self, entry, spec, value, seqno, *, now, wall: (
        self.create_q.move_to_end(spec.var_id, last=False) if spec.var_id in self.create_q else None))
then(Database, Database.mark_deleted)("delete-first", "VD-DEL-05 VD-PD-04",
    "puts a deleted variable at the head of deleteQ",
    lambda self, result, entry: (
        self.delete_q.move_to_end(entry.spec.var_id, last=False) if entry.spec.var_id in self.delete_q else None))
then(Database, Database.arm_update)("update-last", "VD-UPD-09 VD-PU-07",
    "moves a variable to the tail of updateQ when it is updated again",
    lambda self, result, entry: (
        self.update_q.move_to_end(entry.spec.var_id) if entry.spec.var_id in self.update_q else None))
then(Database, Database.arm_create)("create-last", "VD-RC-03",
    "moves a variable to the tail of createQ when it is requested again",
    lambda self, result, entry: (
        self.create_q.move_to_end(entry.spec.var_id) if entry.spec.var_id in self.create_q else None))
then(Database, Database.store)("summary-renewed", "VD-CMP-03",
    "moves a variable to the tail of summaryQ when it is updated",
    lambda self, result, entry, value, seqno, *, now, wall: self.summary_q.rotate(entry.spec.var_id))
# fmt: on


@mutant("updates-wait", "VD-PAY-02 VD-PAY-01", "sends no VarUpdates in a payload with VarCreates")
class UpdatesWait(Composer):
    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, used = super()._fitting(kind, queue, room, largest)
        if kind is ICType.CREATE_VARIABLES:
            self.__dict__["made"] = bool(chosen)
        return ([], 0) if kind is ICType.UPDATES and self.__dict__.get("made") else (chosen, used)

    def compose(self, room: int) -> Any:
        self.__dict__["made"] = False
        return super().compose(room)


# -- heuristics --------------------------------------------------------------------------------------------------------


class Limits(Receiver):
    """Gives up requests or answers for a variable."""

    times: ClassVar[int] = 5

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        self.now = now
        super().process(extracted, now=now, wall=wall)

    def again(self, what: str, var_id: int) -> bool:
        """Count an event of a variable, and return whether it was seldom enough so far."""
        counts: dict[tuple[str, int], int] = self.__dict__.setdefault("counts", {})
        counts[what, var_id] = counts.get((what, var_id), 0) + 1
        return counts[what, var_id] <= self.times

    def recent(self, what: str, var_id: int, wait: int) -> bool:
        """Return whether the same event was less than ``wait`` ms ago, and note it otherwise."""
        last: dict[tuple[str, int], int] = self.__dict__.setdefault("last", {})
        if self.now - last.get((what, var_id), -(1 << 62)) < wait * MS:
            return True
        last[what, var_id] = self.now
        return False


@mutant("five-requests", "VD-PS-01 VD-PU-01", "requests a variable at most five times")
class FiveRequests(Limits):
    def _request(self, var_id: int, offset: int) -> None:
        if self.again("create", var_id):
            super()._request(var_id, offset)


@mutant("five-update-requests", "VD-PS-04", "requests updates of a variable at most five times")
class FiveUpdateRequests(Limits):
    def _summary(self, record: Any, offset: int) -> None:
        before = record.var_id in self._database.req_upd_q
        super()._summary(record, offset)
        if not before and record.var_id in self._database.req_upd_q and not self.again("update", record.var_id):
            self._database.req_upd_q.remove(record.var_id)


@mutant("five-lessons", "VD-PS-03 VD-PU-06", "answers old summaries of a variable at most five times")
class FiveLessons(Limits):
    def _summary(self, record: Any, offset: int) -> None:
        before = record.var_id in self._database.update_q
        super()._summary(record, offset)
        entry = self._database.lookup(record.var_id)
        taught = entry is not None and not before and record.var_id in self._database.update_q
        if entry is not None and taught and not self.again("lesson", record.var_id):
            self._database.update_q.remove(record.var_id)
            entry.count_update = 0


@mutant("faulty-sender-ignored", "VD-ROB-01", "ignores a sender for 60 s after eight payloads with errors")
class FaultySenderIgnored(Vardis):
    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        faults: dict[bytes, tuple[int, int]] = self.__dict__.setdefault("faults", {})
        sender: bytes = self._core.delivery.peer
        count, since = faults.get(sender, (0, now))
        if self._extractor.extract(payload).problems:
            faults[sender] = count, since = count + 1, now
        if count < 8 or now - since > 60_000 * MS:
            super().handle_payload(payload, now=now, wall=wall)


@mutant("created-first", "VD-CMP-03 VD-CRE-12", "begins its summaries with the first variable again after RTDB-Create")
class CreatedFirst(Vardis):
    def create(self, *args: Any, **params: Any) -> Confirm:
        confirm = super().create(*args, **params)
        queue = self._database.summary_q
        for var_id in [each for each in self._database.entries if each in queue]:
            queue.rotate(var_id)
        return confirm


@mutant("own-by-suffix", "VD-PC-03 VD-PU-03 DATA-04",
    "treats variables of producers with the last four octets of its own identifier as its own")  # fmt: skip
class OwnBySuffix(Receiver):
    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        if record.spec.prod_id[-4:] != self._core.own_id[-4:] or record.spec.prod_id == self._core.own_id:
            super()._create(record, offset, now, wall)


on_entry(Receiver, Receiver._create)("pending-update-left", "VD-PC-08",
    "continues to send the VarUpdate of a variable that another node creates again",
    lambda self, entry, before: (
        assign(entry, count_update=min(before.count_update, entry.spec.rep_cnt))
        or self._database.update_q.append(entry.spec.var_id)
        if before.count_update and before.spec is not entry.spec else None),
    since=SpecVersion.V2_0, unseen=NOT_REPLACED)  # fmt: skip
