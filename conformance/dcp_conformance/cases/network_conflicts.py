"""Networks: contradictory information from several neighbours.

What is left in the end is seen by requesting the variable: the VarCreate carries what the database holds.
"""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.services import produced, settled

from .vardis_receive import require_both_taken

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES


def held(bench: Bench, name: int) -> VarCreate | None:
    """What the implementation holds of a variable, by its answer to a request; None if it does not answer."""
    if bench.instructions(_CREATE, name):
        bench.repeated(_CREATE, name, 0)
    asking, mark = bench.peer(), bench.mark()
    asking.send(asking.request_create(name))
    if bench.until_instruction(_CREATE, name) is None:
        return None
    # What was composed before the request may have come first.
    bench.repeated(_CREATE, name, mark)
    record: VarCreate = bench.instructions(_CREATE, name, mark)[-1].record
    return record


def check_deleted(bench: Bench, name: int, *requirements: str) -> None:
    """Check that a variable is deleted: no answer to a request for it."""
    asking, mark = bench.peer(), bench.mark()
    asking.send(asking.request_create(name))
    bench.require_alive("a request for a deleted variable", *requirements)
    found = bench.instructions(_CREATE, name, mark)
    bench.check(
        not found, "the variable is deleted: nobody gets its VarCreate", f"{len(found)} came", *requirements, shown=True
    )


@case(
    "TC_NET_RACE_BV_01",
    "An older and a newer value cross each other: the newer one stays ({variant})",
    requirements="VD-PU-07 VD-PU-06",
    stimulus="a variable is known with number 1; two peers send VarUpdates 4 and 5 at once: {variant}",
    expect="number 5 and its value stay, and no VarUpdate 4 follows a VarUpdate 5",
    window=20,
    variants={"newer-first": (5, 4), "older-first": (4, 5)},
)
def crossing(bench: Bench, order: tuple[int, int]) -> None:
    source, name = bench.peer(), bench.var_id()
    bench.learn(source, source.create(name, seqno=1, rep_cnt=bench.rep_cnt(2)))
    mark = bench.mark()
    for number in order:
        peer = bench.peer()
        peer.send(peer.update(name, number, b"%d" % number))
    numbers = [each.record.seqno for each in bench.repeated(_UPDATE, name, mark)]
    bench.check(numbers == sorted(numbers), "numbers that never go back", f"{numbers}", "VD-PU-06", shown=True)
    bench.check(5 in numbers, "VarUpdate 5 is passed on", f"{numbers}", "VD-PU-07")
    record = held(bench, name)
    state = None if record is None else (record.upd.seqno, record.upd.value)
    bench.check(
        state == (5, b"5"), "number 5 with its value", f"{state}", "VD-PU-07", shown=5 in numbers and record is not None
    )


@case(
    "TC_NET_RACE_BV_02",
    "Two producers create one identifier: {variant}",
    requirements="VD-PC-01 VD-PC-10",
    stimulus="a peer creates a variable, and while it is being repeated another one creates the same identifier",
    expect="since 2.0 the later creationTime stays, of two equal ones the first; before, always the first",
    window=30,
    variants={"the-second-later": 1, "both-equal": 0, "the-second-earlier": -1},
)
def two_producers(bench: Bench, difference: int) -> None:
    first, second, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.rep_cnt(4)
    bench.creation_time()
    time = bench.creation_time()
    one = first.create(name, value=b"one", rep_cnt=count, creation_time=time)
    two = second.create(name, value=b"two", rep_cnt=count, creation_time=time + difference)
    if difference > 0:
        bench.session.creation_time = max(bench.session.creation_time, time + difference)
    first.send(one)
    bench.require(bench.until_instruction(_CREATE, name), "the first VarCreate is passed on", "it is not", "VD-PC-10")
    second.send(two)
    wanted = two if bench.features.creation_time and difference > 0 else one
    found = bench.repeated(_CREATE, name, 0)
    wrong = [each for each in found if each.record not in (one, two)]
    bench.check(
        not wrong, "VarCreates as they were sent", f"{len(wrong)} others", "VD-PC-10", frames=wrong[:4], shown=True
    )
    if wanted is two:
        begun = next((place for place, each in enumerate(found) if each.record == two), None)
        bench.require(begun is not None, "the later creation is passed on", "it is not", "VD-PC-01")
        late = [each for each in found[begun:] if each.record == one]
        text = f"{len(late)} of the first one"
        bench.check(not late, "only the later creation from then on", text, "VD-PC-01", frames=late, shown=True)
        times = sum(each.record == two for each in found)
        bench.check(
            times == count,
            f"the later creation in {count} beacons",
            f"{times}",
            "VD-PC-01",
            frames=found,
            shown=times > count,
        )
    else:
        times = sum(each.record == one for each in found)
        bench.check(
            times == len(found) == count,
            f"the first in {count} beacons",
            f"{times} of {len(found)}",
            shown=len(found) > count or times != len(found),
        )
    record = held(bench, name)
    state = "nothing" if record is None else f"{record.spec.prod_id.hex(':')} {record.upd.value!r}"
    bench.check(
        record == wanted,
        f"{wanted.spec.prod_id.hex(':')} {wanted.upd.value!r} stays",
        state,
        "VD-PC-01",
        shown=record is not None,
    )


