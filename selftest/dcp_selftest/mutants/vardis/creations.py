"""Faults in the processing of received VarCreates."""

from __future__ import annotations

from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarCreate
from dcp_selftest.mutants.cells import Cells, everywhere
from dcp_selftest.mutants.entries import on_entry
from dcp_selftest.mutants.family import after, attributes, instead
from dcp_selftest.mutants.unseen import NO_TIMES
from dcp_stack.vardis.database import DBEntry
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.state_table import Action, Event

V2 = SpecVersion.V2_0


# -- VarCreate ---------------------------------------------------------------------------------------------------------


class Creations(Receiver):
    """Changes the comparison of creationTimes."""

    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        received, stored = record.spec.creation_time, entry.spec.creation_time
        if received is None or stored is None:
            return False
        return self.later(received, stored, entry)

    def later(self, received: int, stored: int, entry: DBEntry) -> bool:
        """Return whether the received VarCreate is stored."""
        return received > stored


# fmt: off
later = instead(Creations, Creations.later)
later("same", "VD-PC-01", "accepts a VarCreate with the stored creationTime",
    lambda self, received, stored, entry: received >= stored, since=V2)
later("earlier", "VD-PC-01", "accepts a VarCreate with an earlier creationTime",
    lambda self, received, stored, entry: received != stored, since=V2)
later("later-refused", "VD-PC-01", "ignores a VarCreate with a later creationTime while the variable is alive",
    lambda self, received, stored, entry: received > stored and entry.is_deleted, since=V2)
later("seconds", "VD-PC-01", "compares creationTimes in seconds",
    lambda self, received, stored, entry: received // 10**9 > stored // 10**9, since=V2)
later("low-half", "VD-PC-01", "compares only the lower four octets of creationTimes",
    lambda self, received, stored, entry: received & 0xFFFFFFFF > stored & 0xFFFFFFFF, since=V2)
after_is_later = after(Receiver, Receiver._is_later)
after_is_later("same-producer", "VD-PC-01", "accepts a later creation only from the same producer",
    lambda self, result, record, entry: result and record.spec.prod_id == entry.spec.prod_id, since=V2)
after_is_later("own-kept", "VD-PC-01", "does not allow another node to take over one of its own variables",
    lambda self, result, record, entry: result and entry.spec.prod_id != self._core.own_id, since=V2)
is_later = instead(Receiver, Receiver._is_later)
is_later("known-taken", "VD-SCP-03", "accepts any VarCreate of a known variable", lambda self, record, entry: True)
is_later("other-producer", "VD-PC-11", "accepts a VarCreate of a known variable with another producer",
    lambda self, record, entry: record.spec.prod_id != entry.spec.prod_id)
is_later("revives", "VD-PC-11", "accepts a VarCreate of a variable that is being deleted",
    lambda self, record, entry: entry.is_deleted)
later("not-revived", "VD-PC-02", "does not create a deleted variable again",
    lambda self, received, stored, entry: received > stored and not entry.is_deleted, since=V2)
on_entry(Receiver, Receiver._create)("stays-deleted", "VD-PC-02",
    "stores a later creation of a deleted variable, but leaves it deleted",
    lambda self, entry, before: self._database.mark_deleted(entry) if before.is_deleted else None, since=V2)
attributes(Cells, __name__)("taken", "VD-PC-03", "accepts a VarCreate with itself as producer",
    cells=everywhere(Event.RX_CREATE_OWN, Action.ADOPT))
is_bad_value = instead(Receiver, Receiver._is_bad_value)
is_bad_value("any-value", "VD-PC-04", "accepts a VarCreate whose value is too long", lambda self, value: not value)
is_bad_value("empty-value", "VD-PC-04 VD-TYP-02", "accepts a VarCreate with an empty value",
    lambda self, value: len(value) > self._parameters.max_value_length)
after(Receiver, Receiver._is_bad_value)("longest-refused", "VD-PC-04 VD-PU-04 DATA-06",
    "ignores values of maximum length",
    lambda self, result, value: result or len(value) >= self._parameters.max_value_length)
create_event = after(Receiver, Receiver._create_event)
create_event("any-description", "VD-PC-05", "accepts a VarCreate whose description is too long",
    lambda self, event, record, entry: (
        Event.RX_CREATE_LATER if event is Event.RX_CREATE_BAD_DESCRIPTION and record.spec.descr else event))
create_event("empty-description", "VD-PC-05", "accepts a VarCreate with an empty description",
    lambda self, event, record, entry: (
        Event.RX_CREATE_LATER
        if event is Event.RX_CREATE_BAD_DESCRIPTION and not record.spec.descr else event), since=SpecVersion.V1_2)
create_event("longest-refused", "VD-PC-05", "ignores a VarCreate with a description of maximum length",
    lambda self, event, record, entry: (
        Event.RX_CREATE_BAD_DESCRIPTION if len(record.spec.descr) >= self._parameters.longest_description else event))
create_event("characters", "VD-PC-05 DATA-08", "counts the characters of received descriptions, not the octets",
    lambda self, event, record, entry: (
        Event.RX_CREATE_LATER if event is Event.RX_CREATE_BAD_DESCRIPTION
        and (0 < len(record.spec.descr.decode(errors="replace")) <= self._parameters.longest_description) else event))
create_event("too-often", "VD-PC-06", "accepts a VarCreate with a repetition count above the maximum",
    lambda self, event, record, entry: (
        Event.RX_CREATE_LATER
        if event is Event.RX_CREATE_BAD_REPCNT and record.spec.rep_cnt else event), since=SpecVersion.V1_2)
create_event("zero", "VD-PC-06", "accepts a VarCreate with a repetition count of 0",
    lambda self, event, record, entry: (
        Event.RX_CREATE_LATER
        if event is Event.RX_CREATE_BAD_REPCNT and not record.spec.rep_cnt else event), since=SpecVersion.V1_2)
create_event("time-0", "VD-PC-01 VD-PC-09", "treats a VarCreate with creationTime 0 as invalid",
    lambda self, event, record, entry: Event.RX_CREATE_NOT_LATER if record.spec.creation_time == 0 else event,
    since=SpecVersion.V2_0, unseen=NO_TIMES)
create_event("nobody", "VD-PC-07 DATA-04", "ignores a VarCreate whose producer has the identifier 0",
    lambda self, event, record, entry: event if any(record.spec.prod_id) else Event.RX_CREATE_BAD_VALUE)
create_event("most-refused", "VD-PC-06", "ignores a VarCreate with the maximum repetition count",
    lambda self, event, record, entry: (
        Event.RX_CREATE_BAD_REPCNT if record.spec.rep_cnt == self._parameters.max_repetitions else event))
# fmt: on
