"""dcp-vardis.md: Application Service Interface: requests that are rejected change nothing; counters of an entry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.suite.vardis.composition.summaries import summarises
from dcp_conformance.test_steps.services import (
    DESCRIPTION_TOO_LONG,
    EXISTS,
    ILLEGAL_REPCOUNT,
    NOT_PRODUCER,
    OK,
    VALUE_TOO_LONG,
    create_request,
    deleted_status,
    empty_status,
    entry_of,
    expect_any,
    least_left,
    longest_description,
    max_repetitions,
    produced,
    settled,
    several_repetitions,
    teach_variable,
    too_long,
)
from dcp_conformance.test_steps.variable_queries import stepped, traces
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_SERVICES = ("RTDB-Create", "RTDB-Update", "RTDB-Delete", "RTDB-DescribeVariable")
V2_0 = SpecVersion.V2_0
#: Fields that repetitions change.
_COUNTERS = ("countCreate", "countUpdate", "countDelete")


class Refusal(NamedTuple):
    """A request that is rejected: its service, its parameters, and the statuses."""

    service: str
    params: Callable[[Bench, int], dict[str, Any]]
    status: Callable[[Bench], str]


def _creation(**changes: Callable[[Bench], Any]) -> Callable[[Bench, int], dict[str, Any]]:
    def params(bench: Bench, var_id: int) -> dict[str, Any]:
        descr = bench.records.descr(b"other").decode()
        timed = bench.features.creation_time and bench.sut.longest_timeout >= 30_000
        given: dict[str, Any] = {"descr": descr, "value": b"w", "timeout": 30_000 if timed else 0}
        return create_request(
            bench, var_id, exact=True, **given | {name: make(bench) for name, make in changes.items()}
        )

    return params


def _value(make: Callable[[Bench], bytes]) -> Callable[[Bench, int], dict[str, Any]]:
    return lambda bench, var_id: {"varId": var_id, "value": make(bench).hex()}


def _name(_bench: Bench, var_id: int) -> dict[str, Any]:
    return {"varId": var_id}


_OWN = {
    "update-too-long": Refusal("RTDB-Update", _value(too_long), lambda _: VALUE_TOO_LONG),
    "update-empty": Refusal("RTDB-Update", _value(lambda _: b""), empty_status),
    "create-value-too-long": Refusal("RTDB-Create", _creation(value=too_long), lambda _: VALUE_TOO_LONG),
    "create-empty": Refusal("RTDB-Create", _creation(value=lambda _: b""), empty_status),
    "create-description-too-long": Refusal(
        "RTDB-Create",
        _creation(descr=lambda bench: "d" * (longest_description(bench) + 1)),
        lambda _: DESCRIPTION_TOO_LONG,
    ),
    "create-repcnt-0": Refusal("RTDB-Create", _creation(rep_cnt=lambda _: 0), lambda _: ILLEGAL_REPCOUNT),
}
_FOREIGN = {
    "update": Refusal("RTDB-Update", _value(lambda _: b"w"), lambda _: NOT_PRODUCER),
    "update-too-long": Refusal("RTDB-Update", _value(too_long), lambda _: NOT_PRODUCER),
    "delete": Refusal("RTDB-Delete", _name, lambda _: NOT_PRODUCER),
    "create": Refusal("RTDB-Create", _creation(), lambda _: EXISTS),
}
_DELETED = {
    "update": Refusal("RTDB-Update", _value(lambda _: b"w"), deleted_status),
    "delete": Refusal("RTDB-Delete", _name, deleted_status),
    "create-repcnt-0": Refusal("RTDB-Create", _creation(rep_cnt=lambda _: 0), lambda _: ILLEGAL_REPCOUNT),
}
_STATES = {
    "own": ("own", _OWN, "VD-UPD-11 VD-UPD-08 VD-UPD-07"),
    "own-pending": ("pending", _OWN, "VD-UPD-11 VD-CRE-13 VD-CRE-11"),
    "foreign": ("foreign", _FOREIGN, "VD-UPD-03 VD-DEL-03 VD-CRE-02 VD-DB-03"),
    "own-deleted": ("deleted", _DELETED, "VD-DEL-04 VD-UPD-04 VD-DEL-05"),
}


@case(
    "TC_VD_KEEP_BO_01",
    "Requests that are rejected have no effect on the variable ({variant})",
    requirements="VD-UPD-11",
    stimulus="for a variable in this state ({variant}), each request that must be rejected, half a period apart",
    expect=(
        "the status of each; the entry unchanged in RTDB-DescribeVariable, except for the counters of running "
        "repetitions; no further records; the next accepted update has the next sequence number"
    ),
    window=40,
    variants={
        name: Variant(
            (state, refusals),
            requirements=requirements,
            needs=Needs(V2_0 if state == "deleted" else SpecVersion.V1_0, ut=_SERVICES),
        )
        for name, (state, refusals, requirements) in _STATES.items()
    },
)
def refused(bench: Bench, what: tuple[str, dict[str, Refusal]]) -> None:
    state, refusals = what
    peer, count = bench.peer(), max_repetitions(bench) if state == "pending" else 1
    begun = bench.mark()
    if state == "foreign":
        var_id = teach_variable(bench, peer, seqno=5)
    else:
        var_id = produced(bench, rep_cnt=count, value=b"v")
        if state != "pending":
            settled(bench, var_id, begun)
    if state == "deleted":
        begun = bench.mark()
        bench.must("RTDB-Delete", varId=var_id)
        bench.waiting.repeated(_DELETE, var_id, begun)
    before, start = entry_of(bench, var_id), bench.mark()
    if before is None:
        bench.inconclusive("a description of the variable, which this case needs", "none in RTDB-DescribeVariable")
    for refusal in refusals.values():
        # Some nodes create no existing variable again (X20).
        statuses = (refusal.status(bench), *([EXISTS] if refusal.service == "RTDB-Create" else []))
        expect_any(bench, statuses, refusal.service, *bench.case.requirements, **refusal.params(bench, var_id))
        bench.wait(0.5)
    after = bench.present(entry_of(bench, var_id), "a description of the variable", *bench.case.requirements)
    fixed = {name: value for name, value in before.items() if name not in _COUNTERS}
    bench.fields(after, *bench.case.requirements, **fixed)
    if state == "pending":
        bench.check_repeated(_CREATE, var_id, count, begun, *bench.case.requirements)
        bench.none(bench.instructions(_UPDATE, var_id, begun), "no VarUpdate", *bench.case.requirements)
    else:
        bench.wait(3)
        bench.none(traces(bench, var_id, start), "no record of the variable", *bench.case.requirements)
    if state == "deleted":
        return
    if summarises(bench) is None:
        found = bench.until_instruction(ICType.SUMMARIES, var_id, 16)
        bench.some(found, "a summary of the variable", *bench.case.requirements)
    start = bench.mark()
    if state == "foreign":
        peer.send(peer.update(var_id, 6, b"w"))
    else:
        bench.expect_status(OK, "RTDB-Update", varId=var_id, value="77")
    found = bench.until_instruction(_UPDATE, var_id)
    number = stepped(bench, 6 if state == "foreign" else 0, 0 if state == "foreign" else 1)
    bench.equal(found and found.seqno, number, "sequence number of the next VarUpdate", *bench.case.requirements)


@case(
    "TC_VD_DVA_BV_03",
    "The counters in RTDB-DescribeVariable are those of the running repetitions ({variant})",
    requirements="VD-DVA-03",
    stimulus="an own variable with the most repetitions: RTDB-{variant}, then RTDB-DescribeVariable",
    expect="the counter of this record is between the repetitions that can be left and repCnt; the others are 0",
    window=30,
    variants={
        "Create": Variant("countCreate", requirements="VD-DVA-03 VD-CRE-10"),
        "Update": Variant("countUpdate", requirements="VD-DVA-03 VD-UPD-08"),
        "Delete": Variant("countDelete", requirements="VD-DVA-03 VD-DEL-05"),
    },
    needs=Needs(ut=_SERVICES, when=several_repetitions),
)
def counters(bench: Bench, name: str) -> None:
    count, start = max_repetitions(bench), bench.mark()
    var_id = produced(bench, rep_cnt=count)
    if name != "countCreate":
        settled(bench, var_id, start)
        start = bench.mark()
        update = {"value": bench.records.value(b"next").hex()} if name == "countUpdate" else {}
        bench.must("RTDB-Update" if update else "RTDB-Delete", varId=var_id, **update)
    entry = entry_of(bench, var_id)
    least = least_left(bench, count, start)
    if not least:
        bench.inconclusive("remaining repetitions when the entry is described", "none may be left")
    if entry is None:
        bench.proved(False, "an entry of the variable", "none", "VD-DVA-03")
        return
    number = entry.get(name)
    right = isinstance(number, int) and least <= number <= count
    bench.proved(right, f"{name} {least} to {count}", f"{number}")
    others = {each: entry.get(each) for each in _COUNTERS if each != name}
    bench.every(others.values(), lambda each: each == 0, "0 in the other counters", seen=f"{others}")


@case(
    "TC_VD_DVA_BV_04",
    "A later VarCreate of a known variable resets the counters of what was being repeated ({variant})",
    requirements="VD-PC-07",
    stimulus="a variable of another node with the most repetitions: its {variant}, then a later VarCreate of it",
    expect="the entry of the second VarCreate, with countUpdate and countDelete 0",
    window=10,
    variants={
        "VarUpdate": lambda peer, var_id: peer.update(var_id, seqno=2),
        "VarDelete": lambda peer, var_id: peer.delete(var_id),
    },
    needs=Needs(since=V2_0, ut=("RTDB-DescribeVariable",), when=several_repetitions),
)
def counters_restarted(bench: Bench, pending: Callable[[Peer, int], Any]) -> None:
    peer, var_id, count = bench.peer(), bench.var_id(), max_repetitions(bench)
    first = bench.learnt(peer, var_id, seqno=1, rep_cnt=count)
    assert first.spec.creation_time is not None
    second = peer.create(var_id, seqno=9, rep_cnt=count, creation_time=first.spec.creation_time + 1)
    bench.records.creation_time()
    peer.send(pending(peer, var_id))
    peer.send(second)
    forwarded = bench.until(lambda heard: any(each.record == second for each in heard.instructions(_CREATE, var_id)))
    bench.required(forwarded, "the second VarCreate is forwarded")
    entry = entry_of(bench, var_id) or {}
    counts = {each: entry.get(each) for each in ("countUpdate", "countDelete")}
    bench.every(counts.values(), lambda each: each == 0, "0 in countUpdate and countDelete", seen=f"{counts}")
