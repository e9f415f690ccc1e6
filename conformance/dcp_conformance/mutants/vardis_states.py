"""Faults in the table of VarDis: a wrong cell, or a wrong comparison that leads to one (C.5)."""

from __future__ import annotations

from typing import ClassVar

from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarDelete, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate
from dcp_stack.vardis_core import Sequence
from dcp_stack.vardis_db import DBEntry
from dcp_stack.vardis_receive import Receiver
from dcp_stack.vardis_table import Action, Cell, Event

from .cells import CONSUMED, DELETED, DELETED_OWN, PRODUCED, UNKNOWN, Cells, within
from .mutant import mutant
from .unseen import PURGED

V2 = SpecVersion.V2_0

UPDATES = (Event.RX_UPDATE_EQUAL, Event.RX_UPDATE_OLDER, Event.RX_UPDATE_NEWER, Event.RX_UPDATE_BAD_VALUE)
SUMMARIES = (Event.RX_SUMMARY_EQUAL, Event.RX_SUMMARY_OLDER, Event.RX_SUMMARY_NEWER)
REQUESTS = (Event.RX_REQUEST_UPDATE_BEHIND, Event.RX_REQUEST_UPDATE_OTHER)


# -- VarDelete ---------------------------------------------------------------------------------------------------------


@mutant("requested", "VD-PD-01", "requests a variable of which it only hears that it is deleted")
class DeletedRequested(Receiver):
    def _delete(self, record: VarDelete, offset: int) -> None:
        if self._database.lookup(record.var_id) is None:
            self._request(record.var_id, offset)
        super()._delete(record, offset)


@mutant("again", "VD-PD-02 VD-SCP-03", "repeats the deletion of a deleted variable whenever it hears of it")
class DeletedAgain(Cells):
    cells: ClassVar = within((DELETED,), Action.DELETE, Event.RX_DELETE)


@mutant("own", "VD-PD-03", "lets others delete its own variables")
class OwnDeleted(Cells):
    cells: ClassVar = within((PRODUCED,), Action.DELETE, Event.RX_DELETE)


@mutant("ignored", "VD-PD-04", "does not delete variables of others")
class NotDeleted(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_DELETE)


# -- VarUpdate ---------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-PU-01", "does not request the variable of an update that it does not know")
class UpdateIgnored(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.IGNORE, *UPDATES)


@mutant("requests-deleted", "VD-PU-02", "requests a deleted variable when it hears an update of it")
class UpdateRequests(Cells):
    cells: ClassVar = within((DELETED,), Action.REQUEST_CREATE, *UPDATES)


@mutant("revived", "VD-PU-02", "revives a deleted variable with an update")
class UpdateRevives(Receiver):
    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.is_deleted and record.value and entry.spec.prod_id != self._core.own_id:
            self._database.insert(entry.spec, record.value, record.seqno, now=now, wall=wall)
        else:
            super()._update(record, offset, now, wall)


@mutant("stored-deleted", "VD-PU-02", "repeats updates of deleted variables")
class UpdateOfDeleted(Cells):
    cells: ClassVar = within((DELETED, DELETED_OWN), Action.STORE, Event.RX_UPDATE_NEWER)


@mutant("own", "VD-PU-03", "takes updates of its own variables from others")
class OwnUpdated(Cells):
    cells: ClassVar = within((PRODUCED,), Action.STORE, Event.RX_UPDATE_NEWER)


@mutant("own-taught", "VD-PU-03", "answers an older update of its own variable with its value")
class OwnTaught(Cells):
    cells: ClassVar = within((PRODUCED,), Action.TEACH, Event.RX_UPDATE_OLDER)


@mutant("any-length", "VD-PU-04", "stores values of any length from updates")
class AnyUpdate(Receiver):
    def _update_event(self, record: VarUpdate, entry: DBEntry | None) -> Event:
        value = record.value[: self._parameters.max_value_length] or b"-"
        return super()._update_event(VarUpdate(record.var_id, record.seqno, value), entry)


@mutant("empty", "VD-PU-04 VD-TYP-02", "stores the empty value of an update", since=SpecVersion.V1_2)
class EmptyUpdate(Receiver):
    def _update_event(self, record: VarUpdate, entry: DBEntry | None) -> Event:
        return super()._update_event(VarUpdate(record.var_id, record.seqno, record.value or b"-"), entry)


@mutant("stored", "VD-PU-05", "stores the value of an update with the number that it has")
class EqualStored(Cells):
    cells: ClassVar = within((CONSUMED,), Action.STORE, Event.RX_UPDATE_EQUAL)


