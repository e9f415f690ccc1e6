"""dcp-vardis.md: Composing the Containers.

The implementation is a consumer in all of this: what it composes are repetitions and answers.
"""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.filling import PAYLOAD_SIZE, longest
from dcp_conformance.heard import Heard, Instruction
from dcp_conformance.services import produced

from .vardis_payload import check_filled, check_order_of_queue, stock

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_SUMMARY, _ASK_UPDATE, _ASK_CREATE = ICType.SUMMARIES, ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES


def _counts(bench: Bench) -> list[int]:
    """Different repetition counts, as far as there are any."""
    return [bench.rep_cnt(1), bench.rep_cnt(2), bench.rep_cnt(4)]


@case(
    "TC_VD_CMP_BV_01",
    "Each VarCreate counts down its own variable, among several with different repetition counts",
    requirements="VD-CMP-06 VD-SCP-02",
    stimulus="three variables with repetition counts 1, 2 and 4 are created by one beacon",
    expect="each VarCreate in exactly as many beacons as its repCnt says",
    window=12,
)
def creates_counted(bench: Bench) -> None:
    peer, mark = bench.peer(), bench.mark()
    creates = [peer.create(bench.var_id(), rep_cnt=each) for each in _counts(bench)]
    peer.send(*creates)
    for each in creates:
        bench.check_repeated(_CREATE, each.spec.var_id, each.spec.rep_cnt, mark)


@case(
    "TC_VD_CMP_BV_02",
    "Each VarUpdate counts down its own variable, among several with different repetition counts",
    requirements="VD-CMP-09 VD-SCP-02",
    stimulus="three variables with repetition counts 1, 2 and 4 are updated by one beacon",
    expect="each VarUpdate in exactly as many beacons as the repCnt of its variable says",
    window=12,
)
def updates_counted(bench: Bench) -> None:
    peer = bench.peer()
    creates = [peer.create(bench.var_id(), rep_cnt=each) for each in _counts(bench)]
    bench.learn(peer, *creates)
    mark = bench.mark()
    peer.send(*(peer.update(each.spec.var_id, 1) for each in creates))
    for each in creates:
        bench.check_repeated(_UPDATE, each.spec.var_id, each.spec.rep_cnt, mark)


@case(
    "TC_VD_CMP_BV_03",
    "Each VarDelete counts down its own variable, among several with different repetition counts",
    requirements="VD-CMP-10 VD-SCP-02",
    stimulus="three variables with repetition counts 1, 2 and 4 are deleted by one beacon",
    expect="each VarDelete in exactly as many beacons as the repCnt of its variable says",
    window=12,
)
def deletes_counted(bench: Bench) -> None:
    peer = bench.peer()
    creates = [peer.create(bench.var_id(), rep_cnt=each) for each in _counts(bench)]
    bench.learn(peer, *creates)
    mark = bench.mark()
    peer.send(*(peer.delete(each.spec.var_id) for each in creates))
    for each in creates:
        bench.check_repeated(_DELETE, each.spec.var_id, each.spec.rep_cnt, mark)


@case(
    "TC_VD_CMP_BV_04",
    "What is to be repeated goes back to the tail of its queue: all once before any twice ({variant})",
    requirements="VD-CMP-06 VD-CMP-09",
    stimulus="requests in one beacon for more variables with repCnt 2 than fit into a payload",
    expect="the records in the order of the requests, and then in the same order again",
    window=20,
    needs=Needs(when=lambda bench: None if bench.rep_cnt(2) == 2 else "it accepts no repetition count of 2"),
    variants={"creates": _CREATE, "updates": _UPDATE},
)
def back_to_the_tail(bench: Bench, kind: ICType) -> None:
    peer = bench.peer()
    creates = stock(bench, peer, kind, rep_cnt=2, seqno=9)
    names = [each.spec.var_id for each in creates]
    mark = bench.mark()
    if kind is _CREATE:
        peer.send(*(peer.request_create(each) for each in names))
    else:
        peer.send(*(peer.request_update(each, 8) for each in names))
    bench.until_quiet(lambda heard: heard.instructions(kind), since=mark)
    check_order_of_queue(bench, kind, names * 2, mark, "VD-CMP-06" if kind is _CREATE else "VD-CMP-09")


