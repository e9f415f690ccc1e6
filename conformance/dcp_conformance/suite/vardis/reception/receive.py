"""dcp-vardis.md: Receive Path, Processing Order of Instruction Containers."""

from __future__ import annotations

import itertools
from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.received import var_id_of
from dcp_conformance.test_steps.services import entry_of, max_repetitions, settled, teach_variable
from dcp_conformance.test_steps.variable_queries import ask, check_stored, modulus, stepped, teach_variables, traces
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_SEVERAL = Needs(since=SpecVersion.V1_1)
_RC, _RU = ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES


def _stored(bench: Bench, var_id: int, seqno: int, value: bytes, came: object, *requirements: str) -> None:
    """Check the stored sequence number and value of a variable."""
    what = f"stored sequence number and value of variable {var_id}"
    check_stored(bench, ask(bench, var_id), seqno, value, what, *requirements, given=came)


def _not_requested(bench: Bench, var_id: int, since: int, kinds: tuple[ICType, ...], *requirements: str) -> None:
    bench.excuses.relies_on("VarCreate")
    found = traces(bench, var_id, since, kinds)
    # An implementation that lost a container has a reason to send a request.
    bench.none(found, f"no request for variable {var_id}", *requirements, given=not bench.session.known.lost_container)


@case(
    "TC_VD_RX_BV_01",
    "All records of a payload are extracted before any of them is processed",
    requirements="VD-RX-01",
    stimulus="a payload with the VarUpdate of an unknown variable before its VarCreate",
    expect="both records are applied, and there is no request for the variable",
)
def two_phases(bench: Bench) -> None:
    peer, var_id, since = bench.peer(), bench.var_id(), bench.mark()
    peer.send(peer.update(var_id, 1, b"newer"), peer.create(var_id, value=b"first"))
    came = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    _stored(bench, var_id, 1, b"newer", came)
    _not_requested(bench, var_id, since, (_RC, _RU))


# -- order of containers -----------------------------------------------------------------------------------------------


@case(
    "TC_VD_RX_BV_02",
    "The order of containers in a payload does not affect the result",
    requirements="VD-RX-02 VD-RX-08",
    stimulus=(
        "payloads with a VarCreate, a newer VarUpdate of the same variable, and summaries of it (with the number "
        "of the update) and of an unknown variable; the containers in every order"
    ),
    expect=(
        "for every order, the variable is stored with the update, and the unknown variable is the only one requested"
    ),
    window=8,
)
def permutations(bench: Bench) -> None:
    peer = bench.peer()
    orders = list(itertools.permutations(range(3)))
    created, unknown, since = (
        bench.identifiers.var_ids(len(orders)),
        bench.identifiers.unknown_ids(len(orders)),
        bench.mark(),
    )
    for order, var_id, other in zip(orders, created, unknown, strict=True):
        containers = [
            bench.builder.container(peer.create(var_id, value=b"first")),
            bench.builder.container(peer.update(var_id, 1, b"newer")),
            bench.builder.container(peer.summary(var_id, 1), peer.summary(other, 1)),
        ]
        peer.send(*(containers[index] for index in order))
    names = ("CREATE-VARIABLES", "UPDATES", "SUMMARIES")
    bench.until(lambda heard: set(unknown) <= {each.var_id for each in heard.instructions(_RC)})
    for order, var_id, other in zip(orders, created, unknown, strict=True):
        what = " before ".join(names[index] for index in order)
        found = [each.record.upd for each in bench.waiting.repeated(ICType.CREATE_VARIABLES, var_id, since)]
        newest = (found[-1].seqno, found[-1].value) if found else None
        applied = bench.equal(newest, (1, bench.records.value(b"newer")), f"{what}: the last VarCreate", "VD-RX-02")
        came = bench.instructions(_RC, other, since)
        bench.repeated(came, 1, f"{what}: requests for the unknown variable", "VD-RX-02")
        # An implementation that lost the VarCreate has a reason to send a request.
        if applied:
            _not_requested(bench, var_id, since, (_RC, _RU), "VD-RX-08")


_Stimulus = Callable[[Peer, int], VardisRecord]


