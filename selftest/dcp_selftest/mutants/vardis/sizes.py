"""Faults of VarDis with long values, many records, and long periods, and with parameters that change."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec
from dcp_spec.constants import ICType, SpecVersion
from dcp_spec.parameters import Violation
from dcp_spec.status import VardisStatus

from dcp_selftest.mutants.family import after, around, attributes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.config import MS
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.confirms import Confirm, DescribeDatabaseConfirm
from dcp_stack.vardis.database import DBEntry, IdQueue
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.parameters import PAYLOAD_SIZE, REPETITIONS, SUMMARIES
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.wire import ContainerType, Extracted, Extractor

V2 = SpecVersion.V2_0


# -- lengths -----------------------------------------------------------------------------------------------------------


# fmt: off
around(Vardis, Vardis._refused_value)("long-refused", "VD-CRE-05 VD-UPD-05",
    "rejects values of 128 octets or more whatever the maximum",
    lambda self, proceed, value: VardisStatus.VALUE_TOO_LONG if len(value) > 127 else proceed(value),
    since=SpecVersion.V1_1, unseen={"1.0": "in 1.0 the sum of both lengths is limited"})
around(Receiver, Receiver._is_bad_value)("long-ignored", "VD-PC-04 VD-PU-04 VD-PC-07 VD-PU-07 DATA-06",
    "ignores received values of 128 octets or more whatever the maximum",
    lambda self, proceed, value: len(value) > 127 or proceed(value), since=SpecVersion.V1_1,
    unseen={"1.0": "in 1.0 the sum of both lengths is limited"})
around(Receiver, Receiver._create)("long-description-ignored", "VD-PC-05 VD-PC-07 DATA-07",
    "ignores received descriptions of 128 octets or more whatever the maximum",
    lambda self, proceed, record, offset, now, wall: (
        None if len(record.spec.descr) > 127 else proceed(record, offset, now, wall)), since=SpecVersion.V1_2)
# fmt: on


@mutant("long-description-refused", "VD-CRE-04", "rejects descriptions of 128 octets or more whatever the maximum")
class LongDescriptionRefused(Vardis):
    def create(
        self, var_id: int, prod_id: bytes | None, rep_cnt: int, descr: bytes, *rest: Any, **more: Any
    ) -> Confirm:
        confirm = super().create(var_id, prod_id, rep_cnt, descr[:1] if len(descr) > 127 else descr, *rest, **more)
        if confirm.status.is_ok and len(descr) > 127:
            self._database.entries.pop(var_id)
            self._database._remove_from_queues(var_id)
            return Confirm(VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG)
        return confirm


@mutant("cut-at-100", "VD-PU-07 VD-PC-07", "stores at most 100 octets of a received value",
    since=SpecVersion.V1_1, unseen={"1.0": "in 1.0 the sum of both lengths is limited"})  # fmt: skip
class CutsValues(Receiver):
    def _update(self, record: Any, offset: int, now: int, wall: int) -> None:
        super()._update(msgspec.structs.replace(record, value=record.value[:100]), offset, now, wall)


# -- numbers of records ------------------------------------------------------------------------------------------------


class AtMost(Composer):
    """Puts only a limited number of records of some kinds into a container."""

    most: ClassVar[int] = 255
    kinds: ClassVar[tuple[ICType, ...]] = tuple(ICType)

    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, used = super()._fitting(kind, queue, room, largest)
        if kind in self.kinds and len(chosen) > self.most:
            used -= sum(self._record_size(kind, var_id) for var_id in chosen[self.most :])
            chosen = chosen[: self.most]
        return chosen, used


# fmt: off
at_most = attributes(AtMost, __name__)
at_most("127-records", "VD-PAY-02", "puts at most 127 records into a container", most=127)
at_most("32-deletes", "VD-PAY-02 VD-CMP-10", "puts at most 32 VarDeletes into a container", most=32,
    kinds=(ICType.DELETE_VARIABLES,))
after(Vardis, Vardis.describe_database)("hundred-listed", "VD-DDB-02",
    "describes at most 100 variables in RTDB-DescribeDatabase",
    lambda self, confirm: DescribeDatabaseConfirm(confirm.status, confirm.variables[:100]))
around(Receiver, Receiver._request)("64-wanted", "VD-PU-01 VD-PS-01 VD-RU-01 VD-RC-01",
    "requests at most 64 variables at a time, and forgets the others",
    lambda self, proceed, var_id, offset: (
        proceed(var_id, offset) if len(self._database.req_create_q) < 64 else None))
# fmt: on


class Reads(Extractor):
    """Leaves out some of the extracted records."""

    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        return Extracted({kind: self.chosen(records) for kind, records in found.records.items()}, found.problems)

    def chosen(self, records: list[tuple[int, Any]]) -> list[tuple[int, Any]]:
        """Return the records of a kind to be processed."""
        return records


# fmt: off
chosen = instead(Reads, Reads.chosen)
# fmt: on


# -- periods -----------------------------------------------------------------------------------------------------------


@mutant("scrubs-after-the-old-period", "VD-SCR-01 VD-PAR-01",
    "uses a new VARDISPAR_SCRUBBING_PERIOD only after the interval that has begun", since=V2,
    unseen={"1.1 1.2 1.3": "there is no scrubbing before 2.0"})  # fmt: skip
class ScrubsAfterOldPeriod(Vardis):
    def set_parameter(self, name: str, value: object) -> Violation | None:
        period = self._parameters.scrubbing_period_ms
        violation = super().set_parameter(name, value)
        if violation is None and name == "VARDISPAR_SCRUBBING_PERIOD":
            # The next run is due when the old period ends.
            self._last_scrub += (period - self._parameters.scrubbing_period_ms) * MS
        return violation


@mutant("checks-after-the-old-period", "VD-RUN-02 VD-PAR-01",
    "uses a new VARDISPAR_BUFFER_CHECK_PERIOD only after the interval that has begun")  # fmt: skip
class ChecksAfterOldPeriod(Vardis):
    def set_parameter(self, name: str, value: object) -> Violation | None:
        period = self._parameters.buffer_check_period_ms
        violation = super().set_parameter(name, value)
        if violation is None and name == "VARDISPAR_BUFFER_CHECK_PERIOD":
            self._last_check += (period - self._parameters.buffer_check_period_ms) * MS
        return violation


# -- parameters that change while records wait -------------------------------------------------------------------------


class Lowers(Vardis):
    """Does something with the variables when a parameter was lowered."""

    name: ClassVar[str]

    def set_parameter(self, name: str, value: object) -> Violation | None:
        violation = super().set_parameter(name, value)
        if violation is None and name == self.name:
            for entry in list(self._database.entries.values()):
                if not entry.is_deleted:
                    self.lowered(entry)
        return violation

    def lowered(self, entry: DBEntry) -> None:
        """Change a variable after the parameter was set."""


def _cut(self: Vardis, entry: DBEntry) -> None:
    most = self._parameters.max_repetitions
    entry.count_create, entry.count_update = min(entry.count_create, most), min(entry.count_update, most)


def _unsent(self: Vardis, entry: DBEntry, *, long: bool) -> None:
    if long:
        entry.count_create = entry.count_update = 0
        self._database.create_q.remove(entry.spec.var_id)
        self._database.update_q.remove(entry.spec.var_id)


# fmt: off
lowered = instead(Lowers, Lowers.lowered)
lowered("repetitions-cut", "VD-PAR-01 VD-CMP-06 VD-CMP-09",
    "reduces the outstanding repetitions of variables when VARDISPAR_MAX_REPETITIONS is lowered",
    lambda self, entry: _cut(self, entry), name=REPETITIONS)
lowered("large-unsent", "VD-PAR-01 VD-CMP-13",
    "drops the records that do not fit into a lowered VARDISPAR_MAX_PAYLOAD_SIZE",
    lambda self, entry: _unsent(self, entry, long=self._core.sizes.create(entry.spec, entry.value) > self._room()),
    name=PAYLOAD_SIZE)
lowered("summaries-forgotten", "VD-PAR-01 VD-CMP-03",
    "no longer summarises its variables after VARDISPAR_MAX_SUMMARIES was 0",
    lambda self, entry: self._database.summary_q.remove(entry.spec.var_id)
        if not self._parameters.max_summaries else None, name=SUMMARIES)
# fmt: on


class Answers(Receiver):
    """Answers some requests differently."""

    def _answer(self, cell: Any, entry: DBEntry | None, var_id: int, offset: int) -> None:
        if entry is None or self.answers(entry):
            super()._answer(cell, entry, var_id, offset)

    def answers(self, entry: DBEntry) -> bool:
        """Return whether records about a variable have an effect."""
        return True


# fmt: off
answers = instead(Answers, Answers.answers)
answers("long-description-mute", "VD-PAR-01 VD-RC-03",
    "answers no requests for a variable whose description is longer than a lowered maximum",
    lambda self, entry: len(entry.spec.descr) <= self._parameters.longest_description)
answers("long-value-mute", "VD-PAR-01 VD-RU-04 VD-RC-03",
    "answers no requests for a variable whose value is longer than a lowered maximum",
    lambda self, entry: len(entry.value) <= self._parameters.max_value_length)
# fmt: on
