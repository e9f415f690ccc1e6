"""dcp-vardis.md: Scrubbing Process.

A variable with timeout t is deleted between t and t plus one scrubbing period after its last change; the beacon that
tells it may be one reaction later, and timers may be late (PIXIT timer_tolerance_ms).
"""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.bench import MS, Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.heard import Instruction
from dcp_conformance.peers import Peer
from dcp_conformance.services import create_request

_DELETE = ICType.DELETE_VARIABLES
_WIRE = Needs(since=SpecVersion.V2_0)
_OWN = Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Update"))


def scrubbing_period_ms(bench: Bench) -> int:
    """VARDISPAR_SCRUBBING_PERIOD in ms."""
    return bench.parameter("VARDISPAR_SCRUBBING_PERIOD")


def _hurry(bench: Bench) -> int:
    """Shorten the scrubbing period for this case, where it can be set and reset; the period in ms from now on.

    A period that has begun may run to its end: what must be there at the latest goes by the initial one.
    """
    upper = bench.session.upper
    if upper is not None and {"UT-Reset", "VD-SetParameter"} <= upper.methods:
        answer = bench.call("VD-SetParameter", name="VARDISPAR_SCRUBBING_PERIOD", value=200)
        if answer.ok:
            return 200
    return scrubbing_period_ms(bench)


def _latest(bench: Bench, timeout_ms: int) -> int:
    """ns after which the VarDelete must have been heard."""
    tolerance = bench.pixit.timer_tolerance_ms * bench.session.timing_scale
    return round((timeout_ms + scrubbing_period_ms(bench) + tolerance) * MS + bench.reaction * bench.period)


def _deleted(bench: Bench, name: int, since: int, timeout_ms: int) -> Instruction | None:
    """Wait for the first VarDelete until it must have come at the latest; ``since`` is the time of the last change."""
    left = since + _latest(bench, timeout_ms) - bench.now()
    if not bench.instructions(_DELETE, name):
        bench.until_instruction(_DELETE, name, max(0.0, left / bench.period))
    return next(iter(bench.instructions(_DELETE, name)), None)


def _check_time(bench: Bench, found: Instruction, since: int, timeout_ms: int, *requirements: str) -> None:
    """Whether a VarDelete has come neither too early nor too late after the last change."""
    took = found.heard.time - since
    # Clocks of whole milliseconds may be one ahead at both ends.
    least, most = (timeout_ms - 2) * MS, _latest(bench, timeout_ms)
    what = f"the VarDelete {timeout_ms} ms to {most / MS:.0f} ms after the last change"
    bench.check(least <= took <= most, what, f"{took / MS:.0f} ms", *requirements, frames=[found])


def _learn(bench: Bench, peer: Peer, name: int, timeout_ms: int, rep_cnt: int = 1) -> int:
    """Let the implementation learn a variable with a timeout; the time at which it got it."""
    since = bench.now()
    peer.send(peer.create(name, timeout=timeout_ms, rep_cnt=rep_cnt))
    if bench.until_instruction(ICType.CREATE_VARIABLES, name) is None:
        bench.inconclusive("the implementation learns a variable with a timeout", "it does not pass it on")
    return since


def _not_by_consumers(bench: Bench, name: int) -> None:
    """The other reading of X26 is that only producers scrub. Stops the case if that seems to be it."""
    bench.reading("X26", "producer-only")
    still = bench.until_instruction(ICType.SUMMARIES, name, 8)
    text = "it is summarised still" if still else "neither VarDelete nor summary"
    bench.info("whether a consumer deletes a variable whose time has run out", text)