@case(
    "TC_NET_RACE_BV_03",
    "A deletion and an update of one variable race: it ends up deleted ({variant})",
    requirements="VD-PD-04 VD-PU-02 VD-RX-08 VD-RX-04",
    stimulus="a variable is known; VarDelete and a newer VarUpdate reach the implementation at once: {variant}",
    expect="the VarDelete in exactly repCnt beacons, no VarUpdate behind it, and the variable is deleted",
    window=24,
    variants={
        "deletion-first": ("delete", "update"),
        "update-first": ("update", "delete"),
        "one-payload-deletion-first": ("delete+update",),
        "one-payload-update-first": ("update+delete",),
    },
)
def deletion_and_update(bench: Bench, beacons: tuple[str, ...]) -> None:
    source, name, count = bench.peer(), bench.var_id(), bench.rep_cnt(3)
    bench.learn(source, source.create(name, rep_cnt=count))
    records: dict[str, VardisRecord] = {"delete": source.delete(name), "update": source.update(name, 1)}
    mark = bench.mark()
    for each in beacons:
        bench.peer().send(*(records[part] for part in each.split("+")))
    together = len(beacons) == 1
    # Who has lost the second container has not seen that there is something to delete.
    found = bench.check_repeated(_DELETE, name, count, mark, "VD-PD-04", absent="VD-RX-04" if together else "")
    if found:
        late = bench.instructions(_UPDATE, name, bench.heard.index(found[0].heard))
        rule = "VD-RX-08" if together else "VD-PU-02"
        bench.check(
            not late, "no VarUpdate of a deleted variable", f"{len(late)} came", rule, frames=late[:4], shown=True
        )
    elif together:
        return
    if not bench.features.removed_after_deletion:
        check_deleted(bench, name, "VD-PD-04")


@case(
    "TC_NET_RACE_BV_04",
    "A variable that is created and deleted by one payload ends up deleted ({variant})",
    requirements="VD-RX-08 VD-PD-04 VD-RX-04",
    stimulus="VarCreate and VarDelete of two variables in one payload, then both of an unknown variable: {variant}",
    expect="VarDeletes in exactly repCnt beacons, no VarCreate and no summary",
    window=16,
    variants={"creation-first": 1, "deletion-first": -1},
)
def created_and_deleted(bench: Bench, step: int) -> None:
    peer, count = bench.peer(), bench.rep_cnt(2)
    require_both_taken(bench, peer, step < 0)
    name, mark = bench.var_id(), bench.mark()
    records: list[VardisRecord] = [peer.create(name, rep_cnt=count), peer.delete(name)]
    peer.send(*records[::step])
    bench.check_repeated(_DELETE, name, count, mark, "VD-PD-04")
    for kind in (_CREATE, ICType.SUMMARIES):
        found = bench.instructions(kind, name, mark)
        bench.check(
            not found, f"no {kind.label} record", f"{len(found)} came", "VD-RX-08", frames=found[:4], shown=True
        )


@case(
    "TC_NET_RACE_BO_01",
    "A slow echo does not bring a deleted variable back",
    requirements="VD-PC-01 VD-PU-02 VD-PS-02",
    stimulus="behind the deletion of a variable come its old VarCreate, a VarUpdate and a summary of another peer",
    expect="no reaction; the variable stays deleted",
    window=24,
    needs=Needs(since=SpecVersion.V2_0),
)
def slow_echo(bench: Bench) -> None:
    source, echo, name, count = bench.peer(), bench.peer(), bench.var_id(), bench.rep_cnt(2)
    create = source.create(name, rep_cnt=count)
    bench.learn(source, create)
    mark = bench.mark()
    source.send(source.delete(name))
    bench.repeated(_DELETE, name, mark)
    mark = bench.mark()
    for record, requirement in (
        (create, "VD-PC-01"),
        (echo.update(name, 3), "VD-PU-02"),
        (echo.summary(name, 3), "VD-PS-02"),
    ):
        echo.send(record)
        bench.require_alive("what concerns a deleted variable", requirement)
        trace = [each for heard in bench.heard[mark:] for each in heard.instructions(None, name)]
        bench.check(not trace, "no reaction", f"{len(trace)} records", requirement, frames=trace[:4], shown=True)
    check_deleted(bench, name, "VD-PC-01")


@case(
    "TC_NET_RACE_BO_02",
    "What neighbours say of an own variable changes nothing: {variant}",
    requirements="VD-PU-03 VD-PD-03 VD-PS-02",
    stimulus="the application creates a variable; a peer sends a {variant}",
    expect="the variable keeps value and number; nothing is passed on",
    window=16,
    needs=Needs(ut=("RTDB-Create", "RTDB-Read")),
    variants={"newer-update": "update", "deletion": "delete", "newer-summary": "summary"},
)
def own_variable(bench: Bench, what: str) -> None:
    name, peer = produced(bench, value=b"\x0a"), bench.peer()
    bench.until_instruction(_CREATE, name)
    settled(bench, name)
    rule = {"update": "VD-PU-03", "delete": "VD-PD-03", "summary": "VD-PS-02"}[what]
    records: dict[str, VardisRecord] = {
        "update": peer.update(name, 5, b"foreign"),
        "delete": peer.delete(name),
        "summary": peer.summary(name, 5),
    }
    mark = bench.mark()
    peer.send(records[what])
    bench.require_alive("it", rule)
    answer = bench.expect_status("VARDIS-STATUS-OK", "RTDB-Read", rule, varId=name)
    bench.check(answer.result.get("value") == "0a", "the value 0a", f"{answer.result.get('value')}", rule, shown=True)
    trace = [
        each for kind in (_UPDATE, _DELETE, ICType.REQUEST_VARUPDATES) for each in bench.instructions(kind, name, mark)
    ]
    bench.check(
        not trace, "nothing is passed on or requested", f"{len(trace)} records", rule, frames=trace[:4], shown=True
    )
    record = held(bench, name)
    state = None if record is None else record.upd.seqno
    bench.check(state == 0, "the number 0", f"{state}", rule, shown=record is not None)
