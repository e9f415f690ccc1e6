"""Nodes that are wrong in one thing: the cases about received VarDis payloads must notice."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_selftest.mutants import node_with
from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VarSpec
from dcp_stack.config import NodeConfig
from dcp_stack.node import Node
from dcp_stack.vardis.core import Core, Sequence
from dcp_stack.vardis.database import Database, DBEntry
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.state_table import Action, Cell, Event, State
from dcp_stack.vardis.wire import Extracted, Extractor

from ..rig import known_cases, one_case

Make = Callable[[NodeConfig, random.Random, int, int], Node]


def make_with(part: type[Any]) -> Make:
    """Make nodes with a changed part."""
    made_of = node_with(part)

    def make(config: NodeConfig, rng: random.Random, now: int, wall: int) -> Node:
        return made_of(config, rng=rng, now=now, wall=wall)

    return make


# -- every cell of the table -------------------------------------------------------------------------------------------

STATES = {
    State.UNKNOWN: "unknown",
    State.ALIVE_PRODUCER: "alive-producer",
    State.ALIVE_CONSUMER: "alive-consumer",
    State.DELETED_PRODUCER: "deleted-producer",
    State.DELETED_CONSUMER: "deleted-consumer",
}
#: The event that a case is about, and what an implementation would do that wrongly does not ignore it.
EVENTS: dict[str, tuple[Event, Action]] = {
    "rx-create-later": (Event.RX_CREATE_LATER, Action.ADOPT),
    "rx-create-same": (Event.RX_CREATE_NOT_LATER, Action.ADOPT),
    "rx-create-earlier": (Event.RX_CREATE_NOT_LATER, Action.ADOPT),
    "rx-create-own": (Event.RX_CREATE_OWN, Action.ADOPT),
    "rx-delete": (Event.RX_DELETE, Action.DELETE),
    "rx-newer-update": (Event.RX_UPDATE_NEWER, Action.STORE),
    "rx-equal-update": (Event.RX_UPDATE_EQUAL, Action.STORE),
    "rx-older-update": (Event.RX_UPDATE_OLDER, Action.TEACH),
    "rx-newer-summary": (Event.RX_SUMMARY_NEWER, Action.REQUEST_UPDATE),
    "rx-equal-summary": (Event.RX_SUMMARY_EQUAL, Action.REQUEST_UPDATE),
    "rx-older-summary": (Event.RX_SUMMARY_OLDER, Action.TEACH),
    "rx-request-behind": (Event.RX_REQUEST_UPDATE_BEHIND, Action.SEND_UPDATE),
    "rx-request-equal": (Event.RX_REQUEST_UPDATE_OTHER, Action.SEND_UPDATE),
    "rx-request-ahead": (Event.RX_REQUEST_UPDATE_OTHER, Action.SEND_UPDATE),
    "rx-request-create": (Event.RX_REQUEST_CREATE, Action.SEND_CREATE),
}
UNKNOWN: dict[str, tuple[Event, Action]] = {
    "rx-create": (Event.RX_CREATE_LATER, Action.ADOPT),
    "rx-create-own": (Event.RX_CREATE_OWN, Action.ADOPT),
    "rx-update": (Event.RX_UPDATE_NEWER, Action.REQUEST_CREATE),
    "rx-summary": (Event.RX_SUMMARY_NEWER, Action.REQUEST_CREATE),
    "rx-request-update": (Event.RX_REQUEST_UPDATE_OTHER, Action.REQUEST_CREATE),
    "rx-request-create": (Event.RX_REQUEST_CREATE, Action.REQUEST_CREATE),
}
CELLS = [
    (state, name, *what) for state in State for name, what in (UNKNOWN if state is State.UNKNOWN else EVENTS).items()
]


def other_cell(state: State, event: Event, action: Action) -> type[Core]:
    """One cell of the table is other than it should be: ignored, or not ignored."""

    class OtherCore(Core):
        def cell(self, event_: Event, entry: DBEntry | None) -> Cell:
            right = super().cell(event_, entry)
            if event_ is not event or _state(self, entry) is not state:
                return right
            if right.action is Action.IGNORE:
                return Cell(action)
            return Cell(Action.IGNORE, reason="own-create")

    return OtherCore


def _state(core: Core, entry: DBEntry | None) -> State:
    if entry is None:
        return State.UNKNOWN
    if entry.spec.prod_id == core.own_id:
        return State.DELETED_PRODUCER if entry.is_deleted else State.ALIVE_PRODUCER
    return State.DELETED_CONSUMER if entry.is_deleted else State.ALIVE_CONSUMER


def verdict_of(case_id: str, make: Make, profile: str = "dcp-2.0") -> Verdict:
    result = one_case(case_id, profile, make)
    assert result.verdict is not Verdict.ERROR, result.error_detail
    return result.verdict


def case_of(state: State, name: str) -> str:
    found = [each for each in known_cases() if each.endswith(f"-{STATES[state]}.{name}") and "_VD_STATE_" in each]
    assert len(found) >= 1, f"there is no case for {STATES[state]}.{name}"
    return found[0]


@pytest.mark.parametrize(("state", "name", "event", "action"), CELLS, ids=[f"{STATES[c[0]]}.{c[1]}" for c in CELLS])
def test_a_wrong_cell_is_noticed(state: State, name: str, event: Event, action: Action) -> None:
    make = make_with(other_cell(state, event, action))
    assert verdict_of(case_of(state, name), make) is Verdict.FAIL


@pytest.mark.parametrize("profile", ["dcp-1.3", "cpp-1.3"])
@pytest.mark.parametrize("state", [State.DELETED_PRODUCER, State.DELETED_CONSUMER])
@pytest.mark.parametrize("name", [name for name in EVENTS if not name.startswith(("rx-create", "rx-delete"))])
def test_a_wrong_cell_of_a_variable_that_is_being_deleted_is_noticed(profile: str, state: State, name: str) -> None:
    event, action = EVENTS[name]
    make = make_with(other_cell(state, event, action))
    assert verdict_of(case_of(state, name), make, profile) is Verdict.FAIL


# -- single things -----------------------------------------------------------------------------------------------------


class FirstContainerOnly(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        return super().extract(self._codec.encode_containers(self._codec.decode_containers(payload)[:1]))


class LosesLastContainer(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        containers = self._codec.decode_containers(payload)
        return super().extract(self._codec.encode_containers(containers[:-1] if len(containers) > 1 else containers))


class HalfOfThePayload(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        return super().extract(payload if len(payload) < 24 else payload[: len(payload) // 2])


class StopsAt256(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        return super().extract(payload[:256])


class LosesLastRecord(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        containers = [
            msgspec.structs.replace(each, records=each.records[:-1]) if len(each.records) > 1 else each
            for each in self._codec.decode_containers(payload)
        ]
        return super().extract(self._codec.encode_containers(tuple(containers)))


class SignedCount(Extractor):
    """Takes icNumRecords for a signed octet."""

    def extract(self, payload: bytes) -> Extracted:
        return super().extract(payload) if payload[1] < 128 else Extracted({kind: [] for kind in ICType})


class LastOfEachType(Extractor):
    """Keeps containers in a dictionary by type."""

    def extract(self, payload: bytes) -> Extracted:
        containers = {each.ic_type: each for each in self._codec.decode_containers(payload)}
        return super().extract(self._codec.encode_containers(tuple(containers.values())))


class InOrderOfArrival(Receiver):
    """Processes updates first."""

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        for offset, record in extracted.records[ICType.UPDATES]:
            self._update(record, offset, now, wall)
        rest = {**extracted.records, ICType.UPDATES: []}
        super().process(Extracted(rest, extracted.problems), now=now, wall=wall)


class SummariesFirst(Receiver):
    """And forgets to remove from reqUpdQ, which would hide it."""

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        for offset, record in extracted.records[ICType.SUMMARIES]:
            self._summary(record, offset)
        pending = list(self._database.req_upd_q)
        rest = {**extracted.records, ICType.SUMMARIES: []}
        super().process(Extracted(rest, extracted.problems), now=now, wall=wall)
        for var_id in pending:
            self._database.req_upd_q.append(var_id)


class DeletionsFirst(Receiver):
    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        deletions = extracted.records[ICType.DELETE_VARIABLES]
        for offset, record in deletions:
            self._delete(record, offset)
        rest = {**extracted.records, ICType.DELETE_VARIABLES: []}
        super().process(Extracted(rest, extracted.problems), now=now, wall=wall)


class Backwards(Receiver):
    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        turned = {kind: found[::-1] for kind, found in extracted.records.items()}
        super().process(Extracted(turned, extracted.problems), now=now, wall=wall)


class Dies(Receiver):
    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        if extracted.problems:
            raise RuntimeError(extracted.problems[0].reason)
        super().process(extracted, now=now, wall=wall)


class LongerValues(Receiver):
    def _is_bad_value(self, value: bytes) -> bool:
        return len(value) > self._parameters.max_value_length + 1 or not value


class EmptyValues(Receiver):
    def _is_bad_value(self, value: bytes) -> bool:
        return len(value) > self._parameters.max_value_length


class NoRepCntCheck(Receiver):
    def _create_event(self, record: VarCreate, entry: DBEntry | None) -> Event:
        found = super()._create_event(record, entry)
        return Event.RX_CREATE_LATER if found is Event.RX_CREATE_BAD_REPCNT and record.spec.rep_cnt else found


class ShorterDescriptions(Receiver):
    def _create_event(self, record: VarCreate, entry: DBEntry | None) -> Event:
        if len(record.spec.descr) >= self._parameters.longest_description:
            return Event.RX_CREATE_BAD_DESCRIPTION
        return super()._create_event(record, entry)


class LaterOrSame(Receiver):
    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        received, stored = record.spec.creation_time or 0, entry.spec.creation_time or 0
        return received >= stored


class ByLittleEndian(Receiver):
    """Has the octets of creation times in the other order, which a run tells once, under DATA-01."""

    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        def turned(spec: VarSpec) -> int:
            return int.from_bytes((spec.creation_time or 0).to_bytes(8, "big"), "little")

        return turned(record.spec) > turned(entry.spec)


class ByHighBits(Receiver):
    """Compares creation times without their lowest nine bits."""

    def _is_later(self, record: VarCreate, entry: DBEntry) -> bool:
        return (record.spec.creation_time or 0) >> 9 > (entry.spec.creation_time or 0) >> 9


class OwnTime(Receiver):
    """Stamps creations with the own clock."""

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        spec = msgspec.structs.replace(record.spec, creation_time=wall + 1)
        super()._create(msgspec.structs.replace(record, spec=spec), offset, now, wall)


class PlainComparison(Sequence):
    """Compares without regard to the wrap."""

    def received_is_older(self, received: int, own: int) -> bool:
        return received < own

    def answers(self, requested: int, own: int) -> bool:
        return own > requested


class OffByOne(Sequence):
    def received_is_older(self, received: int, own: int) -> bool:
        return 0 < (own - received) % self._modulus < self._half - 1


class AnswersEqual(Sequence):
    def answers(self, requested: int, own: int) -> bool:
        return requested == own or super().answers(requested, own)


class OneMoreCreate(Database):
    def insert(self, spec: VarSpec, value: bytes, seqno: int, *, now: int, wall: int) -> DBEntry:
        entry = super().insert(spec, value, seqno, now=now, wall=wall)
        entry.count_create += 1
        return entry


class OneMoreUpdate(Database):
    def arm_update(self, entry: DBEntry) -> None:
        super().arm_update(entry)
        entry.count_update += 1


class OneLessDelete(Database):
    def mark_deleted(self, entry: DBEntry) -> None:
        super().mark_deleted(entry)
        entry.count_delete = max(1, entry.count_delete - 1)


class KeepsRequest(Receiver):
    """Forgets to remove from reqUpdQ."""

    def _update(self, record: Any, offset: int, now: int, wall: int) -> None:
        pending = record.var_id in self._database.req_upd_q
        super()._update(record, offset, now, wall)
        if pending:
            self._database.req_upd_q.append(record.var_id)


class AlwaysArms(Receiver):
    """Older information starts the counting again."""

    def _answer(self, cell: Cell, entry: DBEntry | None, var_id: int, offset: int) -> None:
        if cell.action is Action.TEACH:
            cell = Cell(Action.SEND_UPDATE)
        super()._answer(cell, entry, var_id, offset)


class NeverArms(Receiver):
    """A request while the answer is pending does not start the counting again."""

    def _answer(self, cell: Cell, entry: DBEntry | None, var_id: int, offset: int) -> None:
        queues = {Action.SEND_UPDATE: self._database.update_q, Action.SEND_CREATE: self._database.create_q}
        if cell.action in queues and var_id in queues[cell.action]:
            return
        super()._answer(cell, entry, var_id, offset)


class AsksForTheDeleted(Receiver):
    def _delete(self, record: Any, offset: int) -> None:
        if self._database.lookup(record.var_id) is None:
            self._request(record.var_id, offset)
        super()._delete(record, offset)


MUTANTS: list[tuple[str, Make, str]] = [
    ("TC_VD_SPLIT_BV_01", make_with(FirstContainerOnly), "dcp-2.0"),
    ("TC_VD_SPLIT_BV_02-summaries+updates", make_with(FirstContainerOnly), "dcp-1.0"),
    ("TC_VD_SPLIT_BV_01", make_with(LosesLastContainer), "dcp-2.0"),
    ("TC_VD_SPLIT_BV_02-updates+create", make_with(LosesLastContainer), "dcp-1.2"),
    ("TC_VD_SPLIT_BV_01", make_with(HalfOfThePayload), "dcp-1.1"),
    ("TC_VD_SPLIT_BV_02-summaries+summaries", make_with(LosesLastRecord), "dcp-2.0"),
    ("TC_VD_SPLIT_BV_03", make_with(StopsAt256), "dcp-2.0"),
    ("TC_VD_SPLIT_BV_05-255", make_with(StopsAt256), "dcp-2.0"),
    ("TC_VD_SPLIT_BV_05-128", make_with(SignedCount), "dcp-2.0"),
    ("TC_VD_SPLIT_BV_04", make_with(LastOfEachType), "dcp-2.0"),
    ("TC_VD_RX_BV_04-delete", make_with(LastOfEachType), "dcp-1.2"),
    ("TC_VD_RX_BV_01", make_with(InOrderOfArrival), "dcp-2.0"),
    ("TC_VD_RX_BV_06-in-order", make_with(InOrderOfArrival), "dcp-2.0"),
    ("TC_VD_RX_BV_07-in-order", make_with(SummariesFirst), "dcp-1.0"),
    ("TC_VD_RX_BV_05-in-order", make_with(DeletionsFirst), "dcp-1.3"),
    ("TC_VD_RX_BV_09", make_with(Backwards), "dcp-2.0"),
    ("TC_VD_RX_BV_10", make_with(Backwards), "dcp-1.2"),
    ("TC_VD_ROB_BI_01-type-7", make_with(Dies), "dcp-2.0"),
    ("TC_VD_ROB_BI_01-count-0", make_with(Dies), "dcp-2.0"),
    ("TC_VD_ROB_BI_02", make_with(Dies), "dcp-2.0"),
    ("TC_VD_ROB_BI_03-1", make_with(Dies), "dcp-2.0"),
    ("TC_VD_LEN_BI_01-value-max+1", make_with(LongerValues), "dcp-2.0"),
    ("TC_VD_LEN_BI_02-max+1", make_with(LongerValues), "dcp-1.1"),
    ("TC_VD_LEN_BI_01-value-0", make_with(EmptyValues), "dcp-1.2"),
    ("TC_VD_LEN_BI_02-0", make_with(EmptyValues), "dcp-2.0"),
    ("TC_VD_LEN_BI_01-repCnt-max+1", make_with(NoRepCntCheck), "dcp-2.0"),
    ("TC_VD_LEN_BI_01-repCnt-255", make_with(NoRepCntCheck), "dcp-1.2"),
    ("TC_VD_LEN_BI_01-description-max", make_with(ShorterDescriptions), "dcp-1.0"),
    ("TC_VD_CRT_BO_01-the-same", make_with(LaterOrSame), "dcp-2.0"),
    ("TC_VD_CRT_BV_03-255-256", make_with(ByHighBits), "dcp-2.0"),
    ("TC_VD_CRT_BV_01-plain", make_with(OwnTime), "dcp-2.0"),
    ("TC_VD_SEQ_BV_01-1", make_with(PlainComparison), "dcp-2.0"),
    ("TC_VD_SEQ_BV_02-M-1", make_with(PlainComparison), "dcp-2.0"),
    ("TC_VD_SEQ_BV_03-M-1", make_with(PlainComparison), "dcp-1.2"),
    ("TC_VD_SEQ_BV_01-half+1", make_with(OffByOne), "dcp-2.0"),
    ("TC_VD_SEQ_BV_03-0", make_with(AnswersEqual), "dcp-2.0"),
    ("TC_VD_FWD_BV_01-r2", make_with(OneMoreCreate), "dcp-2.0"),
    ("TC_VD_FWD_BV_02-r1", make_with(OneMoreUpdate), "dcp-2.0"),
    ("TC_VD_FWD_BV_03-max", make_with(OneLessDelete), "dcp-1.3"),
    ("TC_VD_STATE_BO_01-unknown.rx-delete", make_with(AsksForTheDeleted), "dcp-2.0"),
    ("TC_VD_PEND_BV_01", make_with(KeepsRequest), "dcp-2.0"),
    ("TC_VD_FWD_BV_06-update", make_with(AlwaysArms), "dcp-2.0"),
    ("TC_VD_FWD_BV_07-request-create", make_with(NeverArms), "dcp-2.0"),
    ("TC_VD_FWD_BV_07-request-update", make_with(NeverArms), "dcp-1.0"),
]


@pytest.mark.parametrize(
    ("case_id", "make", "profile"), MUTANTS, ids=[f"{c[0]}@{c[2]}-{i}" for i, c in enumerate(MUTANTS)]
)
def test_a_wrong_node_is_noticed(case_id: str, make: Make, profile: str) -> None:
    assert verdict_of(case_id, make, profile) is Verdict.FAIL


def test_creation_times_with_swapped_octets_are_a_fault_of_the_data_type() -> None:
    result = one_case("TC_VD_CRT_BV_03-255-256", "dcp-2.0", make_with(ByLittleEndian))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "DATA-01" in result.reason
