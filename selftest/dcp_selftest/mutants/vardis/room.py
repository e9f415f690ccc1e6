"""Faults in composing: records that do not fit into a payload are lost, or counted as sent."""

from __future__ import annotations

from typing import ClassVar

from dcp_spec.constants import ICType

from dcp_selftest.mutants.family import after, around, attributes, instead
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.database import IdQueue
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.wire import ContainerType


class Loses(Composer):
    """Removes records of one kind from their queue although they do not fit."""

    kind: ClassVar[ICType]

    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, used = super()._fitting(kind, queue, room, largest)
        if kind is self.kind:
            for var_id in [each for each in queue if each not in chosen]:
                self._lose(var_id)
        return chosen, used

    def _lose(self, var_id: int) -> None:
        self._take(self.kind, var_id)


class LosesAllOrNone(Loses):
    """Removes records only if no record of the kind fits; the rest of a partial container stays queued."""

    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, used = Composer._fitting(self, kind, queue, room, largest)
        if kind is self.kind and not chosen:
            for var_id in list(queue):
                self._lose(var_id)
        return chosen, used


# fmt: off
loses = attributes(Loses, __name__)
loses("creates-lost", "VD-CMP-13 VD-CMP-06", "counts VarCreates that do not fit as sent", kind=ICType.CREATE_VARIABLES)
loses_all_or_none = attributes(LosesAllOrNone, __name__)
loses_all_or_none("updates-lost", "VD-CMP-13 VD-CMP-09", "counts VarUpdates as sent if none of them fits",
    kind=ICType.UPDATES)
loses_all_or_none("deletes-lost", "VD-CMP-13 VD-CMP-10", "counts VarDeletes as sent if none of them fits",
    kind=ICType.DELETE_VARIABLES)
loses_all_or_none("create-requests-lost", "VD-CMP-13 VD-CMP-12", "drops requests for variables if none of them fits",
    kind=ICType.REQUEST_VARCREATES)
loses_all_or_none("update-requests-lost", "VD-CMP-13 VD-CMP-11", "drops requests for updates if none of them fits",
    kind=ICType.REQUEST_VARUPDATES)
instead(LosesAllOrNone, LosesAllOrNone._lose)("summaries-lost", "VD-CMP-13 VD-CMP-03",
    "no longer summarises variables whose summary did not fit into a payload",
    lambda self, var_id: self._database.summary_q.remove(var_id), kind=ICType.SUMMARIES)
loses("rest-of-updates-lost", "VD-CMP-13 VD-CMP-09", "counts the VarUpdates that do not fit as sent",
    kind=ICType.UPDATES)
loses("rest-of-deletes-lost", "VD-CMP-13 VD-CMP-10", "counts the VarDeletes that do not fit as sent",
    kind=ICType.DELETE_VARIABLES)
loses("rest-of-requests-lost", "VD-CMP-13 VD-CMP-12", "drops the requests for variables that do not fit",
    kind=ICType.REQUEST_VARCREATES)
loses("rest-of-update-requests-lost", "VD-CMP-13 VD-CMP-11", "drops the requests for updates that do not fit",
    kind=ICType.REQUEST_VARUPDATES)
around(Composer, Composer._fitting)("exact-fit-skipped", "VD-PAY-02",
    "skips single records that exactly fill a payload",
    lambda self, proceed, kind, queue, room, largest: proceed(kind, queue, room, largest - 1))
after(Vardis, Vardis._room)("exact-fit-refused", "VD-CRE-14 VD-UPD-07",
    "rejects RTDB-Create and RTDB-Update if the record exactly fills a payload",
    lambda self, result: result - 1)
around(Composer, Composer._record_size)("small-records-too-large", "VD-PAY-02",
    "assumes one octet too many for each VarDelete and VarReqCreate",
    lambda self, proceed, kind, var_id: (
        proceed(kind, var_id) + (kind in (ICType.DELETE_VARIABLES, ICType.REQUEST_VARCREATES))))
# fmt: on
