"""Networks: contradictory information from several neighbours.

The final state is read by requesting the variable: the VarCreate in the answer carries the contents of the database.
"""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.suite.vardis.reception.receive import require_both_taken
from dcp_conformance.test_steps.repetitions import check_order
from dcp_conformance.test_steps.services import produced, settled
from dcp_conformance.test_system.bench import Bench

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES


def held(bench: Bench, name: int) -> VarCreate | None:
    """Return the VarCreate in the answer to a request for a variable; None if there is no answer."""
    if bench.instructions(_CREATE, name):
        bench.waiting.repeated(_CREATE, name, 0)
    asking, mark = bench.peer(), bench.mark()
    asking.send(asking.request_create(name))
    if bench.until_instruction(_CREATE, name) is None:
        return None
    # A VarCreate composed before the request may arrive first; the last one is the answer.
    bench.waiting.repeated(_CREATE, name, mark)
    record: VarCreate = bench.instructions(_CREATE, name, mark)[-1].record
    return record


def check_deleted(bench: Bench, name: int, *requirements: str) -> None:
    """Check that a variable is deleted: a request for it is not answered."""
    asking, mark = bench.peer(), bench.mark()
    asking.send(asking.request_create(name))
    bench.require_alive("a request for a deleted variable", *requirements)
    bench.none(bench.instructions(_CREATE, name, mark), "no VarCreate of the deleted variable", *requirements)


@case(
    "TC_NET_RACE_BV_01",
    "If an older and a newer value arrive in either order, the newer one is stored ({variant})",
    requirements="VD-PU-07 VD-PU-06",
    stimulus="a variable is known with sequence number 1; two peers send VarUpdates 4 and 5 at once ({variant})",
    expect="sequence number 5 and its value in the end; no VarUpdate 4 after a VarUpdate 5",
    window=20,
    variants={"newer-first": (5, 4), "older-first": (4, 5)},
)
def crossing(bench: Bench, order: tuple[int, int]) -> None:
    source, name = bench.peer(), bench.var_id()
    bench.learn(source, source.create(name, seqno=1, rep_cnt=bench.sut.rep_cnt(2)))
    mark = bench.mark()
    for number in order:
        peer = bench.peer()
        peer.send(peer.update(name, number, b"%d" % number))
    numbers = check_order(bench, bench.waiting.repeated(_UPDATE, name, mark), "VD-PU-06")
    bench.some(5 in numbers, "VarUpdate 5 is forwarded", "VD-PU-07", seen=numbers)
    record = held(bench, name)
    state = record and (record.upd.seqno, record.upd.value)
    bench.equal(state, (5, b"5"), "stored sequence number and value", "VD-PU-07", given=5 in numbers)


@case(
    "TC_NET_RACE_BV_02",
    "Two producers create the same variable identifier ({variant})",
    requirements="VD-PC-01 VD-PC-10",
    stimulus="a peer creates a variable; while it is being repeated, another peer creates the same identifier",
    expect=(
        "from 2.0 on the variable with the later creationTime, the first one if they are equal; before 2.0 always "
        "the first"
    ),
    window=30,
    variants={"the-second-later": 1, "both-equal": 0, "the-second-earlier": -1},
)
def two_producers(bench: Bench, difference: int) -> None:
    first, second, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.sut.rep_cnt(4)
    bench.records.creation_time()
    time = bench.records.creation_time()
    one = first.create(name, value=b"one", rep_cnt=count, creation_time=time)
    two = second.create(name, value=b"two", rep_cnt=count, creation_time=time + difference)
    if difference > 0:
        bench.session.creation_time = max(bench.session.creation_time, time + difference)
    first.send(one)
    bench.required(bench.until_instruction(_CREATE, name), "the first VarCreate is forwarded", "VD-PC-10")
    second.send(two)
    wanted = two if bench.features.creation_time and difference > 0 else one
    found = bench.waiting.repeated(_CREATE, name, 0)
    bench.every(found, lambda each: each.record in (one, two), "only unchanged VarCreates", "VD-PC-10")
    if wanted is two:
        begun = bench.required(
            next((place for place, each in enumerate(found) if each.record == two), None),
            "the later VarCreate is forwarded",
            "VD-PC-01",
        )
        late = [each for each in found[begun:] if each.record == one]
        bench.none(late, "after it only VarCreates of the later variable", "VD-PC-01")
        times = sum(each.record == two for each in found)
        bench.repeated(times, count, "beacons with the later VarCreate", "VD-PC-01", frames=found)
    else:
        bench.every(found, one, "no VarCreate other than the first")
        bench.repeated(found, count, "beacons with the first VarCreate")
    record = held(bench, name)
    bench.equal(record, wanted, f"{wanted.spec.prod_id.hex(':')} {wanted.upd.value!r} in the database", "VD-PC-01")