@mutant("repeated", "VD-PU-05 VD-SCP-03", "repeats an update whenever it hears it")
class EqualRepeated(Cells):
    cells: ClassVar = within((CONSUMED,), Action.SEND_UPDATE, Event.RX_UPDATE_EQUAL)


@mutant("stored", "VD-PU-06", "stores older updates")
class OlderStored(Cells):
    cells: ClassVar = within((CONSUMED,), Action.STORE, Event.RX_UPDATE_OLDER)


@mutant("not-taught", "VD-PU-06", "does not answer an older update with its newer value")
class NotTaught(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_UPDATE_OLDER)


@mutant("counts-again", "VD-PU-06", "counts the repetitions of an update anew for each older one that it hears")
class CountsAgain(Cells):
    cells: ClassVar = within((CONSUMED,), Action.SEND_UPDATE, Event.RX_UPDATE_OLDER)


@mutant("ignored", "VD-PU-07", "ignores newer updates of variables of others")
class NewerIgnored(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_UPDATE_NEWER)


@mutant("asked", "VD-PU-07", "requests a newer update instead of storing it")
class NewerAsked(Cells):
    cells: ClassVar = within((CONSUMED,), Action.REQUEST_UPDATE, Event.RX_UPDATE_NEWER)


# -- VarSumm -----------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-PS-01", "does not request the variable of a summary that it does not know")
class SummaryIgnored(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.IGNORE, *SUMMARIES)


@mutant("requests-deleted", "VD-PS-02", "requests a deleted variable when it hears a summary of it")
class SummaryOfDeleted(Cells):
    cells: ClassVar = within((DELETED,), Action.REQUEST_CREATE, *SUMMARIES)


@mutant("own-requested", "VD-PS-02", "requests an update of its own variable after a newer summary")
class OwnRequested(Cells):
    cells: ClassVar = within((PRODUCED,), Action.REQUEST_UPDATE, Event.RX_SUMMARY_NEWER)


@mutant("own-taught", "VD-PS-02", "answers an older summary of its own variable")
class OwnSummaryTaught(Cells):
    cells: ClassVar = within((PRODUCED,), Action.TEACH, Event.RX_SUMMARY_OLDER)


@mutant("equal-answered", "VD-PS-02", "answers a summary with the number that it has")
class EqualAnswered(Cells):
    cells: ClassVar = within((CONSUMED,), Action.TEACH, Event.RX_SUMMARY_EQUAL)


@mutant("equal-requested", "VD-PS-02", "requests an update after a summary with the number that it has")
class EqualRequested(Cells):
    cells: ClassVar = within((CONSUMED,), Action.REQUEST_UPDATE, Event.RX_SUMMARY_EQUAL)


@mutant("not-taught", "VD-PS-03", "does not answer an older summary with its value")
class SummaryNotTaught(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_SUMMARY_OLDER)


@mutant("counts-again", "VD-PS-03", "counts the repetitions of an update anew for each older summary")
class SummaryCountsAgain(Cells):
    cells: ClassVar = within((CONSUMED,), Action.SEND_UPDATE, Event.RX_SUMMARY_OLDER)


@mutant("not-requested", "VD-PS-04", "does not request the update that a newer summary tells of")
class NewerNotRequested(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, Event.RX_SUMMARY_NEWER)


@mutant("number-taken", "VD-PS-04", "takes the number of a newer summary for its own, and requests nothing")
class NumberTaken(Receiver):
    def _summary(self, record: VarSumm, offset: int) -> None:
        entry = self._database.lookup(record.var_id)
        consumed = entry is not None and not entry.is_deleted and entry.spec.prod_id != self._core.own_id
        if entry is not None and consumed and not self._core.sequence.received_is_older(record.seqno, entry.seqno):
            entry.seqno = record.seqno
        else:
            super()._summary(record, offset)


@mutant("whole-requested", "VD-PS-04", "requests the whole variable after a newer summary")
class WholeRequested(Cells):
    cells: ClassVar = within((CONSUMED,), Action.REQUEST_CREATE, Event.RX_SUMMARY_NEWER)


# -- requests ----------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-RU-01", "does not request an unknown variable that another node asks an update of")
class UnknownUpdateRequest(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.IGNORE, *REQUESTS)


@mutant(
    "requested",
    "VD-RU-05 VD-SCP-01",
    "requests an unknown variable that another node asks an update of, as only later versions do",
)
class UnknownUpdateRequested(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.REQUEST_CREATE, *REQUESTS)


@mutant("deleted-answered", "VD-RU-02", "answers requests for updates of deleted variables", unseen=PURGED)
class DeletedAnswered(Cells):
    cells: ClassVar = within((DELETED, DELETED_OWN), Action.SEND_UPDATE, *REQUESTS)


