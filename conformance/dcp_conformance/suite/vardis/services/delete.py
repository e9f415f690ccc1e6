"""dcp-vardis.md: Service RTDB-Delete."""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.repetitions import check_one_in_each
from dcp_conformance.test_steps.services import (
    NOT_PRODUCER,
    OK,
    UNKNOWN,
    count_of,
    created_again,
    deleted_by_peer,
    deleted_status,
    described,
    entry_of,
    expect_any,
    least_left,
    max_repetitions,
    or_removed,
    produced,
    settled,
    several_repetitions,
    statuses_after_deletion,
    teach_variable,
)
from dcp_conformance.test_system.bench import Bench

_D = ICType.DELETE_VARIABLES
_OTHERS = (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES)
_DELETE = Needs(ut=("RTDB-Create", "RTDB-Delete"))


@case(
    "TC_VD_DEL_BV_01",
    "A VarDelete is sent in exactly repCnt beacons, and no other record of the variable ({variant})",
    requirements="VD-DEL-05",
    stimulus="RTDB-Create with repCnt {variant}; after its repetitions RTDB-Delete",
    expect="VARDIS-STATUS-OK; one VarDelete in each of exactly repCnt beacons, and no VarCreate, VarUpdate or summary",
    window=50,
    needs=_DELETE,
    variants={"1": "1", "2": "2", "most": "most"},
)
def repetitions(bench: Bench, name: str) -> None:
    count = count_of(bench, name)
    var_id = produced(bench, rep_cnt=count)
    settled(bench, var_id)
    _check_deletion(bench, var_id, count)


def _check_deletion(bench: Bench, var_id: int, count: int) -> None:
    mark = bench.mark()
    bench.expect_status(OK, "RTDB-Delete", varId=var_id)
    done = bench.mark()
    frames = bench.until_quiet(lambda heard: heard.instructions(_D, var_id), since=mark)
    bench.repeated(frames, count, "beacons with the VarDelete")
    check_one_in_each(bench, frames, _D, var_id)
    # A beacon prepared before the request may still be sent.
    for kind in _OTHERS:
        others = bench.receiver.frames_with(kind, var_id, done)
        late = [heard for heard in others if frames and heard.time >= frames[0].time]
        bench.proved(
            len(others) <= 1 and not late,
            f"no {kind.label} record of the variable, except in a beacon prepared before the request",
            f"in {len(others)} beacons, {len(late)} of them with or after the first VarDelete",
            frames=others,
        )


@case(
    "TC_VD_DEL_BV_02",
    "A deletion cancels the repetitions of creation and update",
    requirements="VD-DEL-05",
    stimulus="RTDB-Create and RTDB-Update with the maximum repCnt; after two beacons RTDB-Delete",
    expect=(
        "VARDIS-STATUS-OK; exactly repCnt beacons with the VarDelete, and no VarCreate, VarUpdate or summary with "
        "or after them"
    ),
    window=50,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-Delete"), when=several_repetitions),
)
def ends_repetitions(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count)
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"newer").hex())
    bench.needed(bench.until_instruction(ICType.UPDATES, var_id), "a VarUpdate of the variable")
    _check_deletion(bench, var_id, count)


@case(
    "TC_VD_DEL_BV_06",
    "The VarDeletes of a variable that was created again are counted from repCnt again",
    requirements="VD-DEL-05 VD-CRE-10",
    stimulus=(
        "RTDB-Create and RTDB-Delete with the maximum repCnt; after two VarDeletes RTDB-Create and RTDB-Delete again"
    ),
    expect="after the second RTDB-Delete exactly repCnt beacons with the VarDelete",
    window=60,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Delete"), when=several_repetitions),
)
def counted_again(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count)
    bench.must("RTDB-Delete", varId=var_id)
    for _ in range(2):
        bench.needed(bench.until_instruction(_D, var_id), "a VarDelete of the variable, which this case needs")
    created_again(bench, var_id, rep_cnt=count)
    if bench.until_instruction(ICType.CREATE_VARIABLES, var_id) is None:
        bench.inconclusive("a VarCreate of the new creation, which this case needs", "none in time")
    _check_deletion(bench, var_id, count)


@case(
    "TC_VD_DEL_BV_03",
    "The database entry of a deleted variable has the contents that the specification requires",
    requirements="VD-DEL-05",
    stimulus="RTDB-Create, RTDB-Update and RTDB-Delete with the maximum repCnt, then immediately RTDB-DescribeVariable",
    expect="isDeleted true, countDelete at most two less than repCnt, the other counters 0",
    needs=Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-Delete", "RTDB-DescribeVariable"), when=several_repetitions),
)
def entry(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count)
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"newer").hex())
    start = bench.mark()
    bench.must("RTDB-Delete", varId=var_id)
    found = bench.present(entry_of(bench, var_id), "a database entry of the deleted variable")
    least = least_left(bench, count, start)
    for name, low, high in (
        ("isDeleted", True, True),
        ("countDelete", least, count),
        ("countCreate", 0, 0),
        ("countUpdate", 0, 0),
    ):
        if name in found:
            bench.proved(low <= found[name] <= high, f"{name} from {low} to {high}", found[name])


