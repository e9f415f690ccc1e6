"""dcp-vardis.md: Queues; Composing the Containers, when more is queued than fits into a payload."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from itertools import cycle, pairwise
from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import FILLS, Needs, Variant, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.suite.vardis.reception.payload import check_filled, check_order_of_queue, size_of
from dcp_conformance.test_steps.full_payloads import require_undisturbed
from dcp_conformance.test_steps.services import listed, produced
from dcp_conformance.test_steps.variable_queries import modulus, teach_variables
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

from .exact_sizes import lower
from .summaries import SUMMARIES, summarises

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_SUMMARY, _ASK_UPDATE, _ASK_CREATE = ICType.SUMMARIES, ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES
#: Variables with queued records, and the records that fit into a payload.
_QUEUED, _FIT = 14, 4
#: The place of the variable that is queued again.
_AGAIN = 2 * _FIT + 2

Stimulus = Callable[[Peer, int], VardisRecord]
_STIMULI: dict[str, tuple[ICType, Stimulus, str]] = {
    "creates": (_CREATE, lambda peer, var_id: peer.request_create(var_id), "VD-CMP-06 VD-RC-03 VD-PC-09"),
    "new-variables": (
        _CREATE,
        lambda peer, var_id: peer.create(var_id, value=b"v", descr=b"d", rep_cnt=2),
        "VD-CMP-06 VD-PC-09 VD-CRE-12",
    ),
    "deletes": (_DELETE, lambda peer, var_id: peer.delete(var_id), "VD-CMP-10 VD-PD-04 VD-CMP-13"),
    "updates": (_UPDATE, lambda peer, var_id: peer.update(var_id, 9, b"w"), "VD-CMP-09 VD-PU-07"),
    "requests": (_ASK_CREATE, lambda peer, var_id: peer.summary(var_id, 9), "VD-CMP-12 VD-PS-01 DATA-12"),
    "update-requests": (_ASK_UPDATE, lambda peer, var_id: peer.summary(var_id, 9), "VD-CMP-11 VD-PS-04"),
}


def _variants(*names: str) -> dict[str, Variant]:
    found = {name: _STIMULI[name] for name in names}
    return {name: Variant(value, requirements=f"{value[2]} VD-PAY-06 VD-PAY-02") for name, value in found.items()}


_SETTABLE = Needs(
    ut=("UT-Reset", "VD-SetParameter"),
    when=lambda bench: bench.sut.lacks("variables", _QUEUED + 1) or None,
)


def _about(kind: ICType, names: Collection[int]) -> Callable[[ReceivedBeacon], bool]:
    """Return whether a beacon has records of a kind about these variables, not those of an application on the node."""
    return lambda heard: any(each.var_id in names for each in heard.instructions(kind))


def _scrambled(names: Sequence[int]) -> list[int]:
    """Return the same identifiers in an order that neither rises nor falls."""
    return [*names[1::2], *reversed(names[::2])]


def _prepared(bench: Bench, peer: Peer, kind: ICType, rep_cnt: int, *, known: bool = True) -> tuple[list[int], int]:
    """Lower the payload size to that of a few records of a kind; return variables that are ``known``, and the size."""
    asked = kind is _ASK_CREATE
    names = _scrambled(bench.identifiers.unknown_ids(_QUEUED) if asked else bench.identifiers.var_ids(_QUEUED))
    if known and not asked:
        # In the order of the identifiers: that of the stimuli is another one.
        bench.learn(
            peer, *(peer.create(each, value=b"v", descr=b"d", seqno=5, rep_cnt=rep_cnt) for each in sorted(names))
        )
    size = bench.builder.record_size(_record(bench, peer, kind))
    return names, lower(bench, _FIT * size, 2)


def _record(bench: Bench, peer: Peer, kind: ICType) -> VardisRecord:
    """Return a record of a kind as long as those of the case."""
    create = bench.records.sample(value=b"v", descr=b"d")
    made: dict[ICType, VardisRecord] = {
        _CREATE: create,
        _UPDATE: create.upd,
        _DELETE: peer.delete(0),
        _ASK_CREATE: peer.request_create(0),
        _ASK_UPDATE: peer.request_update(0, 0),
    }
    return made[kind]


@case(
    "TC_VD_ORD_BV_01",
    "Records that do not fit into a payload follow in the order of their queue, and repetitions after them ({variant})",
    requirements="VD-PAY-06 VD-PAY-02",
    stimulus=(
        f"VARDISPAR_MAX_PAYLOAD_SIZE is lowered to {_FIT} records; one beacon queues records of this kind "
        f"({{variant}}) "
        f"about {_QUEUED} variables, in an order that neither rises nor falls, with repCnt 2; the next beacon queues "
        "one of those again that wait for the third payload, if that is possible"
    ),
    expect="all records in this order, then all again (requests once); full payloads, except for the last",
    window=30,
    needs=_SETTABLE,
    variants=_variants("new-variables", "deletes", "requests"),
)
@case(
    "TC_VD_ORD_BV_03",
    "As TC_VD_ORD_BV_01 for records of known variables ({variant})",
    requirements="VD-PAY-06 VD-PAY-02",
    stimulus="see TC_VD_ORD_BV_01; records of this kind: {variant}",
    expect="all records in the order of the queue, then all again (requests once); full payloads, except for the last",
    window=30,
    needs=_SETTABLE,
    variants=_variants("creates", "updates", "update-requests"),
    long=True,
)
def order_of_queue(bench: Bench, what: tuple[ICType, Stimulus, str]) -> None:
    kind, stimulus, _ = what
    once, new = kind in (_ASK_CREATE, _ASK_UPDATE), what is _STIMULI["new-variables"]
    peer, count = bench.peer(), 1 if once else bench.sut.rep_cnt(2)
    if new and count < 2:
        bench.verdicts.not_applicable("the implementation does not accept repCnt 2")
    names, limit = _prepared(bench, peer, kind, count, known=not new)
    name, start = names[_AGAIN], bench.mark()
    peer.send(*(stimulus(peer, each) for each in names))
    if not new and kind is not _DELETE:
        peer.send(peer.update(name, 10, b"x") if kind is _UPDATE else stimulus(peer, name))
        bench.mark()
        if bench.instructions(kind, name, start):
            bench.inconclusive("a record that waits for the third payload", "it was sent at once")
    frames = bench.until_quiet(_about(kind, names), since=start)
    require_undisturbed(bench, kind, bench.heard[start:])
    check_order_of_queue(bench, kind, names * count, start)
    if kind is _UPDATE:
        numbers = [each.record.seqno for each in bench.instructions(kind, name, start)]
        bench.every(numbers, lambda each: each == 10, "the newest value of the variable", "VD-UPD-10", "VD-PU-07")
    size = bench.builder.record_size(_record(bench, peer, kind))
    room = [each for each in frames[:-1] if size_of(bench, each) + size <= limit]
    bench.none(room, f"payloads without room for another record in {limit} octets", "VD-PAY-02")
    large = [each for each in frames if size_of(bench, each) > limit]
    bench.none(large, f"payloads of at most {limit} octets", "VD-IC-05")


# -- summaries ---------------------------------------------------------------------------------------------------------


@case(
    "TC_VD_ORD_BV_02",
    "A new variable is summarised after all others, and the others keep their turns",
    requirements="VD-CMP-03 VD-CRE-12 VD-PC-09",
    stimulus=(
        "VARDISPAR_MAX_SUMMARIES = 2 with nine variables; a tenth is created; then one of them and an own one are "
        "updated in each of 13 periods, and three of these follow: VarCreate, VarDelete, summaries, "
        "VarReqCreate, VarReqUpdate, RTDB-Create, -Read, -Delete, -DescribeVariable, -DescribeDatabase, VD-SetParameter"
    ),
    expect=(
        "a summary of each of the nine before the first of the tenth; then summaries of the updated variable, and of "
        "all that are not deleted in turn"
    ),
    window=40,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter"), when=summarises),
)
def turn_of_summaries(bench: Bench) -> None:
    peer, names = bench.peer(), bench.identifiers.var_ids(9)
    teach_variables(bench, peer, [peer.create(each, value=b"v", descr=b"d") for each in names])
    served = bench.services.upper.methods
    own = [produced(bench, value=b"v", descr="d") for _ in range(3)] if "RTDB-Create" in served else []
    bench.must("VD-SetParameter", name=SUMMARIES, value=2)
    bench.wait(3)
    new, start = bench.var_id(), bench.mark()
    peer.send(peer.create(new, value=b"v", descr=b"d"))
    bench.until_instruction(_SUMMARY, new, 16)
    order = [each.var_id for each in bench.instructions(_SUMMARY, since=start)]
    bench.some(new in order, "a summary of the new variable", "VD-CMP-03")
    before = order[: order.index(new)] if new in order else order
    bench.complete([each for each in names if each not in before], "a summary of each other variable before")
    start, gone = bench.mark(), [*names[-2:], *own[1:]]
    turns = [each for each in dict.fromkeys(order) if each in {*names, *own} and each not in gone]

    def waiting() -> int:
        """Return a variable that is neither the next to be summarised nor the last one."""
        last = [each.var_id for each in bench.instructions(_SUMMARY) if each.var_id in turns]
        return (
            names[(names.index(last[-1]) + len(names) // 2) % (len(names) - 2)]
            if last and last[-1] in names
            else names[0]
        )

    acts = _acts(bench, peer, waiting, names, own)
    for number in range(len(acts)):
        peer.send(peer.update(names[4], number + 1, b"w"))
        if own and "RTDB-Update" in served:
            bench.call("RTDB-Update", varId=own[0], value="77")
        # Each more than once: a rotation that starts again does not show if it was at its start.
        for ago in (0, 4, 7):
            acts[number - ago]()
        bench.beacons(1, 1.5)
    found = bench.instructions(_SUMMARY, since=start)
    updated = [each for each in found if each.var_id == names[4]]
    bench.some(updated, "a summary of the variable that is updated", "VD-CMP-03", frames=updated[:2])
    # In a rotating queue each variable has its turn after the same other one.
    places = [turns.index(each.var_id) for each in found if each.var_id in turns]
    wrong = [turns[place] for last, place in pairwise(places) if place != (last + 1) % len(turns)]
    bench.complete(wrong, "summaries of the variables in turn", "VD-CMP-03", frames=found[:8])


def _acts(
    bench: Bench, peer: Peer, waiting: Callable[[], int], names: list[int], own: list[int]
) -> list[Callable[[], object]]:
    """Return events that do not change the order of the summaries: up to 13, or 8 without services.

    ``waiting`` returns a variable to be affected. The last two of ``names`` and of ``own`` are deleted, and others are
    created.
    """
    deleted, removed = cycle(names[-2:]), cycle(own[-2:])
    records = [
        lambda: peer.create(bench.var_id(), value=b"v", descr=b"d"),
        lambda: peer.delete(next(deleted)),
        lambda: peer.summary(waiting(), 1),
        lambda: peer.summary(waiting(), modulus(bench) - 1),
        lambda: peer.summary(waiting(), 0),
        lambda: peer.request_create(waiting()),
        lambda: peer.request_update(waiting(), modulus(bench) - 1),
    ]
    acts: list[Callable[[], object]] = [lambda make=make: peer.send(make()) for make in records]  # type: ignore[misc]
    acts.append(lambda: bench.must("VD-SetParameter", name=SUMMARIES, value=2))
    if own:
        calls: dict[str, Callable[[], dict[str, Any]]] = {
            "RTDB-Read": lambda: {"varId": own[0]},
            "RTDB-DescribeVariable": lambda: {"varId": names[0]},
            "RTDB-DescribeDatabase": dict,
            "RTDB-Delete": lambda: {"varId": next(removed)},
        }
        served = [each for each in calls if each in bench.services.upper.methods]
        acts += [lambda each=each: bench.call(each, **calls[each]()) for each in served]  # type: ignore[misc]
        acts.append(lambda: produced(bench, value=b"v", descr="d"))
    return acts


# -- many records ------------------------------------------------------------------------------------------------------


def _holds(count: int) -> Callable[[Bench], str | None]:
    return lambda bench: bench.sut.lacks("variables", count) or None


_MANY: dict[str, tuple[ICType, int, Stimulus, str]] = {
    "requests": (_ASK_CREATE, 200, lambda peer, var_id: peer.summary(var_id, 9), "VD-CMP-12 VD-PS-01"),
    "deletes": (_DELETE, 40, lambda peer, var_id: peer.delete(var_id), "VD-CMP-10"),
}


@case(
    "TC_VD_PAY_BV_11",
    "A payload has as many records as fit, also 40 or 200 ({variant})",
    requirements="VD-PAY-02",
    stimulus="one beacon queues records of this kind ({variant}) about 200 unknown or 40 known variables",
    expect="records about all of them, in payloads that are full, except for the last",
    window=30,
    variants={
        name: Variant(
            value,
            requirements=f"VD-PAY-02 {value[3]}",
            needs=Needs(ut=("UT-Reset",), when=_holds(value[1])),
        )
        for name, value in _MANY.items()
    },
)
def many_records(bench: Bench, what: tuple[ICType, int, Stimulus, str]) -> None:
    kind, count, stimulus, _ = what
    # Frees the identifiers, also for another execution of this case.
    bench.must("UT-Reset")
    peer = bench.peer()
    names = bench.identifiers.unknown_ids(count) if kind is _ASK_CREATE else bench.identifiers.var_ids(count)
    if kind is not _ASK_CREATE:
        teach_variables(bench, peer, [peer.create(each, value=b"v", descr=b"d", seqno=5) for each in names])
    start = peer.stimulate(*(stimulus(peer, each) for each in names))
    frames = bench.until_quiet(_about(kind, names), since=start)
    found = [each for each in bench.instructions(kind, since=start) if each.var_id in names]
    # An application on the node may have created one of them.
    known = {each.var_id for each in bench.instructions(_SUMMARY)} if kind is _ASK_CREATE else set[int]()
    missing = set(names) - known - {each.var_id for each in found}
    bench.complete(sorted(missing), f"{kind.label} records about all {count} variables", frames=found[:8])
    if frames:
        check_filled(bench, kind, frames, "VD-PAY-02")


@case(
    "TC_VD_PAY_BV_12",
    "Records of different kinds that are queued at the same time share a payload",
    requirements="VD-PAY-02 VD-PAY-01",
    stimulus=(
        "one beacon that creates, deletes and updates a variable each, and summarises an unknown variable and a newer "
        "value; up to three times"
    ),
    expect="in one of the attempts the first payload with one of the five kinds of records has all of them",
    window=16,
    alone=FILLS,
)
def all_kinds_together(bench: Bench) -> None:
    kinds, counts = {_CREATE, _DELETE, _UPDATE, _ASK_CREATE, _ASK_UPDATE}, list[int]()
    for _ in range(3):
        peer, (gone, updated, behind) = bench.peer(), bench.identifiers.var_ids(3)
        known = [peer.create(each, value=b"v", descr=b"d", seqno=5) for each in (gone, updated, behind)]
        bench.learn(peer, *known)
        start, new, unknown = bench.mark(), bench.var_id(), bench.unknown_id()
        summaries = peer.summary(behind, 9), peer.summary(unknown, 9)
        create = peer.create(new, value=b"v", descr=b"d")
        peer.send(create, peer.delete(gone), peer.update(updated, 9, b"w"), *summaries)
        names = (new, gone, updated, behind, unknown)
        bench.until_instruction(_ASK_CREATE, unknown)
        bench.beacons(1, 1.5)
        found = [
            {each.kind for each in heard.instructions() if each.var_id in names} & kinds
            for heard in bench.heard[start:]
        ]
        counts.append(len(next(filter(None, found), ())))
        if counts[-1] == len(kinds):
            break
    expected = "all five kinds of records in the first payload of an attempt"
    bench.some(max(counts) == len(kinds), expected, seen=f"{counts} kinds")


@case(
    "TC_VD_DDB_BV_04",
    "RTDB-DescribeDatabase returns all variables, also if there are 104",
    requirements="VD-DDB-02",
    stimulus="VarCreates of 104 variables",
    expect="all variables in the answer",
    window=20,
    needs=Needs(
        SpecVersion.V1_0,
        ut=("RTDB-DescribeDatabase", "UT-Reset"),
        when=_holds(104),
    ),
)
def many_described(bench: Bench) -> None:
    bench.must("UT-Reset")
    peer, names = bench.peer(), bench.identifiers.var_ids(104)
    teach_variables(bench, peer, [peer.create(each, value=b"v", descr=b"d") for each in names])
    found = listed(bench)
    bench.none([each for each in names if each not in found], "all 104 variables in the answer")
