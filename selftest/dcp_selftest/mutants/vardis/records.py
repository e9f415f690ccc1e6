"""Faults in the records that VarDis sends: number of repetitions, and contents."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_codec.values import (
    Beacon,
    Container,
    Payload,
    VarCreate,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)
from dcp_selftest.mutants.air import Air
from dcp_selftest.mutants.family import assign, attributes, instead, skips, then
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NO_TIMES
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.database import Database, DBEntry
from dcp_stack.vardis.wire import ContainerType

C = ICType.CREATE_VARIABLES
S, RC, RU = ICType.SUMMARIES, ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES


# -- how often ---------------------------------------------------------------------------------------------------------


class Counts(Database):
    """Changes the number of repetitions."""

    creates: ClassVar[int] = 0
    updates: ClassVar[int] = 0
    deletes: ClassVar[int] = 0

    def arm_create(self, entry: DBEntry) -> None:
        super().arm_create(entry)
        entry.count_create += self.creates if entry.count_create > 1 or self.creates > 0 else 0

    def arm_update(self, entry: DBEntry) -> None:
        super().arm_update(entry)
        entry.count_update += self.updates if entry.count_update > 1 or self.updates > 0 else 0

    def mark_deleted(self, entry: DBEntry) -> None:
        super().mark_deleted(entry)
        if entry.count_delete:
            entry.count_delete += self.deletes if entry.count_delete > 1 or self.deletes > 0 else 0


counts = attributes(Counts, __name__)
counts("one-more", "VD-CMP-06 VD-SCP-02 VD-CRE-12 VD-PC-09", "sends VarCreates once more than repCnt", creates=1)
counts("one-less", "VD-CMP-06 VD-SCP-02 VD-CRE-12 VD-PC-09", "sends VarCreates once less than repCnt", creates=-1)
counts("one-more", "VD-CMP-09 VD-SCP-02 VD-UPD-08 VD-PU-07", "sends VarUpdates once more than repCnt", updates=1)
counts("one-less", "VD-CMP-09 VD-SCP-02 VD-UPD-08 VD-PU-07", "sends VarUpdates once less than repCnt", updates=-1)
counts("one-more", "VD-CMP-10 VD-SCP-02 VD-DEL-05 VD-PD-04", "sends VarDeletes once more than repCnt", deletes=1)
counts("one-less", "VD-CMP-10 VD-SCP-02 VD-DEL-05 VD-PD-04", "sends VarDeletes once less than repCnt", deletes=-1)
then(Database, Database.arm_create)("capped", "VD-CMP-06 VD-SCP-02 VD-CRE-12 VD-PC-09",
    "sends VarCreates at most seven times",
    lambda self, result, entry: assign(entry, count_create=min(entry.count_create, 7)))  # fmt: skip
skips(Database, Database.arm_update)("not-restarted", "VD-UPD-08 VD-PU-07",
    "does not restart the repetitions of a VarUpdate when the variable is updated again",
    lambda self, entry: bool(entry.count_update))  # fmt: skip


@mutant("no-rotation", "VD-CMP-06 VD-PAY-06", "sends all repetitions of one VarCreate before it sends the next")
class NoRotation(Composer):
    def _take(self, kind: ContainerType, var_id: int) -> Any:
        record = super()._take(kind, var_id)
        queue = self._database.create_q
        if kind is C and var_id in queue:
            for each in [each for each in queue if each != var_id]:
                queue.rotate(each)
        return record


VarSpecKey = tuple[int, int | None]
"""Identifier and creationTime, which together identify a creation."""


# -- what records say --------------------------------------------------------------------------------------------------


class Records(Composer):
    """Changes records to be sent."""

    def _take(self, kind: ContainerType, var_id: int) -> Any:
        return self.record(super()._take(kind, var_id), self._database.lookup(var_id))

    def record(self, record: Any, entry: DBEntry | None) -> Any:
        """Return the record to be sent."""
        return record


record = instead(Records, Records.record)
record("summary-behind", "VD-CMP-04", "summarises the sequence number before the current one",
    lambda self, record, entry: (
        VarSumm(record.var_id, max(record.seqno - 1, 0)) if isinstance(record, VarSumm) else record))  # fmt: skip


@mutant("first-number", "VD-CMP-04", "summarises the first sequence number of a variable")
class FirstNumber(Records):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.first: dict[VarSpecKey, int] = {}

    def record(self, record: Any, entry: DBEntry | None) -> Any:
        if not isinstance(record, VarSumm) or entry is None:
            return record
        return VarSumm(record.var_id, self.first.setdefault((record.var_id, entry.spec.creation_time), record.seqno))


record("seqno-zero", "VD-CMP-07", "sends VarCreates with sequence number 0",
    lambda self, record, entry: (
        record if not isinstance(record, VarCreate)
        else VarCreate(record.spec, VarUpdate(record.upd.var_id, 0, record.upd.value))))  # fmt: skip


@mutant("first-value", "VD-CMP-07 VD-UPD-10", "sends VarCreates with the first value of the variable")
class FirstValue(Records):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.first: dict[VarSpecKey, VarCreate] = {}

    def record(self, record: Any, entry: DBEntry | None) -> Any:
        if not isinstance(record, VarCreate):
            return record
        return self.first.setdefault((record.spec.var_id, record.spec.creation_time), record)


@mutant("first-update", "VD-UPD-10 VD-UPD-09", "repeats a VarUpdate with the value at the time of its queueing")
class FirstUpdate(Records):
    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.queued: dict[int, VarUpdate] = {}

    def record(self, record: Any, entry: DBEntry | None) -> Any:
        if not isinstance(record, VarUpdate) or entry is None:
            return record
        sent = self.queued.setdefault(record.var_id, record)
        if not entry.count_update:
            del self.queued[record.var_id]
        return sent


@mutant("received-number", "VD-CMP-11", "requests updates with the sequence number in the summary instead of its own")
class WantedNumber(Air):
    def _build(self, now: int, wall: int) -> None:
        super()._build(now, wall)
        self.wanted: dict[int, int] = {}

    def hears(self, octets: bytes) -> Iterable[bytes]:
        for each in self.instructions(octets):
            if self.kind(each) is S:
                self.wanted.update({record.var_id: record.seqno for record in each.records})
        yield octets

    def containers(self, containers: tuple[Container, ...]) -> Iterable[Container]:
        for each in containers:
            if self.kind(each) is not RU:
                yield each
                continue
            wanted = (VarReqUpdate(record.var_id, self.wanted.get(record.var_id, 0)) for record in each.records)
            yield Container(each.ic_type, tuple(wanted))


# fmt: off
record("ahead", "VD-CMP-11", "requests updates with the sequence number after its own",
    lambda self, record, entry: (
        VarReqUpdate(record.var_id, (record.seqno + 1) % 256) if isinstance(record, VarReqUpdate) else record))
# fmt: on


class Again(Air):
    """Sends some requests a second time in the next payload."""

    kind_again: ClassVar[ICType] = RU

    def _build(self, now: int, wall: int) -> None:
        super()._build(now, wall)
        self.again: Container | None = None

    def blocks(self, beacon: Beacon) -> Iterable[Payload]:
        found = [each for block in beacon.payloads for each in block.vardis or () if self.kind(each) is self.kind_again]
        again, self.again = self.again, found[0] if found and self.again is None else None
        for block in beacon.payloads:
            if block.vardis is None or again is None:
                yield block
            else:
                yield Payload(block.protocol_id, (*block.vardis, again))
                again = None
        if again is not None:
            yield Payload(BP_PROTID_VARDIS, (again,))


again = attributes(Again, __name__)
again("twice", "VD-CMP-11", "sends each request for an update twice", kind_again=RU)
again("twice", "VD-CMP-12 VD-PS-01", "sends each request for a variable twice", kind_again=RC)
then_take = then(Composer, Composer._take)
then_take("until-answered", "VD-CMP-12", "requests a variable in every payload until it has it",
    lambda self, record, kind, var_id: (
        self._database.req_create_q.append(var_id) if isinstance(record, VarReqCreate) else None))  # fmt: skip
then_take("update-until-answered", "VD-CMP-11", "requests an update in every payload until it has it",
    lambda self, record, kind, var_id: (
        self._database.req_upd_q.append(var_id) if isinstance(record, VarReqUpdate) else None))  # fmt: skip


# -- own creations on the wire -----------------------------------------------------------------------------------------


def present(spec: VarSpec, members: dict[str, Any]) -> dict[str, Any]:
    """Return the members without those that the version of this VarSpec lacks: they have no value."""
    return {name: value for name, value in members.items() if getattr(spec, name) is not None}


class OwnSpec(Records):
    """Changes the VarSpec in VarCreates."""

    def record(self, record: Any, entry: DBEntry | None) -> Any:
        if not isinstance(record, VarCreate):
            return record
        return VarCreate(msgspec.structs.replace(record.spec, **present(record.spec, self.members(record))), record.upd)

    def members(self, record: VarCreate) -> dict[str, Any]:
        """Return the changed members."""
        return {}


def swapped(number: int, width: int) -> int:
    """Return the number with its octets in reverse order."""
    return int.from_bytes(number.to_bytes(width, "big"), "little")


# fmt: off
members = instead(OwnSpec, OwnSpec.members)
members("creation-time-swapped", "DATA-01", "sends creationTime little-endian",
    lambda self, record: {"creation_time": swapped(record.spec.creation_time or 0, 8)}, unseen=NO_TIMES)
members("timeout-swapped", "DATA-01 VD-TYP-04 VD-TYP-06", "sends timeouts little-endian",
    lambda self, record: {"timeout": swapped(record.spec.timeout or 0, 2)}, unseen=NO_TIMES)
members("creation-time-ms", "DATA-05 VD-CRE-09", "sends creationTime in ms although the profile has ns",
    lambda self, record: {"creation_time": (record.spec.creation_time or 0) // 1_000_000}, unseen=NO_TIMES)
members("timeout-seconds", "VD-TYP-04 VD-TYP-06", "sends timeouts in seconds",
    lambda self, record: {"timeout": (record.spec.timeout or 0) // 1000}, since=SpecVersion.V2_0)
members("trailing-nul", "DATA-07", "ends descriptions with a zero octet",
    lambda self, record: {"descr": record.spec.descr[:31] + b"\0"}, since=SpecVersion.V1_1)
members("member-order", "VD-TYP-05", "exchanges repCnt and varId in VarSpecs",
    lambda self, record: {"var_id": record.spec.rep_cnt, "rep_cnt": record.spec.var_id})
# fmt: on
