"""Faults in composing: records that do not fit into a payload are lost, or counted as sent."""

from __future__ import annotations

from typing import ClassVar

from dcp_spec.constants import ICType

from dcp_selftest.mutants.mutant import mutant
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


@mutant("creates-lost", "VD-CMP-13 VD-CMP-06", "counts VarCreates that do not fit as sent")
class LosesCreates(Loses):
    kind = ICType.CREATE_VARIABLES


@mutant("updates-lost", "VD-CMP-13 VD-CMP-09", "counts VarUpdates as sent if none of them fits")
class LosesUpdates(LosesAllOrNone):
    kind = ICType.UPDATES


@mutant("deletes-lost", "VD-CMP-13 VD-CMP-10", "counts VarDeletes as sent if none of them fits")
class LosesDeletes(LosesAllOrNone):
    kind = ICType.DELETE_VARIABLES


@mutant("create-requests-lost", "VD-CMP-13 VD-CMP-12", "drops requests for variables if none of them fits")
class LosesCreateRequests(LosesAllOrNone):
    kind = ICType.REQUEST_VARCREATES


@mutant("update-requests-lost", "VD-CMP-13 VD-CMP-11", "drops requests for updates if none of them fits")
class LosesUpdateRequests(LosesAllOrNone):
    kind = ICType.REQUEST_VARUPDATES


@mutant(
    "summaries-lost", "VD-CMP-13 VD-CMP-03", "no longer summarises variables whose summary did not fit into a payload"
)
class LosesSummaries(LosesAllOrNone):
    kind = ICType.SUMMARIES

    def _lose(self, var_id: int) -> None:
        self._database.summary_q.remove(var_id)


@mutant("rest-of-updates-lost", "VD-CMP-13 VD-CMP-09", "counts the VarUpdates that do not fit as sent")
class LosesRestOfUpdates(Loses):
    kind = ICType.UPDATES


@mutant("rest-of-deletes-lost", "VD-CMP-13 VD-CMP-10", "counts the VarDeletes that do not fit as sent")
class LosesRestOfDeletes(Loses):
    kind = ICType.DELETE_VARIABLES


@mutant("rest-of-requests-lost", "VD-CMP-13 VD-CMP-12", "drops the requests for variables that do not fit")
class LosesRestOfRequests(Loses):
    kind = ICType.REQUEST_VARCREATES


@mutant(
    "rest-of-update-requests-lost",
    "VD-CMP-13 VD-CMP-11",
    "drops the requests for updates that do not fit",
)
class LosesRestOfUpdateRequests(Loses):
    kind = ICType.REQUEST_VARUPDATES


@mutant("exact-fit-skipped", "VD-PAY-02", "skips single records that exactly fill a payload")
class SkipsExactFit(Composer):
    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        return super()._fitting(kind, queue, room, largest - 1)


@mutant(
    "exact-fit-refused",
    "VD-CRE-14 VD-UPD-07",
    "rejects RTDB-Create and RTDB-Update if the record exactly fills a payload",
)
class RefusesExactFit(Vardis):
    def _room(self) -> int:
        return super()._room() - 1


@mutant("small-records-too-large", "VD-PAY-02", "assumes one octet too many for each VarDelete and VarReqCreate")
class WidensSmallRecords(Composer):
    def _record_size(self, kind: ContainerType, var_id: int) -> int:
        small = kind in (ICType.DELETE_VARIABLES, ICType.REQUEST_VARCREATES)
        return super()._record_size(kind, var_id) + small
