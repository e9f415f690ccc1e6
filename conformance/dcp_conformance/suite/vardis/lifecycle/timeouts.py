"""dcp-vardis.md: Scrubbing Process.

Events that restart the timeout of a variable, and events that do not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import TIMES_DELETION, Needs, Variant, case
from dcp_conformance.frames.received import Instruction
from dcp_conformance.test_steps.timeouts import (
    Change,
    check_not_kept,
    check_time,
    create_own,
    deleted,
    deleted_by_consumer,
    lasting,
    latest,
    learn,
    not_by_consumers,
    sent,
    shorten_scrubbing,
    updated_in_time,
)
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer
from dcp_conformance.upper_tester import Answer

_DELETE = ICType.DELETE_VARIABLES
_WIRE = Needs(since=SpecVersion.V2_0)
_OWN = Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Update"))


@case(
    "TC_VD_SCR_TI_04",
    "Updates prevent the timeout of a variable at a consumer; after the last one it is deleted in time",
    requirements="VD-SCR-03 VD-SCR-06 VD-SCR-01",
    alone=TIMES_DELETION,
    stimulus=(
        "a variable with timeout 600 ms (longer if beacons are rare) is updated three times per timeout, for one "
        "and a half timeouts and a scrubbing period"
    ),
    expect="no VarDelete until the last update; one within the time allowed after it",
    window=60,
    needs=_WIRE,
)
def kept_by_updates(bench: Bench) -> None:
    period_ms, scale = shorten_scrubbing(bench), bench.session.timing_scale
    peer, name, timeout_ms = bench.peer(), bench.var_id(), lasting(bench, round(600 * scale), 4)
    since = learn(bench, peer, name, timeout_ms)
    until = bench.now() + (3 * timeout_ms // 2 + period_ms) * MS
    number = slowest = 0
    while bench.now() < until:
        last, number = since, number + 1
        since = sent(bench, peer, peer.update(name, number, bytes((number,))))
        slowest = max(slowest, since.after - last.before)
        bench.waiting.wait_ns(timeout_ms * MS // 3)
    early = _early(bench, name, since, timeout_ms)
    _check_in_time(bench, slowest, timeout_ms, early)
    bench.some(
        not early,
        "no VarDelete of a variable that is updated in time",
        "VD-SCR-03 VD-SCR-06",
        seen=f"{len(early)} VarDeletes",
    )
    if early:
        return
    found = deleted_by_consumer(bench, name, since, timeout_ms)
    last_one = any(each.record.seqno == number for each in bench.instructions(ICType.UPDATES, name))
    check_time(bench, found, since, timeout_ms, "VD-SCR-01 VD-SCR-06", received=last_one)


@case(
    "TC_VD_SCR_TI_05",
    "Updates by its application prevent the timeout of a variable at the producer",
    requirements="VD-SCR-03",
    alone=TIMES_DELETION,
    stimulus="the application updates a variable with timeout 600 ms every 200 ms for one and a half timeouts",
    expect="no VarDelete until the last update; one within the time allowed after it",
    window=60,
    needs=_OWN,
)
def kept_by_the_application(bench: Bench) -> None:
    period_ms = shorten_scrubbing(bench)
    if "UT-Hello" in bench.services.upper.methods:
        # Measures how long a call takes.
        bench.call("UT-Hello")
    name, timeout_ms = bench.identifiers.own_var_id(), updated_in_time(bench, round(600 * bench.session.timing_scale))
    since = create_own(bench, name, timeout_ms)
    until = bench.now() + (3 * timeout_ms // 2 + period_ms) * MS
    slowest = 0
    refused: Answer | None = None
    while bench.now() < until:
        last, before = since, bench.now()
        answer = bench.call("RTDB-Update", varId=name, value="01")
        if not answer.ok:
            refused = answer
            # If the reason is that the variable was deleted, the next beacons show it.
            bench.wait(bench.sut.reaction)
            slowest = max(slowest, before - last.before)
            break
        since = Change(before, bench.now())
        slowest = max(slowest, since.after - last.before)
        bench.waiting.wait_ns(timeout_ms * MS // 3)
    early = _early(bench, name, since, timeout_ms)
    _check_in_time(bench, slowest, timeout_ms, early)
    bench.none(early, "no VarDelete of a variable that is updated in time")
    if early:
        return
    if refused is not None:
        bench.inconclusive("RTDB-Update succeeds, which this case needs", str(refused))
    found = bench.required(
        deleted(bench, name, since, timeout_ms),
        "a VarDelete after the last update",
        seen=f"none in {latest(bench, timeout_ms) / MS:.0f} ms",
    )
    took = found.heard.time - since.before
    what = f"the VarDelete at least {timeout_ms} ms after the last update"
    bench.proved(took >= (timeout_ms - 2) * MS, what, f"{took / MS:.0f} ms", frames=[found])


def _early(bench: Bench, name: int, since: Change, timeout_ms: int) -> list[Instruction]:
    """Return the VarDeletes that were sent before a timeout after the last change: the tester may have read later."""
    due = since.before + timeout_ms * MS
    return [each for each in bench.instructions(_DELETE, name) if each.heard.time < due]


def _check_in_time(bench: Bench, slowest: int, timeout_ms: int, early: Sequence[Instruction]) -> None:
    """Stop as inconclusive if a variable was deleted after two of its updates were too far apart (``slowest`` ns)."""
    if early and slowest > timeout_ms * MS * 9 // 10:
        bench.inconclusive("updates within the timeout", f"{slowest / MS:.0f} ms between two of them")


@case(
    "TC_VD_SCR_TI_06",
    "A record that changes nothing does not extend the life of a variable ({variant})",
    requirements="VD-SCR-06 VD-SCR-01",
    stimulus="a variable with timeout 500 ms is created; then a record that changes nothing every 150 ms ({variant})",
    expect="the VarDelete within the time allowed after the creation",
    window=40,
    needs=_WIRE,
    variants={
        "equal-update": lambda peer, name: peer.send(peer.update(name, 5, b"another")),
        "older-update": lambda peer, name: peer.send(peer.update(name, 4, b"older")),
        "summary": lambda peer, name: peer.send(peer.summary(name, 5)),
        "request": lambda peer, name: peer.send(peer.request_create(name), peer.request_update(name, 3)),
    },
)
def not_kept(bench: Bench, act: Callable[[Peer, int], object]) -> None:
    check_not_kept(bench, lambda peer, record: act(peer, record.spec.var_id), "records")


@case(
    "TC_VD_SCR_TI_08",
    "A renewed creation restarts the timeout, with its new value",
    requirements="VD-SCR-03 VD-SCR-05 VD-SCR-01",
    alone=TIMES_DELETION,
    stimulus=(
        "a variable with timeout 300 ms is deleted by scrubbing; then it is created again with three times that timeout"
    ),
    expect="a second VarDelete within the time allowed after the second creation, and not earlier",
    window=60,
    needs=_WIRE,
)
def created_again(bench: Bench) -> None:
    shorten_scrubbing(bench)
    peer, name = bench.peer(), bench.var_id()
    short = lasting(bench, 300, 2)
    first = learn(bench, peer, name, short)
    deleted_by_consumer(bench, name, first, short)
    bench.waiting.repeated(_DELETE, name, 0)
    mark = bench.mark()
    long = 3 * short
    second = learn(bench, peer, name, long)
    left = second.after + latest(bench, long) - bench.now()
    bench.required(
        bench.until_instruction(_DELETE, name, left / bench.period),
        "a VarDelete after the second creation",
        "VD-SCR-05",
    )
    check_time(bench, bench.instructions(_DELETE, name, mark)[0], second, long, "VD-SCR-03 VD-SCR-01")


_LONGEST = 65_535


@case(
    "TC_VD_SCR_TI_12",
    "The longest timeout, 65,535 ms, is neither truncated nor ignored ({variant})",
    requirements="VD-TYP-04 VD-SCR-01",
    stimulus="a variable with timeout 65535 ms is created; then no more records",
    expect="the VarDelete 65,535 ms later, or at most one scrubbing period after that",
    window=700,
    needs=_WIRE,
    variants={"received": False, "own": Variant(True, needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create",)))},
    long=True,
)
def longest_timeout(bench: Bench, own: bool) -> None:
    shorten_scrubbing(bench)
    name = bench.identifiers.own_var_id() if own else bench.var_id()
    since = create_own(bench, name, _LONGEST) if own else learn(bench, bench.peer(), name, _LONGEST)
    found = deleted(bench, name, since, _LONGEST)
    if found is None and not own:
        not_by_consumers(bench, name)
        return
    check_time(bench, bench.required(found, "a VarDelete of the variable"), since, _LONGEST)
