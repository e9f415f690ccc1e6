"""Faults in the services of VarDis for applications, except RTDB-Create."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import SpecVersion
from dcp_spec.status import VardisStatus

from dcp_codec.values import VarSpec
from dcp_selftest.mutants.cells import Cells
from dcp_selftest.mutants.entries import drop, on_entry
from dcp_selftest.mutants.family import after, around, assign, attributes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import ALWAYS_ACTIVE
from dcp_stack.vardis.confirms import Confirm, DescribeVariableConfirm, NoResponseError, ReadConfirm
from dcp_stack.vardis.core import Sequence
from dcp_stack.vardis.database import DBEntry
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.state_table import Action, Cell, Event, State

V2 = SpecVersion.V2_0
CONSUMED = State.ALIVE_CONSUMER
DELETED_OWN, DELETED = State.DELETED_PRODUCER, State.DELETED_CONSUMER
IS_DELETED, DOES_NOT_EXIST = VardisStatus.VARIABLE_IS_DELETED, VardisStatus.VARIABLE_DOES_NOT_EXIST
OK = VardisStatus.OK


def _refused(event: Event, status: VardisStatus, *states: State) -> dict[tuple[Event, State], Cell]:
    return {(event, state): Cell(Action.REFUSE, status=status) for state in states}


def _later(confirm: Confirm) -> Confirm:
    """Return the confirm with the status that 2.0 has for deleted variables."""
    return Confirm(IS_DELETED) if confirm.status is VardisStatus.VARIABLE_BEING_DELETED else confirm


# -- RTDB-Delete, RTDB-Update, RTDB-Read -------------------------------------------------------------------------------


# fmt: off
after(Vardis, Vardis.delete)("ok", "VD-DEL-02", "confirms the deletion of an unknown variable with OK",
    lambda self, confirm, var_id, *, now, wall: Confirm(OK) if confirm.status is DOES_NOT_EXIST else confirm)
cells = attributes(Cells, __name__)
cells("foreign", "VD-DEL-03", "deletes variables of other nodes",
    cells={(Event.APP_DELETE, CONSUMED): Cell(Action.DELETE)})
cells("status", "VD-DEL-03", "answers IS-DELETED for a deleted variable of another node",
    cells=_refused(Event.APP_DELETE, IS_DELETED, DELETED))
cells("again", "VD-DEL-04", "deletes a deleted variable again",
    since=V2, cells={(Event.APP_DELETE, DELETED_OWN): Cell(Action.DELETE)})
cells("does-not-exist", "VD-DEL-04", "answers DOES-NOT-EXIST for its own deleted variable",
    since=V2, cells=_refused(Event.APP_DELETE, DOES_NOT_EXIST, DELETED_OWN))
on_entry(Vardis, Vardis.delete)("silent", "VD-DEL-05", "deletes its own variables without sending VarDeletes",
    lambda self, entry, before: drop(self._database.delete_q, entry, count_delete=0))
after_update = after(Vardis, Vardis.update)
after_update("creates", "VD-UPD-02", "creates a variable that does not exist when it is to be updated",
    lambda self, confirm, var_id, value, *, now, wall: (
        self.create(var_id, None, 1, b"updated", value, now=now, wall=wall)
        if confirm.status is DOES_NOT_EXIST else confirm))
cells("foreign", "VD-UPD-03", "updates variables of other nodes",
    cells={(Event.APP_UPDATE, CONSUMED): Cell(Action.UPDATE)})
cells("status", "VD-UPD-03", "answers IS-DELETED for a deleted variable of another node",
    cells=_refused(Event.APP_UPDATE, IS_DELETED, DELETED))
around_update = around(Vardis, Vardis.update)
around_update("later-status", "VD-UPD-12", "answers IS-DELETED for a variable that is being deleted, as in 2.0",
    lambda self, proceed, var_id, value, *, now, wall: _later(proceed(var_id, value, now=now, wall=wall)))
around(Vardis, Vardis.delete)("later-status", "VD-DEL-09",
    "answers IS-DELETED for a variable that is being deleted, as in 2.0",
    lambda self, proceed, var_id, *, now, wall: _later(proceed(var_id, now=now, wall=wall)))
after_read = after(Vardis, Vardis.read)
after_read("later-status", "VD-REA-06", "answers IS-DELETED for a variable that is being deleted, as in 2.0",
    lambda self, confirm, var_id: (
        ReadConfirm(IS_DELETED) if confirm.status is VardisStatus.VARIABLE_BEING_DELETED else confirm))
after_update("ok", "VD-UPD-04", "confirms updates of its own deleted variables with OK",
    lambda self, confirm, var_id, value, *, now, wall: Confirm(OK) if confirm.status is IS_DELETED else confirm,
    since=V2)
# fmt: on


@mutant("revives", "VD-UPD-04", "restores its own deleted variable when it is updated", since=V2)
class UpdateRevives(Vardis):
    def update(self, var_id: int, value: bytes, *, now: int, wall: int) -> Confirm:
        confirm = super().update(var_id, value, now=now, wall=wall)
        entry = self._database.lookup(var_id)
        if confirm.status is IS_DELETED and entry is not None:
            self._database.insert(entry.spec, value, self._core.sequence.after(entry.seqno), now=now, wall=wall)
            return Confirm(OK)
        return confirm


# fmt: off
around_update("cut", "VD-UPD-05", "truncates values of updates that are too long, and answers OK",
    lambda self, proceed, var_id, value, *, now, wall: (
        proceed(var_id, value[: self._parameters.max_value_length], now=now, wall=wall)))
after_update("ok", "VD-UPD-06", "confirms an update with an empty value with OK",
    lambda self, confirm, var_id, value, *, now, wall: (
        Confirm(OK) if confirm.status in (VardisStatus.EMPTY_VALUE, VardisStatus.INVALID_VALUE) else confirm))
afters = instead(Sequence, Sequence.after)
afters("constant", "VD-UPD-07", "does not increase the sequence number with updates", lambda self, seqno: seqno)
afters("by-two", "VD-UPD-07", "increases the sequence number by two with each update",
    lambda self, seqno: (seqno + 2) % self._modulus)
afters("wraps-early", "VD-UPD-07 VD-TYP-03", "wraps sequence numbers to 0 after 254",
    lambda self, seqno: (seqno + 1) % (self._modulus - 1))
afters("wraps-to-one", "VD-UPD-07 VD-TYP-03", "wraps sequence numbers to 1 instead of 0",
    lambda self, seqno: (seqno + 1) % self._modulus or 1)
# fmt: on


@mutant("shared", "VD-TYP-03 VD-UPD-07", "uses one sequence of numbers for the updates of all variables")
class SharedCounter(Vardis):
    counter = 0

    def update(self, var_id: int, value: bytes, *, now: int, wall: int) -> Confirm:
        confirm = super().update(var_id, value, now=now, wall=wall)
        entry = self._database.lookup(var_id)
        if confirm.status is OK and entry is not None:
            self.counter = (self.counter + 1) % 256
            entry.seqno = self.counter
        return confirm


# fmt: off
on_update = on_entry(Vardis, Vardis.update)
on_update("once", "VD-UPD-08", "sends a VarUpdate once, whatever the repCnt",
    lambda self, entry, before: assign(entry, count_update=1))
on_update("stamp", "VD-UPD-08 VD-DB-03", "keeps the time stamp of the creation when a variable is updated",
    lambda self, entry, before: assign(entry, t_stamp=before.t_stamp))
after_read("unknown-empty", "VD-REA-02", "returns an empty value for a variable that does not exist",
    lambda self, confirm, var_id: ReadConfirm(OK, b"", 0) if confirm.status is DOES_NOT_EXIST else confirm)
cells("deleted", "VD-REA-03", "returns the last value of a deleted variable",
    since=V2, cells={(Event.APP_READ, state): Cell(Action.READ) for state in (DELETED, DELETED_OWN)})
cells("does-not-exist", "VD-REA-03", "answers DOES-NOT-EXIST for a deleted variable",
    since=V2, cells=_refused(Event.APP_READ, DOES_NOT_EXIST, DELETED, DELETED_OWN))
# fmt: on


@mutant("with-value", "VD-REA-03", "returns the last value together with IS-DELETED", since=V2)
class ReadsWithValue(Vardis):
    def read(self, var_id: int) -> ReadConfirm:
        confirm = super().read(var_id)
        entry = self._database.lookup(var_id)
        if confirm.status is IS_DELETED and entry is not None:
            return ReadConfirm(confirm.status, entry.value, entry.t_stamp)
        return confirm


@mutant("first-value", "VD-REA-04", "always returns the value of the first RTDB-Read of a variable")
class ReadsFirst(Vardis):
    def __init__(self, *args: Any, **times: Any) -> None:
        super().__init__(*args, **times)
        self._first: dict[tuple[int, int | None], ReadConfirm] = {}

    def read(self, var_id: int) -> ReadConfirm:
        confirm = super().read(var_id)
        entry = self._database.lookup(var_id)
        if confirm.status is not OK or entry is None:
            return confirm
        return self._first.setdefault((var_id, entry.spec.creation_time), confirm)


around(Vardis, Vardis.read)("no-stamp", "VD-REA-04 VD-DB-03", "returns the value with a time stamp of zero",
    lambda self, proceed, var_id: (
        answer if (answer := proceed(var_id)).t_stamp is None
        else msgspec.structs.replace(answer, t_stamp=0)))  # fmt: skip


# -- descriptions ------------------------------------------------------------------------------------------------------


# fmt: off
after_describe_database = after(Vardis, Vardis.describe_database)
after_describe_database("hides-deleted", "VD-DDB-02 VD-DB-02", "omits deleted variables from RTDB-DescribeDatabase",
    lambda self, confirm: (
        msgspec.structs.replace(confirm, variables=tuple(each for each in confirm.variables if not each.is_deleted))))
after_describe_database("own-only", "VD-DDB-02", "describes only its own variables",
    lambda self, confirm: (
        msgspec.structs.replace(confirm, variables=tuple(each for each in confirm.variables
        if each.spec.prod_id == self.own_node_identifier))))
after_describe_variable = after(Vardis, Vardis.describe_variable)
after_describe_variable("unknown-ok", "VD-DVA-02", "describes an empty variable if the variable does not exist",
    lambda self, confirm, var_id: (
        DescribeVariableConfirm(OK, DBEntry(VarSpec(var_id, self._core.own_id, 1, b"", 0, 0), b"", 0, 0, 0))
        if confirm.status is DOES_NOT_EXIST else confirm))
after_describe_variable("deleted", "VD-DVA-03", "rejects RTDB-DescribeVariable for a deleted variable",
    lambda self, confirm, var_id: (
        DescribeVariableConfirm(IS_DELETED) if confirm.entry is not None and confirm.entry.is_deleted else confirm))
# fmt: on


@mutant("no-answer", "DATA-10", "does not answer if a variable to be deleted does not exist")
class NoAnswer(Vardis):
    def delete(self, var_id: int, *, now: int, wall: int) -> Confirm:
        confirm = super().delete(var_id, now=now, wall=wall)
        if confirm.status is DOES_NOT_EXIST:
            raise NoResponseError("nothing to say")
        return confirm


# -- inactive ----------------------------------------------------------------------------------------------------------


class Inactive(Vardis):
    """Executes some requests while it is inactive."""

    serves: ClassVar[str] = ""

    def __getattribute__(self, name: str) -> Any:
        found = super().__getattribute__(name)
        if name != type(self).serves:
            return found

        def served(*args: Any, **times: int) -> Any:
            active, self._core.active = self._core.active, self.registered
            try:
                return found(*args, **times)
            finally:
                self._core.active = active

        return served


# fmt: off
inactive = attributes(Inactive, __name__)
inactive("served", "VD-DDB-01 VD-MGT-04", "executes RTDB-DescribeDatabase while it is inactive",
    unseen=ALWAYS_ACTIVE, serves="describe_database")
inactive("served", "VD-DVA-01 VD-MGT-04", "executes RTDB-DescribeVariable while it is inactive",
    unseen=ALWAYS_ACTIVE, serves="describe_variable")
inactive("served", "VD-CRE-01 VD-MGT-04", "creates variables while it is inactive",
    unseen=ALWAYS_ACTIVE, serves="create")
inactive("served", "VD-DEL-01 VD-MGT-04", "deletes variables while it is inactive",
    unseen=ALWAYS_ACTIVE, serves="delete")
inactive("served", "VD-UPD-01 VD-MGT-04", "updates variables while it is inactive",
    unseen=ALWAYS_ACTIVE, serves="update")
inactive("served", "VD-REA-01 VD-MGT-04", "reads variables while it is inactive", unseen=ALWAYS_ACTIVE, serves="read")
# fmt: on


@mutant("silently", "VD-MGT-04 VD-CRE-01", "answers INACTIVE, but creates the variable", unseen=ALWAYS_ACTIVE)
class InactiveSilently(Inactive):
    def create(self, *args: Any, **times: Any) -> Confirm:
        if self.active or not self.registered:
            return super().create(*args, **times)
        self._core.active = True
        super().create(*args, **times)
        self._core.active = False
        return Confirm(VardisStatus.INACTIVE)