@case(
    "TC_VD_DEL_BV_04",
    "A deleted variable remains in the database",
    requirements="VD-DEL-06",
    stimulus="RTDB-Create and RTDB-Delete; after the last VarDelete RTDB-DescribeVariable",
    expect="VARDIS-STATUS-OK and the entry, marked as deleted",
    window=20,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Delete", "RTDB-DescribeVariable")),
)
def stays(bench: Bench) -> None:
    var_id = produced(bench)
    bench.must("RTDB-Delete", varId=var_id)
    bench.until_quiet(lambda heard: heard.instructions(_D, var_id))
    found = described(bench.expect_status(OK, "RTDB-DescribeVariable", varId=var_id))
    bench.answered(found.get("isDeleted", True), True, "isDeleted")


@case(
    "TC_VD_DEL_BV_05",
    "Up to 1.3, a deleted variable is removed from the database after its last VarDelete",
    requirements="VD-DEL-08",
    stimulus="RTDB-Create and RTDB-Delete; after the last VarDelete RTDB-DescribeVariable and RTDB-Delete",
    expect="VARIABLE-DOES-NOT-EXIST",
    window=20,
    needs=Needs(until=SpecVersion.V1_3, ut=("RTDB-Create", "RTDB-Delete", "RTDB-DescribeVariable")),
)
def leaves(bench: Bench) -> None:
    var_id = produced(bench)
    bench.must("RTDB-Delete", varId=var_id)
    bench.until_quiet(lambda heard: heard.instructions(_D, var_id))
    bench.expect_status(UNKNOWN, "RTDB-DescribeVariable", varId=var_id)
    bench.expect_status(UNKNOWN, "RTDB-Delete", varId=var_id)


# -- refusals ----------------------------------------------------------------------------------------------------------


@case(
    "TC_VD_DEL_BI_01",
    "RTDB-Delete rejects a variable that does not exist",
    requirements="VD-DEL-02",
    stimulus="RTDB-Delete for an identifier that is not in use",
    expect="VARIABLE-DOES-NOT-EXIST; no VarDelete",
    needs=Needs(ut=("RTDB-Delete",)),
)
def unknown(bench: Bench) -> None:
    var_id = bench.unknown_id()
    bench.expect_status(UNKNOWN, "RTDB-Delete", varId=var_id)
    bench.require_alive("RTDB-Delete for an unknown variable")
    bench.none(bench.receiver.frames_with(_D, var_id), "no VarDelete")


@case(
    "TC_VD_DEL_BO_01",
    "RTDB-Delete rejects a variable of another node",
    requirements="VD-DEL-03",
    stimulus="a peer creates a variable; RTDB-Delete",
    expect="NOT-PRODUCER; RTDB-Read still finds the variable, and no VarDelete is sent",
    needs=Needs(ut=("RTDB-Delete", "RTDB-Read")),
)
def foreign(bench: Bench) -> None:
    var_id = teach_variable(bench, bench.peer(), value=b"theirs")
    bench.expect_status(NOT_PRODUCER, "RTDB-Delete", varId=var_id)
    bench.require_alive("RTDB-Delete for a variable of another node")
    answer = bench.call("RTDB-Read", varId=var_id)
    bench.proved(
        answer.ok and answer.result.get("value") == bench.records.value(b"theirs").hex(),
        "the variable still exists",
        answer,
    )
    bench.none(bench.receiver.frames_with(_D, var_id), "no VarDelete")


@case(
    "TC_VD_DEL_BO_02",
    "RTDB-Delete rejects a deleted variable of another node, and checks the producer first",
    requirements="VD-DEL-03",
    stimulus="a peer creates and deletes a variable; RTDB-Delete",
    expect="NOT-PRODUCER; up to 1.3 VARIABLE-DOES-NOT-EXIST once it has been removed",
    needs=Needs(ut=("RTDB-Delete",)),
)
def foreign_deleted(bench: Bench) -> None:
    var_id = deleted_by_peer(bench, max_repetitions(bench))
    expect_any(bench, or_removed(bench, NOT_PRODUCER), "RTDB-Delete", varId=var_id)


@case(
    "TC_VD_DEL_BO_03",
    "A second RTDB-Delete of a variable is rejected, both immediately and later",
    requirements="VD-DEL-04 VD-DEL-09",
    stimulus=(
        "RTDB-Create with the maximum repCnt, RTDB-Delete, RTDB-Delete again immediately, and after the last VarDelete"
    ),
    expect="VARIABLE-IS-DELETED both times, and no further VarDelete; up to 1.3 VARIABLE-BEING-DELETED, then "
    "VARIABLE-DOES-NOT-EXIST",
    window=30,
    needs=_DELETE,
)
def twice(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count)
    mark = bench.mark()
    bench.must("RTDB-Delete", varId=var_id)
    expect_any(bench, statuses_after_deletion(bench), "RTDB-Delete", varId=var_id)
    frames = bench.until_quiet(lambda heard: heard.instructions(_D, var_id), since=mark)
    bench.repeated(frames, count, "beacons with the VarDelete")
    status = UNKNOWN if bench.features.removed_after_deletion else deleted_status(bench)
    bench.expect_status(status, "RTDB-Delete", varId=var_id)