@case(
    "TC_NET_RACE_BV_03",
    "A variable that is deleted and updated at the same time ends up deleted ({variant})",
    requirements="VD-PD-04 VD-PU-02 VD-RX-08 VD-RX-04",
    stimulus="a VarDelete and a newer VarUpdate of a known variable arrive at once ({variant})",
    expect=(
        "the VarDelete in exactly repCnt beacons, no VarUpdate after it, and no answer to a request for the variable"
    ),
    window=24,
    variants={
        "deletion-first": ("delete", "update"),
        "update-first": ("update", "delete"),
        "one-payload-deletion-first": ("delete+update",),
        "one-payload-update-first": ("update+delete",),
    },
)
def deletion_and_update(bench: Bench, beacons: tuple[str, ...]) -> None:
    source, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(3)
    bench.learn(source, source.create(name, rep_cnt=count))
    records: dict[str, VardisRecord] = {"delete": source.delete(name), "update": source.update(name, 1)}
    mark = bench.mark()
    for each in beacons:
        bench.peer().send(*(records[part] for part in each.split("+")))
    together = len(beacons) == 1
    # If the second container is lost, the implementation cannot know that there is a deletion.
    found = bench.check_repeated(_DELETE, name, count, mark, "VD-PD-04", absent="VD-RX-04" if together else "")
    if found:
        late = bench.instructions(_UPDATE, name, bench.heard.index(found[0].heard))
        bench.none(late, "no VarUpdate of the deleted variable", "VD-RX-08" if together else "VD-PU-02")
    elif together:
        return
    if not bench.features.removed_after_deletion:
        check_deleted(bench, name, "VD-PD-04")


@case(
    "TC_NET_RACE_BV_04",
    "A variable that is created and deleted in one payload ends up deleted ({variant})",
    requirements="VD-RX-08 VD-PD-04 VD-RX-04",
    stimulus="VarCreates and VarDeletes of two variables in one payload, then both of an unknown variable ({variant})",
    expect="VarDeletes in exactly repCnt beacons; no VarCreate and no summary",
    window=16,
    variants={"creation-first": 1, "deletion-first": -1},
)
def created_and_deleted(bench: Bench, step: int) -> None:
    peer, count = bench.peer(), bench.sut.rep_cnt(2)
    require_both_taken(bench, peer, step < 0)
    name, mark = bench.var_id(), bench.mark()
    records: list[VardisRecord] = [peer.create(name, rep_cnt=count), peer.delete(name)]
    peer.send(*records[::step])
    bench.check_repeated(_DELETE, name, count, mark, "VD-PD-04")
    for kind in (_CREATE, ICType.SUMMARIES):
        bench.none(bench.instructions(kind, name, mark), f"no {kind.label} record of the variable", "VD-RX-08")


@case(
    "TC_NET_RACE_BO_01",
    "Late records from a neighbour do not restore a deleted variable",
    requirements="VD-PC-01 VD-PU-02 VD-PS-02",
    stimulus="after the deletion of a variable, another peer sends its old VarCreate, a VarUpdate and a summary",
    expect="no reaction; the variable stays deleted",
    window=24,
    needs=Needs(since=SpecVersion.V2_0),
)
def slow_echo(bench: Bench) -> None:
    source, echo, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    create = bench.learnt(source, name, rep_cnt=count)
    mark = source.stimulate(source.delete(name))
    # Unless it has forwarded the deletion, it may not have received it.
    deleted = bench.waiting.repeated(_DELETE, name, mark)
    mark = bench.mark()
    for record, requirement in (
        (create, "VD-PC-01"),
        (echo.update(name, 3), "VD-PU-02"),
        (echo.summary(name, 3), "VD-PS-02"),
    ):
        echo.send(record)
        bench.require_alive("a late record about a deleted variable", requirement)
        trace = [each for heard in bench.heard[mark:] for each in heard.instructions(None, name)]
        bench.none(trace, "no record about the variable", requirement, given=deleted)
    check_deleted(bench, name, "VD-PC-01")


@case(
    "TC_NET_RACE_BO_02",
    "Records of neighbours about a node's own variable change nothing ({variant})",
    requirements="VD-PU-03 VD-PD-03 VD-PS-02",
    stimulus="the application creates a variable; a peer sends a record about it ({variant})",
    expect="value and sequence number unchanged; no record is forwarded",
    window=16,
    needs=Needs(ut=("RTDB-Create", "RTDB-Read")),
    variants={"newer-update": "update", "deletion": "delete", "newer-summary": "summary"},
)
def own_variable(bench: Bench, what: str) -> None:
    mark = bench.mark()
    name, peer = produced(bench, value=b"\x0a"), bench.peer()
    bench.until_instruction(_CREATE, name)
    settled(bench, name, mark)
    rule = {"update": "VD-PU-03", "delete": "VD-PD-03", "summary": "VD-PS-02"}[what]
    records: dict[str, VardisRecord] = {
        "update": peer.update(name, 5, b"foreign"),
        "delete": peer.delete(name),
        "summary": peer.summary(name, 5),
    }
    mark = peer.stimulate(records[what])
    bench.require_alive("a record about a variable of its own", rule)
    answer = bench.expect_status("VARDIS-STATUS-OK", "RTDB-Read", rule, varId=name)
    bench.answered(answer.result.get("value"), "0a", "the value", rule)
    trace = [
        each for kind in (_UPDATE, _DELETE, ICType.REQUEST_VARUPDATES) for each in bench.instructions(kind, name, mark)
    ]
    bench.none(trace, "no record forwarded, and no request", rule)
    record = held(bench, name)
    bench.equal(record and record.upd.seqno, 0, "stored sequence number", rule)
