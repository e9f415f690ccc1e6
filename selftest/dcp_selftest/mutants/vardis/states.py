"""Faults in the state table of VarDis (C.5): a wrong cell, or a wrong comparison that leads to one."""

from __future__ import annotations

from typing import ClassVar

from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarSumm, VarUpdate
from dcp_selftest.mutants.cells import CONSUMED, DELETED, DELETED_OWN, PRODUCED, UNKNOWN, Cells, within
from dcp_selftest.mutants.entries import on_entry
from dcp_selftest.mutants.family import around, assign, attributes, before, instead, skips
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import PURGED
from dcp_stack.vardis.core import Sequence
from dcp_stack.vardis.database import DBEntry
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.state_table import Action, Cell, Event

V2 = SpecVersion.V2_0

UPDATES = (Event.RX_UPDATE_EQUAL, Event.RX_UPDATE_OLDER, Event.RX_UPDATE_NEWER, Event.RX_UPDATE_BAD_VALUE)
SUMMARIES = (Event.RX_SUMMARY_EQUAL, Event.RX_SUMMARY_OLDER, Event.RX_SUMMARY_NEWER)
REQUESTS = (Event.RX_REQUEST_UPDATE_BEHIND, Event.RX_REQUEST_UPDATE_OTHER)


# -- VarDelete ---------------------------------------------------------------------------------------------------------


# fmt: off
before(Receiver, Receiver._delete)("requested", "VD-PD-01",
    "requests an unknown variable when it receives a VarDelete of it",
    lambda self, record, offset: (
        self._request(record.var_id, offset) if self._database.lookup(record.var_id) is None else None))
cells = attributes(Cells, __name__)
cells("again", "VD-PD-02 VD-SCP-03", "repeats the VarDelete of a deleted variable whenever it receives one",
    cells=within((DELETED,), Action.DELETE, Event.RX_DELETE))
cells("own", "VD-PD-03", "allows other nodes to delete its own variables",
    cells=within((PRODUCED,), Action.DELETE, Event.RX_DELETE))
cells("ignored", "VD-PD-04", "does not delete variables of other nodes",
    cells=within((CONSUMED,), Action.IGNORE, Event.RX_DELETE))
# fmt: on


# -- VarUpdate ---------------------------------------------------------------------------------------------------------


cells("ignored", "VD-PU-01", "does not request an unknown variable when it receives a VarUpdate of it",
    cells=within((UNKNOWN,), Action.IGNORE, *UPDATES))  # fmt: skip
cells("requests-deleted", "VD-PU-02", "requests a deleted variable when it receives a VarUpdate of it",
    cells=within((DELETED,), Action.REQUEST_CREATE, *UPDATES))  # fmt: skip


