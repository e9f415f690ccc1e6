"""dcp-vardis.md: Composing the Containers.

In these cases the implementation is a consumer: it composes repetitions and answers.
"""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import FILLS, Needs, case
from dcp_conformance.frames.received import Instruction
from dcp_conformance.suite.vardis.reception.payload import check_filled, check_order_of_queue, stock
from dcp_conformance.test_steps.full_payloads import PAYLOAD_SIZE, longest
from dcp_conformance.test_steps.services import produced
from dcp_conformance.test_system.bench import Bench

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_SUMMARY, _ASK_UPDATE, _ASK_CREATE = ICType.SUMMARIES, ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES


def _counts(bench: Bench) -> list[int]:
    """Return different repetition counts, as far as the implementation accepts them."""
    return [bench.sut.rep_cnt(1), bench.sut.rep_cnt(2), bench.sut.rep_cnt(4)]


@case(
    "TC_VD_CMP_BV_01",
    "Each VarCreate is repeated according to the repCnt of its own variable",
    requirements="VD-CMP-06 VD-SCP-02",
    alone=FILLS,
    stimulus="one beacon creates three variables with repCnt 1, 2 and 4",
    expect="each VarCreate in exactly repCnt beacons",
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
    "Each VarUpdate is repeated according to the repCnt of its own variable",
    requirements="VD-CMP-09 VD-SCP-02",
    alone=FILLS,
    stimulus="one beacon updates three variables with repCnt 1, 2 and 4",
    expect="each VarUpdate in exactly repCnt beacons",
    window=12,
    value=_UPDATE,
)
@case(
    "TC_VD_CMP_BV_03",
    "Each VarDelete is repeated according to the repCnt of its own variable",
    requirements="VD-CMP-10 VD-SCP-02",
    stimulus="one beacon deletes three variables with repCnt 1, 2 and 4",
    expect="each VarDelete in exactly repCnt beacons",
    window=12,
    value=_DELETE,
)
def changes_counted(bench: Bench, kind: ICType) -> None:
    peer = bench.peer()
    creates = [peer.create(bench.var_id(), rep_cnt=each) for each in _counts(bench)]
    bench.learn(peer, *creates)
    names = [each.spec.var_id for each in creates]
    mark = peer.stimulate(*(peer.update(each, 1) if kind is _UPDATE else peer.delete(each) for each in names))
    for each in creates:
        bench.check_repeated(kind, each.spec.var_id, each.spec.rep_cnt, mark)