@case(
    "TC_VD_RX_BV_03",
    "Containers of all six types in one payload are processed, whatever their order ({variant})",
    requirements="VD-RX-02",
    stimulus="a payload with one container of each type, in an order rotated by {variant}",
    expect=(
        "a forwarded VarCreate and VarUpdate, a VarDelete, a VarReqCreate and a VarReqUpdate, and the answers to "
        "both requests"
    ),
    window=6,
    variants={str(turn): turn for turn in range(6)} | {f"{turn}-reversed": turn + 6 for turn in range(6)},
)
def all_types(bench: Bench, turn: int) -> None:
    peer = bench.peer()
    known = [peer.create(var_id, seqno=5) for var_id in bench.identifiers.var_ids(5)]
    teach_variables(bench, peer, known)
    doomed, updated, behind, asked, lagging = (create.spec.var_id for create in known)
    fresh, unknown = bench.var_id(), bench.unknown_id()
    containers = [
        bench.builder.container(peer.create(fresh)),
        bench.builder.container(peer.delete(doomed)),
        bench.builder.container(peer.update(updated, 6)),
        bench.builder.container(peer.summary(unknown, 1), peer.summary(lagging, 6)),
        bench.builder.container(peer.request_update(behind, 4)),
        bench.builder.container(peer.request_create(asked)),
    ]
    containers = containers[turn % 6 :] + containers[: turn % 6]
    since = peer.stimulate(*(containers if turn < 6 else containers[::-1]))
    expected = {
        (ICType.CREATE_VARIABLES, fresh): "the VarCreate is forwarded",
        (ICType.DELETE_VARIABLES, doomed): "the VarDelete is forwarded",
        (ICType.UPDATES, updated): "the VarUpdate is forwarded",
        (_RC, unknown): "a VarReqCreate in response to the summary of an unknown variable",
        (_RU, lagging): "a VarReqUpdate in response to the newer summary",
        (ICType.UPDATES, behind): "a VarUpdate in response to the VarReqUpdate",
        (ICType.CREATE_VARIABLES, asked): "a VarCreate in response to the VarReqCreate",
    }

    def missing() -> list[str]:
        return [what for (kind, var_id), what in expected.items() if not bench.instructions(kind, var_id, since)]

    bench.until(lambda _: not missing(), bench.teaching.periods(len(expected)))
    left = missing()
    for what in expected.values():
        bench.some(what not in left, what)


_PLACES = ("the first", "the second", "the third")
_TWO: dict[str, tuple[ICType, _Stimulus, ICType]] = {
    "create": (ICType.CREATE_VARIABLES, lambda peer, var_id: peer.create(var_id), ICType.CREATE_VARIABLES),
    "delete": (ICType.DELETE_VARIABLES, lambda peer, var_id: peer.delete(var_id), ICType.DELETE_VARIABLES),
    "update": (ICType.UPDATES, lambda peer, var_id: peer.update(var_id, 6), ICType.UPDATES),
    "summary": (ICType.SUMMARIES, lambda peer, var_id: peer.summary(var_id, 6), _RU),
    "request-update": (_RU, lambda peer, var_id: peer.request_update(var_id, 4), ICType.UPDATES),
    "request-create": (_RC, lambda peer, var_id: peer.request_create(var_id), ICType.CREATE_VARIABLES),
}


@case(
    "TC_VD_RX_BV_04",
    "Two containers of the same type in a payload are both processed ({variant})",
    requirements="VD-RX-03",
    stimulus="a payload with two containers of this type, the first with two records, the second with one",
    expect="the effects of all three records",
    needs=_SEVERAL,
    variants=_TWO,
)
def same_type_twice(bench: Bench, what: tuple[ICType, _Stimulus, ICType]) -> None:
    kind, make, answer = what
    peer, ids = bench.peer(), bench.identifiers.var_ids(3)
    if kind is not ICType.CREATE_VARIABLES:
        teach_variables(bench, peer, [peer.create(var_id, seqno=5) for var_id in ids])
    one, two, three = (make(peer, var_id) for var_id in ids)
    since = peer.stimulate(bench.builder.container(one, two), bench.builder.container(three))
    bench.until(lambda _: all(bench.instructions(answer, var_id, since) for var_id in ids), bench.teaching.periods(6))
    missing = [number for number, var_id in enumerate(ids, 1) if not bench.instructions(answer, var_id, since)]
    bench.complete(missing, f"effects of three {kind.label} records in two containers")


# -- order of processing -----------------------------------------------------------------------------------------------

_ORDERS = {"in-order": False, "reversed": True}


def _send(bench: Bench, peer: Peer, records: tuple[VardisRecord, ...], reverse: bool) -> int:
    containers = [bench.builder.container(each) for each in records]
    return peer.stimulate(*(reversed(containers) if reverse else containers))


def require_both_taken(bench: Bench, peer: Peer, reverse: bool) -> None:
    """Fail and stop the case unless a VarCreate and a VarDelete of two variables in one payload are both processed.

    For two variables their order does not matter, so an implementation that loses the second container is not reported
    for a wrong order of processing.
    """
    doomed = teach_variable(bench, peer)
    _send(bench, peer, (peer.create(bench.var_id()), peer.delete(doomed)), reverse)
    came = bench.until_instruction(ICType.DELETE_VARIABLES, doomed)
    what = "a VarDelete is processed that is in one payload with the VarCreate of another variable"
    bench.required(came, what, "VD-RX-04", seen="no VarDelete in time")


