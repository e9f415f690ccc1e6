"""Faults in the effect of a timeout, in continuing after a deactivation, and in limits with equal defaults."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_spec.constants import SpecVersion

from dcp_codec.values import VarCreate, VarReqCreate
from dcp_selftest.mutants.entries import Expires
from dcp_selftest.mutants.family import attributes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.unseen import ALWAYS_ACTIVE
from dcp_stack.config import MS
from dcp_stack.vardis.confirms import Confirm
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.parameters import VardisParameters
from dcp_stack.vardis.receive import Receiver

V2 = SpecVersion.V2_0
V1_2 = SpecVersion.V1_2
HALF = 32_768


# -- what a timeout removes --------------------------------------------------------------------------------------------


class LeavesQueue(Vardis):
    """Leaves the variable in one queue, with its counter, when it is scrubbed."""

    queue: ClassVar[str]
    counter: ClassVar[str] = ""

    def _scrub(self, now: int) -> None:
        queue = self._database.queues[self.queue]
        held = {
            var_id: getattr(entry, self.counter, 0)
            for var_id, entry in self._database.entries.items()
            if not entry.is_deleted and var_id in queue
        }
        super()._scrub(now)
        for var_id, count in held.items():
            entry = self._database.lookup(var_id)
            if entry is not None and entry.is_deleted:
                queue.append(var_id)
                if self.counter:
                    setattr(entry, self.counter, count)


leaves_queue = attributes(LeavesQueue, __name__)
leaves_queue("updateQ", "VD-SCR-04", "continues to repeat the VarUpdate of a variable after its timeout",
    since=V2, queue="updateQ", counter="count_update")  # fmt: skip
leaves_queue("createQ", "VD-SCR-04", "continues to repeat the VarCreate of a variable after its timeout",
    since=V2, queue="createQ", counter="count_create")  # fmt: skip
leaves_queue("summaryQ", "VD-SCR-04 VD-CMP-05", "continues to summarise a variable after its timeout",
    since=V2, queue="summaryQ")  # fmt: skip
leaves_queue("reqUpdQ", "VD-SCR-04", "requests an update of a variable after its timeout", since=V2, queue="reqUpdQ")


@mutant("counts-left", "VD-SCR-04", "does not reset the counters of a variable after its timeout", since=V2)
class ScrubLeavesCounts(Vardis):
    def _scrub(self, now: int) -> None:
        held = {
            var_id: (entry.count_create, entry.count_update)
            for var_id, entry in self._database.entries.items()
            if not entry.is_deleted
        }
        super()._scrub(now)
        for var_id, counts in held.items():
            entry = self._database.lookup(var_id)
            if entry is not None and entry.is_deleted:
                entry.count_create, entry.count_update = counts


expired = instead(Expires, Expires.expired)
expired("signed-at-once", "VD-TYP-04 VD-SCR-03", "immediately deletes variables with timeouts of 32,768 ms and more",
    lambda self, timeout, age: timeout >= HALF, since=V2, also=True)  # fmt: skip
expired("one-octet", "VD-TYP-04 VD-SCR-03", "uses timeouts modulo 256",
    lambda self, timeout, age: 0 < timeout % 256 * MS < age, since=V2, also=True)  # fmt: skip


# -- deactivation ------------------------------------------------------------------------------------------------------


@mutant("once-deactivated", "VD-SCR-01 VD-MGT-05", "never scrubs again after it was deactivated", since=V2)
class ScrubbingEnds(Vardis):
    _ended = False

    def deactivate(self) -> Confirm:
        self._ended = True
        return super().deactivate()

    def _scrub(self, now: int) -> None:
        if not self._ended:
            super()._scrub(now)


@mutant(
    "no-check-after",
    "VD-RUN-02 VD-MGT-05",
    "no longer checks the buffer after it was deactivated",
    unseen=ALWAYS_ACTIVE,
)
class CheckingEnds(Vardis):
    _ended = False

    def deactivate(self) -> Confirm:
        self._ended = True
        return super().deactivate()

    def handle_timeout(self, now: int, wall: int) -> None:
        if self._ended:
            self._last_check = now
        super().handle_timeout(now, wall)


# -- limits that are equal by default ----------------------------------------------------------------------------------


instead(VardisParameters, VardisParameters.max_value_length)("value-by-description",
    "VD-PC-04 VD-PU-04 VD-CRE-05 VD-UPD-05", "compares the length of values with the maximum of descriptions",
    lambda self: self.longest_description)  # fmt: skip
instead(VardisParameters, VardisParameters.longest_description)("description-by-value", "VD-PC-05 VD-CRE-04",
    "compares the length of descriptions with the maximum of values",
    lambda self: self.max_value_length)  # fmt: skip
instead(Receiver, Receiver._is_bad_value)("received-by-description", "VD-PC-04 VD-PU-04",
    "compares the length of received values with the maximum of descriptions",
    lambda self, value: (
        (self._check_too_long and len(value) > self._parameters.longest_description)
        or (self._check_empty_and_repcnt and not value)))  # fmt: skip


@mutant("left-in-reqCreateQ", "VD-CRE-11", "continues to request a variable that its application has created")
class RequestsItsOwn(Vardis):
    def create(self, var_id: int, *args: Any, **more: Any) -> Confirm:
        wanted = var_id in self._database.req_create_q
        confirm = super().create(var_id, *args, **more)
        if wanted and confirm.status.is_ok:
            self._database.req_create_q.append(var_id)
        return confirm


# -- what is pending ---------------------------------------------------------------------------------------------------


@mutant("request-ends-updates", "VD-RC-03 VD-SCP-02 VD-CMP-09", "sends no more VarUpdates after a VarReqCreate")
class RequestEndsUpdates(Receiver):
    def _request_create(self, record: VarReqCreate, offset: int) -> None:
        super()._request_create(record, offset)
        entry = self._database.lookup(record.var_id)
        if entry is not None and record.var_id in self._database.update_q:
            entry.count_update = 0
            self._database.update_q.remove(record.var_id)


@mutant(
    "ignored-withdraws",
    "VD-PC-04 VD-PC-06 VD-PS-01 VD-CMP-12",
    "does not request a variable any more after a VarCreate of it that it ignores",
)
class IgnoredWithdraws(Receiver):
    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        super()._create(record, offset, now, wall)
        var_id = record.spec.var_id
        if self._database.lookup(var_id) is None and var_id in self._database.req_create_q:
            self._database.req_create_q.remove(var_id)
