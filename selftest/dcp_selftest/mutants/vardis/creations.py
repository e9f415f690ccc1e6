"""Faults in the processing of received VarCreates."""

from __future__ import annotations

from typing import ClassVar

from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarCreate
from dcp_selftest.mutants.cells import Cells, everywhere
from dcp_selftest.mutants.mutant import mutant
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

    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - used by overrides
        """Return whether the received VarCreate is stored."""
        return received > stored


@mutant("same", "VD-PC-01", "accepts a VarCreate with the stored creationTime", since=V2)
class TakesSame(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - as above
        return received >= stored


@mutant("earlier", "VD-PC-01", "accepts a VarCreate with an earlier creationTime", since=V2)
class TakesEarlier(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - as above
        return received != stored


@mutant(
    "later-refused", "VD-PC-01", "ignores a VarCreate with a later creationTime while the variable is alive", since=V2
)
class RefusesLater(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:
        return received > stored and entry.is_deleted


@mutant("seconds", "VD-PC-01", "compares creationTimes in seconds", since=V2)
class InSeconds(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - as above
        return received // 10**9 > stored // 10**9


@mutant("low-half", "VD-PC-01", "compares only the lower four octets of creationTimes", since=V2)
class LowHalf(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:  # noqa: ARG002 - as above
        return received & 0xFFFFFFFF > stored & 0xFFFFFFFF


@mutant("same-producer", "VD-PC-01", "accepts a later creation only from the same producer", since=V2)
class SameProducer(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        return super()._is_later(record, entry) and record.spec.prod_id == entry.spec.prod_id


@mutant("own-kept", "VD-PC-01", "does not allow another node to take over one of its own variables", since=V2)
class OwnKept(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        return super()._is_later(record, entry) and entry.spec.prod_id != self._core.own_id


@mutant("known-taken", "VD-SCP-03", "accepts any VarCreate of a known variable")
class KnownTaken(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:  # noqa: ARG002 - always
        return True


@mutant("other-producer", "VD-PC-11", "accepts a VarCreate of a known variable with another producer")
class OtherProducerTaken(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        return record.spec.prod_id != entry.spec.prod_id


@mutant("revives", "VD-PC-11", "accepts a VarCreate of a variable that is being deleted")
class DeletedTaken(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:  # noqa: ARG002 - whatever it says
        return entry.is_deleted


@mutant("not-revived", "VD-PC-02", "does not create a deleted variable again", since=V2)
class NotRevived(Creations):
    def later(self, received: int, stored: int, entry: DBEntry) -> bool:
        return received > stored and not entry.is_deleted


@mutant("stays-deleted", "VD-PC-02", "stores a later creation of a deleted variable, but leaves it deleted", since=V2)
class StaysDeleted(Receiver):
    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        known = self._database.lookup(record.spec.var_id)
        super()._create(record, offset, now, wall)
        entry = self._database.lookup(record.spec.var_id)
        if known is not None and entry is not None and known.is_deleted and entry is not known:
            self._database.mark_deleted(entry)


@mutant("taken", "VD-PC-03", "accepts a VarCreate with itself as producer")
class TakesOwn(Cells):
    cells: ClassVar = everywhere(Event.RX_CREATE_OWN, Action.ADOPT)


@mutant("any-value", "VD-PC-04", "accepts a VarCreate whose value is too long")
class AnyValue(Receiver):
    def _is_bad_value(self, value: bytes) -> bool:
        return not value


@mutant("empty-value", "VD-PC-04 VD-TYP-02", "accepts a VarCreate with an empty value")
class EmptyValue(Receiver):
    def _is_bad_value(self, value: bytes) -> bool:
        return len(value) > self._parameters.max_value_length


@mutant("longest-refused", "VD-PC-04 VD-PU-04 DATA-06", "ignores values of maximum length")
class LongestValue(Receiver):
    def _is_bad_value(self, value: bytes) -> bool:
        return super()._is_bad_value(value) or len(value) >= self._parameters.max_value_length


class Events(Receiver):
    """Changes the event that a VarCreate causes."""

    def _create_event(self, record: VarCreate, entry: DBEntry | None) -> Event:
        return self.event(super()._create_event(record, entry), record)

    def event(self, event: Event, record: VarCreate) -> Event:  # noqa: ARG002 - used by overrides
        """Return the event to be processed."""
        return event


@mutant("any-description", "VD-PC-05", "accepts a VarCreate whose description is too long")
class AnyDescription(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        long = event is Event.RX_CREATE_BAD_DESCRIPTION and record.spec.descr
        return Event.RX_CREATE_LATER if long else event


@mutant("empty-description", "VD-PC-05", "accepts a VarCreate with an empty description", since=SpecVersion.V1_2)
class EmptyDescription(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        empty = event is Event.RX_CREATE_BAD_DESCRIPTION and not record.spec.descr
        return Event.RX_CREATE_LATER if empty else event


@mutant("longest-refused", "VD-PC-05", "ignores a VarCreate with a description of maximum length")
class LongestDescription(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        longest = len(record.spec.descr) >= self._parameters.longest_description
        return Event.RX_CREATE_BAD_DESCRIPTION if longest else event


@mutant("characters", "VD-PC-05 DATA-08", "counts the characters of received descriptions, not the octets")
class ReceivedCharacters(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        fits = 0 < len(record.spec.descr.decode(errors="replace")) <= self._parameters.longest_description
        return Event.RX_CREATE_LATER if event is Event.RX_CREATE_BAD_DESCRIPTION and fits else event


@mutant(
    "too-often", "VD-PC-06", "accepts a VarCreate with a repetition count above the maximum", since=SpecVersion.V1_2
)
class TooOften(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        often = event is Event.RX_CREATE_BAD_REPCNT and record.spec.rep_cnt
        return Event.RX_CREATE_LATER if often else event


@mutant("zero", "VD-PC-06", "accepts a VarCreate with a repetition count of 0", since=SpecVersion.V1_2)
class NeverRepeated(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        zero = event is Event.RX_CREATE_BAD_REPCNT and not record.spec.rep_cnt
        return Event.RX_CREATE_LATER if zero else event


@mutant("most-refused", "VD-PC-06", "ignores a VarCreate with the maximum repetition count")
class MostRefused(Events):
    def event(self, event: Event, record: VarCreate) -> Event:
        most = record.spec.rep_cnt == self._parameters.max_repetitions
        return Event.RX_CREATE_BAD_REPCNT if most else event
