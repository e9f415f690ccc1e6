"""Faults with variable identifiers at their limits."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_spec.status import VardisStatus

from dcp_codec.values import VarCreate, VarSumm, VarUpdate
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.vardis.confirms import Confirm
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver


class IgnoresSome(Receiver):
    """Ignores the VarCreates of some variables."""

    ignored: ClassVar[range]

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        if record.spec.var_id not in self.ignored:
            super()._create(record, offset, now, wall)


@mutant("zero", "VD-TYP-01 VD-PC-09", "treats the identifier 0 of a received variable as none")
class IgnoresZero(IgnoresSome):
    ignored = range(1)


@mutant("highest", "VD-TYP-01 VD-PC-09", "cannot store a received variable with the identifier 255")
class IgnoresHighest(IgnoresSome):
    ignored = range(255, 256)


@mutant("signed", "VD-TYP-01 VD-PC-09", "decodes identifiers of received variables as signed")
class IgnoresUpperHalf(IgnoresSome):
    ignored = range(128, 256)


@mutant("no-request-for-zero", "VD-PS-01 VD-TYP-01", "does not request the unknown variable with the identifier 0")
class RequestsNotZero(Receiver):
    def _summary(self, record: VarSumm, offset: int) -> None:
        if record.var_id or self._database.lookup(0) is not None:
            super()._summary(record, offset)


@mutant("no-update-of-highest", "VD-PU-07 VD-TYP-01", "ignores updates of the variable with the identifier 255")
class UpdatesNotHighest(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        if record.var_id != 255:
            super()._update(record, offset, now, wall)


class RefusesSome(Vardis):
    """Rejects RTDB-Create for some identifiers."""

    refused: ClassVar[range]

    def create(self, var_id: int, *args: Any, **params: Any) -> Confirm:
        if var_id in self.refused:
            return Confirm(VardisStatus.VARIABLE_EXISTS)
        return super().create(var_id, *args, **params)


@mutant("own-zero", "VD-TYP-01 VD-CRE-14", "rejects RTDB-Create with the identifier 0")
class RefusesZero(RefusesSome):
    refused = range(1)


@mutant("own-highest", "VD-TYP-01 VD-CRE-14", "rejects RTDB-Create with the identifier 255")
class RefusesHighest(RefusesSome):
    refused = range(255, 256)


@mutant("own-signed", "VD-TYP-01 VD-CRE-14", "rejects RTDB-Create with identifiers above 127")
class RefusesUpperHalf(RefusesSome):
    refused = range(128, 256)
