"""Faults of VarDis at an activation while active, with creation times far away, and after a re-creation."""

from __future__ import annotations

from typing import Any

from dcp_codec.values import VarCreate, VarSumm, VarUpdate
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import ALWAYS_ACTIVE, NO_TIMES, NOT_ANEW
from dcp_stack.vardis.database import Database, DBEntry
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver


@mutant(
    "activation-repeats",
    "VD-SCP-02 VD-MGT-05",
    "sends its VarCreates again at an activation while active",
    unseen=ALWAYS_ACTIVE,
)
class ActivationRepeats(Vardis):
    def activate(self) -> Any:
        if self.active:
            for entry in self._database.entries.values():
                if not entry.is_deleted:
                    self._database.arm_create(entry)
        return super().activate()


class OldCreation(Receiver):
    """Changes the entry of a received creation."""

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        old = self._database.lookup(record.spec.var_id)
        super()._create(record, offset, now, wall)
        new = self._database.lookup(record.spec.var_id)
        if new is not None and new is not old and record.spec.creation_time is not None:
            self.adopted(new, self._core.clock.wall(record.spec.creation_time, near=wall), now, wall)

    def adopted(self, entry: DBEntry, created: int, now: int, wall: int) -> None:
        """Change a new entry. Times in ns."""


@mutant(
    "age-of-creation",
    "VD-SCR-03 VD-PC-07",
    "computes the age of a received variable from its creationTime",
    unseen=NO_TIMES,
)
class AgeOfCreation(OldCreation):
    def adopted(self, entry: DBEntry, created: int, now: int, wall: int) -> None:
        entry.refreshed = now - (wall - created)


@mutant(
    "read-creation-time",
    "VD-REA-04 VD-PC-07",
    "reads the creationTime of a received variable as its tStamp",
    unseen=NO_TIMES,
)
class ReadCreationTime(OldCreation):
    def adopted(self, entry: DBEntry, created: int, now: int, wall: int) -> None:
        entry.t_stamp = created


@mutant(
    "rest-of-deletions",
    "VD-DEL-05 VD-CRE-10",
    "sends only the VarDeletes left from the first deletion after another",
    unseen=NOT_ANEW,
)
class RestOfDeletions(Database):
    def insert(self, spec: Any, *args: Any, **kwargs: Any) -> Any:
        left: dict[int, int] = self.__dict__.setdefault("left", {})
        old = self.entries.get(spec.var_id)
        left[spec.var_id] = 0 if old is None else old.count_delete
        return super().insert(spec, *args, **kwargs)

    def mark_deleted(self, entry: DBEntry) -> None:
        super().mark_deleted(entry)
        left: dict[int, int] = self.__dict__.setdefault("left", {})
        entry.count_delete = left.pop(entry.spec.var_id, 0) or entry.count_delete


@mutant("still-requested", "VD-PU-08", "requests an update also after one that is older than the summary before it")
class StillRequested(Receiver):
    def _summary(self, record: VarSumm, offset: int) -> None:
        self.__dict__.setdefault("announced", {})[record.var_id] = record.seqno
        super()._summary(record, offset)

    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        queue = self._database.req_upd_q
        waits = record.var_id in queue
        super()._update(record, offset, now, wall)
        entry = self._database.lookup(record.var_id)
        announced = self.__dict__.get("announced", {}).get(record.var_id)
        dropped = waits and record.var_id not in queue and entry is not None and announced is not None
        if dropped and entry is not None and self._core.sequence.answers(entry.seqno, announced):
            queue.append(record.var_id)
