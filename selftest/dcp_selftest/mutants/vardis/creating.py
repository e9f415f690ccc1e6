"""Faults in RTDB-Create."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import SpecVersion
from dcp_spec.status import VardisStatus

from dcp_selftest.mutants.cells import Cells
from dcp_selftest.mutants.entries import drop, on_entry
from dcp_selftest.mutants.family import after, around, assign, attributes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NOT_ANEW
from dcp_stack.vardis.confirms import Confirm
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

    def early(self, var_id: int, rep_cnt: int, descr: bytes, value: bytes) -> VardisStatus | None:
        """Return a status to be confirmed before any check; None to continue."""
        return None

    def changed(self, rep_cnt: int, descr: bytes, value: bytes) -> tuple[int, bytes, bytes]:
        """Return the parameters to be used."""
        return rep_cnt, descr, value


# -- RTDB-Create -------------------------------------------------------------------------------------------------------


# fmt: off
cells = attributes(Cells, __name__)
cells("foreign", "VD-CRE-02", "creates a variable that exists and is produced by another node",
    cells={(Event.APP_CREATE, CONSUMED): Cell(Action.CREATE)})
cells("status", "VD-CRE-02", "answers NOT-PRODUCER for a variable produced by another node",
    cells=_refused(Event.APP_CREATE, NOT_PRODUCER, CONSUMED, DELETED))
cells("deleted-refused", "VD-CRE-03", "does not create its own deleted variable again",
    since=V2, cells=_refused(Event.APP_CREATE, EXISTS, DELETED_OWN))
cells("accepted", "VD-CRE-16 VD-CRE-02", "creates an existing variable again, as in 2.0",
    cells={(Event.APP_CREATE, PRODUCED): Cell(Action.CREATE)})
cells("deleting-accepted", "VD-CRE-16 VD-CRE-02", "creates a variable again while its deletion is being repeated",
    cells={(Event.APP_CREATE, DELETED_OWN): Cell(Action.CREATE)})
# fmt: on


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


limits = attributes(Limits, __name__)
limits("one-more", "VD-CRE-04 VD-PC-05", "accepts descriptions that are one octet too long", description=1)
limits("one-less", "VD-CRE-04 VD-PC-05", "rejects descriptions of maximum length", description=-1)


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


# fmt: off
changed = instead(Creates, Creates.changed)
changed("cut", "VD-CRE-04", "truncates descriptions that are too long, and answers OK",
    lambda self, rep_cnt, descr, value: (rep_cnt, descr[: self._parameters.longest_description], value))
limits("one-more", "VD-CRE-05 VD-UPD-05 VD-PC-04 VD-PU-04", "accepts values that are one octet too long", value=1)
limits("one-less", "VD-CRE-05 VD-UPD-05 VD-PC-04 VD-PU-04", "rejects values of maximum length", value=-1)
changed("cut", "VD-CRE-05", "truncates values that are too long, and answers OK",
    lambda self, rep_cnt, descr, value: (rep_cnt, descr, value[: self._parameters.max_value_length]))
changed("taken", "VD-CRE-06 VD-TYP-02", "creates variables with an empty value, and stores a zero octet",
    lambda self, rep_cnt, descr, value: (rep_cnt, descr, value or b"\0"))
after(Creates, Creates._refused_value)("status", "VD-CRE-06", "answers VALUE-TOO-LONG for an empty value",
    lambda self, result, value: result and VardisStatus.VALUE_TOO_LONG)
limits("one-more", "VD-CRE-07 VD-PC-06", "accepts a repetition count one above the maximum", repetitions=1)
limits("one-less", "VD-CRE-07 VD-PC-06", "rejects the maximum repetition count", repetitions=-1)
changed("zero", "VD-CRE-07", "treats a repetition count of 0 as 1",
    lambda self, rep_cnt, descr, value: (rep_cnt or 1, descr, value))
changed("clamped", "VD-CRE-07", "reduces repetition counts to the maximum, and answers OK",
    lambda self, rep_cnt, descr, value: (min(rep_cnt, self._parameters.max_repetitions), descr, value))
instead(Vardis, Vardis._producer)("given", "VD-CRE-08", "accepts the producer of a variable from the application",
    lambda self, given: self._core.own_id if given is None else given, since=SpecVersion.V1_2)
# fmt: on


@mutant("constant", "VD-CRE-09", "uses the time of its start as creationTime", since=V2)
class ConstantTime(Vardis):
    def __init__(self, *args: Any, now: int, wall: int, **more: Any) -> None:
        super().__init__(*args, now=now, wall=wall, **more)
        self.started = wall

    def _creation_time(self, entry: DBEntry | None, wall: int) -> int | None:
        return super()._creation_time(None, self.started)


# fmt: off
around(Vardis, Vardis._creation_time)("kept", "VD-CRE-09 VD-CRE-03",
    "keeps the old creationTime when it creates a variable again",
    lambda self, proceed, entry, wall: proceed(entry, wall) if entry is None else entry.spec.creation_time, since=V2)
on_create = on_entry(Vardis, Vardis.create)
on_create("from-one", "VD-CRE-10", "starts with sequence number 1", lambda self, entry, before: assign(entry, seqno=1))
# fmt: on


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


# fmt: off
on_create("stamp", "VD-CRE-10 VD-DB-03", "stores variables without a time stamp",
    lambda self, entry, before: assign(entry, t_stamp=0))
on_create("with-update", "VD-CRE-10 VD-CRE-12", "sends a VarUpdate with the first value along with the VarCreate",
    lambda self, entry, before: self._database.arm_update(entry))
on_create("not-summarised", "VD-CRE-12", "does not summarise its own variables",
    lambda self, entry, before: drop(self._database.summary_q, entry))
on_create("only-summarised", "VD-CRE-12", "only summarises its own variables, without a VarCreate",
    lambda self, entry, before: drop(self._database.create_q, entry, count_create=0))
early = instead(Creates, Creates.early)
early("repcnt-first", "VD-CRE-13 DATA-11", "checks the repetition count first",
    lambda self, var_id, rep_cnt, descr, value: (
        None if 1 <= rep_cnt <= self._parameters.max_repetitions else VardisStatus.ILLEGAL_REPCOUNT))
early("value-first", "VD-CRE-13 DATA-11", "checks the value before the description",
    lambda self, var_id, rep_cnt, descr, value: (
        None if self._database.lookup(var_id) is not None else self._refused_value(value)))
early("exists-last", "VD-CRE-13 DATA-11", "checks last whether the variable exists",
    lambda self, var_id, rep_cnt, descr, value: (
        VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG
        if len(descr) > self._parameters.longest_description else self._refused_value(value)))
around(Vardis, Vardis.create)("inactive-last", "VD-CRE-13 VD-CRE-01",
    "checks the value before it checks whether it is active",
    lambda self, proceed, *args, **times: (
        self._confirm(status) if (status := self._refused_value(args[4])) else proceed(*args, **times)))
# fmt: on