@mutant("revived", "VD-PU-02", "restores a deleted variable when it receives a VarUpdate of it")
class UpdateRevives(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.is_deleted and record.value and entry.spec.prod_id != self._core.own_id:
            self._database.insert(entry.spec, record.value, record.seqno, now=now, wall=wall)
        else:
            super()._update(record, offset, now, wall)


# fmt: off
cells("stored-deleted", "VD-PU-02", "forwards VarUpdates of deleted variables",
    cells=within((DELETED, DELETED_OWN), Action.STORE, Event.RX_UPDATE_NEWER))
cells("own", "VD-PU-03", "accepts updates of its own variables from other nodes",
    cells=within((PRODUCED,), Action.STORE, Event.RX_UPDATE_NEWER))
cells("own-taught", "VD-PU-03", "answers an older VarUpdate of its own variable with its value",
    cells=within((PRODUCED,), Action.TEACH, Event.RX_UPDATE_OLDER))
around_update_event = around(Receiver, Receiver._update_event)
around_update_event("any-length", "VD-PU-04", "stores values of any length from updates",
    lambda self, proceed, record, entry: (
        proceed(VarUpdate(record.var_id, record.seqno, record.value[: self._parameters.max_value_length] or b"-"),
        entry)))
around_update_event("empty", "VD-PU-04 VD-TYP-02", "stores the empty value of a VarUpdate",
    lambda self, proceed, record, entry: proceed(VarUpdate(record.var_id, record.seqno, record.value or b"-"), entry),
    since=SpecVersion.V1_2)
cells("stored", "VD-PU-05", "stores the value of a VarUpdate with the stored sequence number",
    cells=within((CONSUMED,), Action.STORE, Event.RX_UPDATE_EQUAL))
cells("repeated", "VD-PU-05 VD-SCP-03", "forwards the same VarUpdate whenever it receives it",
    cells=within((CONSUMED,), Action.SEND_UPDATE, Event.RX_UPDATE_EQUAL))
cells("stored", "VD-PU-06", "stores older VarUpdates", cells=within((CONSUMED,), Action.STORE, Event.RX_UPDATE_OLDER))
cells("not-taught", "VD-PU-06", "does not answer an older VarUpdate with its newer value",
    cells=within((CONSUMED,), Action.IGNORE, Event.RX_UPDATE_OLDER))
cells("counts-again", "VD-PU-06", "restarts the repetitions of a VarUpdate with each older one that it receives",
    cells=within((CONSUMED,), Action.SEND_UPDATE, Event.RX_UPDATE_OLDER))
cells("ignored", "VD-PU-07", "ignores newer VarUpdates of other nodes' variables",
    cells=within((CONSUMED,), Action.IGNORE, Event.RX_UPDATE_NEWER))
cells("asked", "VD-PU-07", "requests an update instead of storing a newer VarUpdate",
    cells=within((CONSUMED,), Action.REQUEST_UPDATE, Event.RX_UPDATE_NEWER))
# fmt: on


# -- VarSumm -----------------------------------------------------------------------------------------------------------


# fmt: off
cells("ignored", "VD-PS-01", "does not request an unknown variable when it receives a summary of it",
    cells=within((UNKNOWN,), Action.IGNORE, *SUMMARIES))
cells("requests-deleted", "VD-PS-02", "requests a deleted variable when it receives a summary of it",
    cells=within((DELETED,), Action.REQUEST_CREATE, *SUMMARIES))
cells("own-requested", "VD-PS-02", "requests an update of its own variable after a newer summary",
    cells=within((PRODUCED,), Action.REQUEST_UPDATE, Event.RX_SUMMARY_NEWER))
cells("own-taught", "VD-PS-02", "answers an older summary of its own variable",
    cells=within((PRODUCED,), Action.TEACH, Event.RX_SUMMARY_OLDER))
cells("equal-answered", "VD-PS-02", "answers a summary with the stored sequence number",
    cells=within((CONSUMED,), Action.TEACH, Event.RX_SUMMARY_EQUAL))
cells("equal-requested", "VD-PS-02", "requests an update after a summary with the stored sequence number",
    cells=within((CONSUMED,), Action.REQUEST_UPDATE, Event.RX_SUMMARY_EQUAL))
cells("not-taught", "VD-PS-03", "does not answer an older summary with its value",
    cells=within((CONSUMED,), Action.IGNORE, Event.RX_SUMMARY_OLDER))
cells("counts-again", "VD-PS-03", "restarts the repetitions of a VarUpdate with each older summary",
    cells=within((CONSUMED,), Action.SEND_UPDATE, Event.RX_SUMMARY_OLDER))
cells("not-requested", "VD-PS-04", "does not request an update after a newer summary",
    cells=within((CONSUMED,), Action.IGNORE, Event.RX_SUMMARY_NEWER))
# fmt: on


@mutant("number-taken", "VD-PS-04", "stores the sequence number of a newer summary, and does not request the value")
class NumberTaken(Receiver):
    def _summary(self, record: VarSumm, offset: int) -> None:
        entry = self._database.lookup(record.var_id)
        consumed = entry is not None and not entry.is_deleted and entry.spec.prod_id != self._core.own_id
        if entry is not None and consumed and not self._core.sequence.received_is_older(record.seqno, entry.seqno):
            entry.seqno = record.seqno
        else:
            super()._summary(record, offset)


cells("whole-requested", "VD-PS-04", "requests the VarCreate after a newer summary",
    cells=within((CONSUMED,), Action.REQUEST_CREATE, Event.RX_SUMMARY_NEWER))  # fmt: skip


# -- requests ----------------------------------------------------------------------------------------------------------


# fmt: off
cells("ignored", "VD-RU-01", "does not request an unknown variable when it receives a VarReqUpdate for it",
    cells=within((UNKNOWN,), Action.IGNORE, *REQUESTS))
cells("requested", "VD-RU-05 VD-SCP-01",
    "requests an unknown variable when it receives a VarReqUpdate for it, as in later versions",
    cells=within((UNKNOWN,), Action.REQUEST_CREATE, *REQUESTS))
cells("deleted-answered", "VD-RU-02", "answers requests for updates of deleted variables",
    unseen=PURGED, cells=within((DELETED, DELETED_OWN), Action.SEND_UPDATE, *REQUESTS))
around(Sequence, Sequence.answers)("equal-answered", "VD-RU-03", "answers a VarReqUpdate with an equal sequence number",
    lambda self, proceed, requested, own: requested == own or proceed(requested, own))
answers = instead(Sequence, Sequence.answers)
answers("newer-answered", "VD-RU-03", "answers a VarReqUpdate with a newer sequence number",
    lambda self, requested, own: requested != own)
answers("no-wrap", "VD-RU-03 VD-RU-04", "compares the sequence numbers of requests without wrap-around",
    lambda self, requested, own: own > requested)
cells("consumer-silent", "VD-RU-04", "answers requests for updates only as the producer",
    cells=within((CONSUMED,), Action.IGNORE, *REQUESTS))
cells("producer-silent", "VD-RU-04", "does not answer requests for updates of its own variables",
    cells=within((PRODUCED,), Action.IGNORE, *REQUESTS))
cells("with-create", "VD-RU-04", "answers a VarReqUpdate with a VarCreate",
    cells=within((PRODUCED, CONSUMED), Action.SEND_CREATE, Event.RX_REQUEST_UPDATE_BEHIND))
on_entry(Receiver, Receiver._request_update)("once", "VD-RU-04", "answers a VarReqUpdate once, whatever the repCnt",
    lambda self, entry, before: assign(entry, count_update=min(entry.count_update, 1)))
cells("ignored", "VD-RC-01", "does not request an unknown variable when it receives a VarReqCreate for it",
    cells=within((UNKNOWN,), Action.IGNORE, Event.RX_REQUEST_CREATE))
cells("requested", "VD-RC-04 VD-SCP-01",
    "requests an unknown variable when it receives a VarReqCreate for it, as in later versions",
    cells=within((UNKNOWN,), Action.REQUEST_CREATE, Event.RX_REQUEST_CREATE))
cells("deleted-answered", "VD-RC-02", "answers requests for deleted variables",
    unseen=PURGED, cells=within((DELETED, DELETED_OWN), Action.SEND_CREATE, Event.RX_REQUEST_CREATE))
# fmt: on


@mutant("deletion-answered", "VD-RC-02", "answers requests for deleted variables with a VarDelete")
class DeletionSent(Cells):
    cells: ClassVar = within((DELETED, DELETED_OWN), Action.DELETE, Event.RX_REQUEST_CREATE)

    def cell(self, event: Event, entry: DBEntry | None) -> Cell:
        cell = super().cell(event, entry)
        if cell.action is Action.DELETE and event is Event.RX_REQUEST_CREATE and entry is not None:
            self.database.mark_deleted(entry)
        return cell


# fmt: off
cells("consumer-silent", "VD-RC-03", "answers requests for variables only as the producer",
    cells=within((CONSUMED,), Action.IGNORE, Event.RX_REQUEST_CREATE))
cells("producer-silent", "VD-RC-03", "does not answer requests for its own variables",
    cells=within((PRODUCED,), Action.IGNORE, Event.RX_REQUEST_CREATE))
cells("with-update", "VD-RC-03", "answers a VarReqCreate with a VarUpdate",
    cells=within((PRODUCED, CONSUMED), Action.SEND_UPDATE, Event.RX_REQUEST_CREATE))
on_entry(Receiver, Receiver._request_create)("once", "VD-RC-03", "answers a VarReqCreate once, whatever the repCnt",
    lambda self, entry, before: assign(entry, count_create=min(entry.count_create, 1)))
skips(Receiver, Receiver._request_create)("not-again", "VD-RC-03",
    "does not restart the repetitions of a VarCreate when the variable is requested again",
    lambda self, record, offset: not (record.var_id not in self._database.create_q))
# fmt: on


# -- sequence numbers --------------------------------------------------------------------------------------------------


# fmt: off
received_is_older = instead(Sequence, Sequence.received_is_older)
received_is_older("no-wrap", "VD-PU-07 VD-PU-06 VD-PS-03 VD-PS-04",
    "compares received sequence numbers without wrap-around",
    lambda self, received, own: received < own)
received_is_older("quarter", "VD-PU-06 VD-PU-07 VD-PS-03 VD-PS-04",
    "treats sequence numbers as older only up to a quarter of the number space",
    lambda self, received, own: 0 < (own - received) % self._modulus < self._modulus // 4)
received_is_older("next-only", "VD-PU-07 VD-PS-04", "treats a sequence number as newer only if it is the next one",
    lambda self, received, own: received != (own + 1) % self._modulus)
received_is_older("half-off", "VD-PU-06 VD-PS-03", "treats the oldest sequence number (by circular distance) as newer",
    lambda self, received, own: 0 < (own - received) % self._modulus < self._modulus // 2 - 1)
received_is_older("newest-lost", "VD-PU-07 VD-PS-04",
    "treats the newest sequence number (by circular distance) as older",
    lambda self, received, own: 0 < (own - received) % self._modulus <= self._modulus // 2 + 1)
answers("answers-half-off", "VD-RU-04",
    "does not answer requests with the oldest sequence number (by circular distance)",
    lambda self, requested, own: 0 < (own - requested) % self._modulus < self._modulus // 2 - 1)
# fmt: on
