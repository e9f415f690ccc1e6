"""Faults in composing: what does not fit into a payload is lost, or counted as sent."""

from __future__ import annotations

from typing import ClassVar

from dcp_spec.constants import ICType

from dcp_stack.vardis import Vardis
from dcp_stack.vardis_compose import Composer
from dcp_stack.vardis_db import IdQueue

from .mutant import mutant


class Loses(Composer):
    """Takes records of one kind from their queue although there is no room for them."""

    kind: ClassVar[ICType]

    def _fitting(self, kind: ICType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, used = super()._fitting(kind, queue, room, largest)
        if kind is self.kind:
            for var_id in [each for each in queue if each not in chosen]:
                self._lose(var_id)
        return chosen, used

    def _lose(self, var_id: int) -> None:
        self._take(self.kind, var_id)


class LosesAllOrNone(Loses):
    """Does so only when no record of the kind fits: the rest of a container that was begun stays queued."""

    def _fitting(self, kind: ICType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, used = Composer._fitting(self, kind, queue, room, largest)
        if kind is self.kind and not chosen:
            for var_id in list(queue):
                self._lose(var_id)
        return chosen, used


@mutant("creates-lost", "VD-CMP-13 VD-CMP-06", "counts VarCreates that have no room as sent")
class LosesCreates(Loses):
    kind = ICType.CREATE_VARIABLES


@mutant("updates-lost", "VD-CMP-13 VD-CMP-09", "counts VarUpdates as sent when not one of them has room")
class LosesUpdates(LosesAllOrNone):
    kind = ICType.UPDATES


@mutant("deletes-lost", "VD-CMP-13 VD-CMP-10", "counts VarDeletes as sent when not one of them has room")
class LosesDeletes(LosesAllOrNone):
    kind = ICType.DELETE_VARIABLES


@mutant("create-requests-lost", "VD-CMP-13 VD-CMP-12", "drops requests for variables when not one of them has room")
class LosesCreateRequests(LosesAllOrNone):
    kind = ICType.REQUEST_VARCREATES


@mutant("update-requests-lost", "VD-CMP-13 VD-CMP-11", "drops requests for updates when not one of them has room")
class LosesUpdateRequests(LosesAllOrNone):
    kind = ICType.REQUEST_VARUPDATES


@mutant("summaries-lost", "VD-CMP-13 VD-CMP-03", "summarises variables no more for which a payload had no room")
class LosesSummaries(LosesAllOrNone):
    kind = ICType.SUMMARIES

    def _lose(self, var_id: int) -> None:
        self._database.summary_q.remove(var_id)


@mutant("rest-of-updates-lost", "VD-CMP-13 VD-CMP-09", "counts those VarUpdates as sent that have no room any more")
class LosesRestOfUpdates(Loses):
    kind = ICType.UPDATES


@mutant("rest-of-deletes-lost", "VD-CMP-13 VD-CMP-10", "counts those VarDeletes as sent that have no room any more")
class LosesRestOfDeletes(Loses):
    kind = ICType.DELETE_VARIABLES


@mutant("rest-of-requests-lost", "VD-CMP-13 VD-CMP-12", "drops those requests for variables that have no room any more")
class LosesRestOfRequests(Loses):
    kind = ICType.REQUEST_VARCREATES


@mutant(
    "rest-of-update-requests-lost",
    "VD-CMP-13 VD-CMP-11",
    "drops those requests for updates that have no room any more",
)
class LosesRestOfUpdateRequests(Loses):
    kind = ICType.REQUEST_VARUPDATES


@mutant("exact-fit-skipped", "VD-PAY-02", "skips records that would fill a payload alone to the last octet")
class SkipsExactFit(Composer):
    def _fitting(self, kind: ICType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        return super()._fitting(kind, queue, room, largest - 1)


@mutant(
    "exact-fit-refused",
    "VD-CRE-14 VD-UPD-07",
    "refuses to create and update variables whose record fills a payload to the last octet",
)
class RefusesExactFit(Vardis):
    def _room(self) -> int:
        return super()._room() - 1


@mutant("small-records-too-large", "VD-PAY-02", "reckons with an octet too much for each VarDelete and VarReqCreate")
class WidensSmallRecords(Composer):
    def _record_size(self, kind: ICType, var_id: int) -> int:
        small = kind in (ICType.DELETE_VARIABLES, ICType.REQUEST_VARCREATES)
        return super()._record_size(kind, var_id) + small
