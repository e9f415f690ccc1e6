"""Faults in the state table of VarDis (C.5): a wrong cell, or a wrong comparison that leads to one."""

from __future__ import annotations

from typing import ClassVar

from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarDelete, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate
from dcp_selftest.mutants.cells import CONSUMED, DELETED, DELETED_OWN, PRODUCED, UNKNOWN, Cells, within
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


@mutant("requested", "VD-PD-01", "requests an unknown variable when it receives a VarDelete of it")
class DeletedRequested(Receiver):
    def _delete(self, record: VarDelete, offset: int) -> None:
        if self._database.lookup(record.var_id) is None:
            self._request(record.var_id, offset)
        super()._delete(record, offset)


@mutant("again", "VD-PD-02 VD-SCP-03", "repeats the VarDelete of a deleted variable whenever it receives one")
class DeletedAgain(Cells):
    cells: ClassVar = within((DELETED,), Action.DELETE, Event.RX_DELETE)


@mutant("own", "VD-PD-03", "allows other nodes to delete its own variables")
class OwnDeleted(Cells):
    cells: ClassVar = within((PRODUCED,), Action.DELETE, Event.RX_DELETE)


@mutant("ignored", "VD-PD-04", "does not delete variables of other nodes")
class NotDeleted(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_DELETE)


# -- VarUpdate ---------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-PU-01", "does not request an unknown variable when it receives a VarUpdate of it")
class UpdateIgnored(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.IGNORE, *UPDATES)


@mutant("requests-deleted", "VD-PU-02", "requests a deleted variable when it receives a VarUpdate of it")
class UpdateRequests(Cells):
    cells: ClassVar = within((DELETED,), Action.REQUEST_CREATE, *UPDATES)


