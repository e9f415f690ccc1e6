"""dcp-vardis.md: Queues: instructions that are superseded before they are sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import (
    entry_of,
    max_repetitions,
    produced,
    settled,
    several_repetitions,
    teach_variable,
)
from dcp_conformance.test_steps.variable_queries import stepped, traces
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_DELETE = ICType.DELETE_VARIABLES
_OTHERS = (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES)
_Made = Callable[[Peer, int], VardisRecord]


def _check_once(bench: Bench, attempt: Callable[[], bool], expected: str) -> None:
    """Check that at least one of three attempts succeeds: a payload may be composed just between two frames of the
    tester.
    """
    right, observed = any(attempt() for _ in range(3)), "one in every attempt"
    if not right and bench.sut.one_by_one:
        bench.inconclusive(
            expected, f"{observed}; but it processes received payloads one at a time and may answer in between"
        )
    bench.none(not right, expected, seen=observed, given=bench.verdicts.in_time)


@case(
    "TC_VD_PEND_BV_01",
    "A request for an update is cancelled when the update arrives before the request is sent",
    requirements="VD-PU-08",
    stimulus="a newer summary and, immediately after it in another beacon, the VarUpdate; up to three times",
    expect="no VarReqUpdate in at least one attempt",
    window=8,
)
def request_dropped(bench: Bench) -> None:
    expected = "no VarReqUpdate for a value that has arrived"
    _check_cancelled(bench, 1, "an update", lambda peer, var_id: peer.update(var_id, 1), expected)


def _check_cancelled(bench: Bench, number: int, what: str, second: _Made, expected: str) -> None:
    """Check that a second record cancels the request that a summary with this number has caused.

    The variable is known with number 0, or unknown for a summary with 0.
    """
    kind = ICType.REQUEST_VARUPDATES if number else ICType.REQUEST_VARCREATES

    def attempt() -> bool:
        peer = bench.peer()
        var_id = teach_variable(bench, peer) if number else bench.unknown_id()
        bench.identifiers.created.add(var_id)
        since = peer.stimulate(peer.summary(var_id, number))
        peer.send(second(peer, var_id))
        bench.require_processed(f"a summary and {what}")
        return not bench.instructions(kind, var_id, since)

    _check_once(bench, attempt, f"{expected}, in at least one of 3 attempts")


@case(
    "TC_VD_PEND_BV_08",
    "A request for an update is cancelled by an update that is older than the summary before it",
    requirements="VD-PU-08",
    stimulus=(
        "a summary that is newer by two and, immediately after it in another beacon, a VarUpdate that is newer by "
        "one; up to three times"
    ),
    expect="no VarReqUpdate in at least one attempt",
    window=8,
)
def request_dropped_by_an_older_one(bench: Bench) -> None:
    expected = "no VarReqUpdate after a newer value has arrived"
    _check_cancelled(bench, 2, "an update", lambda peer, var_id: peer.update(var_id, 1), expected)


@case(
    "TC_VD_PEND_BV_02",
    "A request for a variable is cancelled when the variable arrives before the request is sent",
    requirements="VD-PC-08",
    stimulus=(
        "a summary of an unknown variable and, immediately after it in another beacon, its VarCreate; up to three times"
    ),
    expect="no VarReqCreate in at least one attempt",
    window=8,
)
def create_request_dropped(bench: Bench) -> None:
    expected = "no VarReqCreate for a variable that has arrived"
    _check_cancelled(bench, 0, "a VarCreate", lambda peer, var_id: peer.create(var_id), expected)


@case(
    "TC_VD_PEND_BV_03",
    "A deletion cancels all pending records of its variable",
    requirements="VD-PD-04",
    stimulus=(
        "requests for a variable and a newer summary of it, and immediately after them its VarDelete, each in a "
        "beacon; up to three times"
    ),
    expect="no record other than the VarDelete in at least one attempt",
    window=8,
)
def pending_dropped(bench: Bench) -> None:
    def attempt() -> bool:
        peer = bench.peer()
        # Up to 1.3 the variable is unknown after the last VarDelete, so no other record could be sent in any case.
        several = bench.features.removed_after_deletion and not bench.sut.one_by_one
        var_id = teach_variable(bench, peer, seqno=5, rep_cnt=min(3, max_repetitions(bench)) if several else 1)
        if several:
            settled(bench, var_id)
        since = bench.mark()
        asked = peer.summary(var_id, 6), peer.request_create(var_id), peer.request_update(var_id, 4)
        for record in (*asked, peer.delete(var_id)):
            peer.send(record)
        bench.required(bench.until_instruction(ICType.DELETE_VARIABLES, var_id), "the VarDelete is forwarded")
        bench.beacons(1, 1.5)
        return not traces(bench, var_id, since, (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.REQUEST_VARUPDATES))

    _check_once(bench, attempt, "no pending answer or request sent after the deletion, in at least one of 3 attempts")


def _three_repetitions(bench: Bench) -> str | None:
    return (
        None
        if max_repetitions(bench) >= 4
        else "the deletion must be repeated four times to be superseded, and the maximum is less"
    )


@case(
    "TC_VD_PEND_BV_04",
    "A new VarCreate cancels the repetitions of a preceding VarDelete",
    requirements="VD-PC-08",
    stimulus="a VarDelete with many repetitions, and after the first of them a VarCreate with a later creationTime",
    expect="repCnt beacons with the VarCreate; no VarDelete in them or later",
    window=20,
    needs=Needs(since=SpecVersion.V2_0, when=_three_repetitions),
)
def deletion_overtaken(bench: Bench) -> None:
    peer, count = bench.peer(), max_repetitions(bench)
    var_id = teach_variable(bench, peer, rep_cnt=count)
    peer.send(peer.delete(var_id))
    bench.required(bench.until_instruction(ICType.DELETE_VARIABLES, var_id), "the VarDelete is forwarded")
    since = peer.stimulate(peer.create(var_id, rep_cnt=2))
    found = bench.check_repeated(ICType.CREATE_VARIABLES, var_id, 2, since)
    first = bench.heard.index(found[0].heard) if found else since
    late = traces(bench, var_id, first, (ICType.DELETE_VARIABLES, ICType.UPDATES, ICType.REQUEST_VARUPDATES))
    bench.none(late, "no VarDelete with or after the new VarCreate", given=found)


@case(
    "TC_VD_PEND_BV_05",
    "A new VarCreate cancels the repetitions of a preceding VarUpdate",
    requirements="VD-PC-08",
    stimulus="a VarUpdate with many repetitions, and after the first of them a VarCreate with a later creationTime",
    expect="repCnt beacons with the VarCreate; no VarUpdate in them or later",
    window=20,
    needs=Needs(since=SpecVersion.V2_0, when=_three_repetitions),
)
def update_overtaken(bench: Bench) -> None:
    peer, count = bench.peer(), max_repetitions(bench)
    var_id = bench.var_id()
    bench.learn(peer, peer.create(var_id, rep_cnt=count))
    peer.send(peer.update(var_id, 1))
    bench.required(bench.until_instruction(ICType.UPDATES, var_id), "the VarUpdate is forwarded")
    record = peer.create(var_id, rep_cnt=2, value=b"anew")
    since = peer.stimulate(record)
    found = bench.check_repeated(ICType.CREATE_VARIABLES, var_id, 2, since)
    bench.every(found, record, "the new VarCreate unchanged")
    first = bench.heard.index(found[0].heard) if found else since
    late = traces(bench, var_id, first, (ICType.UPDATES, ICType.DELETE_VARIABLES))
    bench.none(late, "no VarUpdate with or after the new VarCreate", given=found)


@case(
    "TC_VD_PEND_BV_06",
    "A request for an update is cancelled when the variable is created again before the request is sent",
    requirements="VD-PC-08",
    stimulus=(
        "a newer summary and, immediately after it in another beacon, a VarCreate with a later creationTime; up to "
        "three times"
    ),
    expect="no VarReqUpdate in at least one attempt",
    window=8,
    needs=Needs(since=SpecVersion.V2_0),
)
def request_overtaken(bench: Bench) -> None:
    expected = "no VarReqUpdate for a variable created again"
    _check_cancelled(bench, 1, "a VarCreate", lambda peer, var_id: peer.create(var_id), expected)


_Event = Callable[[Peer, int, Callable[[int], int]], VardisRecord]
#: Records about a deleted variable, with the requirements by which they change nothing; the function returns a sequence
#: number with a given distance from the stored one.
_EVENTS: dict[str, tuple[_Event, str]] = {
    "VarDelete": (lambda peer, var_id, _: peer.delete(var_id), "VD-PD-02 VD-SCP-03"),
    "newer-VarUpdate": (lambda peer, var_id, seqno: peer.update(var_id, seqno(1), b"w"), "VD-PU-02"),
    "older-VarUpdate": (lambda peer, var_id, seqno: peer.update(var_id, seqno(-1), b"w"), "VD-PU-02"),
    "newer-VarSumm": (lambda peer, var_id, seqno: peer.summary(var_id, seqno(1)), "VD-PS-02"),
    "older-VarSumm": (lambda peer, var_id, seqno: peer.summary(var_id, seqno(-1)), "VD-PS-02"),
    "VarReqUpdate": (lambda peer, var_id, seqno: peer.request_update(var_id, seqno(-1)), "VD-RU-02"),
    "VarReqCreate": (lambda peer, var_id, _: peer.request_create(var_id), "VD-RC-02"),
}


@case(
    "TC_VD_PEND_BV_07",
    "A record received while a deletion is being repeated neither extends nor changes it ({variant})",
    requirements="VD-PD-02",
    stimulus="a variable is deleted by its producer; after the first VarDelete another record arrives ({variant})",
    expect=(
        "repCnt VarDeletes, no other record, and the sequence number unchanged (if RTDB-DescribeVariable is available)"
    ),
    window=20,
    needs=Needs(when=several_repetitions),
    variants={
        **{name: Variant((event, False), requirements=ids) for name, (event, ids) in _EVENTS.items()},
        **{
            f"own-{name}": Variant(
                (event, True),
                requirements=ids.replace("VD-PD-02", "VD-PD-03"),
                needs=Needs(ut=("RTDB-Create", "RTDB-Delete"), when=several_repetitions),
            )
            for name, (event, ids) in _EVENTS.items()
        },
    },
)
def deletion_continues(bench: Bench, variant: tuple[_Event, bool]) -> None:
    event, own = variant
    peer, count = bench.peer(), min(5, max_repetitions(bench))
    var_id = produced(bench, rep_cnt=count) if own else teach_variable(bench, peer, rep_cnt=count, seqno=5)
    settled(bench, var_id)
    since, stored = bench.mark(), 0 if own else 5
    if own:
        bench.must("RTDB-Delete", varId=var_id)
    else:
        peer.send(peer.delete(var_id))
    bench.required(bench.until_instruction(_DELETE, var_id), "the VarDelete is sent")
    record = event(peer, var_id, lambda distance: stepped(bench, stored, distance))
    peer.send(record)
    bench.require_alive(type(record).__name__)
    entry = entry_of(bench, var_id) if bench.services.offers("RTDB-DescribeVariable") else None
    if entry is not None:
        bench.answered(entry.get("seqno"), stored, "seqno")
    deletions = bench.check_repeated(_DELETE, var_id, count, since)
    first, last = (bench.heard.index(each.heard) for each in (deletions[0], deletions[-1]))
    late = traces(bench, var_id, first, _OTHERS)
    if bench.features.removed_after_deletion:
        # After the last VarDelete the variable is unknown and may be requested.
        late = [each for each in late if bench.heard.index(each.heard) <= last]
    bench.none(late, "no other record of the variable")


@case(
    "TC_VD_PEND_BV_09",
    "A VarDelete of an unknown variable does not withdraw the request for it",
    requirements="VD-PD-01 VD-PS-01 VD-CMP-12",
    stimulus="a summary of an unknown variable and, immediately after it in another beacon, a VarDelete of it",
    expect="a VarReqCreate for the variable",
    window=8,
)
def request_kept(bench: Bench) -> None:
    _check_kept(bench, bench.unknown_id(), lambda peer, var_id: peer.delete(var_id))


def _check_kept(bench: Bench, var_id: int, second: _Made) -> None:
    """Check that a second record about an unknown variable leaves the request for it in its queue."""
    peer = bench.peer()
    peer.send(peer.summary(var_id, 0))
    peer.send(second(peer, var_id))
    found = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    bench.some(found, "a VarReqCreate for the variable")


@case(
    "TC_VD_PEND_BV_10",
    "A VarDelete of an unknown variable does not keep it from being created later",
    requirements="VD-PD-01 VD-PC-07",
    stimulus="a VarDelete of an unknown variable; in another beacon its VarCreate",
    expect="the VarCreate is forwarded",
    window=8,
)
def created_after_deletion(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    peer.send(peer.delete(var_id))
    peer.send(peer.create(var_id))
    found = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    bench.some(found, "a VarCreate of the variable")


@case(
    "TC_VD_PEND_BV_11",
    "A VarReqUpdate has the sequence number that the node holds when it sends it",
    requirements="VD-CMP-11 VD-PS-04",
    stimulus=(
        "a newer summary and, immediately after it in another beacon, a VarUpdate; after its repetitions a summary "
        "that is newer again"
    ),
    expect="a VarReqUpdate with the sequence number of the VarUpdate",
    window=12,
)
def number_of_a_request(bench: Bench) -> None:
    peer = bench.peer()
    var_id, kind = teach_variable(bench, peer, seqno=5), ICType.REQUEST_VARUPDATES
    peer.send(peer.summary(var_id, 9))
    peer.send(peer.update(var_id, 7, b"second"))
    if bench.until_instruction(ICType.UPDATES, var_id) is None:
        bench.inconclusive("a VarUpdate of the variable, which this case needs", "the implementation sends none")
    # A request that was prepared before the VarUpdate may still be sent.
    bench.wait(2)
    start = peer.stimulate(peer.summary(var_id, 11))
    bench.until_instruction(kind, var_id)
    found = bench.required(bench.instructions(kind, var_id, start), "a VarReqUpdate for the variable", "VD-PS-04")
    numbers = [getattr(each.record, "seqno", None) for each in found]
    bench.answered(numbers[-1], 7, "seqno of the VarReqUpdate", frames=found)


@case(
    "TC_VD_PEND_BV_12",
    "A summary with the stored sequence number does not withdraw a request for a newer one",
    requirements="VD-PS-02 VD-PS-04 VD-CMP-11",
    stimulus="a newer summary of a neighbour and, immediately after it, a summary of another with the stored number",
    expect="a VarReqUpdate for the variable",
    window=8,
)
def request_not_withdrawn(bench: Bench) -> None:
    peer, other = bench.peer(), bench.peer()
    var_id = teach_variable(bench, peer, seqno=5)
    start = peer.stimulate(peer.summary(var_id, 9))
    other.send(other.summary(var_id, 5))
    bench.until_instruction(ICType.REQUEST_VARUPDATES, var_id)
    found = bench.instructions(ICType.REQUEST_VARUPDATES, var_id, start)
    bench.some(found, "a VarReqUpdate for the variable")


@case(
    "TC_VD_PEND_BV_13",
    "A VarCreate that is ignored does not withdraw the request for its variable ({variant})",
    requirements="VD-PS-01 VD-CMP-12",
    stimulus="a summary of an unknown variable and, immediately after it in another beacon, a VarCreate with {variant}",
    expect="a VarReqCreate for the variable",
    window=8,
    needs=Needs(since=SpecVersion.V1_2),
    variants={
        "an-empty-value": Variant({"value": b""}, requirements="VD-PC-04 VD-PS-01 VD-CMP-12"),
        "repCnt-0": Variant({"rep_cnt": 0}, requirements="VD-PC-06 VD-PS-01 VD-CMP-12"),
    },
)
def request_kept_by_an_ignored_one(bench: Bench, fields: dict[str, Any]) -> None:
    var_id = bench.unknown_id()
    bench.identifiers.created.add(var_id)
    _check_kept(bench, var_id, lambda peer, var_id: peer.create(var_id, **fields))


@case(
    "TC_VD_PEND_BV_14",
    "A VarReqCreate does not cancel the repetitions of a VarUpdate",
    requirements="VD-RC-03 VD-SCP-02 VD-CMP-09",
    stimulus="a VarUpdate with several repetitions, and after the first of them a VarReqCreate of another neighbour",
    expect="repCnt beacons with the VarUpdate",
    window=20,
    needs=Needs(when=several_repetitions),
)
def updates_continue(bench: Bench) -> None:
    peer, count = bench.peer(), min(5, max_repetitions(bench))
    var_id = teach_variable(bench, peer, rep_cnt=count)
    settled(bench, var_id)
    since, other = bench.mark(), bench.peer()
    peer.send(peer.update(var_id, 1))
    bench.required(bench.until_instruction(ICType.UPDATES, var_id), "the VarUpdate is forwarded")
    other.send(other.request_create(var_id))
    bench.check_repeated(ICType.UPDATES, var_id, count, since)
