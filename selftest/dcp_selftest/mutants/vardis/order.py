"""Faults in the order of checks: a later condition determines the status instead of an earlier one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from dcp_spec.status import VardisStatus

from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import ALWAYS_ACTIVE
from dcp_stack.vardis.confirms import Confirm, DescribeVariableConfirm, ReadConfirm
from dcp_stack.vardis.entity import Vardis

EMPTY, TOO_LONG = VardisStatus.EMPTY_VALUE, VardisStatus.VALUE_TOO_LONG
DESCRIPTION = VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG
REPCOUNT = VardisStatus.ILLEGAL_REPCOUNT
UNKNOWN, NOT_PRODUCER = VardisStatus.VARIABLE_DOES_NOT_EXIST, VardisStatus.NOT_PRODUCER
EXISTS, DELETED = VardisStatus.VARIABLE_EXISTS, VardisStatus.VARIABLE_IS_DELETED

Given = tuple[bytes, bytes, int]


class Hasty(Vardis):
    """Checks one condition of a service too early.

    ``service``: the service; ``first``: the status that is returned too early; ``before``: the correct status.
    """

    service: ClassVar[str]
    first: ClassVar[VardisStatus]
    before: ClassVar[VardisStatus]

    def _also(self, var_id: int, value: bytes = b"-", descr: bytes = b"-", rep_cnt: int = 1) -> bool:
        """Return whether the condition of ``first`` holds."""
        entry, parameters = self._database.lookup(var_id), self._parameters
        own = entry is not None and entry.spec.prod_id == self._core.own_id
        conditions: dict[VardisStatus, Callable[[], bool]] = {
            EMPTY: lambda: not value,
            TOO_LONG: lambda: len(value) > parameters.max_value_length,
            DESCRIPTION: lambda: len(descr) > parameters.longest_description,
            REPCOUNT: lambda: not 1 <= rep_cnt <= parameters.max_repetitions,
            UNKNOWN: lambda: entry is None,
            NOT_PRODUCER: lambda: entry is not None and not own,
            DELETED: lambda: entry is not None and entry.is_deleted,
            EXISTS: lambda: entry is not None and not own,
        }
        return conditions[self.first]()

    def _hasty(self, service: str, confirm: Any, *given: Any) -> VardisStatus:
        right: VardisStatus = confirm.status
        expected = self.before.in_version(self._core.config.profile.spec_version)
        if service == self.service and right in (self.before, expected) and self._also(*given):
            return self.first.in_version(self._core.config.profile.spec_version)
        return right

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
        confirm = super().create(var_id, prod_id, rep_cnt, descr, value, timeout_ms, **more)
        return Confirm(self._hasty("create", confirm, var_id, value, descr, rep_cnt))

    def update(self, var_id: int, value: bytes, **times: int) -> Confirm:
        return Confirm(self._hasty("update", super().update(var_id, value, **times), var_id, value))

    def delete(self, var_id: int, **times: int) -> Confirm:
        return Confirm(self._hasty("delete", super().delete(var_id, **times), var_id))

    def read(self, var_id: int) -> ReadConfirm:
        confirm = super().read(var_id)
        status = self._hasty("read", confirm, var_id)
        return confirm if status is confirm.status else ReadConfirm(status)

    def describe_variable(self, var_id: int) -> DescribeVariableConfirm:
        confirm = super().describe_variable(var_id)
        status = self._hasty("describe", confirm, var_id)
        return confirm if status is confirm.status else DescribeVariableConfirm(status)


INACTIVE = VardisStatus.INACTIVE


def _hasty(
    service: str, first: VardisStatus, before: VardisStatus, requirement: str, unseen: dict[str, str] | None
) -> type[Hasty]:
    names = (first.value, before.value)
    short = [name.removeprefix("VARDIS-STATUS-").removeprefix("VARIABLE-").lower() for name in names]
    made = type(
        f"Hasty{service.title()}{first.name}{before.name}",
        (Hasty,),
        {"__module__": __name__, "service": service, "first": first, "before": before},
    )
    what = f"answers {names[0]} if the conditions of both {names[0]} and {names[1]} hold (RTDB-{service.title()})"
    return mutant(f"{short[0]}-before-{short[1]}", requirement, what, unseen=unseen)(made)


def _pairs(service: str, requirement: str, *order: VardisStatus) -> dict[str, type[Hasty]]:
    """Return a mutant for each pair of conditions that can hold together."""
    never = [{UNKNOWN, NOT_PRODUCER}, {UNKNOWN, DELETED}, {EMPTY, TOO_LONG}]
    made: dict[str, type[Hasty]] = {}
    for index, before in enumerate(order):
        for first in order[index + 1 :]:
            if {first, before} in never:
                continue
            unseen = ALWAYS_ACTIVE if before is INACTIVE else None
            each = _hasty(service, first, before, requirement, unseen)
            made[each.__name__] = each
    return made


globals().update(
    _pairs("create", "VD-CRE-13", INACTIVE, EXISTS, DESCRIPTION, TOO_LONG, EMPTY, REPCOUNT)
    | _pairs("update", "VD-UPD-11", INACTIVE, UNKNOWN, NOT_PRODUCER, DELETED, TOO_LONG, EMPTY)
    | _pairs("delete", "VD-DEL-07", INACTIVE, UNKNOWN, NOT_PRODUCER, DELETED)
    | _pairs("read", "VD-REA-05", INACTIVE, UNKNOWN, DELETED)
    | _pairs("describe", "VD-DVA-01", INACTIVE, UNKNOWN)
)  # fmt: skip
