"""Faults of VarDis in further creations, after expiries, and after refused requests."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarCreate
from dcp_selftest.mutants.entries import on_entry
from dcp_selftest.mutants.family import after, around, assign, attributes, instead, then
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NOT_ANEW, NOT_REPLACED
from dcp_stack.config import MS
from dcp_stack.vardis.confirms import Confirm, DescribeDatabaseConfirm, DescribeVariableConfirm
from dcp_stack.vardis.database import DBEntry
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver

V2 = SpecVersion.V2_0


# -- after scrubbing ---------------------------------------------------------------------------------------------------


class Scrubbed(Vardis):
    """Knows which variables scrubbing has deleted."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.scrubbed: set[int] = set()

    def _scrub(self, now: int) -> None:
        alive = {var_id for var_id, entry in self._database.entries.items() if not entry.is_deleted}
        super()._scrub(now)
        self.scrubbed -= alive
        self.scrubbed |= {var_id for var_id in alive if self._database.entries[var_id].is_deleted}


@mutant("scrubbed-deletion-left", "VD-CRE-11 VD-SCR-04",
    "continues to send the VarDelete of a variable that scrubbing has deleted when it is created again",
    since=V2, unseen={"1.1 1.2 1.3": "there is no scrubbing before 2.0"})  # fmt: skip
class DeletionLeft(Scrubbed):
    def create(self, var_id: int, *args: Any, **more: Any) -> Confirm:
        entry = self._database.lookup(var_id)
        count = entry.count_delete if entry is not None and var_id in self.scrubbed else 0
        confirm = super().create(var_id, *args, **more)
        if confirm.status.is_ok and count:
            self._database.entries[var_id].count_delete = count
            self._database.delete_q.append(var_id)
        return confirm


after(Scrubbed, Scrubbed.describe_database)("scrubbed-missing", "VD-DDB-02 VD-SCR-04",
    "does not describe variables that scrubbing has deleted in RTDB-DescribeDatabase",
    lambda self, confirm: DescribeDatabaseConfirm(confirm.status, tuple(each for each in confirm.variables
        if not (each.is_deleted and each.spec.var_id in self.scrubbed))), since=V2,
    unseen={"1.0 1.1 1.2 1.3": "there is no scrubbing before 2.0"})  # fmt: skip


class Ages(Vardis):
    """Uses another age of a variable than the time since its last change."""

    def _scrub(self, now: int) -> None:
        kept = {var_id: entry.refreshed for var_id, entry in self._database.entries.items()}
        for entry in self._database.entries.values():
            entry.refreshed = now - self.age(entry, now - entry.refreshed)
        super()._scrub(now)
        for var_id, entry in self._database.entries.items():
            entry.refreshed = kept[var_id]

    def age(self, entry: DBEntry, age: int) -> int:
        """Return the age that is compared with the timeout, in ns."""
        return age


def _own(self: Vardis, entry: DBEntry) -> bool:
    return entry.spec.prod_id == self._core.own_id


