"""Faults in single fields of the answers to RTDB-DescribeDatabase, RTDB-DescribeVariable and RTDB-Read."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
from dcp_spec.status import VardisStatus

from dcp_codec.values import VarSpec
from dcp_selftest.mutants.family import after, attributes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import NO_TIMES
from dcp_stack.vardis.confirms import DescribeDatabaseConfirm, DescribeVariableConfirm, ReadConfirm
from dcp_stack.vardis.entity import Vardis


class OtherField(Vardis):
    """Returns another value of a field."""

    field: ClassVar[str]
    value: ClassVar[Any]

    def _changed(self, what: Any) -> Any:
        if self.field not in what.__struct_fields__:
            return what
        return msgspec.structs.replace(what, **{self.field: self.value})


class OtherList(OtherField):
    """Changes a field in RTDB-DescribeDatabase."""

    def describe_database(self) -> DescribeDatabaseConfirm:
        confirm = super().describe_database()
        changed = tuple(msgspec.structs.replace(each, spec=self._changed(each.spec)) for each in confirm.variables)
        return msgspec.structs.replace(confirm, variables=changed)


class OtherEntry(OtherField):
    """Changes a field in RTDB-DescribeVariable."""

    def describe_variable(self, var_id: int) -> DescribeVariableConfirm:
        confirm = super().describe_variable(var_id)
        if confirm.entry is None:
            return confirm
        entry = self._changed(confirm.entry)
        return msgspec.structs.replace(confirm, entry=msgspec.structs.replace(entry, spec=self._changed(entry.spec)))


def _others(
    base: type[OtherField], requirement: str, where: str, fields: dict[str, Any]
) -> dict[str, type[OtherField]]:
    """Return a mutant for each field."""
    made: dict[str, type[OtherField]] = {}
    for field, value in fields.items():
        name = f"{base.__name__}{field.title().replace('_', '')}"
        each = type(name, (base,), {"__module__": __name__, "field": field, "value": value})
        unseen = NO_TIMES if field in ("creation_time", "timeout") else None
        what = f"returns a wrong {field} in {where}"
        made[name] = mutant(f"other-{field.replace('_', '-')}", requirement, what, unseen=unseen)(each)
    return made


_SPEC = {"prod_id": b"\2\0\0\0\0\x78", "rep_cnt": 0, "descr": b"", "creation_time": 0, "timeout": 0}
_ENTRY = {"value": b"", "seqno": 255, "count_update": 255, "count_create": 255, "count_delete": 255}


globals().update(
    _others(OtherList, "VD-DDB-02", "RTDB-DescribeDatabase", _SPEC)
    | _others(OtherEntry, "VD-DVA-03", "RTDB-DescribeVariable", _SPEC | _ENTRY | {"t_stamp": 0, "is_deleted": False})
)  # fmt: skip
attributes(OtherEntry, __name__)("alive-deleted", "VD-DVA-03 VD-DB-02", "returns isDeleted true for every variable",
    field="is_deleted", value=True)  # fmt: skip


@mutant(
    "creation-stamp", "VD-DVA-03 VD-DB-03", "returns the time of the creation of a variable as that of its last change"
)
class CreationStamp(Vardis):
    def __init__(self, *args: Any, **times: Any) -> None:
        super().__init__(*args, **times)
        self._first: dict[tuple[int, VarSpec], int] = {}

    def handle_timeout(self, now: int, wall: int) -> None:
        for var_id, entry in self._database.entries.items():
            self._first.setdefault((var_id, entry.spec), entry.t_stamp)
        super().handle_timeout(now, wall)

    def describe_variable(self, var_id: int) -> DescribeVariableConfirm:
        confirm = super().describe_variable(var_id)
        if confirm.entry is None:
            return confirm
        first = self._first.get((var_id, confirm.entry.spec), confirm.entry.t_stamp)
        return msgspec.structs.replace(confirm, entry=msgspec.structs.replace(confirm.entry, t_stamp=first))


# fmt: off
after(Vardis, Vardis.read)("value-with-error", "VD-SRV-03 VD-REA-03",
    "returns a value with every status of RTDB-Read other than OK",
    lambda self, confirm, var_id: confirm if confirm.status.is_ok else ReadConfirm(confirm.status, b"-", 0))
instead(Vardis, Vardis.describe_database)("inactive", "VD-DDB-02",
    "answers RTDB-DescribeDatabase with INACTIVE although it is active",
    lambda self: DescribeDatabaseConfirm(VardisStatus.INACTIVE))
after(Vardis, Vardis.describe_database)("last-missing", "VD-DDB-02",
    "does not list the variable with the largest identifier that one octet can hold",
    lambda self, confirm: msgspec.structs.replace(
        confirm, variables=tuple(each for each in confirm.variables if each.spec.var_id != 255)))
# fmt: on
