"""dcp-vardis.md: Receive Path, Variable States.

Every event in every state of a variable: unknown, alive or deleted, produced by the implementation or by another node.
The variants are named ``state.event``. Variables of other nodes need only beacons; the node's own variables need the
services of the application.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import teach_variable
from dcp_conformance.test_steps.variable_queries import own_id
from dcp_conformance.test_steps.variable_states import (
    VariableState,
    deletes,
    foreign,
    ignored,
    own,
    requests_update,
    requests_variable,
    sends_value,
    sends_variable,
    stores,
    taken_over,
)
from dcp_conformance.test_system.bench import Bench

_OWN = ("RTDB-Create", "RTDB-Update", "RTDB-Delete")
_V2_0, _V1_3, _V1_1 = SpecVersion.V2_0, SpecVersion.V1_3, SpecVersion.V1_1

# -- the events --------------------------------------------------------------------------------------------------------

Outcome = Callable[[VariableState, int, VardisRecord], None]
Event = Callable[[VariableState], VardisRecord]


@dataclass(frozen=True)
class Cell:
    """An event in a state, with its expected outcome."""

    situation: Callable[[Bench, str], VariableState]
    state: str
    event: Event
    outcome: Outcome | None
    """None if the record must be ignored."""


EVENTS: dict[str, tuple[str, Event]] = {
    "rx-create": ("a VarCreate", lambda s: s.create(1)),
    "rx-create-later": ("a VarCreate with a later creationTime", lambda s: s.create(1)),
    "rx-create-same": ("a VarCreate with the stored creationTime", lambda s: s.create(0)),
    "rx-create-earlier": ("a VarCreate with an earlier creationTime", lambda s: s.create(-1)),
    "rx-create-own": ("a VarCreate with the implementation as producer", lambda s: s.create(1, own_id(s.bench))),
    "rx-delete": ("a VarDelete", lambda s: s.peer.delete(s.var_id)),
    "rx-update": ("a VarUpdate", lambda s: s.peer.update(s.var_id, 3)),
    "rx-newer-update": ("a VarUpdate with a newer number", lambda s: s.peer.update(s.var_id, s.seqno(1))),
    "rx-equal-update": ("a VarUpdate with the stored number", lambda s: s.peer.update(s.var_id, s.seqno(0))),
    "rx-older-update": ("a VarUpdate with an older number", lambda s: s.peer.update(s.var_id, s.seqno(-1))),
    "rx-summary": ("a summary", lambda s: s.peer.summary(s.var_id, 3)),
    "rx-newer-summary": ("a summary with a newer number", lambda s: s.peer.summary(s.var_id, s.seqno(1))),
    "rx-equal-summary": ("a summary with the stored number", lambda s: s.peer.summary(s.var_id, s.seqno(0))),
    "rx-older-summary": ("a summary with an older number", lambda s: s.peer.summary(s.var_id, s.seqno(-1))),
    "rx-request-update": ("a VarReqUpdate", lambda s: s.peer.request_update(s.var_id, 3)),
    "rx-request-behind": (
        "a VarReqUpdate with an older number",
        lambda s: s.peer.request_update(s.var_id, s.seqno(-1)),
    ),
    "rx-request-equal": (
        "a VarReqUpdate with the stored number",
        lambda s: s.peer.request_update(s.var_id, s.seqno(0)),
    ),
    "rx-request-ahead": ("a VarReqUpdate with a newer number", lambda s: s.peer.request_update(s.var_id, s.seqno(1))),
    "rx-request-create": ("a VarReqCreate", lambda s: s.peer.request_create(s.var_id)),
}

_Row = tuple[str, str, Outcome | None, Needs]
_ALL, _SINCE_1_1, _SINCE_2_0, _UNTIL_1_3 = Needs(), Needs(since=_V1_1), Needs(since=_V2_0), Needs(until=_V1_3)
_ONLY_1_0 = Needs(until=SpecVersion.V1_0)


def _one_repetition(bench: Bench) -> str | None:
    if bench.sut.bound("VARDISPAR_MAX_REPETITIONS") < 2:
        return "a test during the deletion of a variable needs at least two repetitions"
    return None


_DELETING = Needs(until=_V1_3, when=_one_repetition)

UNKNOWN: list[_Row] = [
    ("rx-create", "VD-PC-07 VD-PC-09", stores, _ALL),
    ("rx-create-own", "VD-PC-03", None, _ALL),
    ("rx-delete", "VD-PD-01", None, _ALL),
    ("rx-update", "VD-PU-01", requests_variable, _ALL),
    ("rx-summary", "VD-PS-01", requests_variable, _ALL),
    ("rx-request-update", "VD-RU-01", requests_variable, _SINCE_1_1),
    ("rx-request-create", "VD-RC-01", requests_variable, _SINCE_1_1),
]
UNKNOWN_1_0: list[_Row] = [
    ("rx-request-update", "VD-RU-05 VD-SCP-01", None, _ONLY_1_0),
    ("rx-request-create", "VD-RC-04 VD-SCP-01", None, _ONLY_1_0),
]
ALIVE_CONSUMER: list[_Row] = [
    ("rx-create-later", "VD-PC-01", stores, _SINCE_2_0),
    ("rx-create-same", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create-earlier", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create", "VD-PC-11 VD-SCP-03", None, _UNTIL_1_3),
    ("rx-create-own", "VD-PC-03", None, _ALL),
    ("rx-delete", "VD-PD-04", deletes, _ALL),
    ("rx-newer-update", "VD-PU-07", stores, _ALL),
    ("rx-equal-update", "VD-PU-05", None, _ALL),
    ("rx-older-update", "VD-PU-06", sends_value, _ALL),
    ("rx-newer-summary", "VD-PS-04", requests_update, _ALL),
    ("rx-equal-summary", "VD-PS-02", None, _ALL),
    ("rx-older-summary", "VD-PS-03", sends_value, _ALL),
    ("rx-request-behind", "VD-RU-04", sends_value, _ALL),
    ("rx-request-equal", "VD-RU-03", None, _ALL),
    ("rx-request-ahead", "VD-RU-03", None, _ALL),
    ("rx-request-create", "VD-RC-03", sends_variable, _ALL),
]
ALIVE_PRODUCER: list[_Row] = [
    ("rx-create-later", "VD-PC-01", taken_over, _SINCE_2_0),
    ("rx-create-same", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create-earlier", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create", "VD-PC-11 VD-SCP-03", None, _UNTIL_1_3),
    ("rx-create-own", "VD-PC-03", None, _ALL),
    ("rx-delete", "VD-PD-03", None, _ALL),
    ("rx-newer-update", "VD-PU-03", None, _ALL),
    ("rx-equal-update", "VD-PU-03", None, _ALL),
    ("rx-older-update", "VD-PU-03", None, _ALL),
    ("rx-newer-summary", "VD-PS-02", None, _ALL),
    ("rx-equal-summary", "VD-PS-02", None, _ALL),
    ("rx-older-summary", "VD-PS-02", None, _ALL),
    ("rx-request-behind", "VD-RU-04", sends_value, _ALL),
    ("rx-request-equal", "VD-RU-03", None, _ALL),
    ("rx-request-ahead", "VD-RU-03", None, _ALL),
    ("rx-request-create", "VD-RC-03", sends_variable, _ALL),
]
DELETED: list[_Row] = [
    ("rx-create-later", "VD-PC-02", stores, _SINCE_2_0),
    ("rx-create-same", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create-earlier", "VD-PC-01", None, _SINCE_2_0),
    ("rx-create", "VD-PC-11 VD-SCP-03", None, _DELETING),
    ("rx-create-own", "VD-PC-03", None, _ALL),
    ("rx-delete", "VD-PD-02", None, _ALL),
    ("rx-newer-update", "VD-PU-02", None, _ALL),
    ("rx-equal-update", "VD-PU-02", None, _ALL),
    ("rx-older-update", "VD-PU-02", None, _ALL),
    ("rx-newer-summary", "VD-PS-02", None, _ALL),
    ("rx-equal-summary", "VD-PS-02", None, _ALL),
    ("rx-older-summary", "VD-PS-02", None, _ALL),
    ("rx-request-behind", "VD-RU-02", None, _ALL),
    ("rx-request-equal", "VD-RU-02", None, _ALL),
    ("rx-request-ahead", "VD-RU-02", None, _ALL),
    ("rx-request-create", "VD-RC-02", None, _ALL),
]

_CONSUMER = {"unknown": UNKNOWN, "alive-consumer": ALIVE_CONSUMER, "deleted-consumer": DELETED}
_PRODUCER = {"alive-producer": ALIVE_PRODUCER, "deleted-producer": DELETED}
_WORDS = {
    "unknown": "an unknown variable",
    "alive-consumer": "a variable of another node",
    "alive-producer": "one of the node's own variables",
    "deleted-consumer": "a deleted variable of another node",
    "deleted-producer": "one of the node's own deleted variables",
}


def _cells(table: dict[str, list[_Row]], *, effect: bool) -> Iterator[tuple[str, Variant]]:
    """Yield the variants of a case: events with an effect, or those that must be ignored."""
    for column, rows in table.items():
        for name, requirements, outcome, needs in rows:
            if (outcome is not None) is not effect:
                continue
            what, event = EVENTS[name]
            makes = own if column.endswith("producer") else foreign
            result = (outcome.__doc__ or "").rstrip(".") if outcome is not None else "It is ignored"
            yield (
                f"{column}.{name}",
                Variant(
                    Cell(makes, column.partition("-")[0], event, outcome),
                    purpose=f"{what[0].upper()}{what[1:]} of {_WORDS[column]}: {result[0].lower()}{result[1:]}",
                    requirements=requirements,
                    stimulus=f"{what} of {_WORDS[column]}",
                    expect=f"{result[0].lower()}{result[1:]}",
                    needs=Needs(since=needs.since, until=needs.until, ut=_OWN if makes is own else (), when=needs.when),
                ),
            )


@case(
    "TC_VD_STATE_BV_01",
    "{variant}",
    requirements="VD-PC-07",
    stimulus="{variant}",
    expect="the effect that the specification gives for this event in this state",
    window=4,
    variants=dict(_cells(_CONSUMER, effect=True)),
)
@case(
    "TC_VD_STATE_BO_01",
    "{variant}",
    requirements="VD-PC-07",
    stimulus="{variant}",
    expect="no reaction; a probe is answered",
    window=4,
    variants=dict(_cells(_CONSUMER, effect=False)),
)
@case(
    "TC_VD_STATE_BO_02",
    "{variant} (1.0)",
    requirements="VD-SCP-01",
    stimulus="{variant}",
    expect="no reaction; a probe is answered",
    window=4,
    variants=dict(_cells({"unknown": UNKNOWN_1_0}, effect=False)),
)
@case(
    "TC_VD_STATE_BV_02",
    "{variant}",
    requirements="VD-PC-07",
    stimulus="{variant}",
    expect="the effect that the specification gives for this event in this state",
    window=4,
    variants=dict(_cells(_PRODUCER, effect=True)),
)
@case(
    "TC_VD_STATE_BO_03",
    "{variant}",
    requirements="VD-PC-07",
    stimulus="{variant}",
    expect="no reaction; a probe is answered",
    window=4,
    variants=dict(_cells(_PRODUCER, effect=False)),
)
def event(bench: Bench, cell: Cell) -> None:
    situation = cell.situation(bench, cell.state)
    record = cell.event(situation)
    since = bench.mark()
    situation.send(record)
    if cell.outcome is None:
        ignored(situation, since)
    else:
        cell.outcome(situation, since, record)


@case(
    "TC_VD_STATE_BV_04",
    "Up to 1.3, a variable is unknown again after the repetitions of its deletion",
    requirements="VD-DEL-08 VD-PD-04",
    stimulus="a VarDelete; after its repetitions a summary of the variable",
    expect="a request for the variable",
    needs=_UNTIL_1_3,
)
def removed(bench: Bench) -> None:
    peer = bench.peer()
    var_id = teach_variable(bench, peer)
    since = peer.stimulate(peer.delete(var_id))
    bench.check_repeated(ICType.DELETE_VARIABLES, var_id, 1, since)
    peer.send(peer.summary(var_id, 0))
    came = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    bench.some(came, "a request for the variable, which is unknown again")
    peer.send(peer.create(var_id))
    came = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    bench.some(came, "a new VarCreate with its identifier is forwarded")
