"""Faults in RTDB-Create."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import SpecVersion
from dcp_spec.status import VardisStatus

from dcp_selftest.mutants.cells import Cells
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NOT_ANEW
from dcp_stack.vardis.confirms import (
    Confirm,
)
from dcp_stack.vardis.database import DBEntry
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.parameters import VardisParameters
from dcp_stack.vardis.state_table import Action, Cell, Event, State

V2 = SpecVersion.V2_0
PRODUCED, CONSUMED = State.ALIVE_PRODUCER, State.ALIVE_CONSUMER
DELETED_OWN, DELETED = State.DELETED_PRODUCER, State.DELETED_CONSUMER
EXISTS, NOT_PRODUCER = VardisStatus.VARIABLE_EXISTS, VardisStatus.NOT_PRODUCER
OK = VardisStatus.OK


def _refused(event: Event, status: VardisStatus, *states: State) -> dict[tuple[Event, State], Cell]:
    return {(event, state): Cell(Action.REFUSE, status=status) for state in states}


class Creates(Vardis):
    """Changes RTDB-Create."""

    def create(
        self,
        var_id: int,
        prod_id: bytes | None,
        rep_cnt: int,
        descr: bytes,
        value: bytes,
        timeout_ms: int = 0,
        **more: Any,
    ) -> Confirm:
        early = self.early(var_id, rep_cnt, descr, value)
        if early is not None and self.active:
            return Confirm(early)
        rep_cnt, descr, value = self.changed(rep_cnt, descr, value)
        return super().create(var_id, prod_id, rep_cnt, descr, value, timeout_ms, **more)

    def early(self, var_id: int, rep_cnt: int, descr: bytes, value: bytes) -> VardisStatus | None:  # noqa: ARG002
        """Return a status to be confirmed before any check; None to continue."""
        return None

    def changed(self, rep_cnt: int, descr: bytes, value: bytes) -> tuple[int, bytes, bytes]:
        """Return the parameters to be used."""
        return rep_cnt, descr, value


# -- RTDB-Create -------------------------------------------------------------------------------------------------------


@mutant("foreign", "VD-CRE-02", "creates a variable that exists and is produced by another node")
class CreatesForeign(Cells):
    cells: ClassVar = {(Event.APP_CREATE, CONSUMED): Cell(Action.CREATE)}


@mutant("status", "VD-CRE-02", "answers NOT-PRODUCER for a variable produced by another node")
class CreateStatus(Cells):
    cells: ClassVar = _refused(Event.APP_CREATE, NOT_PRODUCER, CONSUMED, DELETED)


@mutant("deleted-refused", "VD-CRE-03", "does not create its own deleted variable again", since=V2)
class DeletedNotCreatedAgain(Cells):
    cells: ClassVar = _refused(Event.APP_CREATE, EXISTS, DELETED_OWN)


@mutant("accepted", "VD-CRE-16 VD-CRE-02", "creates an existing variable again, as in 2.0")
class CreatesAgain(Cells):
    cells: ClassVar = {(Event.APP_CREATE, PRODUCED): Cell(Action.CREATE)}


@mutant("deleting-accepted", "VD-CRE-16 VD-CRE-02", "creates a variable again while its deletion is being repeated")
class CreatesWhileDeleting(Cells):
    cells: ClassVar = {(Event.APP_CREATE, DELETED_OWN): Cell(Action.CREATE)}


class Limits(VardisParameters):
    """Changes the limits of lengths and repetition counts."""

    value: ClassVar[int] = 0
    description: ClassVar[int] = 0
    repetitions: ClassVar[int] = 0

    @property
    def max_value_length(self) -> int:
        return super().max_value_length + self.value

    @property
    def longest_description(self) -> int:
        return super().longest_description + self.description

    @property
    def max_repetitions(self) -> int:
        return super().max_repetitions + self.repetitions


@mutant("one-more", "VD-CRE-04 VD-PC-05", "accepts descriptions that are one octet too long")
class DescriptionMore(Limits):
    description = 1


@mutant("one-less", "VD-CRE-04 VD-PC-05", "rejects descriptions of maximum length")
class DescriptionLess(Limits):
    description = -1


@mutant("characters", "DATA-08 VD-CRE-04", "counts the characters of descriptions, not the octets")
class Characters(Creates):
    def create(self, *args: Any, **times: Any) -> Confirm:
        descr: bytes = args[3]
        fits = 0 < len(descr.decode(errors="replace")) <= self._parameters.longest_description
        counted = descr[:1] if fits else descr
        changed: list[Any] = [*args[:3], counted, *args[4:]]
        confirm = super().create(*changed, **times)
        entry = self._database.lookup(args[0])
        if confirm.status is OK and entry is not None:
            entry.spec = msgspec.structs.replace(entry.spec, descr=descr)
        return confirm


@mutant("cut", "VD-CRE-04", "truncates descriptions that are too long, and answers OK")
class DescriptionCut(Creates):
    def changed(self, rep_cnt: int, descr: bytes, value: bytes) -> tuple[int, bytes, bytes]:
        return rep_cnt, descr[: self._parameters.longest_description], value


@mutant("one-more", "VD-CRE-05 VD-UPD-05 VD-PC-04 VD-PU-04", "accepts values that are one octet too long")
class ValueMore(Limits):
    value = 1


@mutant("one-less", "VD-CRE-05 VD-UPD-05 VD-PC-04 VD-PU-04", "rejects values of maximum length")
class ValueLess(Limits):
    value = -1


@mutant("cut", "VD-CRE-05", "truncates values that are too long, and answers OK")
class ValueCut(Creates):
    def changed(self, rep_cnt: int, descr: bytes, value: bytes) -> tuple[int, bytes, bytes]:
        return rep_cnt, descr, value[: self._parameters.max_value_length]


@mutant("taken", "VD-CRE-06 VD-TYP-02", "creates variables with an empty value, and stores a zero octet")
class EmptyTaken(Creates):
    def changed(self, rep_cnt: int, descr: bytes, value: bytes) -> tuple[int, bytes, bytes]:
        return rep_cnt, descr, value or b"\0"


@mutant("status", "VD-CRE-06", "answers VALUE-TOO-LONG for an empty value")
class EmptyStatus(Creates):
    def _refused_value(self, value: bytes) -> VardisStatus | None:
        return super()._refused_value(value) and VardisStatus.VALUE_TOO_LONG


@mutant("one-more", "VD-CRE-07 VD-PC-06", "accepts a repetition count one above the maximum")
class RepetitionsMore(Limits):
    repetitions = 1


@mutant("one-less", "VD-CRE-07 VD-PC-06", "rejects the maximum repetition count")
class RepetitionsLess(Limits):
    repetitions = -1


@mutant("zero", "VD-CRE-07", "treats a repetition count of 0 as 1")
class RepetitionsZero(Creates):
    def changed(self, rep_cnt: int, descr: bytes, value: bytes) -> tuple[int, bytes, bytes]:
        return rep_cnt or 1, descr, value


@mutant("clamped", "VD-CRE-07", "reduces repetition counts to the maximum, and answers OK")
class RepetitionsClamped(Creates):
    def changed(self, rep_cnt: int, descr: bytes, value: bytes) -> tuple[int, bytes, bytes]:
        return min(rep_cnt, self._parameters.max_repetitions), descr, value


@mutant("given", "VD-CRE-08", "accepts the producer of a variable from the application", since=SpecVersion.V1_2)
class ProducerGiven(Vardis):
    def _producer(self, given: bytes | None) -> bytes:
        return self._core.own_id if given is None else given


@mutant("constant", "VD-CRE-09", "uses the time of its start as creationTime", since=V2)
class ConstantTime(Vardis):
    def __init__(self, *args: Any, now: int, wall: int, **more: Any) -> None:
        super().__init__(*args, now=now, wall=wall, **more)
        self.started = wall

    def _creation_time(self, entry: DBEntry | None, wall: int) -> int | None:  # noqa: ARG002 - the same call
        return super()._creation_time(None, self.started)


@mutant("kept", "VD-CRE-09 VD-CRE-03", "keeps the old creationTime when it creates a variable again", since=V2)
class TimeKept(Vardis):
    def _creation_time(self, entry: DBEntry | None, wall: int) -> int | None:
        return super()._creation_time(entry, wall) if entry is None else entry.spec.creation_time


@mutant("from-one", "VD-CRE-10", "starts with sequence number 1")
class FromOne(Creates):
    def create(self, *args: Any, **times: Any) -> Confirm:
        var_id: int = args[0]
        confirm = super().create(*args, **times)
        entry = self._database.lookup(var_id)
        if confirm.status is OK and entry is not None:
            entry.seqno = 1
        return confirm


@mutant(
    "goes-on",
    "VD-CRE-10 VD-CRE-03",
    "continues the sequence numbers of a variable that is created again",
    unseen=NOT_ANEW,
)
class ContinuesNumbers(Creates):
    def create(self, *args: Any, **times: Any) -> Confirm:
        var_id: int = args[0]
        before = self._database.lookup(var_id)
        number = None if before is None else before.seqno
        confirm = super().create(*args, **times)
        entry = self._database.lookup(var_id)
        if confirm.status is OK and entry is not None and number is not None:
            entry.seqno = (number + 1) % 256
        return confirm


@mutant("stamp", "VD-CRE-10 VD-DB-03", "stores variables without a time stamp")
class NoStamp(Creates):
    def create(self, *args: Any, **times: Any) -> Confirm:
        var_id: int = args[0]
        confirm = super().create(*args, **times)
        entry = self._database.lookup(var_id)
        if confirm.status is OK and entry is not None:
            entry.t_stamp = 0
        return confirm


@mutant("with-update", "VD-CRE-10 VD-CRE-12", "sends a VarUpdate with the first value along with the VarCreate")
class WithUpdate(Creates):
    def create(self, *args: Any, **times: Any) -> Confirm:
        var_id: int = args[0]
        confirm = super().create(*args, **times)
        entry = self._database.lookup(var_id)
        if confirm.status is OK and entry is not None:
            self._database.arm_update(entry)
        return confirm


@mutant("not-summarised", "VD-CRE-12", "does not summarise its own variables")
class NotSummarised(Creates):
    def create(self, *args: Any, **times: Any) -> Confirm:
        var_id: int = args[0]
        confirm = super().create(*args, **times)
        if confirm.status is OK:
            self._database.summary_q.remove(var_id)
        return confirm


@mutant("only-summarised", "VD-CRE-12", "only summarises its own variables, without a VarCreate")
class OnlySummarised(Creates):
    def create(self, *args: Any, **times: Any) -> Confirm:
        var_id: int = args[0]
        confirm = super().create(*args, **times)
        entry = self._database.lookup(var_id)
        if confirm.status is OK and entry is not None:
            self._database.create_q.remove(var_id)
            entry.count_create = 0
        return confirm


@mutant("repcnt-first", "VD-CRE-13 DATA-11", "checks the repetition count first")
class RepcntFirst(Creates):
    def early(self, var_id: int, rep_cnt: int, descr: bytes, value: bytes) -> VardisStatus | None:  # noqa: ARG002
        return None if 1 <= rep_cnt <= self._parameters.max_repetitions else VardisStatus.ILLEGAL_REPCOUNT


@mutant("value-first", "VD-CRE-13 DATA-11", "checks the value before the description")
class ValueFirst(Creates):
    def early(self, var_id: int, rep_cnt: int, descr: bytes, value: bytes) -> VardisStatus | None:  # noqa: ARG002
        return None if self._database.lookup(var_id) is not None else self._refused_value(value)


@mutant("exists-last", "VD-CRE-13 DATA-11", "checks last whether the variable exists")
class ExistsLast(Creates):
    def early(self, var_id: int, rep_cnt: int, descr: bytes, value: bytes) -> VardisStatus | None:  # noqa: ARG002
        if len(descr) > self._parameters.longest_description:
            return VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG
        return self._refused_value(value)


@mutant("inactive-last", "VD-CRE-13 VD-CRE-01", "checks the value before it checks whether it is active")
class InactiveLast(Vardis):
    def create(self, *args: Any, **times: Any) -> Confirm:
        if status := self._refused_value(args[4]):
            return self._confirm(status)
        return super().create(*args, **times)