@case(
    "TC_VD_CMP_BV_04",
    ("A record to be repeated returns to the tail of its queue: all are sent once before any is repeated ({variant})"),
    requirements="VD-CMP-06 VD-CMP-09",
    alone=FILLS,
    stimulus="in one beacon, requests for more variables with repCnt 2 than fit into a payload",
    expect="the records in the order of the requests, then all of them again in the same order",
    window=20,
    needs=Needs(
        when=lambda bench: None if bench.sut.rep_cnt(2) == 2 else "the implementation does not accept repCnt 2"
    ),
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
    "A VarCreate has the specification of the creation and the current value and sequence number",
    requirements="VD-CMP-07",
    stimulus="a variable is created and updated twice; then a peer requests its VarCreate",
    expect="a VarCreate with the value and sequence number of the second update, otherwise as created",
    window=16,
)
def current_value(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    create = bench.learnt(peer, var_id, value=b"first", seqno=3, rep_cnt=bench.sut.rep_cnt(2))
    updated: list[Instruction] = []
    for number, value in ((4, b"second"), (7, b"the third")):
        mark = peer.stimulate(peer.update(var_id, number, value))
        updated = bench.waiting.repeated(_UPDATE, var_id, mark)
    mark = peer.stimulate(peer.request_create(var_id))
    bench.required(bench.until_instruction(_CREATE, var_id), "a VarCreate of the requested variable")
    found = bench.instructions(_CREATE, var_id, mark)
    record = found[0].record
    value, seqno = record.upd.value, record.upd.seqno
    bench.equal(value, bench.records.value(b"the third"), "the current value", frames=found[:1], given=updated)
    bench.equal(seqno, 7, "the current sequence number", frames=found[:1], given=updated)
    bench.answered(record.spec, create.spec, "the specification", frames=found[:1])
    if record.upd.seqno == 7:
        bench.reading("X15", "the current sequence number of the database")


@case(
    "TC_VD_CMP_BV_06",
    "A value that changes between two repetitions of a VarCreate is in the later one",
    requirements="VD-CMP-07",
    alone=FILLS,
    stimulus="a variable with many repetitions is created and, while its VarCreate is being repeated, updated",
    expect="the VarCreates after the first VarUpdate have its value and sequence number",
    window=12,
    needs=Needs(
        when=lambda bench: None if bench.sut.rep_cnt(8) >= 4 else "the implementation does not accept repCnt 4"
    ),
)
def changes_while_repeated(bench: Bench) -> None:
    peer, var_id, mark = bench.peer(), bench.var_id(), bench.mark()
    peer.send(peer.create(var_id, value=b"old", rep_cnt=bench.sut.rep_cnt(8)))
    bench.required(bench.until_instruction(_CREATE, var_id), "the VarCreate is forwarded")
    peer.send(peer.update(var_id, 1, b"new"))
    frames = bench.until_quiet(lambda heard: heard.about(_CREATE, var_id) or heard.about(_UPDATE, var_id), since=mark)
    begun = next((place for place, heard in enumerate(frames) if heard.about(_UPDATE, var_id)), None)
    if begun is None:
        bench.inconclusive("the VarUpdate is forwarded", "not forwarded in time")
    behind = [each for heard in frames[begun:] for each in heard.instructions(_CREATE, var_id)]
    if not behind:
        bench.inconclusive("VarCreates with repetitions left when the VarUpdate is sent", "none left")
    bench.every(
        behind,
        lambda each: (each.record.upd.seqno, each.record.upd.value) == (1, bench.records.value(b"new")),
        "value and sequence number of the update in all VarCreates after it",
    )


@case(
    "TC_VD_CMP_BV_07",
    "A VarReqUpdate has the requester's own sequence number and is sent once",
    requirements="VD-CMP-11",
    stimulus="a variable is created with sequence number 5; then one summary with 9",
    expect="exactly one VarReqUpdate, with sequence number 5",
    window=8,
)
def update_requested_once(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    bench.learn(peer, peer.create(var_id, seqno=5, rep_cnt=bench.sut.rep_cnt(3)))
    mark = peer.stimulate(peer.summary(var_id, 9))
    found = bench.check_repeated(_ASK_UPDATE, var_id, 1, mark)
    numbers = [each.record.seqno for each in found]
    bench.proved(set(numbers) <= {5}, "its own sequence number, 5", numbers, frames=found)


@case(
    "TC_VD_CMP_BV_08",
    "A VarReqCreate has the unknown identifier and is sent once",
    requirements="VD-CMP-12",
    stimulus="one summary of an unknown variable",
    expect="exactly one VarReqCreate for it",
    window=8,
)
def create_requested_once(bench: Bench) -> None:
    peer, var_id, mark = bench.peer(), bench.unknown_id(), bench.mark()
    peer.send(peer.summary(var_id, 9))
    found = bench.check_repeated(_ASK_CREATE, var_id, 1, mark)
    if found:
        bench.reading("X16", "a VarReqCreate has only the identifier")


@case(
    "TC_VD_CMP_BV_09",
    "Requests for many variables are sent once each, in one payload if they fit ({variant})",
    requirements="VD-CMP-11 VD-CMP-12 VD-PAY-02",
    alone=FILLS,
    stimulus="summaries of twelve variables in one beacon ({variant})",
    expect="one request for each of them, and no second payload while the first has room",
    window=10,
    variants={"outdated": _ASK_UPDATE, "unknown": _ASK_CREATE},
)
def many_requests(bench: Bench, kind: ICType) -> None:
    peer, names = (
        bench.peer(),
        bench.identifiers.var_ids(12) if kind is _ASK_UPDATE else bench.identifiers.unknown_ids(12),
    )
    requirement = "VD-CMP-11" if kind is _ASK_UPDATE else "VD-CMP-12"
    if kind is _ASK_UPDATE:
        bench.learn(peer, *(peer.create(each, seqno=number) for number, each in enumerate(names)))
    mark = peer.stimulate(*(peer.summary(each, 60) for each in names))
    bench.until_quiet(lambda heard: heard.instructions(kind), since=mark)
    found = [each for each in bench.instructions(kind, since=mark) if each.var_id in names]
    bench.only([each.var_id for each in found], names, "one request for each variable", requirement, frames=found)
    frames = [each for each in bench.heard[mark:] if each.instructions(kind)]
    if frames:
        check_filled(bench, kind, frames, "VD-PAY-02")
    if kind is _ASK_UPDATE:
        bench.every(
            found,
            lambda each: each.record.seqno == names.index(each.var_id),
            "its own sequence number in each request",
            requirement,
        )


@case(
    "TC_VD_CMP_BV_10",
    "After the last VarDelete the variable stays in the database (2.0) or is removed (before 2.0)",
    requirements="VD-CMP-10",
    stimulus="a variable is created and deleted; afterwards a peer sends a summary and a request for it",
    expect="2.0: no reaction, because it is known and deleted; before 2.0: a request, because it is unknown again",
    window=20,
)
def after_the_last_delete(bench: Bench) -> None:
    peer, var_id, repetitions = bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(peer, peer.create(var_id, rep_cnt=repetitions))
    mark = peer.stimulate(peer.delete(var_id))
    bench.check_repeated(_DELETE, var_id, repetitions, mark)
    mark = peer.stimulate(peer.summary(var_id, 1))
    if bench.features.removed_after_deletion:
        bench.some(bench.until_instruction(_ASK_CREATE, var_id), "a request for the variable, which is unknown again")
        return
    peer.send(peer.request_create(var_id))
    bench.require_alive("records about a deleted variable")
    trace = [each for heard in bench.heard[mark:] for each in heard.instructions(None, var_id)]
    kinds = ", ".join(sorted({each.kind.label for each in trace}))
    bench.none(trace, "no reaction: the variable is known and deleted", seen=kinds)


@case(
    "TC_VD_CMP_BV_11",
    "After the last VarDelete, RTDB-DescribeVariable finds the entry (2.0) or does not (before 2.0)",
    requirements="VD-CMP-10",
    stimulus="a variable is created and deleted; RTDB-DescribeVariable after the last repetition of the VarDelete",
    expect="2.0: VARDIS-STATUS-OK and isDeleted; before 2.0: VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST",
    window=20,
    needs=Needs(ut=("RTDB-DescribeVariable",)),
)
def described_after_the_last_delete(bench: Bench) -> None:
    peer, var_id, repetitions = bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(peer, peer.create(var_id, rep_cnt=repetitions))
    mark = peer.stimulate(peer.delete(var_id))
    bench.needed(bench.waiting.repeated(_DELETE, var_id, mark), "a VarDelete of the variable, which this case needs")
    if bench.features.removed_after_deletion:
        bench.expect_status("VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST", "RTDB-DescribeVariable", varId=var_id)
        return
    answer = bench.expect_status("VARDIS-STATUS-OK", "RTDB-DescribeVariable", varId=var_id)
    described = answer.result.get("variable", {})
    bench.answered(described.get("isDeleted"), True, "isDeleted")
    bench.answered(described.get("countDelete"), 0, "countDelete after the last repetition")


@case(
    "TC_VD_CMP_BV_13",
    "An update that does not fit after the other containers is sent in the next payload",
    requirements="VD-PAY-02 VD-PAY-06 VD-CMP-09",
    alone=FILLS,
    stimulus="requests for as many VarCreates as fill a payload, and for a VarUpdate",
    expect="no payload larger than its maximum, and the VarUpdate in exactly repCnt beacons",
    window=16,
)
def update_waits(bench: Bench) -> None:
    peer, repetitions = bench.peer(), bench.sut.rep_cnt(2)
    creates = stock(bench, peer, _CREATE)
    waiting = bench.learnt(peer, bench.var_id(), seqno=9, rep_cnt=repetitions, value=longest(bench)[0])
    mark = bench.mark()
    peer.send(peer.request_update(waiting.spec.var_id, 8), *(peer.request_create(each.spec.var_id) for each in creates))
    frames = bench.until_quiet(lambda heard: heard.instructions(_CREATE) or heard.instructions(_UPDATE), since=mark)
    bench.check_repeated(_UPDATE, waiting.spec.var_id, repetitions, mark, "VD-CMP-09")
    limit = bench.sut.bound(PAYLOAD_SIZE)
    largest = max([len(bench.codec.encode_containers(each.containers)) for each in frames], default=0)
    bench.proved(largest <= limit, f"payloads of at most {limit} octets", largest, "VD-PAY-02", frames=frames[:4])
    check_order_of_queue(bench, _CREATE, [each.spec.var_id for each in creates], mark, "VD-PAY-06")


@case(
    "TC_VD_CMP_BV_14",
    "A deletion cancels pending instructions of its variable ({variant})",
    requirements="VD-PD-04 VD-CMP-05",
    alone=FILLS,
    stimulus="a variable is deleted while its VarCreate or VarUpdate is being repeated many times",
    expect="after the first VarDelete no VarCreate, VarUpdate or summary; exactly repCnt VarDeletes",
    window=24,
    variants={"create": _CREATE, "update": _UPDATE},
)
def deletion_cancels(bench: Bench, kind: ICType) -> None:
    peer, var_id, repetitions = bench.peer(), bench.var_id(), bench.sut.rep_cnt(6)
    create = peer.create(var_id, rep_cnt=repetitions)
    if kind is _CREATE:
        peer.send(create)
    else:
        bench.learn(peer, create)
        peer.send(peer.update(var_id, 1))
    bench.required(bench.until_instruction(kind, var_id), "a record of the variable", "VD-PD-04")
    mark = peer.stimulate(peer.delete(var_id))
    found = bench.check_repeated(_DELETE, var_id, repetitions, mark, "VD-PD-04")
    if not found:
        return
    begun = bench.heard.index(found[0].heard)
    for each, requirement in ((_CREATE, "VD-PD-04"), (_UPDATE, "VD-PD-04"), (_SUMMARY, "VD-CMP-05")):
        late = bench.instructions(each, var_id, begun)
        bench.none(late, f"no {each.label} record of the deleted variable", requirement)


@case(
    "TC_VD_CMP_BV_15",
    "The producer repeats its own VarDelete exactly repCnt times and keeps the database entry",
    requirements="VD-CMP-10",
    alone=FILLS,
    stimulus="the application creates and deletes a variable",
    expect="exactly repCnt VarDeletes; RTDB-DescribeVariable still finds the variable",
    window=16,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Delete", "RTDB-DescribeVariable")),
)
def own_deletion(bench: Bench) -> None:
    repetitions = bench.sut.rep_cnt(3)
    var_id = produced(bench, rep_cnt=repetitions)
    bench.required(bench.until_instruction(_CREATE, var_id), "the VarCreate of the node's own variable")
    mark = bench.mark()
    bench.must("RTDB-Delete", varId=var_id)
    bench.check_repeated(_DELETE, var_id, repetitions, mark)
    bench.expect_status("VARDIS-STATUS-OK", "RTDB-DescribeVariable", varId=var_id)
