"""dcp-vardis.md: Service RTDB-Create, for an identifier that is in the database."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate
from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.test_steps.repetitions import check_one_in_each
from dcp_conformance.test_steps.services import (
    EXISTS,
    OK,
    create_request,
    created_again,
    deleted_by_peer,
    expect_any,
    max_repetitions,
    nanoseconds,
    produced,
    settled,
    several_repetitions,
    teach_variable,
)
from dcp_conformance.test_system.bench import Bench

_CREATE = ICType.CREATE_VARIABLES
_DELETE = ICType.DELETE_VARIABLES
_UPDATE = ICType.UPDATES


@case(
    "TC_VD_CRE_BO_01",
    "RTDB-Create rejects the identifier of another node's variable",
    requirements="VD-CRE-02",
    stimulus="a peer creates a variable; RTDB-Create with its identifier",
    expect="VARIABLE-EXISTS; the variable of the peer is unchanged",
    needs=Needs(ut=("RTDB-Create", "RTDB-Read")),
)
def foreign(bench: Bench) -> None:
    var_id = teach_variable(bench, bench.peer(), value=b"theirs")
    bench.expect_status(EXISTS, "RTDB-Create", **create_request(bench, var_id, value=b"ours"))
    value = bench.call("RTDB-Read", varId=var_id).result.get("value")
    bench.answered(value, bench.records.value(b"theirs").hex(), "the value unchanged")


@case(
    "TC_VD_CRE_BO_02",
    "RTDB-Create rejects the identifier of another node's deleted variable",
    requirements="VD-CRE-02",
    stimulus="a peer creates and deletes a variable; RTDB-Create with its identifier",
    expect="VARIABLE-EXISTS; according to the description of the service, VARDIS-STATUS-OK is also possible (X20)",
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create",)),
)
def foreign_deleted(bench: Bench) -> None:
    var_id = deleted_by_peer(bench, 1)
    answer = expect_any(bench, (EXISTS, OK), "RTDB-Create", "VD-CRE-02", **create_request(bench, var_id))
    if answer.ok or answer.is_status(EXISTS):
        bench.reading("X20", "by-description" if answer.ok else "by-steps")


@case(
    "TC_VD_CRE_BO_03",
    "Up to 1.3, RTDB-Create rejects the identifier of an existing variable of the node itself",
    requirements="VD-CRE-16 VD-CRE-02",
    stimulus="RTDB-Create twice with the same identifier",
    expect="VARDIS-STATUS-OK, then VARIABLE-EXISTS; the first value is kept",
    needs=Needs(until=SpecVersion.V1_3, ut=("RTDB-Create", "RTDB-Read")),
)
def own_exists(bench: Bench) -> None:
    var_id = produced(bench, value=b"first")
    bench.expect_status(EXISTS, "RTDB-Create", **create_request(bench, var_id, value=b"second"))
    value = bench.call("RTDB-Read", varId=var_id).result.get("value")
    bench.answered(value, bench.records.value(b"first").hex(), "the value unchanged")


@case(
    "TC_VD_CRE_BO_04",
    "A node can create its own variable again, with a later creationTime and sequence number 0",
    requirements="VD-CRE-03 VD-CRE-09",
    stimulus="RTDB-Create, RTDB-Update, and RTDB-Create again with another value",
    expect=(
        "VARDIS-STATUS-OK, and a VarCreate with the new value, seqno 0 and a later creationTime (X20: "
        "VARIABLE-EXISTS is also possible)"
    ),
    window=14,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Update")),
)
def own_created_again(bench: Bench) -> None:
    var_id = produced(bench, value=b"first")
    first = bench.needed(bench.until_instruction(_CREATE, var_id), "the first VarCreate")
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"newer").hex())
    bench.wait(2)
    # The resolution of the clock may be coarser than this.
    bench.waiting.wait_ns(nanoseconds(bench, 1))
    mark = bench.mark()
    answer = expect_any(
        bench, (OK, EXISTS), "RTDB-Create", "VD-CRE-03", **create_request(bench, var_id, value=b"second")
    )
    if answer.ok or answer.is_status(EXISTS):
        bench.reading("X20", "by-steps" if answer.ok else "by-description")
    if not answer.ok:
        return
    bench.excuses.relies_on("creationTime")
    _check_recreated(bench, var_id, mark, first.spec.creation_time, bench.records.value(b"second"))


def _check_recreated(bench: Bench, var_id: int, mark: int, before: int, value: bytes) -> None:
    """Check the VarCreate of the second creation; one of the first creation may have been prepared before."""
    record = bench.until(lambda heard: _recreated(heard.about(_CREATE, var_id), before))
    frames = bench.instructions(_CREATE, var_id, mark)
    seen = f"creationTime {frames[-1].record.spec.creation_time}" if frames else "none"
    what = f"a VarCreate with a creationTime after {before}"
    record = bench.required(record, what, "VD-CRE-09", seen=seen, frames=frames)
    bench.answered(record.upd.seqno, 0, "seqno in the VarCreate", "VD-CRE-03", frames=frames)
    bench.answered(record.upd.value, value, "value in the VarCreate", "VD-CRE-03", frames=frames)


def _recreated(record: Any | None, before: int) -> Any | None:
    spec = getattr(record, "spec", None)
    return record if spec is not None and spec.creation_time > before else None


@case(
    "TC_VD_CRE_BO_05",
    "A creation right after a deletion cancels the deletion",
    requirements="VD-CRE-11 VD-CRE-03",
    stimulus="RTDB-Create, RTDB-Delete with the maximum repCnt, and immediately RTDB-Create",
    expect=(
        "after at most one more VarDelete, exactly repCnt VarCreates of the new variable, and no VarDelete among them"
    ),
    window=40,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Delete"), when=several_repetitions),
)
def ends_deletion(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count, value=b"first")
    first = bench.needed(bench.until_instruction(_CREATE, var_id), "the first VarCreate")
    bench.must("RTDB-Delete", varId=var_id)
    bench.needed(bench.until_instruction(_DELETE, var_id), "a VarDelete")
    mark = bench.mark()
    bench.expect_status(OK, "RTDB-Create", "VD-CRE-03", **create_request(bench, var_id, rep_cnt=count, value=b"second"))
    done = bench.mark()
    if len(bench.receiver.frames_with(_DELETE, var_id)) > count - 2:
        bench.inconclusive("remaining repetitions of the VarDelete", "none left when the variable was created again")
    bench.excuses.relies_on("creationTime")
    before = first.spec.creation_time
    made = bench.until_quiet(lambda heard: _recreated(heard.about(_CREATE, var_id), before), since=mark)
    deletions = bench.receiver.frames_with(_DELETE, var_id, done)
    late = [heard for heard in deletions if not made or heard.time >= made[0].time]
    bench.proved(
        len(deletions) <= 1 and not late,
        "no VarDelete, except one prepared before the creation",
        f"{len(deletions)} VarDeletes, {len(late)} of them with or after the new VarCreate",
        "VD-CRE-11",
        frames=deletions,
    )
    bench.repeated(made, count, "beacons with the new VarCreate", "VD-CRE-11")


@case(
    "TC_VD_CRE_BO_06",
    "A second creation cancels the pending records of the variable",
    requirements="VD-CRE-11",
    stimulus="RTDB-Create and RTDB-Update with the maximum repCnt; one beacon later RTDB-Create again",
    expect="exactly repCnt VarCreates of the new variable, one per beacon, and no VarUpdate among them",
    window=40,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Update"), when=several_repetitions),
)
def ends_repetitions(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count, value=b"first")
    first = bench.needed(bench.until_instruction(_CREATE, var_id), "the first VarCreate")
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"newer").hex())
    bench.needed(bench.until_instruction(_UPDATE, var_id), "a VarUpdate")
    mark = bench.mark()
    answer = bench.call("RTDB-Create", **create_request(bench, var_id, rep_cnt=count, value=b"second"))
    if answer.is_status(EXISTS):
        bench.reading("X20", "by-description")
        return
    bench.services.check_status(answer, (OK,), "RTDB-Create")
    bench.excuses.relies_on("creationTime")
    before = first.spec.creation_time
    made = bench.until_quiet(lambda heard: _recreated(heard.about(_CREATE, var_id), before), since=mark)
    bench.repeated(made, count, "beacons with the new VarCreate")
    check_one_in_each(bench, made, _CREATE, var_id)
    late = [heard for heard in bench.receiver.frames_with(_UPDATE, var_id, mark) if made and heard.time >= made[0].time]
    bench.none(late, "no VarUpdate with or after the new VarCreate")


@case(
    "TC_VD_CRE_BO_07",
    "Up to 1.3, an identifier can be used again after its variable was removed",
    requirements="VD-DEL-08 VD-CRE-02",
    stimulus="RTDB-Create, RTDB-Delete; after the last VarDelete RTDB-Create again",
    expect="VARDIS-STATUS-OK, and a VarCreate with seqno 0",
    window=20,
    needs=Needs(until=SpecVersion.V1_3, ut=("RTDB-Create", "RTDB-Update", "RTDB-Delete")),
)
def used_again(bench: Bench) -> None:
    var_id = produced(bench, value=b"first")
    settled(bench, var_id)
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"newer").hex())
    bench.must("RTDB-Delete", varId=var_id)
    bench.until_quiet(lambda heard: heard.instructions(_DELETE, var_id))
    mark = bench.mark()
    bench.expect_status(OK, "RTDB-Create", **create_request(bench, var_id, value=b"second"))
    record = bench.until_instruction(_CREATE, var_id)
    frames = bench.instructions(_CREATE, var_id, mark)
    came = record and (record.upd.seqno, record.upd.value)
    what = "seqno and value in the VarCreate of the new variable"
    bench.equal(came, (0, bench.records.value(b"second")), what, frames=frames)


@case(
    "TC_VD_CRE_BO_08",
    "Up to 1.3, RTDB-Create rejects an identifier while its variable is being deleted",
    requirements="VD-CRE-16 VD-CRE-02",
    stimulus="RTDB-Create and RTDB-Delete with the maximum repCnt, and immediately RTDB-Create",
    expect="VARIABLE-EXISTS",
    needs=Needs(until=SpecVersion.V1_3, ut=("RTDB-Create", "RTDB-Delete"), when=several_repetitions),
)
def being_deleted(bench: Bench) -> None:
    var_id = produced(bench, rep_cnt=max_repetitions(bench))
    bench.must("RTDB-Delete", varId=var_id)
    bench.expect_status(EXISTS, "RTDB-Create", **create_request(bench, var_id))


@case(
    "TC_VD_CRE_BV_08",
    "RTDB-Create cancels a pending request for the variable",
    requirements="VD-CRE-11",
    stimulus="a summary of an unknown variable, and immediately RTDB-Create with its identifier; up to three times",
    expect="no VarReqCreate in at least one attempt",
    window=10,
    needs=Needs(since=SpecVersion.V1_1, ut=("RTDB-Create",)),
)
def request_ended(bench: Bench) -> None:
    late: list[Instruction] = []
    for _ in range(3):
        peer, var_id = bench.peer(), bench.identifiers.own_var_id()
        bench.beacons(1)
        since = peer.stimulate(peer.summary(var_id, 1))
        bench.must("RTDB-Create", **create_request(bench, var_id))
        bench.require_processed("a summary and RTDB-Create")
        late = bench.instructions(ICType.REQUEST_VARCREATES, var_id, since)
        if not late:
            break
    if late and bench.session.slow_call > bench.period // 2:
        bench.inconclusive(
            "no VarReqCreate for the node's own variable", "calls take so long that it may be sent before them"
        )
    what = "no VarReqCreate for the node's own variable in at least one of 3 attempts"
    bench.none(late, what, given=bench.verdicts.in_time)


@case(
    "TC_VD_CRE_BV_10",
    "A variable that its application creates again is queued after the others",
    requirements="VD-CRE-11 VD-CRE-12",
    stimulus="RTDB-Create of two variables with the maximum repCnt; RTDB-Create of the first again",
    expect="in beacons with VarCreates of both, that of the second is before the new one of the first",
    window=20,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create",), when=several_repetitions),
)
def queued_last(bench: Bench) -> None:
    count, kind = max_repetitions(bench), ICType.CREATE_VARIABLES
    first, second = produced(bench, rep_cnt=count), produced(bench, rep_cnt=count)
    descr = bench.records.descr(b"once more")
    start = bench.mark()
    created_again(bench, first, rep_cnt=count, descr=descr.decode())

    def places(heard: ReceivedBeacon) -> list[int]:
        """Return the variables of the new VarCreates in their order."""
        found = [each.record for each in heard.instructions(kind) if isinstance(each.record, VarCreate)]
        new = [each.spec.var_id for each in found if each.spec.var_id == second or each.spec.descr == descr]
        return [each for each in new if each in (first, second)]

    bench.until(lambda _: any(len(places(heard)) == 2 for heard in bench.heard[start:]))
    both = next((heard for heard in bench.heard[start:] if len(places(heard)) == 2), None)
    if both is None:
        bench.info("Are the VarCreates of two variables in one beacon?", "no")
        return
    order = ["first" if each == first else "second" for each in places(both)]
    bench.answered(order, ["second", "first"], "VarCreates", frames=[both])
