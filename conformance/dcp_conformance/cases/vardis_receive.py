"""dcp-vardis.md: Receive Path, Processing Order of Instruction Containers."""

from __future__ import annotations

import itertools
from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.peers import Peer
from dcp_conformance.services import entry_of, max_repetitions, settled, taught
from dcp_conformance.variables import ask, modulus, named, stepped, taught_all, traces

_SEVERAL = Needs(since=SpecVersion.V1_1)
_RC, _RU = ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES


def _stored(bench: Bench, var_id: int, seqno: int, value: bytes, came: object, *requirements: str) -> None:
    """Check what is stored of a variable."""
    held = ask(bench, var_id)
    upd = held.record.upd if held.record is not None else None
    as_expected = upd is not None and (upd.seqno, upd.value) == (seqno, bench.value(value))
    what = f"variable {var_id} is stored with sequence number {seqno} and value {value.hex()}"
    bench.check(as_expected, what, str(held), *requirements, shown=came and held.record)


def _not_requested(bench: Bench, var_id: int, since: int, kinds: tuple[ICType, ...], *requirements: str) -> None:
    found = traces(bench, var_id, since, kinds)
    bench.check(
        not found,
        f"variable {var_id} is not requested",
        f"{named(found)} came",
        *requirements,
        frames=found,
        # An implementation that loses a container has reason to ask.
        shown=not bench.session.lost_container,
    )


@case(
    "TC_VD_RX_BV_01",
    "All records of a payload are extracted before any is processed",
    requirements="VD-RX-01",
    stimulus="a payload in which the VarUpdate of an unknown variable stands before its VarCreate",
    expect="both are applied, and the variable is not requested",
    smoke=True,
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
    "The order of the containers in a payload does not matter",
    requirements="VD-RX-02 VD-RX-08",
    stimulus="a VarCreate, a newer VarUpdate of the same variable, a summary of it with that number and a summary of "
    "an unknown variable, in containers in all orders",
    expect="each time the variable is stored with the update, the unknown one is requested, and nothing else is",
    window=8,
)
def permutations(bench: Bench) -> None:
    peer = bench.peer()
    orders = list(itertools.permutations(range(3)))
    created, unknown, since = bench.var_ids(len(orders)), bench.unknown_ids(len(orders)), bench.mark()
    for order, var_id, other in zip(orders, created, unknown, strict=True):
        containers = [
            bench.forge.container(peer.create(var_id, value=b"first")),
            bench.forge.container(peer.update(var_id, 1, b"newer")),
            bench.forge.container(peer.summary(var_id, 1), peer.summary(other, 1)),
        ]
        peer.send(*(containers[index] for index in order))
    names = ("CREATE-VARIABLES", "UPDATES", "SUMMARIES")
    bench.until(lambda heard: set(unknown) <= {each.var_id for each in heard.instructions(_RC)})
    for order, var_id, other in zip(orders, created, unknown, strict=True):
        what = " before ".join(names[index] for index in order)
        found = [each.record.upd for each in bench.repeated(ICType.CREATE_VARIABLES, var_id, since)]
        newest = [(each.seqno, each.value) for each in found[-1:]]
        shown = f"number {newest[0][0]}, value {newest[0][1]!r}" if newest else "there is no VarCreate"
        right = newest == [(1, bench.value(b"newer"))]
        applied = bench.check(right, f"{what}: creation and update are applied", shown, "VD-RX-02", shown=newest)
        came = bench.instructions(_RC, other, since)
        bench.check(
            len(came) == 1,
            f"{what}: the unknown variable is requested",
            f"{len(came)} requests",
            "VD-RX-02",
            shown=len(came) > 1,
        )
        # Who has lost the creation has reason to ask.
        if applied:
            _not_requested(bench, var_id, since, (_RC, _RU), "VD-RX-08")


_Stimulus = Callable[[Peer, int], VardisRecord]