@mutant("revived", "VD-PU-02", "restores a deleted variable when it receives a VarUpdate of it")
class UpdateRevives(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.is_deleted and record.value and entry.spec.prod_id != self._core.own_id:
            self._database.insert(entry.spec, record.value, record.seqno, now=now, wall=wall)
        else:
            super()._update(record, offset, now, wall)


@mutant("stored-deleted", "VD-PU-02", "forwards VarUpdates of deleted variables")
class UpdateOfDeleted(Cells):
    cells: ClassVar = within((DELETED, DELETED_OWN), Action.STORE, Event.RX_UPDATE_NEWER)


@mutant("own", "VD-PU-03", "accepts updates of its own variables from other nodes")
class OwnUpdated(Cells):
    cells: ClassVar = within((PRODUCED,), Action.STORE, Event.RX_UPDATE_NEWER)


@mutant("own-taught", "VD-PU-03", "answers an older VarUpdate of its own variable with its value")
class OwnTaught(Cells):
    cells: ClassVar = within((PRODUCED,), Action.TEACH, Event.RX_UPDATE_OLDER)


@mutant("any-length", "VD-PU-04", "stores values of any length from updates")
class AnyUpdate(Receiver):
    def _update_event(self, record: VarUpdate, entry: DBEntry | None) -> Event:
        value = record.value[: self._parameters.max_value_length] or b"-"
        return super()._update_event(VarUpdate(record.var_id, record.seqno, value), entry)


@mutant("empty", "VD-PU-04 VD-TYP-02", "stores the empty value of a VarUpdate", since=SpecVersion.V1_2)
class EmptyUpdate(Receiver):
    def _update_event(self, record: VarUpdate, entry: DBEntry | None) -> Event:
        return super()._update_event(VarUpdate(record.var_id, record.seqno, record.value or b"-"), entry)


@mutant("stored", "VD-PU-05", "stores the value of a VarUpdate with the stored sequence number")
class EqualStored(Cells):
    cells: ClassVar = within((CONSUMED,), Action.STORE, Event.RX_UPDATE_EQUAL)


@mutant("repeated", "VD-PU-05 VD-SCP-03", "forwards the same VarUpdate whenever it receives it")
class EqualRepeated(Cells):
    cells: ClassVar = within((CONSUMED,), Action.SEND_UPDATE, Event.RX_UPDATE_EQUAL)


@mutant("stored", "VD-PU-06", "stores older VarUpdates")
class OlderStored(Cells):
    cells: ClassVar = within((CONSUMED,), Action.STORE, Event.RX_UPDATE_OLDER)


@mutant("not-taught", "VD-PU-06", "does not answer an older VarUpdate with its newer value")
class NotTaught(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_UPDATE_OLDER)


@mutant("counts-again", "VD-PU-06", "restarts the repetitions of a VarUpdate with each older one that it receives")
class CountsAgain(Cells):
    cells: ClassVar = within((CONSUMED,), Action.SEND_UPDATE, Event.RX_UPDATE_OLDER)


@mutant("ignored", "VD-PU-07", "ignores newer VarUpdates of other nodes' variables")
class NewerIgnored(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_UPDATE_NEWER)


@mutant("asked", "VD-PU-07", "requests an update instead of storing a newer VarUpdate")
class NewerAsked(Cells):
    cells: ClassVar = within((CONSUMED,), Action.REQUEST_UPDATE, Event.RX_UPDATE_NEWER)


# -- VarSumm -----------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-PS-01", "does not request an unknown variable when it receives a summary of it")
class SummaryIgnored(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.IGNORE, *SUMMARIES)


@mutant("requests-deleted", "VD-PS-02", "requests a deleted variable when it receives a summary of it")
class SummaryOfDeleted(Cells):
    cells: ClassVar = within((DELETED,), Action.REQUEST_CREATE, *SUMMARIES)


@mutant("own-requested", "VD-PS-02", "requests an update of its own variable after a newer summary")
class OwnRequested(Cells):
    cells: ClassVar = within((PRODUCED,), Action.REQUEST_UPDATE, Event.RX_SUMMARY_NEWER)


@mutant("own-taught", "VD-PS-02", "answers an older summary of its own variable")
class OwnSummaryTaught(Cells):
    cells: ClassVar = within((PRODUCED,), Action.TEACH, Event.RX_SUMMARY_OLDER)


@mutant("equal-answered", "VD-PS-02", "answers a summary with the stored sequence number")
class EqualAnswered(Cells):
    cells: ClassVar = within((CONSUMED,), Action.TEACH, Event.RX_SUMMARY_EQUAL)


@mutant("equal-requested", "VD-PS-02", "requests an update after a summary with the stored sequence number")
class EqualRequested(Cells):
    cells: ClassVar = within((CONSUMED,), Action.REQUEST_UPDATE, Event.RX_SUMMARY_EQUAL)


@mutant("not-taught", "VD-PS-03", "does not answer an older summary with its value")
class SummaryNotTaught(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_SUMMARY_OLDER)


@mutant("counts-again", "VD-PS-03", "restarts the repetitions of a VarUpdate with each older summary")
class SummaryCountsAgain(Cells):
    cells: ClassVar = within((CONSUMED,), Action.SEND_UPDATE, Event.RX_SUMMARY_OLDER)


@mutant("not-requested", "VD-PS-04", "does not request an update after a newer summary")
class NewerNotRequested(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_SUMMARY_NEWER)


@mutant("number-taken", "VD-PS-04", "stores the sequence number of a newer summary, and does not request the value")
class NumberTaken(Receiver):
    def _summary(self, record: VarSumm, offset: int) -> None:
        entry = self._database.lookup(record.var_id)
        consumed = entry is not None and not entry.is_deleted and entry.spec.prod_id != self._core.own_id
        if entry is not None and consumed and not self._core.sequence.received_is_older(record.seqno, entry.seqno):
            entry.seqno = record.seqno
        else:
            super()._summary(record, offset)


@mutant("whole-requested", "VD-PS-04", "requests the VarCreate after a newer summary")
class WholeRequested(Cells):
    cells: ClassVar = within((CONSUMED,), Action.REQUEST_CREATE, Event.RX_SUMMARY_NEWER)


# -- requests ----------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-RU-01", "does not request an unknown variable when it receives a VarReqUpdate for it")
class UnknownUpdateRequest(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.IGNORE, *REQUESTS)


@mutant(
    "requested",
    "VD-RU-05 VD-SCP-01",
    "requests an unknown variable when it receives a VarReqUpdate for it, as in later versions",
)
class UnknownUpdateRequested(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.REQUEST_CREATE, *REQUESTS)


@mutant("deleted-answered", "VD-RU-02", "answers requests for updates of deleted variables", unseen=PURGED)
class DeletedAnswered(Cells):
    cells: ClassVar = within((DELETED, DELETED_OWN), Action.SEND_UPDATE, *REQUESTS)


@mutant("equal-answered", "VD-RU-03", "answers a VarReqUpdate with an equal sequence number")
class EqualRequestAnswered(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return requested == own or super().answers(requested, own)


@mutant("newer-answered", "VD-RU-03", "answers a VarReqUpdate with a newer sequence number")
class NewerAnswered(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return requested != own


@mutant("no-wrap", "VD-RU-03 VD-RU-04", "compares the sequence numbers of requests without wrap-around")
class RequestsWithoutWrap(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return own > requested


@mutant("consumer-silent", "VD-RU-04", "answers requests for updates only as the producer")
class ConsumerSilent(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, *REQUESTS)


@mutant("producer-silent", "VD-RU-04", "does not answer requests for updates of its own variables")
class ProducerSilent(Cells):
    cells: ClassVar = within((PRODUCED,), Action.IGNORE, *REQUESTS)


@mutant("with-create", "VD-RU-04", "answers a VarReqUpdate with a VarCreate")
class WithCreate(Cells):
    cells: ClassVar = within((PRODUCED, CONSUMED), Action.SEND_CREATE, Event.RX_REQUEST_UPDATE_BEHIND)


@mutant("once", "VD-RU-04", "answers a VarReqUpdate once, whatever the repCnt")
class AnswersOnce(Receiver):
    def _request_update(self, record: VarReqUpdate, offset: int) -> None:
        super()._request_update(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.count_update > 1:
            entry.count_update = 1


@mutant("ignored", "VD-RC-01", "does not request an unknown variable when it receives a VarReqCreate for it")
class UnknownRequest(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.IGNORE, Event.RX_REQUEST_CREATE)


@mutant(
    "requested",
    "VD-RC-04 VD-SCP-01",
    "requests an unknown variable when it receives a VarReqCreate for it, as in later versions",
)
class UnknownRequested(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.REQUEST_CREATE, Event.RX_REQUEST_CREATE)


@mutant("deleted-answered", "VD-RC-02", "answers requests for deleted variables", unseen=PURGED)
class DeletedSent(Cells):
    cells: ClassVar = within((DELETED, DELETED_OWN), Action.SEND_CREATE, Event.RX_REQUEST_CREATE)


@mutant("deletion-answered", "VD-RC-02", "answers requests for deleted variables with a VarDelete")
class DeletionSent(Cells):
    cells: ClassVar = within((DELETED, DELETED_OWN), Action.DELETE, Event.RX_REQUEST_CREATE)

    def cell(self, event: Event, entry: DBEntry | None) -> Cell:
        cell = super().cell(event, entry)
        if cell.action is Action.DELETE and event is Event.RX_REQUEST_CREATE and entry is not None:
            self.database.mark_deleted(entry)
        return cell


@mutant("consumer-silent", "VD-RC-03", "answers requests for variables only as the producer")
class ConsumerSendsNone(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_REQUEST_CREATE)


@mutant("producer-silent", "VD-RC-03", "does not answer requests for its own variables")
class ProducerSendsNone(Cells):
    cells: ClassVar = within((PRODUCED,), Action.IGNORE, Event.RX_REQUEST_CREATE)


@mutant("with-update", "VD-RC-03", "answers a VarReqCreate with a VarUpdate")
class WithUpdate(Cells):
    cells: ClassVar = within((PRODUCED, CONSUMED), Action.SEND_UPDATE, Event.RX_REQUEST_CREATE)


@mutant("once", "VD-RC-03", "answers a VarReqCreate once, whatever the repCnt")
class SendsOnce(Receiver):
    def _request_create(self, record: VarReqCreate, offset: int) -> None:
        super()._request_create(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.count_create > 1:
            entry.count_create = 1


@mutant("not-again", "VD-RC-03", "does not restart the repetitions of a VarCreate when the variable is requested again")
class NotAgain(Receiver):
    def _request_create(self, record: VarReqCreate, offset: int) -> None:
        if record.var_id not in self._database.create_q:
            super()._request_create(record, offset)


# -- sequence numbers --------------------------------------------------------------------------------------------------


@mutant("no-wrap", "VD-PU-07 VD-PU-06 VD-PS-03 VD-PS-04", "compares received sequence numbers without wrap-around")
class WithoutWrap(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return received < own


@mutant(
    "quarter",
    "VD-PU-06 VD-PU-07 VD-PS-03 VD-PS-04",
    "treats sequence numbers as older only up to a quarter of the number space",
)
class QuarterOlder(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return 0 < (own - received) % self._modulus < self._modulus // 4


@mutant("next-only", "VD-PU-07 VD-PS-04", "treats a sequence number as newer only if it is the next one")
class NextOnly(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return received != (own + 1) % self._modulus


@mutant("half-off", "VD-PU-06 VD-PS-03", "treats the oldest sequence number (by circular distance) as newer")
class HalfOff(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return 0 < (own - received) % self._modulus < self._modulus // 2 - 1


@mutant("newest-lost", "VD-PU-07 VD-PS-04", "treats the newest sequence number (by circular distance) as older")
class NewestLost(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return 0 < (own - received) % self._modulus <= self._modulus // 2 + 1


@mutant(
    "answers-half-off", "VD-RU-04", "does not answer requests with the oldest sequence number (by circular distance)"
)
class AnswersHalfOff(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return 0 < (own - requested) % self._modulus < self._modulus // 2 - 1