@case(
    "TC_VD_CMP_BV_05",
    "A VarCreate carries the specification of the creation with the current value and sequence number",
    requirements="VD-CMP-07",
    stimulus="a variable is created and updated twice; then its VarCreate is requested",
    expect="a VarCreate with the second update's value and number, and all else as it was created",
    window=16,
    smoke=True,
)
def current_value(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    create = peer.create(var_id, value=b"first", seqno=3, rep_cnt=bench.rep_cnt(2))
    bench.learn(peer, create)
    updated: list[Instruction] = []
    for number, value in ((4, b"second"), (7, b"the third")):
        mark = bench.mark()
        peer.send(peer.update(var_id, number, value))
        updated = bench.repeated(_UPDATE, var_id, mark)
    mark = bench.mark()
    peer.send(peer.request_create(var_id))
    bench.require(bench.until_instruction(_CREATE, var_id), "a VarCreate of the requested variable", "none")
    found = bench.instructions(_CREATE, var_id, mark)
    record = found[0].record
    value, seqno = record.upd.value, record.upd.seqno
    bench.check(value == bench.value(b"the third"), "the current value", f"{value!r}", frames=found[:1], shown=updated)
    bench.check(seqno == 7, "the current sequence number, 7", f"{seqno}", frames=found[:1], shown=updated)
    bench.check(
        record.spec == create.spec, f"the specification {create.spec}", f"{record.spec}", frames=found[:1], shown=True
    )
    if record.upd.seqno == 7:
        bench.reading("X15", "the current sequence number of the database")


@case(
    "TC_VD_CMP_BV_06",
    "A value that changes between two repetitions of a VarCreate shows in the second",
    requirements="VD-CMP-07",
    stimulus="a variable with many repetitions is created, and updated while its VarCreate is being repeated",
    expect="the VarCreates behind the first VarUpdate have its value and number",
    window=12,
    needs=Needs(when=lambda bench: None if bench.rep_cnt(8) >= 4 else "it accepts no repetition count of 4"),
)
def changes_while_repeated(bench: Bench) -> None:
    peer, var_id, mark = bench.peer(), bench.var_id(), bench.mark()
    peer.send(peer.create(var_id, value=b"old", rep_cnt=bench.rep_cnt(8)))
    bench.require(bench.until_instruction(_CREATE, var_id), "the VarCreate is passed on", "it is not")
    peer.send(peer.update(var_id, 1, b"new"))
    frames = bench.until_quiet(lambda heard: heard.about(_CREATE, var_id) or heard.about(_UPDATE, var_id), since=mark)
    begun = next((place for place, heard in enumerate(frames) if heard.about(_UPDATE, var_id)), None)
    if begun is None:
        bench.inconclusive("the VarUpdate is passed on", "it is not")
    behind = [each for heard in frames[begun:] for each in heard.instructions(_CREATE, var_id)]
    if not behind:
        bench.inconclusive("VarCreates that are still to be repeated", "the VarUpdate came when there were none left")
    stale = [each for each in behind if (each.record.upd.seqno, each.record.upd.value) != (1, bench.value(b"new"))]
    bench.check(
        not stale, "value and number of the update", f"{len(stale)} VarCreates without", frames=stale[:4], shown=True
    )


@case(
    "TC_VD_CMP_BV_07",
    "A VarReqUpdate carries the number that the requester holds, and goes out once",
    requirements="VD-CMP-11",
    stimulus="a variable is created with number 5; then a summary with number 9 that nobody follows up",
    expect="exactly one VarReqUpdate, with number 5",
    window=8,
)
def update_requested_once(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    bench.learn(peer, peer.create(var_id, seqno=5, rep_cnt=bench.rep_cnt(3)))
    mark = bench.mark()
    peer.send(peer.summary(var_id, 9))
    found = bench.check_repeated(_ASK_UPDATE, var_id, 1, mark)
    numbers = [each.record.seqno for each in found]
    bench.check(set(numbers) <= {5}, "its own sequence number, 5", f"{numbers}", frames=found, shown=True)


@case(
    "TC_VD_CMP_BV_08",
    "A VarReqCreate carries the unknown identifier, and goes out once",
    requirements="VD-CMP-12",
    stimulus="a summary of an unknown variable that nobody follows up",
    expect="exactly one VarReqCreate of it",
    window=8,
    smoke=True,
)
def create_requested_once(bench: Bench) -> None:
    peer, var_id, mark = bench.peer(), bench.unknown_id(), bench.mark()
    peer.send(peer.summary(var_id, 9))
    found = bench.check_repeated(_ASK_CREATE, var_id, 1, mark)
    if found:
        bench.reading("X16", "a VarReqCreate has just the identifier")


@case(
    "TC_VD_CMP_BV_09",
    "Requests for many variables go out once each, in one payload if they fit ({variant})",
    requirements="VD-CMP-11 VD-CMP-12 VD-PAY-02",
    stimulus="summaries of twelve variables, {variant}, in one beacon",
    expect="one request for each of them, none twice, and no second payload while the first has room",
    window=10,
    variants={"outdated": _ASK_UPDATE, "unknown": _ASK_CREATE},
)
def many_requests(bench: Bench, kind: ICType) -> None:
    peer, names = bench.peer(), bench.var_ids(12) if kind is _ASK_UPDATE else bench.unknown_ids(12)
    requirement = "VD-CMP-11" if kind is _ASK_UPDATE else "VD-CMP-12"
    if kind is _ASK_UPDATE:
        bench.learn(peer, *(peer.create(each, seqno=number) for number, each in enumerate(names)))
    mark = bench.mark()
    peer.send(*(peer.summary(each, 60) for each in names))
    bench.until_quiet(lambda heard: heard.instructions(kind), since=mark)
    found = [each for each in bench.instructions(kind, since=mark) if each.var_id in names]
    came = [each.var_id for each in found]
    bench.check(
        sorted(came) == sorted(names),
        "one request for each variable",
        f"{len(came)} requests for {len(set(came))} of {len(names)} variables",
        requirement,
        frames=found[:24],
        shown=len(came) > len(set(came)),
    )
    frames = [each for each in bench.heard[mark:] if each.instructions(kind)]
    if frames:
        check_filled(bench, kind, frames, "VD-PAY-02")
    if kind is _ASK_UPDATE:
        wrong = [each for each in found if each.record.seqno != names.index(each.var_id)]
        bench.check(
            not wrong, "the number that it holds", f"{len(wrong)} with another", requirement, frames=wrong, shown=True
        )


@case(
    "TC_VD_CMP_BV_10",
    "After the last VarDelete the variable stays in the database (2.0) or leaves it (before)",
    requirements="VD-CMP-10",
    stimulus="a variable is created and deleted; afterwards a summary and a request name it",
    expect="2.0: no reaction, as it is known and deleted; before: a request, as it is unknown again",
    window=20,
)
def after_the_last_delete(bench: Bench) -> None:
    peer, var_id, repetitions = bench.peer(), bench.var_id(), bench.rep_cnt(2)
    bench.learn(peer, peer.create(var_id, rep_cnt=repetitions))
    mark = bench.mark()
    peer.send(peer.delete(var_id))
    bench.check_repeated(_DELETE, var_id, repetitions, mark)
    mark = bench.mark()
    peer.send(peer.summary(var_id, 1))
    if bench.features.removed_after_deletion:
        found = bench.until_instruction(_ASK_CREATE, var_id)
        bench.check(found, "a request for the variable, which is unknown again", "none")
        return
    peer.send(peer.request_create(var_id))
    bench.require_alive("naming a deleted variable")
    trace = [each for heard in bench.heard[mark:] for each in heard.instructions(None, var_id)]
    kinds = ", ".join(sorted({each.kind.label for each in trace}))
    bench.check(not trace, "no reaction: the variable is known and deleted", kinds, frames=trace[:4], shown=True)


@case(
    "TC_VD_CMP_BV_11",
    "The database shows it: after the last VarDelete the entry is kept (2.0) or gone (before)",
    requirements="VD-CMP-10",
    stimulus="a variable is created and deleted; when its deletion is repeated no more, it is described",
    expect="2.0: VARDIS-STATUS-OK and isDeleted; before: VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST",
    window=20,
    needs=Needs(ut=("RTDB-DescribeVariable",)),
)
def described_after_the_last_delete(bench: Bench) -> None:
    peer, var_id, repetitions = bench.peer(), bench.var_id(), bench.rep_cnt(2)
    bench.learn(peer, peer.create(var_id, rep_cnt=repetitions))
    mark = bench.mark()
    peer.send(peer.delete(var_id))
    if not bench.repeated(_DELETE, var_id, mark):
        bench.inconclusive("the variable is deleted, which this case needs", "there is no VarDelete")
    if bench.features.removed_after_deletion:
        bench.expect_status("VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST", "RTDB-DescribeVariable", varId=var_id)
        return
    answer = bench.expect_status("VARDIS-STATUS-OK", "RTDB-DescribeVariable", varId=var_id)
    described = answer.result.get("variable", {})
    bench.check(described.get("isDeleted") is True, "isDeleted is true", f"{described.get('isDeleted')}", shown=True)
    left = described.get("countDelete")
    bench.check(left == 0, "countDelete is 0 after the last repetition", f"{left}", shown=True)


@case(
    "TC_VD_CMP_BV_13",
    "An update that does not fit behind the other containers waits for the next payload",
    requirements="VD-PAY-02 VD-PAY-06 VD-CMP-09",
    stimulus="requests for so many VarCreates that a payload is full, and for a VarUpdate",
    expect="no payload beyond its maximum, and the VarUpdate exactly as often as its repCnt says",
    window=16,
)
def update_waits(bench: Bench) -> None:
    peer, repetitions = bench.peer(), bench.rep_cnt(2)
    creates = stock(bench, peer, _CREATE)
    waiting = peer.create(bench.var_id(), seqno=9, rep_cnt=repetitions, value=longest(bench)[0])
    bench.learn(peer, waiting)
    mark = bench.mark()
    peer.send(peer.request_update(waiting.spec.var_id, 8), *(peer.request_create(each.spec.var_id) for each in creates))

    def busy(heard: Heard) -> bool:
        return bool(heard.instructions(_CREATE) or heard.instructions(_UPDATE))

    frames = bench.until_quiet(busy, since=mark)
    bench.check_repeated(_UPDATE, waiting.spec.var_id, repetitions, mark, "VD-CMP-09")
    limit = bench.bound(PAYLOAD_SIZE)
    sizes = [len(bench.codec.encode_containers(each.containers)) for each in frames]
    largest = max(sizes, default=0)
    bench.check(
        largest <= limit,
        f"payloads of at most {limit} octets",
        f"{largest}",
        "VD-PAY-02",
        frames=frames[:4],
        shown=True,
    )
    names = [each.spec.var_id for each in creates]
    check_order_of_queue(bench, _CREATE, names, mark, "VD-PAY-06")


@case(
    "TC_VD_CMP_BV_14",
    "A deletion that overtakes pending instructions takes them back ({variant})",
    requirements="VD-PD-04 VD-CMP-05",
    stimulus="while a VarCreate or VarUpdate with many repetitions is being repeated, its variable is deleted",
    expect="behind the first VarDelete neither VarCreate nor VarUpdate nor summary, and exactly repCnt VarDeletes",
    window=24,
    variants={"create": _CREATE, "update": _UPDATE},
)
def deletion_takes_back(bench: Bench, kind: ICType) -> None:
    peer, var_id, repetitions = bench.peer(), bench.var_id(), bench.rep_cnt(6)
    create = peer.create(var_id, rep_cnt=repetitions)
    if kind is _CREATE:
        peer.send(create)
    else:
        bench.learn(peer, create)
        peer.send(peer.update(var_id, 1))
    bench.require(bench.until_instruction(kind, var_id), "the variable is passed on", "it is not", "VD-PD-04")
    mark = bench.mark()
    peer.send(peer.delete(var_id))
    found = bench.check_repeated(_DELETE, var_id, repetitions, mark, "VD-PD-04")
    if not found:
        return
    begun = bench.heard.index(found[0].heard)
    for each, requirement in ((_CREATE, "VD-PD-04"), (_UPDATE, "VD-PD-04"), (_SUMMARY, "VD-CMP-05")):
        late = bench.instructions(each, var_id, begun)
        what = f"no {each.label} record of a deleted variable"
        bench.check(not late, what, f"{len(late)} records", requirement, frames=late[:4], shown=True)


@case(
    "TC_VD_CMP_BV_15",
    "The producer's own deletion is repeated exactly as often as its repCnt says, and the entry is kept",
    requirements="VD-CMP-10",
    stimulus="the application creates and deletes a variable",
    expect="exactly repCnt VarDeletes; the variable can still be described",
    window=16,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Delete", "RTDB-DescribeVariable")),
)
def own_deletion(bench: Bench) -> None:
    repetitions = bench.rep_cnt(3)
    var_id = produced(bench, rep_cnt=repetitions)
    bench.require(bench.until_instruction(_CREATE, var_id), "the VarCreate of the own variable", "none")
    mark = bench.mark()
    bench.must("RTDB-Delete", varId=var_id)
    bench.check_repeated(_DELETE, var_id, repetitions, mark)
    bench.expect_status("VARDIS-STATUS-OK", "RTDB-DescribeVariable", varId=var_id)
