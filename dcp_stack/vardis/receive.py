"""The receive path of VarDis, second phase: instructions change the database (dcp-vardis.md, "Processing Step")."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VarDelete, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate
from dcp_stack.drops import DROPS
from dcp_stack.effects import Dropped

from .core import Core
from .database import DBEntry
from .instructions import Instruction
from .state_table import Action, Cell, Event
from .wire import Extracted

#: The requirement that applies to an extraction error, by the codec's reason; VD-RX-07 (truncation) for all others.
_EXTRACTION = {"unknown-type": "VD-RX-05", "zero-count": "VD-RX-06"}
_REQUIREMENTS = {reason: requirement for reason, (requirement, _) in DROPS.items()}


class Receiver:
    """Processes the records of a payload, in the order of the specification."""

    def __init__(self, core: Core, instructions: Mapping[str, Instruction] | None = None) -> None:
        """``instructions``: the instructions for the profile's additional container types, by the name of the type."""
        self._instructions = instructions or {}
        self._own_types = [each.name for each in core.config.profile.vardis.own_containers]
        self._core = core
        self._database = core.database
        self._parameters = core.parameters
        self._emit = core.emit
        self._own_fields = core.config.own_fields
        self._check_too_long = core.features.receive_checks_too_long
        self._check_empty_and_repcnt = core.features.receive_checks_empty_and_repcnt
        most = core.settings.max_creation_ahead_s
        self._most_ahead = None if most is None else round(most * 1e9)
        self._drop_mismatch = core.readings.mismatched_ids == "drop-mismatch"

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        """Emit ``Dropped`` for each problem, then process all records. Never raises."""
        for problem in extracted.problems:
            requirement = _EXTRACTION.get(problem.reason, "VD-RX-07")
            self._emit(Dropped("vardis", problem.reason, requirement, problem.offset))
        records = extracted.records
        ##= VD-RX-08
        for offset, record in records[ICType.CREATE_VARIABLES]:
            self._create(record, offset, now, wall)
        for offset, record in records[ICType.DELETE_VARIABLES]:
            self._delete(record, offset)
        for offset, record in records[ICType.UPDATES]:
            self._update(record, offset, now, wall)
        for offset, record in records[ICType.SUMMARIES]:
            self._summary(record, offset)
        for offset, record in records[ICType.REQUEST_VARCREATES]:
            self._request_create(record, offset)
        for offset, record in records[ICType.REQUEST_VARUPDATES]:
            self._request_update(record, offset)
        for name in self._own_types:
            for offset, record in records.get(name, ()):
                self._own(name, record, offset, now, wall)

    # -- one record of each type --------------------------------------------------------------------------------

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        """Process a VarCreate; ``offset`` is that of the record in the payload, here and below."""
        var_id = record.spec.var_id
        if self._most_ahead is not None and self._ahead(record, wall) > self._most_ahead:
            self._dropped("creation-ahead", offset, var_id)
            return
        entry = self._database.lookup(var_id)
        event = self._create_event(record, entry)
        if record.spec.prod_id == self._core.own_id:
            known = None if entry is None else entry.spec.creation_time
            self._core.delivery.own_creation(var_id, record.spec.creation_time, known)
        elif entry is not None and record.upd.seqno == entry.seqno:
            self._core.delivery.has(var_id)
        cell = self._core.cell(event, entry)
        if cell.action is not Action.ADOPT:
            self._drop(cell, offset, var_id)
            return
        if entry is None and len(self._database) >= self._core.max_variables:
            self._dropped("database-full", offset, var_id)
            return
        ##= VD-PC-07
        stored = self._database.insert(record.spec, record.upd.value, record.upd.seqno, now=now, wall=wall)
        self._own_fields.keep(stored.own, record)
        self._core.changed("created", stored)
        self._core.delivery.adopted(entry, stored, self._core.own_id)

    def _ahead(self, record: VarCreate, wall: int) -> int:
        """Return by how many ns the creation time of a VarCreate is ahead of the local clock; usually negative.

        Returns 0 for a record without a creation time.
        """
        created = record.spec.creation_time
        return 0 if created is None else self._core.clock.wall(created, near=wall) - wall

    def _create_event(self, record: VarCreate, entry: DBEntry | None) -> Event:
        """Return the event for a VarCreate, compared with the stored variable in the order of the specification."""
        spec, upd = record.spec, record.upd
        if self._drop_mismatch and upd.var_id != spec.var_id:
            return Event.RX_CREATE_MISMATCH
        ##= VD-PC-01
        if entry is not None and not self._is_later(record, entry):
            return Event.RX_CREATE_NOT_LATER
        ##= VD-PC-03
        if spec.prod_id == self._core.own_id:
            return Event.RX_CREATE_OWN
        ##= VD-PC-04
        if self._is_bad_value(upd.value):
            return Event.RX_CREATE_BAD_VALUE
        ##= VD-PC-05
        if self._check_too_long and len(spec.descr) > self._parameters.longest_description:
            return Event.RX_CREATE_BAD_DESCRIPTION
        if self._check_empty_and_repcnt:
            if not spec.descr:
                return Event.RX_CREATE_BAD_DESCRIPTION
            ##= VD-PC-06
            if not 1 <= spec.rep_cnt <= self._parameters.max_repetitions:
                return Event.RX_CREATE_BAD_REPCNT
        return Event.RX_CREATE_LATER

    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        """Return whether a VarCreate has a later creation time than the stored variable; always False before 2.0."""
        ##= VD-PC-11
        received, stored = record.spec.creation_time, entry.spec.creation_time
        return self._core.features.creation_time and received is not None and stored is not None and received > stored

    def _is_bad_value(self, value: bytes) -> bool:
        """Return whether a received value is too long or empty, if the profile's version checks that."""
        ##= VD-TYP-02
        too_long = self._check_too_long and len(value) > self._parameters.max_value_length
        return too_long or (self._check_empty_and_repcnt and not value)

    def _delete(self, record: VarDelete, offset: int) -> None:
        """Process a VarDelete."""
        entry = self._database.lookup(record.var_id)
        cell = self._core.cell(Event.RX_DELETE, entry)
        if cell.action is Action.DELETE and entry is not None:
            ##= VD-PD-04
            self._database.mark_deleted(entry)
            self._own_fields.keep(entry.own, record)
            self._core.changed("deleted", entry)
        else:
            self._drop(cell, offset, record.var_id)

    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        """Process a VarUpdate."""
        var_id = record.var_id
        entry = self._database.lookup(var_id)
        cell = self._core.cell(self._update_event(record, entry), entry)
        if cell.action is Action.STORE and entry is not None:
            ##= VD-PU-07
            self._database.store(entry, record.value, record.seqno, now=now, wall=wall)
            self._own_fields.keep(entry.own, record)
            ##= VD-PU-08
            self._database.req_upd_q.remove(var_id)
            self._core.changed("updated", entry)
            return
        self._answer(cell, entry, var_id, offset)

    def _update_event(self, record: VarUpdate, entry: DBEntry | None) -> Event:
        """Return the event for a VarUpdate, compared with the stored variable in the order of the specification."""
        ##= VD-PU-04
        if self._is_bad_value(record.value):
            return Event.RX_UPDATE_BAD_VALUE
        if entry is None:
            return Event.RX_UPDATE_NEWER
        ##= VD-PU-05
        if record.seqno == entry.seqno:
            return Event.RX_UPDATE_EQUAL
        if self._core.sequence.received_is_older(record.seqno, entry.seqno):
            return Event.RX_UPDATE_OLDER
        return Event.RX_UPDATE_NEWER

    def _summary(self, record: VarSumm, offset: int) -> None:
        """Process a VarSumm."""
        ##= VD-SCP-01
        var_id = record.var_id
        entry = self._database.lookup(var_id)
        if entry is not None and entry.spec.prod_id == self._core.own_id:
            self._core.delivery.summary_of_own(var_id, record.seqno)
        if entry is not None and record.seqno == entry.seqno:
            event = Event.RX_SUMMARY_EQUAL
            self._core.delivery.has(var_id)
        elif entry is not None and self._core.sequence.received_is_older(record.seqno, entry.seqno):
            event = Event.RX_SUMMARY_OLDER
        else:
            event = Event.RX_SUMMARY_NEWER
        self._answer(self._core.cell(event, entry), entry, var_id, offset)

    def _request_update(self, record: VarReqUpdate, offset: int) -> None:
        """Process a VarReqUpdate."""
        entry = self._database.lookup(record.var_id)
        ##= VD-RU-03
        behind = entry is not None and self._core.sequence.answers(record.seqno, entry.seqno)
        event = Event.RX_REQUEST_UPDATE_BEHIND if behind else Event.RX_REQUEST_UPDATE_OTHER
        self._answer(self._core.cell(event, entry), entry, record.var_id, offset)

    def _request_create(self, record: VarReqCreate, offset: int) -> None:
        """Process a VarReqCreate."""
        entry = self._database.lookup(record.var_id)
        self._answer(self._core.cell(Event.RX_REQUEST_CREATE, entry), entry, record.var_id, offset)

    def _own(self, name: str, record: Any, offset: int, now: int, wall: int) -> None:
        """Process a record of an additional container type; drop it if there is no instruction for the type."""
        instruction = self._instructions.get(name)
        reason = "unhandled-container" if instruction is None else instruction.receive(record, now, wall)
        if reason is not None:
            self._emit(Dropped("vardis", reason, _REQUIREMENTS[reason], offset))

    # -- actions of cells ---------------------------------------------------------------------------------------

    def _answer(self, cell: Cell, entry: DBEntry | None, var_id: int, offset: int) -> None:
        """Queue the record that a cell's action requires, and emit ``Dropped`` if the cell has a reason."""
        database, action = self._database, cell.action
        if action is Action.IGNORE:
            pass
        elif action is Action.REQUEST_CREATE:
            self._request(var_id, offset)
        elif entry is not None:
            if action is Action.TEACH:
                ##= VD-PU-06 VD-PS-03
                if var_id not in database.update_q:
                    database.arm_update(entry)
            elif action is Action.SEND_UPDATE:
                ##= VD-RU-04
                database.arm_update(entry)
                self._core.delivery.asked(var_id)
            elif action is Action.SEND_CREATE:
                ##= VD-RC-03
                database.arm_create(entry)
                self._core.delivery.asked(var_id)
            elif action is Action.REQUEST_UPDATE:
                ##= VD-PS-04
                database.req_upd_q.append(var_id)
        if cell.reason is not None:
            self._dropped(cell.reason, offset, var_id)

    def _request(self, var_id: int, offset: int) -> None:
        """Queue a VarReqCreate for an unknown variable."""
        queue = self._database.req_create_q
        if var_id in queue:
            return
        # The variable could not be stored. The limit of the queue keeps received records from exhausting memory.
        if len(self._database) >= self._core.max_variables or len(queue) >= self._core.max_variables:
            self._dropped("database-full", offset, var_id)
            return
        ##= VD-PU-01 VD-PS-01 VD-RU-01 VD-RC-01
        queue.append(var_id)

    def _drop(self, cell: Cell, offset: int, var_id: int) -> None:
        """Emit ``Dropped`` if the cell has a reason."""
        if cell.reason is not None:
            self._dropped(cell.reason, offset, var_id)

    def _dropped(self, reason: str, offset: int, var_id: int) -> None:
        """Emit ``Dropped`` for a record, with the requirement that belongs to the reason."""
        self._emit(Dropped("vardis", reason, _REQUIREMENTS[reason], offset, var_id))