@case(
    "TC_VD_RX_BV_03",
    "Containers of all six types in one payload are all processed, whichever comes first ({variant})",
    requirements="VD-RX-02",
    stimulus="a payload with one container of each type; the order is turned by {variant}",
    expect="a creation and an update that are repeated, a deletion, a request for a variable and one for an update, "
    "and the answers to both requests",
    window=6,
    variants={str(turn): turn for turn in range(6)} | {f"{turn}-reversed": turn + 6 for turn in range(6)},
)
def all_types(bench: Bench, turn: int) -> None:
    peer = bench.peer()
    known = [peer.create(var_id, seqno=5) for var_id in bench.var_ids(5)]
    taught_all(bench, peer, known)
    doomed, updated, behind, asked, lagging = (create.spec.var_id for create in known)
    fresh, unknown = bench.var_id(), bench.unknown_id()
    containers = [
        bench.forge.container(peer.create(fresh)),
        bench.forge.container(peer.delete(doomed)),
        bench.forge.container(peer.update(updated, 6)),
        bench.forge.container(peer.summary(unknown, 1), peer.summary(lagging, 6)),
        bench.forge.container(peer.request_update(behind, 4)),
        bench.forge.container(peer.request_create(asked)),
    ]
    containers = containers[turn % 6 :] + containers[: turn % 6]
    since = bench.mark()
    peer.send(*(containers if turn < 6 else containers[::-1]))
    expected = {
        (ICType.CREATE_VARIABLES, fresh): "the VarCreate is applied",
        (ICType.DELETE_VARIABLES, doomed): "the VarDelete is applied",
        (ICType.UPDATES, updated): "the VarUpdate is applied",
        (_RC, unknown): "the summary of an unknown variable is processed",
        (_RU, lagging): "the newer summary is processed",
        (ICType.UPDATES, behind): "the VarReqUpdate is answered",
        (ICType.CREATE_VARIABLES, asked): "the VarReqCreate is answered",
    }

    def missing() -> list[str]:
        return [what for (kind, var_id), what in expected.items() if not bench.instructions(kind, var_id, since)]

    bench.until(lambda _: not missing(), bench.sending(len(expected)))
    left = missing()
    for what in expected.values():
        bench.check(what not in left, what, "there is no trace of it")


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
    "Two containers of one type in a payload are both processed: {variant}",
    requirements="VD-RX-03",
    stimulus="a payload with two containers of this type, of two records and of one",
    expect="the effect of all three records",
    needs=_SEVERAL,
    variants=_TWO,
)
def same_type_twice(bench: Bench, what: tuple[ICType, _Stimulus, ICType]) -> None:
    kind, make, answer = what
    peer, ids = bench.peer(), bench.var_ids(3)
    if kind is not ICType.CREATE_VARIABLES:
        taught_all(bench, peer, [peer.create(var_id, seqno=5) for var_id in ids])
    one, two, three = (make(peer, var_id) for var_id in ids)
    since = bench.mark()
    peer.send(bench.forge.container(one, two), bench.forge.container(three))
    bench.until(lambda _: all(bench.instructions(answer, var_id, since) for var_id in ids), bench.sending(6))
    missing = [number for number, var_id in enumerate(ids, 1) if not bench.instructions(answer, var_id, since)]
    names = ", ".join(_PLACES[number - 1] for number in missing)
    bench.check(not missing, f"three {kind.label} records in two containers are processed", f"no trace of {names}")


# -- order of processing -----------------------------------------------------------------------------------------------

_ORDERS = {"in-order": False, "reversed": True}


def _send(bench: Bench, peer: Peer, records: tuple[VardisRecord, ...], reverse: bool) -> int:
    since = bench.mark()
    containers = [bench.forge.container(each) for each in records]
    peer.send(*(reversed(containers) if reverse else containers))
    return since


