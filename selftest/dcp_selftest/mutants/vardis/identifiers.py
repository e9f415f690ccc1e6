"""Faults with variable identifiers at their limits."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_spec.status import VardisStatus

from dcp_codec.values import VarCreate
from dcp_selftest.mutants.family import attributes, skips
from dcp_stack.vardis.confirms import Confirm
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver


class IgnoresSome(Receiver):
    """Ignores the VarCreates of some variables."""

    ignored: ClassVar[range]

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        if record.spec.var_id not in self.ignored:
            super()._create(record, offset, now, wall)


# fmt: off
ignores_some = attributes(IgnoresSome, __name__)
ignores_some("zero", "VD-TYP-01 VD-PC-09", "treats the identifier 0 of a received variable as none", ignored=range(1))
ignores_some("highest", "VD-TYP-01 VD-PC-09", "cannot store a received variable with the identifier 255",
    ignored=range(255, 256))
ignores_some("signed", "VD-TYP-01 VD-PC-09", "decodes identifiers of received variables as signed",
    ignored=range(128, 256))
skips(Receiver, Receiver._summary)("no-request-for-zero", "VD-PS-01 VD-TYP-01",
    "does not request the unknown variable with the identifier 0",
    lambda self, record, offset: not (record.var_id or self._database.lookup(0) is not None))
skips(Receiver, Receiver._update)("no-update-of-highest", "VD-PU-07 VD-TYP-01",
    "ignores updates of the variable with the identifier 255",
    lambda self, record, offset, now, wall: record.var_id == 255)
# fmt: on


class RefusesSome(Vardis):
    """Rejects RTDB-Create for some identifiers."""

    refused: ClassVar[range]

    def create(self, var_id: int, *args: Any, **params: Any) -> Confirm:
        if var_id in self.refused:
            return Confirm(VardisStatus.VARIABLE_EXISTS)
        return super().create(var_id, *args, **params)


refuses_some = attributes(RefusesSome, __name__)
refuses_some("own-zero", "VD-TYP-01 VD-CRE-14", "rejects RTDB-Create with the identifier 0", refused=range(1))
refuses_some("own-highest", "VD-TYP-01 VD-CRE-14", "rejects RTDB-Create with the identifier 255",
    refused=range(255, 256))  # fmt: skip
refuses_some("own-signed", "VD-TYP-01 VD-CRE-14", "rejects RTDB-Create with identifiers above 127",
    refused=range(128, 256))  # fmt: skip
