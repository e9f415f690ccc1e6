"""Composition of a payload from instruction containers (dcp-vardis.md#vardis-payload-format-construction)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import islice

from dcp_spec.constants import IC_MAX_RECORDS, ICType

from dcp_codec.values import (
    Container,
    OwnRecord,
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSumm,
    VarUpdate,
)

from .core import Core
from .database import DBEntry, IdQueue
from .instructions import Instruction
from .wire import ContainerType


class Composer:
    """Fills payloads from the queues of a database, and decrements the repetition counters of the records sent."""

    def __init__(self, core: Core, instructions: Mapping[str, Instruction] | None = None) -> None:
        """``instructions``: the instructions for the profile's additional container types, by the name of the type."""
        self._instructions = instructions or {}
        config = core.config
        self._database = core.database
        self._parameters = core.parameters
        self._sizes = core.sizes
        self._own_fields = config.own_fields
        database = core.database
        self._queues: dict[ContainerType, IdQueue] = {
            ICType.CREATE_VARIABLES: database.create_q,
            ICType.DELETE_VARIABLES: database.delete_q,
            ICType.REQUEST_VARCREATES: database.req_create_q,
            ICType.SUMMARIES: database.summary_q,
            ICType.UPDATES: database.update_q,
            ICType.REQUEST_VARUPDATES: database.req_upd_q,
        }
        ##= VD-PAY-07 VD-PAY-01
        own = {name: each.queue for name, each in self._instructions.items()}
        self._order: tuple[tuple[ContainerType, IdQueue], ...] = (
            *((kind, self._queues[kind]) for kind in config.features.container_order),
            *own.items(),
        )
        ##= VD-IC-02
        self._numbers: dict[ContainerType, int] = {name: each.number for name, each in self._instructions.items()}
        for kind, number in config.container_numbers.items():
            self._numbers[kind] = number
        ##= VD-IC-04
        self._several = (
            config.features.several_containers_per_type and config.profile.behaviour.containers_per_type == "several"
        )
        self._purge = config.features.purge_when_composing or core.readings.summary_purge == "purge-first"

    def compose(self, room: int) -> tuple[Container, ...]:
        """Return the containers of the next payload; an empty tuple if all queues are empty or no record fits.

        Their encoding has at most ``room`` octets. All returned records count as sent: repetition counters are
        decremented, and requests leave their queues.
        """
        ##= VD-CMP-14
        if self._purge:
            self._database.purge()
        largest = room - self._sizes.ic_header
        containers: list[Container] = []
        for kind, queue in self._order:
            ##= VD-IC-03
            if not queue:
                continue
            chosen, used = self._fitting(kind, queue, room, largest)
            room -= used
            # Records are built before the next queue is read: building them changes queues (VD-CMP-06 to VD-CMP-12).
            records = self._take_all(kind, chosen)
            ##= VD-PAY-05
            for first in range(0, len(records), IC_MAX_RECORDS):
                group = tuple(records[first : first + IC_MAX_RECORDS])
                ##= VD-IC-01
                containers.append(Container(ic_type=self._numbers[kind], records=group))
        return tuple(containers)

    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        """Return the identifiers whose records fit into ``room`` octets, and the octets that they need.

        This is ``numberFittingRecords``. The queue is read once, from its head, until a record does not fit, so a
        payload has at most one record of a type per variable. ``largest``: octets of the longest record that an empty
        payload could hold.
        """
        candidates: Iterable[int] = queue
        if kind is ICType.SUMMARIES:
            ##= VD-CMP-01 VD-CMP-02
            candidates = islice(candidates, self._parameters.max_summaries)
        header = self._sizes.ic_header
        chosen: list[int] = []
        used = 0
        ##= VD-PAY-06
        for var_id in candidates:
            size = self._record_size(kind, var_id)
            ##= VD-CMP-08 | exception: a record too long for any payload (limits were lowered) does not block the rest
            if size > largest:
                continue
            if len(chosen) % IC_MAX_RECORDS == 0:
                if chosen and not self._several:
                    break
                size += header
            ##= VD-CMP-08 VD-CMP-13 VD-IC-05
            if used + size > room:
                break
            ##= VD-PAY-02 VD-PAY-03
            chosen.append(var_id)
            used += size
        return chosen, used

    def _record_size(self, kind: ContainerType, var_id: int) -> int:
        """Return the number of octets of the record of a variable, without the container header."""
        if kind is ICType.CREATE_VARIABLES:
            entry = self._entry(var_id)
            return self._sizes.create(entry.spec, entry.value)
        if kind is ICType.UPDATES:
            return self._sizes.update(self._entry(var_id).value)
        size = self._sizes.fixed[kind]
        if size is not None:
            return size
        own = self._instructions[str(kind)]
        return own.size(own.record(var_id))

    def _entry(self, var_id: int) -> DBEntry:
        """Return the database entry of a variable in a queue."""
        return self._database.entries[var_id]

    def _take(self, kind: ContainerType, var_id: int) -> VardisRecord | OwnRecord:
        """Return the record of a variable, and count it as sent."""
        database = self._database
        if kind is ICType.REQUEST_VARCREATES:
            ##= VD-CMP-12
            database.req_create_q.remove(var_id)
            return VarReqCreate(var_id)
        if not isinstance(kind, ICType):
            return self._take_own(self._instructions[kind], var_id)
        entry = self._entry(var_id)
        if kind is ICType.CREATE_VARIABLES:
            ##= VD-CMP-06
            entry.count_create -= 1
            _rotate_or_leave(database.create_q, var_id, entry.count_create)
            ##= VD-CMP-07 VD-TYP-06 VD-PC-10 VD-TYP-07
            return VarCreate(entry.spec, VarUpdate(var_id, entry.seqno, entry.value))
        if kind is ICType.UPDATES:
            ##= VD-CMP-09
            entry.count_update -= 1
            _rotate_or_leave(database.update_q, var_id, entry.count_update)
            ##= VD-UPD-10
            return VarUpdate(var_id, entry.seqno, entry.value)
        if kind is ICType.DELETE_VARIABLES:
            ##= VD-CMP-10
            entry.count_delete -= 1
            _rotate_or_leave(database.delete_q, var_id, entry.count_delete)
            if not entry.count_delete:
                database.after_last_delete(var_id)
            return VarDelete(var_id)
        if kind is ICType.REQUEST_VARUPDATES:
            ##= VD-CMP-11
            database.req_upd_q.remove(var_id)
            return VarReqUpdate(var_id, entry.seqno)
        ##= VD-CMP-03
        database.summary_q.rotate(var_id)
        ##= VD-CMP-04
        return VarSumm(var_id, entry.seqno)

    def _take_all(self, kind: ContainerType, chosen: list[int]) -> Sequence[VardisRecord | OwnRecord]:
        """Return the records of variables, and count them as sent."""
        take = self._take_filled if self._own_fields else self._take
        return [take(kind, var_id) for var_id in chosen]

    def _take_filled(self, kind: ContainerType, var_id: int) -> VardisRecord | OwnRecord:
        """Return :meth:`_take` with the values of fields that the profile adds to records."""
        entry = self._database.lookup(var_id)
        return self._own_fields.filled(self._take(kind, var_id), kept={} if entry is None else entry.own)

    @staticmethod
    def _take_own(instruction: Instruction, var_id: int) -> OwnRecord:
        """Return the record of an additional container type, and let the instruction count it as sent."""
        record = instruction.record(var_id)
        instruction.sent(var_id)
        return record


def _rotate_or_leave(queue: IdQueue, var_id: int, remaining: int) -> None:
    """Move a variable to the tail while repetitions remain, otherwise remove it from the queue."""
    ##= VD-SCP-02
    if remaining:
        queue.rotate(var_id)
    else:
        queue.remove(var_id)