def require_both_taken(bench: Bench, peer: Peer, reverse: bool) -> None:
    """Stop as failed unless VarCreate and VarDelete in one payload are both taken when they are about two variables.

    Then their order says nothing, so that who loses the second container is not blamed for the order of processing.
    """
    doomed = taught(bench, peer)
    _send(bench, peer, (peer.create(bench.var_id()), peer.delete(doomed)), reverse)
    came = bench.until_instruction(ICType.DELETE_VARIABLES, doomed)
    what = "a VarDelete in one payload with the VarCreate of another variable is processed"
    bench.require(came, what, "there is no trace of it", "VD-RX-04")


@case(
    "TC_VD_RX_BV_05",
    "Creations are processed before deletions (containers {variant})",
    requirements="VD-RX-08 VD-RX-04",
    stimulus="a payload with VarCreate and VarDelete of two variables, then one with both of an unknown variable",
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
    bench.check(
        not found, "nothing else is sent about it", f"{named(found)} came", "VD-RX-08", frames=found, shown=True
    )


@case(
    "TC_VD_RX_BV_06",
    "Deletions are processed before updates, which come to nothing then (containers {variant})",
    requirements="VD-RX-08 VD-PD-04 VD-RX-04",
    stimulus="a payload with VarDelete and newer VarUpdate of a known variable",
    expect="the variable is deleted, and the update is neither repeated nor (by RTDB-DescribeVariable) stored",
    variants=_ORDERS,
)
def delete_before_update(bench: Bench, reverse: bool) -> None:
    peer = bench.peer()
    # Up to 1.3 a deleted variable can be described as long as its deletion is repeated.
    count = min(3, max_repetitions(bench)) if bench.features.removed_after_deletion else 1
    var_id = taught(bench, peer, rep_cnt=count)
    if count > 1:
        settled(bench, var_id)
    since = _send(bench, peer, (peer.delete(var_id), peer.update(var_id, 1)), reverse)
    bench.until_instruction(ICType.DELETE_VARIABLES, var_id)
    upper = bench.session.upper
    describes = upper is not None and "RTDB-DescribeVariable" in upper.methods
    entry = entry_of(bench, var_id) if describes else None
    deleted = bench.check_repeated(ICType.DELETE_VARIABLES, var_id, count, since, "VD-PD-04", absent="VD-RX-04")
    if not deleted:
        return
    found = traces(bench, var_id, since, (ICType.CREATE_VARIABLES, ICType.UPDATES, _RC, _RU))
    bench.check(
        not found, "nothing else is sent about it", f"{named(found)} came", "VD-PD-04", frames=found, shown=True
    )
    # On the air it looks the same whichever comes first: the database tells.
    if entry is not None or (describes and not bench.features.removed_after_deletion):
        entry = entry or {}
        bench.check(
            entry.get("seqno") == 0, "the update is not stored", f"seqno {entry.get('seqno')}", "VD-RX-08", shown=True
        )


@case(
    "TC_VD_RX_BV_07",
    "A summary with the number of an update in the same payload brings no request (containers {variant})",
    requirements="VD-PU-08 VD-PS-02",
    stimulus="a payload with a newer VarUpdate and a summary with the same number",
    expect="the update is stored and not requested",
    variants=_ORDERS,
)
def summary_of_update(bench: Bench, reverse: bool) -> None:
    peer = bench.peer()
    var_id = taught(bench, peer)
    since = _send(bench, peer, (peer.update(var_id, 1, b"newer"), peer.summary(var_id, 1)), reverse)
    came = bench.until_instruction(ICType.UPDATES, var_id)
    bench.check(
        came is not None and came.seqno == 1, "the update is stored and repeated", f"{came}", shown=came is not None
    )
    bench.require_alive("the payload")
    _not_requested(bench, var_id, since, (_RU,))


def _require_both(bench: Bench, peer: Peer, reverse: bool) -> None:
    """Stop as inconclusive unless both containers of a payload with a VarUpdate and a summary are processed.

    An implementation that loses one of them (VD-RX-04) shows nothing about their order.
    """
    updated, unknown = taught(bench, peer), bench.unknown_id()
    since = _send(bench, peer, (peer.update(updated, 1, b"newer"), peer.summary(unknown, 2)), reverse)
    bench.until(
        lambda _: bench.instructions(_RC, unknown, since) and bench.instructions(ICType.UPDATES, updated, since)
    )
    lost = [
        name
        for name, found in (
            ("the VarUpdate", bench.instructions(ICType.UPDATES, updated, since)),
            ("the summary", bench.instructions(_RC, unknown, since)),
        )
        if not found
    ]
    if lost:
        bench.inconclusive("both containers of such a payload are processed, which this case needs", f"not {lost[0]}")


@case(
    "TC_VD_RX_BV_11",
    "Updates are processed before summaries (containers {variant})",
    requirements="VD-RX-08",
    stimulus="a payload with a newer VarUpdate, number 1, and a summary with number 2",
    expect="a VarReqUpdate with number 1: the summary is newer than what the update has left",
    variants=_ORDERS,
)
def update_before_summary(bench: Bench, reverse: bool) -> None:
    peer = bench.peer()
    _require_both(bench, peer, reverse)
    var_id = taught(bench, peer)
    since = _send(bench, peer, (peer.update(var_id, 1, b"newer"), peer.summary(var_id, 2)), reverse)
    came = bench.until_instruction(_RU, var_id)
    # Storing the update afterwards would take the request back (VD-PU-08).
    bench.require(came is not None, "a VarReqUpdate on account of the summary", "there is none")
    numbers = {each.record.seqno for each in bench.instructions(_RU, var_id, since)}
    bench.check(numbers == {1}, "it has the number of the update, 1", f"{sorted(numbers)}", shown=True)


@case(
    "TC_VD_RX_BV_08",
    "Creations are processed before summaries and requests (containers {variant})",
    requirements="VD-RX-08",
    stimulus="a payload with the VarCreate of an unknown variable, a summary of it and both kinds of requests",
    expect="the variable is known and not requested",
    variants=_ORDERS,
)
def create_before_requests(bench: Bench, reverse: bool) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    records = (
        peer.create(var_id),
        peer.summary(var_id, 0),
        peer.request_create(var_id),
        peer.request_update(var_id, 0),
    )
    since = _send(bench, peer, records, reverse)
    came = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    bench.check(came, "the creation is repeated", "there is no VarCreate")
    bench.require_alive("the payload")
    _not_requested(bench, var_id, since, (_RC, _RU))


# -- order of records --------------------------------------------------------------------------------------------------


@case(
    "TC_VD_RX_BV_09",
    "VarUpdates in a container are processed in their order",
    requirements="VD-RX-09",
    stimulus="a container with two VarUpdates that are each newer than what is stored when they are reached; then one "
    "of which the second is newer than the first, but older than what was stored",
    expect="the last one of the first container is stored, and the only newer one of the second",
    needs=Needs(since=SpecVersion.V1_2),
)
def updates_in_order(bench: Bench) -> None:
    peer = bench.peer()
    var_id = taught(bench, peer, seqno=0)
    # Reversed, the second would be older than the stored number, and then the first would be stored.
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
    "VarCreates in a container are processed in their order",
    requirements="VD-RX-09",
    stimulus="a container with two VarCreates of one unknown variable, with the same creationTime and other values",
    expect="the first one is stored and repeated",
)
def creates_in_order(bench: Bench) -> None:
    peer, var_id, stamp = bench.peer(), bench.var_id(), bench.creation_time()
    first = peer.create(var_id, value=b"first", creation_time=stamp)
    second = peer.create(var_id, value=b"next", creation_time=stamp)
    since = bench.mark()
    peer.send(first, second)
    found: list[VarCreate] = [each.record for each in bench.repeated(ICType.CREATE_VARIABLES, var_id, since)]
    bench.check(
        found == [first],
        "the first VarCreate is stored and repeated",
        f"{len(found)} records came: {found}",
        shown=found,
    )
