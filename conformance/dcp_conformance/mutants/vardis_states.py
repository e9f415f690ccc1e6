"""Faults in the table of VarDis: a wrong cell, or a wrong comparison that leads to one (C.5)."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarCreate, VarDelete, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate
from dcp_stack.vardis_core import Core, Sequence
from dcp_stack.vardis_db import DBEntry
from dcp_stack.vardis_receive import Receiver
from dcp_stack.vardis_table import Action, Cell, Event, State

from .mutant import mutant

UNKNOWN, PRODUCED, CONSUMED = State.UNKNOWN, State.ALIVE_PRODUCER, State.ALIVE_CONSUMER
DELETED_OWN, DELETED = State.DELETED_PRODUCER, State.DELETED_CONSUMER
NOTHING = Cell(Action.IGNORE)
V2 = SpecVersion.V2_0


class Cells(Core):
    """Has other cells in the table."""

    cells: ClassVar[dict[tuple[Event, State], Cell]] = {}

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        for (event, state), cell in self.cells.items():
            row = list(self._table[event])
            row[state] = cell
            self._table[event] = (row[0], row[1], row[2], row[3], row[4])


def _everywhere(event: Event, action: Action) -> dict[tuple[Event, State], Cell]:
    return {(event, state): Cell(action) for state in State}


def _in(states: tuple[State, ...], action: Action, *events: Event) -> dict[tuple[Event, State], Cell]:
    return {(event, state): Cell(action) for event in events for state in states}


UPDATES = (Event.RX_UPDATE_EQUAL, Event.RX_UPDATE_OLDER, Event.RX_UPDATE_NEWER, Event.RX_UPDATE_BAD_VALUE)
SUMMARIES = (Event.RX_SUMMARY_EQUAL, Event.RX_SUMMARY_OLDER, Event.RX_SUMMARY_NEWER)
REQUESTS = (Event.RX_REQUEST_UPDATE_BEHIND, Event.RX_REQUEST_UPDATE_OTHER)


# -- VarCreate ---------------------------------------------------------------------------------------------------------


class Creations(Receiver):
    """Compares creations in another way."""

    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        received, stored = record.spec.creation_time, entry.spec.creation_time
        if received is None or stored is None:
            return False
        return self.later(received, stored, entry)

    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - for those that look at it
        """Whether the received creation is taken."""
        return received > stored


@mutant("same", "VD-PC-01", "takes a VarCreate with the creationTime that it knows", since=V2)
class TakesSame(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - as above
        return received >= stored


@mutant("earlier", "VD-PC-01", "takes a VarCreate of an earlier creation", since=V2)
class TakesEarlier(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - as above
        return received != stored


@mutant("later-refused", "VD-PC-01", "ignores a VarCreate of a later creation while the variable lives", since=V2)
class RefusesLater(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:
        return received > stored and entry.is_deleted


@mutant("seconds", "VD-PC-01", "compares creationTimes in seconds", since=V2)
class InSeconds(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - as above
        return received // 10**9 > stored // 10**9


@mutant("low-half", "VD-PC-01", "compares the lower four octets of creationTimes", since=V2)
class LowHalf(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - as above
        return received & 0xFFFFFFFF > stored & 0xFFFFFFFF


@mutant("same-producer", "VD-PC-01", "takes a later creation only of the producer that it knows", since=V2)
class SameProducer(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        return super()._is_later(record, entry) and record.spec.prod_id == entry.spec.prod_id


@mutant("own-kept", "VD-PC-01", "does not let another node take over a variable of its own", since=V2)
class OwnKept(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        return super()._is_later(record, entry) and entry.spec.prod_id != self._core.own_id


@mutant(
    "known-taken",
    "VD-PC-01",
    "takes a VarCreate of a variable that it knows",
    since=SpecVersion.V1_0,
    until=SpecVersion.V1_3,
)
class KnownTaken(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:  # noqa: ARG002 - always
        return True


@mutant("not-revived", "VD-PC-02", "does not create a deleted variable anew", since=V2)
class NotRevived(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:
        return received > stored and not entry.is_deleted


@mutant("stays-deleted", "VD-PC-02", "stores a later creation of a deleted variable, which stays deleted", since=V2)
class StaysDeleted(Receiver):
    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        known = self._database.lookup(record.spec.var_id)
        super()._create(record, offset, now, wall)
        entry = self._database.lookup(record.spec.var_id)
        if known is not None and entry is not None and known.is_deleted and entry is not known:
            self._database.mark_deleted(entry)


@mutant("taken", "VD-PC-03", "takes a VarCreate that names it as the producer")
class TakesOwn(Cells):
    cells: ClassVar = _everywhere(Event.RX_CREATE_OWN, Action.ADOPT)


@mutant("any-value", "VD-PC-04", "takes a VarCreate whose value is too long")
class AnyValue(Receiver):
    def _is_bad_value(self, value: bytes) -> bool:
        return not value


@mutant("empty-value", "VD-PC-04 VD-TYP-02", "takes a VarCreate without a value")
class EmptyValue(Receiver):
    def _is_bad_value(self, value: bytes) -> bool:
        return len(value) > self._parameters.max_value_length


@mutant("longest-refused", "VD-PC-04 VD-PU-04 DATA-06", "ignores values of the longest length that is allowed")
class LongestValue(Receiver):
    def _is_bad_value(self, value: bytes) -> bool:
        return super()._is_bad_value(value) or len(value) >= self._parameters.max_value_length


class Events(Receiver):
    """Judges a VarCreate in another way."""

    def _create_event(self, record: VarCreate, entry: DBEntry | None) -> Event:
        return self.event(super()._create_event(record, entry), record)

    def event(self, event: Event, record: VarCreate) -> Event:  # noqa: ARG002 - for those that look at it
        """The event instead of ``event``."""
        return event


@mutant("any-description", "VD-PC-05", "takes a VarCreate whose description is too long")
class AnyDescription(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        long = event is Event.RX_CREATE_BAD_DESCRIPTION and record.spec.descr
        return Event.RX_CREATE_LATER if long else event


@mutant("empty-description", "VD-PC-05", "takes a VarCreate without a description", since=SpecVersion.V1_2)
class EmptyDescription(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        empty = event is Event.RX_CREATE_BAD_DESCRIPTION and not record.spec.descr
        return Event.RX_CREATE_LATER if empty else event


@mutant("longest-refused", "VD-PC-05", "ignores a VarCreate with the longest description that is allowed")
class LongestDescription(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        longest = len(record.spec.descr) >= self._parameters.longest_description
        return Event.RX_CREATE_BAD_DESCRIPTION if longest else event


@mutant("characters", "VD-PC-05 DATA-08", "counts the characters of received descriptions, not the octets")
class ReceivedCharacters(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        fits = 0 < len(record.spec.descr.decode(errors="replace")) <= self._parameters.longest_description
        return Event.RX_CREATE_LATER if event is Event.RX_CREATE_BAD_DESCRIPTION and fits else event


@mutant("too-often", "VD-PC-06", "takes a VarCreate with a repetition count above the maximum", since=SpecVersion.V1_2)
class TooOften(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        often = event is Event.RX_CREATE_BAD_REPCNT and record.spec.rep_cnt
        return Event.RX_CREATE_LATER if often else event


@mutant("zero", "VD-PC-06", "takes a VarCreate with a repetition count of 0", since=SpecVersion.V1_2)
class NeverRepeated(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        zero = event is Event.RX_CREATE_BAD_REPCNT and not record.spec.rep_cnt
        return Event.RX_CREATE_LATER if zero else event


@mutant("most-refused", "VD-PC-06", "ignores a VarCreate with the highest repetition count that is allowed")
class MostRefused(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        most = record.spec.rep_cnt == self._parameters.max_repetitions
        return Event.RX_CREATE_BAD_REPCNT if most else event


# -- VarDelete ---------------------------------------------------------------------------------------------------------


@mutant("requested", "VD-PD-01", "requests a variable of which it only hears that it is deleted")
class DeletedRequested(Receiver):
    def _delete(self, record: VarDelete, offset: int) -> None:
        if self._database.lookup(record.var_id) is None:
            self._request(record.var_id, offset)
        super()._delete(record, offset)


@mutant("again", "VD-PD-02 VD-SCP-03", "repeats the deletion of a deleted variable whenever it hears of it")
class DeletedAgain(Cells):
    cells: ClassVar = _in((DELETED,), Action.DELETE, Event.RX_DELETE)


@mutant("own", "VD-PD-03", "lets others delete its own variables")
class OwnDeleted(Cells):
    cells: ClassVar = _in((PRODUCED,), Action.DELETE, Event.RX_DELETE)


@mutant("ignored", "VD-PD-04", "does not delete variables of others")
class NotDeleted(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.IGNORE, Event.RX_DELETE)


# -- VarUpdate ---------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-PU-01", "does not request the variable of an update that it does not know")
class UpdateIgnored(Cells):
    cells: ClassVar = _in((UNKNOWN,), Action.IGNORE, *UPDATES)


@mutant("requests-deleted", "VD-PU-02", "requests a deleted variable when it hears an update of it", since=V2)
class UpdateRequests(Cells):
    cells: ClassVar = _in((DELETED,), Action.REQUEST_CREATE, *UPDATES)


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
    cells: ClassVar = _in((DELETED, DELETED_OWN), Action.STORE, Event.RX_UPDATE_NEWER)


@mutant("own", "VD-PU-03", "takes updates of its own variables from others")
class OwnUpdated(Cells):
    cells: ClassVar = _in((PRODUCED,), Action.STORE, Event.RX_UPDATE_NEWER)


@mutant("own-taught", "VD-PU-03", "answers an older update of its own variable with its value")
class OwnTaught(Cells):
    cells: ClassVar = _in((PRODUCED,), Action.TEACH, Event.RX_UPDATE_OLDER)


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
    cells: ClassVar = _in((CONSUMED,), Action.STORE, Event.RX_UPDATE_EQUAL)


@mutant("repeated", "VD-PU-05 VD-SCP-03", "repeats an update whenever it hears it")
class EqualRepeated(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.SEND_UPDATE, Event.RX_UPDATE_EQUAL)


@mutant("stored", "VD-PU-06", "stores older updates")
class OlderStored(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.STORE, Event.RX_UPDATE_OLDER)


@mutant("not-taught", "VD-PU-06", "does not answer an older update with its newer value")
class NotTaught(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.IGNORE, Event.RX_UPDATE_OLDER)


@mutant("counts-again", "VD-PU-06", "counts the repetitions of an update anew for each older one that it hears")
class CountsAgain(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.SEND_UPDATE, Event.RX_UPDATE_OLDER)


@mutant("ignored", "VD-PU-07", "ignores newer updates of variables of others")
class NewerIgnored(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.IGNORE, Event.RX_UPDATE_NEWER)


@mutant("asked", "VD-PU-07", "requests a newer update instead of storing it")
class NewerAsked(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.REQUEST_UPDATE, Event.RX_UPDATE_NEWER)


# -- VarSumm -----------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-PS-01", "does not request the variable of a summary that it does not know")
class SummaryIgnored(Cells):
    cells: ClassVar = _in((UNKNOWN,), Action.IGNORE, *SUMMARIES)


@mutant("requests-deleted", "VD-PS-02", "requests a deleted variable when it hears a summary of it", since=V2)
class SummaryOfDeleted(Cells):
    cells: ClassVar = _in((DELETED,), Action.REQUEST_CREATE, *SUMMARIES)


@mutant("own-requested", "VD-PS-02", "requests an update of its own variable after a newer summary")
class OwnRequested(Cells):
    cells: ClassVar = _in((PRODUCED,), Action.REQUEST_UPDATE, Event.RX_SUMMARY_NEWER)


@mutant("own-taught", "VD-PS-02", "answers an older summary of its own variable")
class OwnSummaryTaught(Cells):
    cells: ClassVar = _in((PRODUCED,), Action.TEACH, Event.RX_SUMMARY_OLDER)


@mutant("equal-answered", "VD-PS-02", "answers a summary with the number that it has")
class EqualAnswered(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.TEACH, Event.RX_SUMMARY_EQUAL)


@mutant("equal-requested", "VD-PS-02", "requests an update after a summary with the number that it has")
class EqualRequested(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.REQUEST_UPDATE, Event.RX_SUMMARY_EQUAL)


@mutant("not-taught", "VD-PS-03", "does not answer an older summary with its value")
class SummaryNotTaught(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.IGNORE, Event.RX_SUMMARY_OLDER)


@mutant("counts-again", "VD-PS-03", "counts the repetitions of an update anew for each older summary")
class SummaryCountsAgain(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.SEND_UPDATE, Event.RX_SUMMARY_OLDER)


@mutant("not-requested", "VD-PS-04", "does not request the update that a newer summary tells of")
class NewerNotRequested(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.IGNORE, Event.RX_SUMMARY_NEWER)


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
    cells: ClassVar = _in((CONSUMED,), Action.REQUEST_CREATE, Event.RX_SUMMARY_NEWER)


# -- requests ----------------------------------------------------------------------------------------------------------


@mutant("ignored", "VD-RU-01", "does not request an unknown variable that another node asks an update of")
class UnknownUpdateRequest(Cells):
    cells: ClassVar = _in((UNKNOWN,), Action.IGNORE, *REQUESTS)


@mutant(
    "requested",
    "VD-RU-01",
    "requests an unknown variable that another node asks an update of, as only later versions do",
    since=SpecVersion.V1_0,
    until=SpecVersion.V1_0,
)
class UnknownUpdateRequested(Cells):
    cells: ClassVar = _in((UNKNOWN,), Action.REQUEST_CREATE, *REQUESTS)


@mutant("deleted-answered", "VD-RU-02", "answers requests for updates of deleted variables", since=V2)
class DeletedAnswered(Cells):
    cells: ClassVar = _in((DELETED, DELETED_OWN), Action.SEND_UPDATE, *REQUESTS)


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
    cells: ClassVar = _in((CONSUMED,), Action.IGNORE, *REQUESTS)


@mutant("producer-silent", "VD-RU-04", "does not answer requests for updates of its own variables")
class ProducerSilent(Cells):
    cells: ClassVar = _in((PRODUCED,), Action.IGNORE, *REQUESTS)


@mutant("with-create", "VD-RU-04", "answers a request for an update with the whole variable")
class WithCreate(Cells):
    cells: ClassVar = _in((PRODUCED, CONSUMED), Action.SEND_CREATE, Event.RX_REQUEST_UPDATE_BEHIND)


@mutant("once", "VD-RU-04", "answers a request for an update once, whatever repCnt is")
class AnswersOnce(Receiver):
    def _request_update(self, record: VarReqUpdate, offset: int) -> None:
        super()._request_update(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.count_update > 1:
            entry.count_update = 1


@mutant("ignored", "VD-RC-01", "does not request an unknown variable that another node asks for")
class UnknownRequest(Cells):
    cells: ClassVar = _in((UNKNOWN,), Action.IGNORE, Event.RX_REQUEST_CREATE)


@mutant(
    "requested",
    "VD-RC-01",
    "requests an unknown variable that another node asks for, as only later versions do",
    since=SpecVersion.V1_0,
    until=SpecVersion.V1_0,
)
class UnknownRequested(Cells):
    cells: ClassVar = _in((UNKNOWN,), Action.REQUEST_CREATE, Event.RX_REQUEST_CREATE)


@mutant("deleted-answered", "VD-RC-02", "answers requests for deleted variables", since=V2)
class DeletedSent(Cells):
    cells: ClassVar = _in((DELETED, DELETED_OWN), Action.SEND_CREATE, Event.RX_REQUEST_CREATE)


@mutant("deletion-answered", "VD-RC-02", "answers requests for deleted variables with their deletion", since=V2)
class DeletionSent(Cells):
    cells: ClassVar = _in((DELETED, DELETED_OWN), Action.DELETE, Event.RX_REQUEST_CREATE)

    def cell(self, event: Event, entry: DBEntry | None) -> Cell:
        cell = super().cell(event, entry)
        if cell.action is Action.DELETE and event is Event.RX_REQUEST_CREATE and entry is not None:
            self.database.mark_deleted(entry)
        return cell


@mutant("consumer-silent", "VD-RC-03", "answers requests for variables only as the producer")
class ConsumerSendsNone(Cells):
    cells: ClassVar = _in((CONSUMED,), Action.IGNORE, Event.RX_REQUEST_CREATE)


@mutant("producer-silent", "VD-RC-03", "does not answer requests for its own variables")
class ProducerSendsNone(Cells):
    cells: ClassVar = _in((PRODUCED,), Action.IGNORE, Event.RX_REQUEST_CREATE)


@mutant("with-update", "VD-RC-03", "answers a request for a variable with an update")
class WithUpdate(Cells):
    cells: ClassVar = _in((PRODUCED, CONSUMED), Action.SEND_UPDATE, Event.RX_REQUEST_CREATE)


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