@case(
    "TC_VD_RX_BV_05",
    "VarCreates are processed before VarDeletes (containers {variant})",
    requirements="VD-RX-08 VD-RX-04",
    stimulus="a payload with a VarCreate and a VarDelete of two variables, then one with both of an unknown variable",
    expect="the variable is deleted: a VarDelete, no VarCreate and no summary",
    variants=_ORDERS,
)
def create_before_delete(bench: Bench, reverse: bool) -> None:
    peer = bench.peer()
    require_both_taken(bench, peer, reverse)
    var_id = bench.var_id()
    since = _send(bench, peer, (peer.create(var_id), peer.delete(var_id)), reverse)
    bench.until_instruction(ICType.DELETE_VARIABLES, var_id)
    bench.check_repeated(ICType.DELETE_VARIABLES, var_id, 1, since, "VD-RX-08")
    found = traces(bench, var_id, since, (ICType.CREATE_VARIABLES, ICType.SUMMARIES, _RC))
    bench.none(found, "no other record of the variable", "VD-RX-08")


@case(
    "TC_VD_RX_BV_06",
    "VarDeletes are processed before VarUpdates, which then have no effect (containers {variant})",
    requirements="VD-RX-08 VD-PD-04 VD-RX-04",
    stimulus="a payload with a VarDelete and a newer VarUpdate of a known variable",
    expect=(
        "the variable is deleted; the update is not forwarded, and not stored (if RTDB-DescribeVariable is available)"
    ),
    variants=_ORDERS,
)
def delete_before_update(bench: Bench, reverse: bool) -> None:
    peer = bench.peer()
    # Up to 1.3 RTDB-DescribeVariable finds a deleted variable only while its deletion is being repeated.
    count = min(3, max_repetitions(bench)) if bench.features.removed_after_deletion else 1
    var_id = teach_variable(bench, peer, rep_cnt=count)
    if count > 1:
        settled(bench, var_id)
    since = _send(bench, peer, (peer.delete(var_id), peer.update(var_id, 1)), reverse)
    bench.until_instruction(ICType.DELETE_VARIABLES, var_id)
    describes = bench.services.offers("RTDB-DescribeVariable")
    entry = entry_of(bench, var_id) if describes else None
    deleted = bench.check_repeated(ICType.DELETE_VARIABLES, var_id, count, since, "VD-PD-04", absent="VD-RX-04")
    if not deleted:
        return
    found = traces(bench, var_id, since, (ICType.CREATE_VARIABLES, ICType.UPDATES, _RC, _RU))
    bench.none(found, "no other record of the variable", "VD-PD-04")
    # The beacons are the same for both orders of processing; only the database shows the difference.
    if entry is not None or (describes and not bench.features.removed_after_deletion):
        entry = entry or {}
        bench.answered(entry.get("seqno"), 0, "seqno, as the update is not stored", "VD-RX-08")


@case(
    "TC_VD_RX_BV_07",
    ("A summary with the sequence number of an update in the same payload causes no request (containers {variant})"),
    requirements="VD-PU-08 VD-PS-02",
    stimulus="a payload with a newer VarUpdate and a summary with the same sequence number",
    expect="the update is stored, and there is no request",
    variants=_ORDERS,
)
def summary_of_update(bench: Bench, reverse: bool) -> None:
    peer = bench.peer()
    _require_both(bench, peer, reverse)
    var_id = teach_variable(bench, peer)
    since = _send(bench, peer, (peer.update(var_id, 1, b"newer"), peer.summary(var_id, 1)), reverse)
    came = bench.until_instruction(ICType.UPDATES, var_id)
    bench.equal(came and came.seqno, 1, "sequence number of the forwarded update")
    bench.require_alive("the payload")
    _not_requested(bench, var_id, since, (_RU,))


def _require_all(bench: Bench, peer: Peer, reverse: bool, *stimuli: tuple[VardisRecord, ICType]) -> None:
    """Stop as inconclusive unless all containers of a payload with these records are processed.

    ``stimuli``: records of different variables, each with the type of the reaction to it. If an implementation loses
    one of the containers (VD-RX-04), their order cannot be tested.
    """
    since = _send(bench, peer, tuple(record for record, _ in stimuli), reverse)

    def lost() -> list[str]:
        return [
            f"the record of {record.IC_TYPE.label} is lost"
            for record, reaction in stimuli
            if record.IC_TYPE is not None and not bench.instructions(reaction, var_id_of(record), since)
        ]

    bench.until(lambda _: not lost())
    if missing := lost():
        bench.inconclusive("all containers of such a payload are processed, which this case needs", missing[0])


def _require_both(bench: Bench, peer: Peer, reverse: bool) -> None:
    """Stop as inconclusive unless both containers of a payload with a VarUpdate and a summary are processed."""
    update = peer.update(teach_variable(bench, peer), 1, b"newer"), ICType.UPDATES
    _require_all(bench, peer, reverse, update, (peer.summary(bench.unknown_id(), 2), _RC))


