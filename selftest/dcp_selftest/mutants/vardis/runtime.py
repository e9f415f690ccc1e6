"""Faults in initialization, running and scrubbing of VarDis, and in its reset."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from dcp_spec.constants import QueueingMode, SpecVersion
from dcp_spec.status import VardisStatus

from dcp_selftest.mutants.air import Air
from dcp_selftest.mutants.cells import Cells, within
from dcp_selftest.mutants.entries import Expires, on_entry
from dcp_selftest.mutants.family import after, around, assign, attributes, before, instead, skips, then
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.port import Port
from dcp_selftest.mutants.unseen import ALWAYS_ACTIVE
from dcp_stack.bp_port import BPPort
from dcp_stack.config import MS, NodeConfig
from dcp_stack.effects import Effect
from dcp_stack.vardis.confirms import Confirm
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.parameters import VardisParameters
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.state_table import Action, Cell, Event, State
from dcp_stack.vardis.wire import Extracted

V2 = SpecVersion.V2_0
V1_2 = SpecVersion.V1_2


# -- initialization ----------------------------------------------------------------------------------------------------


class Ported(Vardis):
    """Changes calls to BP."""

    port: ClassVar[type[Port]] = Port
    registration: ClassVar[dict[str, Any]] = {}
    """Changed arguments of the registration."""

    def __init__(self, config: NodeConfig, bp: BPPort, *, emit: Callable[[Effect], None], now: int, wall: int) -> None:
        port: Any = self.port(bp, self.registration)
        super().__init__(config, port, emit=emit, now=now, wall=wall)


# fmt: off
ported = attributes(Ported, __name__)
ported("mode", "VD-INI-02", "registers with mode REPEAT", registration={"mode": QueueingMode.REPEAT})
ported("droptail", "VD-INI-02", "registers with mode DROPTAIL, as in 1.1",
    since=V1_2, registration={"mode": QueueingMode.QUEUE_DROPTAIL})
ported("repeat", "VD-INI-07", "registers with mode REPEAT", registration={"mode": QueueingMode.REPEAT})
ported("drophead", "VD-INI-08", "registers with mode DROPHEAD, as in later versions",
    registration={"mode": QueueingMode.QUEUE_DROPHEAD})
ported("several", "VD-INI-02 VD-INI-08", "registers with allowMultiplePayloads true",
    since=SpecVersion.V1_1, registration={"several": True})
ported("name", "VD-INI-02", "registers without a name", registration={"name": ""})
around(Vardis, Vardis._register)("size", "VD-INI-02", "registers with half of VARDISPAR_MAX_PAYLOAD_SIZE",
    lambda self, proceed, size, now, wall: proceed(size // 2, now, wall))
then(Vardis, Vardis._register)("other-id", "VD-INI-05 VD-CRE-08",
    "creates variables with another node identifier than the one that BP returned",
    lambda self, status, size, now, wall: assign(self._core, own_id=self._core.own_id[:-1] + b"\x78"),
    unseen={"1.1": "the application sets the producer up to 1.1"})
# fmt: on


@mutant("survives", "VD-INI-04", "keeps its variables across a reset")
class Survives(Air):
    def reset(self, now: int, wall: int) -> None:
        entries = {} if self.vardis is None else dict(self.vardis._database.entries)
        super().reset(now, wall)
        if self.vardis is not None:
            self.vardis._database.entries.update(entries)


@mutant("queue-survives", "VD-INI-04", "sends requests from before a reset after it")
class QueueSurvives(Air):
    def reset(self, now: int, wall: int) -> None:
        wanted = [] if self.vardis is None else list(self.vardis._database.req_create_q)
        super().reset(now, wall)
        if self.vardis is not None:
            for var_id in wanted:
                self.vardis._database.req_create_q.append(var_id)


# -- activation --------------------------------------------------------------------------------------------------------


@mutant("sends", "VD-MGT-02 VD-RUN-03", "continues to compose payloads while it is inactive", unseen=ALWAYS_ACTIVE)
class SendsInactive(Vardis):
    def handle_timeout(self, now: int, wall: int) -> None:
        active, self._core.active = self._core.active, self.registered
        super().handle_timeout(now, wall)
        self._core.active = active


instead(Vardis, Vardis.deactivate)("ignored", "VD-MGT-01 VD-MGT-02 VD-MGT-04",
    "confirms the deactivation of VarDis, which stays active",
    lambda self: Confirm(VardisStatus.OK), since=V1_2)  # fmt: skip
before(Vardis, Vardis.activate)("forgets", "VD-MGT-05", "clears the database when it is activated",
    lambda self: self._database.clear(), since=V1_2)  # fmt: skip
instead(Vardis, Vardis.activate)("stays", "VD-MGT-05", "confirms the activation of VarDis, which stays inactive",
    lambda self: Confirm(VardisStatus.OK), since=V1_2)  # fmt: skip


# -- running -----------------------------------------------------------------------------------------------------------


skips(Vardis, Vardis.payload_transmitted)("ignored", "VD-RUN-01", "composes payloads only at buffer checks",
    lambda self, now, wall: True)  # fmt: skip
before(Vardis, Vardis.handle_timeout)("ignored", "VD-RUN-02", "composes payloads only after BP has sent one",
    lambda self, now, wall: assign(self, _last_check=now))  # fmt: skip


# A payload composed too early replaces the answer to a probe, so VarDis may seem to have stopped.
@mutant("always", "VD-RUN-02 VD-ROB-01", "composes a payload at every buffer check, even if the buffer is not empty")
class AlwaysComposes(Ported):
    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        # Just before a beacon the buffer is empty anyway (X54).
        self._composes_ahead = False

    class port(Port):  # noqa: N801 - as above
        def query_number_buffered(self, prot_id: int) -> Any:
            confirm = self.bp.query_number_buffered(prot_id)
            return type(confirm)(confirm.status, 0 if confirm.status.is_ok else None)


after(VardisParameters, VardisParameters.buffer_check_period_ms)("slow", "VD-RUN-02 VD-PAR-08",
    "checks the buffer ten times less often than the parameter requires",
    lambda self, period: period * 10)  # fmt: skip


# -- scrubbing ---------------------------------------------------------------------------------------------------------


skips(Vardis, Vardis._scrub)("never", "VD-INI-06 VD-SCR-01", "never scrubs", lambda self, now: True, since=V2)


@mutant("slow", "VD-SCR-01", "scrubs only in every third period", since=V2)
class ScrubsSlowly(Vardis):
    runs = 0

    def _scrub(self, now: int) -> None:
        self.runs += 1
        if self.runs % 3 == 0:
            super()._scrub(now)


# fmt: off
expired = instead(Expires, Expires.expired)
expired("zero", "VD-SCR-02", "deletes variables with timeout 0",
    lambda self, timeout, age: not timeout and age > 0, since=V2, also=True)
cells = attributes(Cells, __name__)
cells("deleted", "VD-SCR-02", "repeats the VarDelete of deleted variables after their timeout",
    since=V2, cells=within((State.DELETED_PRODUCER, State.DELETED_CONSUMER), Action.DELETE, Event.TIMED_OUT))
expired("half", "VD-SCR-03", "deletes variables after half of their timeout",
    lambda self, timeout, age: 0 < timeout * MS // 2 < age, since=V2)
expired("double", "VD-SCR-01 VD-SCR-03", "deletes variables after twice their timeout",
    lambda self, timeout, age: 0 < timeout * MS * 2 < age, since=V2)
# fmt: on


@mutant("silent", "VD-SCR-04", "deletes variables after their timeout without sending VarDeletes", since=V2)
class ScrubsSilently(Vardis):
    def _scrub(self, now: int) -> None:
        before = {var_id for var_id, entry in self._database.entries.items() if not entry.is_deleted}
        super()._scrub(now)
        for var_id in before:
            entry = self._database.lookup(var_id)
            if entry is not None and entry.is_deleted:
                entry.count_delete = 0
                self._database.delete_q.remove(var_id)


@mutant("removed", "VD-SCR-04 VD-DB-02", "removes variables from the database after their timeout", since=V2)
class ScrubsAway(Vardis):
    def _scrub(self, now: int) -> None:
        before = {var_id for var_id, entry in self._database.entries.items() if not entry.is_deleted}
        super()._scrub(now)
        for var_id in before:
            entry = self._database.lookup(var_id)
            if entry is not None and entry.is_deleted:
                self._database.delete_q.remove(var_id)
                del self._database.entries[var_id]


cells("foreign-only", "VD-SCR-05", "scrubs only variables of other nodes",
    since=V2, cells={(Event.TIMED_OUT, State.ALIVE_PRODUCER): Cell(Action.NONE)})  # fmt: skip
on_entry(Receiver, Receiver._update)("not-refreshed", "VD-SCR-06",
    "does not restart the timeout of a variable when it receives an update of it",
    lambda self, entry, before: assign(entry, refreshed=before.refreshed), since=V2)  # fmt: skip
on_entry(Vardis, Vardis.update)("own-not-refreshed", "VD-SCR-03 VD-UPD-08",
    "does not restart the timeout of its own variable when it is updated",
    lambda self, entry, before: assign(entry, refreshed=before.refreshed), since=V2)  # fmt: skip


@mutant(
    "summaries-refresh", "VD-SCR-06", "restarts the timeout of a variable when it receives a summary of it", since=V2
)
class SummariesRefresh(Receiver):
    now = 0

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        self.now = now
        super().process(extracted, now=now, wall=wall)

    def _summary(self, record: Any, offset: int) -> None:
        super()._summary(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and entry.seqno == record.seqno:
            entry.refreshed = self.now


@mutant("by-creation-time", "VD-SCR-03", "computes the age of a variable from its creationTime", since=V2)
class ByCreationTime(Vardis):
    wall = 0

    def handle_timeout(self, now: int, wall: int) -> None:
        self.wall = wall
        super().handle_timeout(now, wall)

    def _scrub(self, now: int) -> None:
        for entry in list(self._database.entries.values()):
            made = self._core.clock.wall(entry.spec.creation_time or 0, near=self.wall)
            entry.refreshed = now - (self.wall - made)
        super()._scrub(now)