@case(
    "TC_VD_SCR_TI_01",
    "A consumer deletes a variable with timeout {variant} ms when that and at most a scrubbing period has passed",
    requirements="VD-SCR-01 VD-SCR-04 VD-SCR-05",
    stimulus="a variable with a timeout is created; then silence",
    expect="VarDeletes in exactly repCnt beacons, the first in time; no summary behind it",
    window=30,
    needs=_WIRE,
    variants={"200": 200, "1500": 1500},
)
def consumer(bench: Bench, timeout_ms: int) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.rep_cnt(3)
    since = _learn(bench, peer, name, timeout_ms, count)
    found = _deleted(bench, name, since, timeout_ms)
    if found is None:
        _not_by_consumers(bench, name)
        return
    bench.reading("X26", "every-node")
    bench.check(True, "consumers delete variables whose time has run out", "", "VD-SCR-05", frames=[found])
    _check_time(bench, found, since, timeout_ms, "VD-SCR-01")
    bench.check_repeated(_DELETE, name, count, 0, "VD-SCR-04")
    _check_no_trace(bench, name, found)


def _check_no_trace(bench: Bench, name: int, found: Instruction) -> None:
    begun = bench.heard.index(found.heard)
    for kind in (ICType.SUMMARIES, ICType.CREATE_VARIABLES, ICType.UPDATES):
        late = bench.instructions(kind, name, begun)
        what = f"no {kind.label} record behind the first VarDelete"
        bench.check(not late, what, f"{len(late)}", "VD-SCR-04", frames=late[:4])


@case(
    "TC_VD_SCR_TI_02",
    "The producer deletes its own variable when its timeout and at most a scrubbing period has passed",
    requirements="VD-SCR-01 VD-SCR-04 VD-SCR-05 VD-INI-06",
    stimulus="the application creates a variable with timeout 300 ms and never updates it",
    expect="VarDeletes in exactly repCnt beacons, the first in time; no summary behind it",
    window=30,
    needs=_OWN,
)
def producer(bench: Bench) -> None:
    name, count, timeout_ms = bench.var_id(), bench.rep_cnt(3), 300
    since = _create_own(bench, name, timeout_ms, count)
    found = _deleted(bench, name, since, timeout_ms)
    if found is None:
        bench.fail("a VarDelete of the own variable", f"none in {_latest(bench, timeout_ms) / MS:.0f} ms")
    bench.check(True, "scrubbing runs without further action", "", "VD-INI-06", frames=[found])
    _check_time(bench, found, since, timeout_ms, "VD-SCR-01")
    bench.check_repeated(_DELETE, name, count, 0, "VD-SCR-04")
    _check_no_trace(bench, name, found)


def _create_own(bench: Bench, name: int, timeout_ms: int, count: int = 1) -> int:
    """Let the application create a variable; the time just before."""
    since = bench.now()
    bench.must("RTDB-Create", **create_request(bench, name, rep_cnt=count, timeout=timeout_ms))
    return since


@case(
    "TC_VD_SCR_TI_03",
    "A variable with timeout 0 is never deleted",
    requirements="VD-SCR-02",
    stimulus="two variables are created at once, one with timeout 0 and one with 300 ms; then silence",
    expect="when the other has been deleted and two more scrubbing periods have passed, it is still summarised",
    window=40,
    needs=_WIRE,
)
def timeout_zero(bench: Bench) -> None:
    period_ms = _hurry(bench)
    peer, name, other = bench.peer(), bench.var_id(), bench.var_id()
    since = bench.now()
    peer.send(peer.create(name, timeout=0), peer.create(other, timeout=300))
    if _deleted(bench, other, since, 300) is None:
        bench.reading("X26", "producer-only")
    bench.wait_ns(2 * period_ms * MS)
    found = bench.instructions(_DELETE, name)
    bench.check(not found, "no VarDelete of a variable with timeout 0", f"{len(found)}", frames=found[:4])
    _check_known(bench, name, "VD-SCR-02")


def _check_known(bench: Bench, name: int, *requirements: str) -> None:
    """Whether a variable lives: who requests it gets its VarCreate."""
    peer = bench.peer()
    peer.send(peer.request_create(name))
    found = bench.until_instruction(ICType.CREATE_VARIABLES, name)
    bench.check(found, "the variable lives: its VarCreate answers a request", "no answer", *requirements)