@mutant("equal-answered", "VD-RU-03", "answers a request with an equal sequence number")
class EqualRequestAnswered(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return requested == own or super().answers(requested, own)


@mutant("newer-answered", "VD-RU-03", "answers a request of a node that is ahead")
class NewerAnswered(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return requested != own


@mutant("no-wrap", "VD-RU-03 VD-RU-04", "compares numbers of requests without wrap")
class RequestsWithoutWrap(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return own > requested


@mutant("consumer-silent", "VD-RU-04", "answers requests for updates only as the producer")
class ConsumerSilent(Cells):
    cells: ClassVar = within((CONSUMED,), Action.IGNORE, *REQUESTS)


@mutant("producer-silent", "VD-RU-04", "does not answer requests for updates of its own variables")
class ProducerSilent(Cells):
    cells: ClassVar = within((PRODUCED,), Action.IGNORE, *REQUESTS)


@mutant("with-create", "VD-RU-04", "answers a request for an update with the whole variable")
class WithCreate(Cells):
    cells: ClassVar = within((PRODUCED, CONSUMED), Action.SEND_CREATE, Event.RX_REQUEST_UPDATE_BEHIND)


@mutant("once", "VD-RU-04", "answers a request for an update once, whatever repCnt is")
class AnswersOnce(Receiver):
    def _request_update(self, record: VarReqUpdate, offset: int) -> None:
        super()._request_update(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.count_update > 1:
            entry.count_update = 1


@mutant("ignored", "VD-RC-01", "does not request an unknown variable that another node asks for")
class UnknownRequest(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.IGNORE, Event.RX_REQUEST_CREATE)


@mutant(
    "requested",
    "VD-RC-04 VD-SCP-01",
    "requests an unknown variable that another node asks for, as only later versions do",
)
class UnknownRequested(Cells):
    cells: ClassVar = within((UNKNOWN,), Action.REQUEST_CREATE, Event.RX_REQUEST_CREATE)


@mutant("deleted-answered", "VD-RC-02", "answers requests for deleted variables", unseen=PURGED)
class DeletedSent(Cells):
    cells: ClassVar = within((DELETED, DELETED_OWN), Action.SEND_CREATE, Event.RX_REQUEST_CREATE)


@mutant("deletion-answered", "VD-RC-02", "answers requests for deleted variables with their deletion")
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


@mutant("with-update", "VD-RC-03", "answers a request for a variable with an update")
class WithUpdate(Cells):
    cells: ClassVar = within((PRODUCED, CONSUMED), Action.SEND_UPDATE, Event.RX_REQUEST_CREATE)


@mutant("once", "VD-RC-03", "answers a request for a variable once, whatever repCnt is")
class SendsOnce(Receiver):
    def _request_create(self, record: VarReqCreate, offset: int) -> None:
        super()._request_create(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.count_create > 1:
            entry.count_create = 1


@mutant("not-again", "VD-RC-03", "does not count anew when a variable is requested that it is repeating")
class NotAgain(Receiver):
    def _request_create(self, record: VarReqCreate, offset: int) -> None:
        if record.var_id not in self._database.create_q:
            super()._request_create(record, offset)


# -- sequence numbers --------------------------------------------------------------------------------------------------


@mutant("no-wrap", "VD-PU-07 VD-PU-06 VD-PS-03 VD-PS-04", "compares received numbers without wrap")
class WithoutWrap(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return received < own


@mutant("quarter", "VD-PU-06 VD-PU-07 VD-PS-03 VD-PS-04", "takes numbers for older that are up to a quarter behind")
class QuarterOlder(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return 0 < (own - received) % self._modulus < self._modulus // 4


@mutant("next-only", "VD-PU-07 VD-PS-04", "takes a number for newer only if it is the next one")
class NextOnly(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return received != (own + 1) % self._modulus


@mutant("half-off", "VD-PU-06 VD-PS-03", "takes a number for newer that is as far behind as an older one can be")
class HalfOff(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return 0 < (own - received) % self._modulus < self._modulus // 2 - 1


@mutant("newest-lost", "VD-PU-07 VD-PS-04", "takes a number for older that is as far ahead as a newer one can be")
class NewestLost(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return 0 < (own - received) % self._modulus <= self._modulus // 2 + 1


@mutant("answers-half-off", "VD-RU-04", "does not answer requests that are as far behind as they can be")
class AnswersHalfOff(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return 0 < (own - requested) % self._modulus < self._modulus // 2 - 1