# fmt: off
age = instead(Ages, Ages.age)
age("consumer-double", "VD-SCR-03 VD-SCR-01 VD-SCR-04 VD-SCR-05",
    "deletes variables of other nodes after twice their timeout",
    lambda self, entry, age: age if _own(self, entry) else age // 2, since=V2)
age("updated-double", "VD-SCR-03 VD-SCR-01", "deletes variables that were updated after twice their timeout",
    lambda self, entry, age: age if entry.seqno == 0 else age // 2, since=V2)
age("queued-stay", "VD-SCR-03 VD-SCR-01 VD-SCR-04", "does not scrub variables whose records are to be repeated",
    lambda self, entry, age: 0 if entry.count_create or entry.count_update else age, since=V2)
# fmt: on


class Runs(Vardis):
    """Deletes only some of the variables whose timeout has passed in a run of scrubbing."""

    def _scrub(self, now: int) -> None:
        entries = self._database.entries
        chosen = self.scrubs([*entries.values()], now)
        kept = {entry.spec.var_id: entry.refreshed for entry in entries.values() if entry not in chosen}
        for var_id in kept:
            entries[var_id].refreshed = now
        super()._scrub(now)
        for var_id, refreshed in kept.items():
            entries[var_id].refreshed = refreshed

    def scrubs(self, entries: list[DBEntry], now: int) -> list[DBEntry]:
        """Return the entries that this run considers."""
        return entries

    @staticmethod
    def due(entry: DBEntry, now: int) -> bool:
        """Return whether the timeout of a variable has passed."""
        return 0 < (entry.spec.timeout or 0) * MS < now - entry.refreshed and not entry.is_deleted


# fmt: off
scrubs = instead(Runs, Runs.scrubs)
scrubs("four-at-a-time", "VD-SCR-01 VD-SCR-03", "deletes at most four variables in each run of scrubbing",
    lambda self, entries, now: [each for each in entries if self.due(each, now)][:4], since=V2)
scrubs("first-32", "VD-SCR-01 VD-SCR-05", "scrubs only the first 32 variables of its database",
    lambda self, entries, now: entries[:32], since=V2)
# fmt: on


# -- further creations -------------------------------------------------------------------------------------------------


class CreatedAgain(Vardis):
    """Keeps something of an earlier creation when its application creates a variable again."""

    kept: ClassVar[tuple[str, ...]]

    def create(self, var_id: int, *args: Any, **more: Any) -> Confirm:
        old = self._database.lookup(var_id)
        confirm = super().create(var_id, *args, **more)
        entry = self._database.lookup(var_id)
        if confirm.status.is_ok and old is not None and entry is not None:
            entry.spec = msgspec.structs.replace(entry.spec, **{name: getattr(old.spec, name) for name in self.kept})
        return confirm


# fmt: off
anew = attributes(CreatedAgain, __name__)
anew("own-timeout-kept", "VD-CRE-03 VD-CRE-10 VD-TYP-04",
    "keeps the timeout of a variable that its application creates again", since=V2, kept=("timeout",), unseen=NOT_ANEW)
anew("own-description-kept", "VD-CRE-03 VD-CRE-10 VD-TYP-05",
    "keeps the description of a variable that its application creates again", since=V2, kept=("descr",),
    unseen=NOT_ANEW)
on_entry(Receiver, Receiver._create)("timeout-kept", "VD-PC-07 VD-PC-01",
    "keeps the timeout of a variable that another node creates again",
    lambda self, entry, before: assign(entry,
        spec=msgspec.structs.replace(entry.spec, timeout=before.spec.timeout)), since=V2, unseen=NOT_REPLACED)
around(Receiver, Receiver._create_event)("signed-time", "VD-PC-01",
    "compares creation times as signed numbers",
    lambda self, proceed, record, entry: proceed(record, entry) if entry is None else proceed(
        _shifted(record), msgspec.structs.replace(entry, spec=_shifted_spec(entry.spec))), since=V2,
    unseen=NOT_REPLACED)
# fmt: on


def _shifted_spec(spec: Any) -> Any:
    return msgspec.structs.replace(spec, creation_time=((spec.creation_time or 0) + (1 << 63)) % (1 << 64))


def _shifted(record: VarCreate) -> VarCreate:
    return msgspec.structs.replace(record, spec=_shifted_spec(record.spec))


def _in_ms(spec: Any) -> Any:
    return msgspec.structs.replace(spec, creation_time=(spec.creation_time or 0) // MS)


class Creates(Receiver):
    """Ignores some VarCreates of other nodes."""

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        memory: dict[int, int] = self.__dict__.setdefault("memory", {})
        entry = self._database.lookup(record.spec.var_id)
        if entry is not None and entry.is_deleted:
            memory.setdefault(record.spec.var_id, now)
        if self.admits(record, entry, now):
            super()._create(record, offset, now, wall)

    def admits(self, record: VarCreate, entry: DBEntry | None, now: int) -> bool:
        """Return whether a VarCreate is processed."""
        return True


# fmt: off
admits = instead(Creates, Creates.admits)
admits("far-future", "VD-PC-01 VD-PC-02",
    "ignores VarCreates whose creationTime is more than a day after the stored one",
    lambda self, record, entry, now: entry is None or (record.spec.creation_time or 0)
        - (entry.spec.creation_time or 0) < 86_400_000_000_000, since=V2, unseen=NOT_REPLACED)
on_entry(Receiver, Receiver._create)("replaced-not-summarised", "VD-PC-09 VD-CMP-03",
    "no longer summarises a variable that was created again while it was alive",
    lambda self, entry, before: self._database.summary_q.remove(entry.spec.var_id)
        if before.spec.creation_time != entry.spec.creation_time and not before.is_deleted else None, since=V2,
    unseen=NOT_REPLACED)
# fmt: on


# -- requests that are refused -----------------------------------------------------------------------------------------


# fmt: off
then(Vardis, Vardis.update)("refused-counts", "VD-UPD-07 VD-UPD-11",
    "counts a rejected RTDB-Update with a value that is too long",
    lambda self, confirm, var_id, value, *, now, wall: (
        assign(entry, seqno=self._core.sequence.after(entry.seqno)) if not confirm.status.is_ok
        and len(value) > self._parameters.max_value_length
        and (entry := self._database.lookup(var_id)) is not None and _own(self, entry) else None))
then(Vardis, Vardis.update)("refused-repeats", "VD-UPD-08 VD-UPD-11",
    "repeats the VarUpdate of a variable again after a rejected RTDB-Update",
    lambda self, confirm, var_id, value, *, now, wall: (
        self._database.arm_update(entry) if not confirm.status.is_ok
        and (entry := self._database.lookup(var_id)) is not None and _own(self, entry) and not entry.is_deleted
        else None))
then(Vardis, Vardis.create)("refused-unqueues", "VD-CRE-11 VD-CRE-13",
    "stops the repetitions of a variable when RTDB-Create for it is rejected",
    lambda self, confirm, var_id, *rest, **more: (
        assign(entry, count_create=0, count_update=0) or self._database.create_q.remove(var_id)
        or self._database.update_q.remove(var_id) if not confirm.status.is_ok
        and (entry := self._database.lookup(var_id)) is not None and not entry.is_deleted else None))
then(Vardis, Vardis.delete)("refused-silences", "VD-DEL-03 VD-DEL-05",
    "no longer summarises a variable of another node after a rejected RTDB-Delete",
    lambda self, confirm, var_id, *, now, wall: (
        self._database.summary_q.remove(var_id) if not confirm.status.is_ok
        and (entry := self._database.lookup(var_id)) is not None and not _own(self, entry) else None))
then(Vardis, Vardis.update)("foreign-renews", "VD-UPD-03 VD-DB-03 VD-SCR-03",
    "renews the age of a variable of another node after a rejected RTDB-Update",
    lambda self, confirm, var_id, value, *, now, wall: (
        assign(entry, refreshed=now) if not confirm.status.is_ok
        and (entry := self._database.lookup(var_id)) is not None and not _own(self, entry) else None), since=V2,
    unseen={"1.0 1.1 1.2 1.3": "variables have no timeout before 2.0"})
after(Vardis, Vardis.describe_variable)("no-count-delete", "VD-DVA-03",
    "describes every variable with countDelete 0",
    lambda self, confirm, var_id: confirm if confirm.entry is None else DescribeVariableConfirm(
        confirm.status, msgspec.structs.replace(confirm.entry, count_delete=0)))
# fmt: on