@case(
    "TC_VD_SCR_TI_04",
    "Updates keep a variable alive at a consumer; when they end, it is deleted in time",
    requirements="VD-SCR-03 VD-SCR-06 VD-SCR-01",
    stimulus="a variable with timeout 600 ms is updated every 200 ms for two timeouts and a scrubbing period",
    expect="no VarDelete meanwhile; one in time behind the last update",
    window=60,
    needs=_WIRE,
)
def kept_by_updates(bench: Bench) -> None:
    period_ms, scale = _hurry(bench), bench.session.timing_scale
    peer, name, timeout_ms = bench.peer(), bench.var_id(), round(600 * scale)
    _learn(bench, peer, name, timeout_ms)
    until = bench.now() + (2 * timeout_ms + period_ms) * MS
    number, since = 0, 0
    slowest = 0
    while bench.now() < until:
        before = since
        number, since = number + 1, bench.now()
        peer.send(peer.update(name, number, bytes((number,))))
        slowest = max(slowest, since - before) if before else 0
        bench.wait_ns(timeout_ms * MS // 3)
    early = bench.instructions(_DELETE, name)
    if early and slowest > timeout_ms * MS * 3 // 4:
        bench.inconclusive("updates in time", f"the tester was late: {slowest / MS:.0f} ms between two of them")
    bench.check(
        not early, "no VarDelete of a variable that is updated in time", f"{len(early)}", "VD-SCR-03", "VD-SCR-06"
    )
    if early:
        return
    found = _deleted(bench, name, since, timeout_ms)
    if found is None:
        _not_by_consumers(bench, name)
        return
    _check_time(bench, found, since, timeout_ms, "VD-SCR-01", "VD-SCR-06")


@case(
    "TC_VD_SCR_TI_05",
    "Updates of its application keep a variable alive at the producer",
    requirements="VD-SCR-03",
    stimulus="the application updates a variable with timeout 600 ms every 200 ms for two timeouts, then no more",
    expect="no VarDelete meanwhile; one in time behind the last update",
    window=60,
    needs=_OWN,
)
def kept_by_the_application(bench: Bench) -> None:
    period_ms = _hurry(bench)
    name, timeout_ms = bench.var_id(), round(600 * bench.session.timing_scale)
    _create_own(bench, name, timeout_ms)
    until = bench.now() + (2 * timeout_ms + period_ms) * MS
    since = bench.now()
    while bench.now() < until:
        if not bench.call("RTDB-Update", varId=name, value="01").ok:
            # If it is because the variable was deleted, the next beacons tell.
            bench.wait(bench.reaction)
            break
        since = bench.now()
        bench.wait_ns(timeout_ms * MS // 3)
    early = bench.instructions(_DELETE, name)
    bench.check(not early, "no VarDelete of a variable that is updated in time", f"{len(early)}", frames=early[:2])
    if early:
        return
    found = _deleted(bench, name, since, timeout_ms)
    if found is None:
        bench.fail("a VarDelete behind the last update", f"none in {_latest(bench, timeout_ms) / MS:.0f} ms")
    took = found.heard.time - since
    # A request takes a while to arrive: only what is clearly too early is.
    what = f"the VarDelete at least {timeout_ms} ms after the last update"
    bench.check(took >= timeout_ms * MS * 0.95, what, f"{took / MS:.0f} ms", frames=[found])


def _equal(peer: Peer, name: int) -> None:
    peer.send(peer.update(name, 5, b"another"))


def _older(peer: Peer, name: int) -> None:
    peer.send(peer.update(name, 4, b"older"))


def _summary(peer: Peer, name: int) -> None:
    peer.send(peer.summary(name, 5))


def _request(peer: Peer, name: int) -> None:
    peer.send(peer.request_create(name), peer.request_update(name, 3))


@case(
    "TC_VD_SCR_TI_06",
    "What changes nothing does not keep a variable alive: {variant}",
    requirements="VD-SCR-06 VD-SCR-01",
    stimulus="a variable with timeout 500 ms is created; every 150 ms comes something that brings nothing new",
    expect="the VarDelete in time behind the creation",
    window=40,
    needs=_WIRE,
    variants={"equal-update": _equal, "older-update": _older, "summary": _summary, "request": _request},
)
def not_kept(bench: Bench, act: Callable[[Peer, int], None]) -> None:
    _hurry(bench)
    peer, name, silent, timeout_ms = bench.peer(), bench.var_id(), bench.var_id(), 500
    since = bench.now()
    peer.send(peer.create(name, seqno=5, timeout=timeout_ms), peer.create(silent, timeout=timeout_ms))
    deadline = since + _latest(bench, timeout_ms)
    while bench.now() < deadline and not bench.instructions(_DELETE, name):
        bench.wait_ns(150 * MS)
        if not bench.instructions(_DELETE, name):
            act(peer, name)
    found = bench.instructions(_DELETE, name)
    if not found and not bench.instructions(_DELETE, silent):
        # With X26 read the other way nothing can be said.
        _not_by_consumers(bench, name)
        return
    bench.require(found, "a VarDelete of it, as of the variable of which nothing was said", "none in time")
    _check_time(bench, found[0], since, timeout_ms)


@case(
    "TC_VD_SCR_TI_07",
    "A deleted variable is not deleted again when its timeout has passed",
    requirements="VD-SCR-02",
    stimulus="two variables with timeout 400 ms are created, and one of them is at once deleted by a VarDelete",
    expect="exactly repCnt VarDeletes of it, also when the other one has been deleted by scrubbing",
    window=30,
    needs=_WIRE,
)
def deleted_skipped(bench: Bench) -> None:
    _hurry(bench)
    peer, name, other, count = bench.peer(), bench.var_id(), bench.var_id(), bench.rep_cnt(2)
    _learn(bench, peer, name, 400, count)
    since = _learn(bench, peer, other, 400)
    peer.send(peer.delete(name))
    if _deleted(bench, other, since, 400) is None:
        bench.reading("X26", "producer-only")
    bench.beacons(2)
    found = bench.instructions(_DELETE, name)
    text = f"{len(found)}"
    bench.check(len(found) == count, f"{count} VarDeletes, none for the timeout", text, frames=found[-4:])


@case(
    "TC_VD_SCR_TI_08",
    "A re-creation starts the timeout anew, with its own value",
    requirements="VD-SCR-03 VD-SCR-05 VD-SCR-01",
    stimulus="a variable with timeout 300 ms is deleted by scrubbing; then it is created anew with timeout 900 ms",
    expect="a second VarDelete in time behind the second creation, not before",
    window=60,
    needs=_WIRE,
)
def created_anew(bench: Bench) -> None:
    _hurry(bench)
    peer, name = bench.peer(), bench.var_id()
    first = _learn(bench, peer, name, 300)
    if _deleted(bench, name, first, 300) is None:
        _not_by_consumers(bench, name)
        return
    bench.repeated(_DELETE, name, 0)
    mark = bench.mark()
    second = _learn(bench, peer, name, 900)
    left = second + _latest(bench, 900) - bench.now()
    found = bench.until_instruction(_DELETE, name, left / bench.period)
    bench.require(found, "a VarDelete behind the second creation", "none in time", "VD-SCR-05")
    _check_time(bench, bench.instructions(_DELETE, name, mark)[0], second, 900, "VD-SCR-03", "VD-SCR-01")


@case(
    "TC_VD_SCR_TI_09",
    "A timeout takes back what is still to be repeated",
    requirements="VD-SCR-04",
    stimulus="a variable with many repetitions and timeout 1 ms is created",
    expect="behind the first VarDelete neither VarCreate nor summary; exactly repCnt VarDeletes",
    window=40,
    needs=_WIRE,
)
def takes_back(bench: Bench) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.rep_cnt(15)
    since = bench.now()
    peer.send(peer.create(name, timeout=1, rep_cnt=count))
    found = _deleted(bench, name, since, 1)
    if found is None:
        _not_by_consumers(bench, name)
        return
    bench.check_repeated(_DELETE, name, count, 0)
    _check_no_trace(bench, name, found)


@case(
    "TC_VD_SCR_TI_10",
    "Scrubbing looks at all variables: several that time out together are all deleted",
    requirements="VD-SCR-01 VD-SCR-05",
    stimulus="twelve variables of four producers with timeouts of 100 to 650 ms are created, and three with timeout 0",
    expect="a VarDelete of each of the twelve in time, none of the three",
    window=40,
    needs=_WIRE,
)
def all_variables(bench: Bench) -> None:
    _hurry(bench)
    peers = [bench.peer() for _ in range(4)]
    names = bench.var_ids(12)
    kept = bench.var_ids(3)
    since = bench.now()
    timeouts = {name: 100 + 50 * number for number, name in enumerate(names)}
    for number, peer in enumerate(peers):
        mine = [peer.create(each, timeout=timeouts[each]) for each in names[number::4]]
        peer.send_all([*mine, *(peer.create(each) for each in kept[number : number + 1])])
    deadline = since + _latest(bench, max(timeouts.values()))
    bench.until(
        lambda _: {each.var_id for each in bench.instructions(_DELETE)} >= set(names),
        (deadline - bench.now()) / bench.period,
    )
    deleted = {each.var_id for each in bench.instructions(_DELETE)}
    if not deleted & set(names):
        _not_by_consumers(bench, names[0])
        return
    missing = sorted(set(names) - deleted)
    text = f"none of {', '.join(map(str, missing))}"
    bench.check(not missing, "a VarDelete of every variable whose time has run out", text, "VD-SCR-05")
    for name in sorted(deleted & set(names)):
        _check_time(bench, bench.instructions(_DELETE, name)[0], since, timeouts[name], "VD-SCR-01")
    wrong = sorted(deleted & set(kept))
    bench.check(not wrong, "no VarDelete of the others", f"of {wrong}", "VD-SCR-05")


@case(
    "TC_VD_SCR_TI_11",
    "With a short scrubbing period a variable lives not much longer than its timeout",
    requirements="VD-SCR-01 VD-SCR-03",
    stimulus="VARDISPAR_SCRUBBING_PERIOD = 100 ms; the application creates a variable with timeout 1000 ms",
    expect="the first VarDelete 1000 ms to 1100 ms later, plus tolerance and a reaction",
    window=60,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "UT-Reset", "VD-SetParameter")),
)
def not_much_longer(bench: Bench) -> None:
    first, scale = scrubbing_period_ms(bench), bench.session.timing_scale
    bench.must("VD-SetParameter", name="VARDISPAR_SCRUBBING_PERIOD", value=round(100 * scale))
    # The period that has begun may run to its end.
    bench.wait_ns(first * MS)
    name, timeout_ms = bench.var_id(), round(1000 * scale)
    since = _create_own(bench, name, timeout_ms)
    tolerance = bench.pixit.timer_tolerance_ms * scale
    most = round((timeout_ms + 100 * scale + tolerance) * MS + bench.reaction * bench.period)
    bench.until_instruction(_DELETE, name, 2 * most / bench.period)
    found = next(iter(bench.instructions(_DELETE, name)), None)
    if found is None:
        bench.fail("a VarDelete of the own variable", f"none in {2 * most / MS:.0f} ms", "VD-SCR-01")
    took = found.heard.time - since
    what = f"the VarDelete {timeout_ms} ms to {most / MS:.0f} ms after the creation"
    bench.check((timeout_ms - 2) * MS <= took <= most, what, f"{took / MS:.0f} ms", frames=[found])