@case(
    "TC_VD_RX_BV_11",
    "VarUpdates are processed before summaries (containers {variant})",
    requirements="VD-RX-08",
    stimulus="a payload with a newer VarUpdate with sequence number 1, and a summary with 2",
    expect="a VarReqUpdate with sequence number 1: the summary is newer than the value just stored",
    variants=_ORDERS,
)
def update_before_summary(bench: Bench, reverse: bool) -> None:
    peer = bench.peer()
    _require_both(bench, peer, reverse)
    var_id = teach_variable(bench, peer)
    since = _send(bench, peer, (peer.update(var_id, 1, b"newer"), peer.summary(var_id, 2)), reverse)
    came = bench.until_instruction(_RU, var_id)
    # If the update were stored afterwards, it would cancel the request (VD-PU-08).
    bench.required(came, "a VarReqUpdate in response to the summary")
    numbers = {each.record.seqno for each in bench.instructions(_RU, var_id, since)}
    bench.answered(numbers, {1}, "sequence numbers in the VarReqUpdate")


@case(
    "TC_VD_RX_BV_08",
    "VarCreates are processed before summaries and requests (containers {variant})",
    requirements="VD-RX-08",
    stimulus="a payload with the VarCreate of an unknown variable, a summary of it and both kinds of requests for it",
    expect="the variable is known, and there is no request for it",
    variants=_ORDERS,
)
def create_before_requests(bench: Bench, reverse: bool) -> None:
    peer, (known, asked) = bench.peer(), bench.identifiers.var_ids(2)
    teach_variables(bench, peer, [peer.create(each, seqno=5) for each in (known, asked)])
    _require_all(
        bench, peer, reverse, (peer.create(bench.var_id()), ICType.CREATE_VARIABLES),
        (peer.summary(bench.unknown_id(), 0), _RC), (peer.request_create(known), ICType.CREATE_VARIABLES),
        (peer.request_update(asked, 4), ICType.UPDATES),
    )  # fmt: skip
    var_id = bench.var_id()
    records = (
        peer.create(var_id),
        peer.summary(var_id, 0),
        peer.request_create(var_id),
        peer.request_update(var_id, 0),
    )
    since = _send(bench, peer, records, reverse)
    bench.some(bench.until_instruction(ICType.CREATE_VARIABLES, var_id), "the VarCreate is forwarded")
    bench.require_alive("the payload")
    _not_requested(bench, var_id, since, (_RC, _RU))


# -- order of records --------------------------------------------------------------------------------------------------


@case(
    "TC_VD_RX_BV_09",
    "VarUpdates in a container are processed in order",
    requirements="VD-RX-09",
    stimulus=(
        "a container with two VarUpdates, each newer than the value stored before it; then one with a newer "
        "VarUpdate followed by one that is older than it but newer than the value stored before"
    ),
    expect="the last VarUpdate of the first container is stored, and the first of the second",
    needs=Needs(since=SpecVersion.V1_2),
)
def updates_in_order(bench: Bench) -> None:
    peer = bench.peer()
    var_id = teach_variable(bench, peer, seqno=0)
    # In reverse order, the second would be older than the stored value, and the first would be stored.
    half = modulus(bench) // 2
    one, two = stepped(bench, 0, half - 8), stepped(bench, 0, 2 * half - 16)
    peer.send(peer.update(var_id, one, b"one"), peer.update(var_id, two, b"two"))
    came = bench.until_instruction(ICType.UPDATES, var_id)
    _stored(bench, var_id, two, b"two", came)
    nearer, newest = stepped(bench, two, 1), stepped(bench, two, 2)
    peer.send(peer.update(var_id, newest, b"last"), peer.update(var_id, nearer, b"near"))
    came = bench.until(
        lambda heard: any(each.record.seqno == newest for each in heard.instructions(ICType.UPDATES, var_id))
    )
    _stored(bench, var_id, newest, b"last", came)


@case(
    "TC_VD_RX_BV_10",
    "VarCreates in a container are processed in order",
    requirements="VD-RX-09",
    stimulus="a container with two VarCreates of one unknown variable, with the same creationTime and different values",
    expect="the first one is stored and forwarded",
)
def creates_in_order(bench: Bench) -> None:
    peer, var_id, stamp = bench.peer(), bench.var_id(), bench.records.creation_time()
    first = peer.create(var_id, value=b"first", creation_time=stamp)
    second = peer.create(var_id, value=b"next", creation_time=stamp)
    since = peer.stimulate(first, second)
    found: list[VarCreate] = [each.record for each in bench.waiting.repeated(ICType.CREATE_VARIABLES, var_id, since)]
    bench.in_order(found, [first], "only the first VarCreate is forwarded")
