"""dcp-vardis.md: Scrubbing Process.

Which variables are deleted, when, and which of their records are still sent.
"""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.received import Instruction
from dcp_conformance.test_steps.timeouts import (
    Change,
    check_time,
    create_own,
    deleted,
    deleted_by_consumer,
    deleted_by_producer,
    lasting,
    latest,
    learn,
    not_by_consumers,
    scrubbing_period_ms,
    scrubs,
    sent,
    shorten_scrubbing,
)
from dcp_conformance.test_system.bench import MS, Bench

_DELETE = ICType.DELETE_VARIABLES
_WIRE = Needs(since=SpecVersion.V2_0)
_OWN = Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Update"))


@case(
    "TC_VD_SCR_TI_01",
    "A consumer deletes a variable with timeout {variant} ms at most one scrubbing period after the timeout",
    requirements="VD-SCR-01 VD-SCR-04 VD-SCR-05",
    stimulus="a variable with a timeout is created; then no more records",
    expect="VarDeletes in exactly repCnt beacons, the first within the time allowed; no summary after it",
    window=30,
    needs=_WIRE,
    variants={"200": 200, "1500": 1500},
)
def consumer(bench: Bench, timeout_ms: int) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(3)
    timeout_ms = lasting(bench, timeout_ms, 2)
    since = learn(bench, peer, name, timeout_ms, count)
    found = deleted_by_consumer(bench, name, since, timeout_ms)
    scrubs(bench, by_consumers=True)
    bench.passed("consumers delete variables after their timeout", "VD-SCR-05", frames=[found])
    check_time(bench, found, since, timeout_ms, "VD-SCR-01")
    bench.check_repeated(_DELETE, name, count, 0, "VD-SCR-04")
    _check_no_trace(bench, name, found)


def _check_no_trace(bench: Bench, name: int, found: Instruction) -> None:
    begun = bench.heard.index(found.heard)
    for kind in (ICType.SUMMARIES, ICType.CREATE_VARIABLES, ICType.UPDATES):
        late = bench.instructions(kind, name, begun)
        bench.none(late, f"no {kind.label} record after the first VarDelete", "VD-SCR-04")


@case(
    "TC_VD_SCR_TI_02",
    "A producer deletes its own variable at most one scrubbing period after its timeout",
    requirements="VD-SCR-01 VD-SCR-04 VD-SCR-05 VD-INI-06",
    stimulus="the application creates a variable with timeout 300 ms and does not update it",
    expect="VarDeletes in exactly repCnt beacons, the first within the time allowed; no summary after it",
    window=30,
    needs=_OWN,
)
def producer(bench: Bench) -> None:
    name, count, timeout_ms = bench.identifiers.own_var_id(), bench.sut.rep_cnt(3), 300
    since = create_own(bench, name, timeout_ms, count)
    found = deleted_by_producer(bench, name, since, timeout_ms)
    bench.passed("scrubbing runs from the start", "VD-INI-06", frames=[found])
    check_time(bench, found, since, timeout_ms, "VD-SCR-01")
    bench.check_repeated(_DELETE, name, count, 0, "VD-SCR-04")
    _check_no_trace(bench, name, found)


@case(
    "TC_VD_SCR_TI_03",
    "A variable with timeout 0 is never deleted",
    requirements="VD-SCR-02",
    stimulus="two variables are created at the same time, with timeouts of 0 and 300 ms; then no more records",
    expect="the first variable still exists two scrubbing periods after the other was deleted",
    window=40,
    needs=_WIRE,
)
def timeout_zero(bench: Bench) -> None:
    period_ms = shorten_scrubbing(bench)
    peer, name, other = bench.peer(), bench.var_id(), bench.var_id()
    since = sent(bench, peer, peer.create(name, timeout=0), peer.create(other, timeout=300))
    if deleted(bench, other, since, 300) is None:
        not_by_consumers(bench, other)
    bench.waiting.wait_ns(2 * period_ms * MS)
    bench.none(bench.instructions(_DELETE, name), "no VarDelete of a variable with timeout 0")
    _check_known(bench, name, "VD-SCR-02")


def _check_known(bench: Bench, name: int, *requirements: str) -> None:
    """Check that a variable exists: a request for it is answered with its VarCreate."""
    peer = bench.peer()
    peer.send(peer.request_create(name))
    found = bench.until_instruction(ICType.CREATE_VARIABLES, name)
    bench.some(found, "a VarCreate of the variable in answer to a request", *requirements)


@case(
    "TC_VD_SCR_TI_07",
    "A deleted variable is not deleted again after its timeout",
    requirements="VD-SCR-02",
    stimulus="two variables with timeout 400 ms are created; one of them is deleted immediately by a VarDelete",
    expect="exactly repCnt VarDeletes of it, even after the other one was deleted by scrubbing",
    window=30,
    needs=_WIRE,
)
def deleted_skipped(bench: Bench) -> None:
    shorten_scrubbing(bench)
    peer, name, other, count = bench.peer(), bench.var_id(), bench.var_id(), bench.sut.rep_cnt(2)
    timeout_ms = lasting(bench, 400, 4)
    learn(bench, peer, name, timeout_ms, count)
    since = learn(bench, peer, other, timeout_ms)
    peer.send(peer.delete(name))
    if deleted(bench, other, since, timeout_ms) is None:
        not_by_consumers(bench, other)
    bench.beacons(2)
    bench.repeated(bench.instructions(_DELETE, name), count, "VarDeletes in all")


@case(
    "TC_VD_SCR_TI_09",
    "A timeout cancels remaining repetitions",
    requirements="VD-SCR-04",
    stimulus="a variable with many repetitions and timeout 1 ms is created",
    expect="after the first VarDelete no VarCreate and no summary; exactly repCnt VarDeletes",
    window=40,
    needs=_WIRE,
)
def cancels(bench: Bench) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(15)
    since = sent(bench, peer, peer.create(name, timeout=1, rep_cnt=count))
    found = deleted_by_consumer(bench, name, since, 1)
    bench.check_repeated(_DELETE, name, count, 0)
    _check_no_trace(bench, name, found)


@case(
    "TC_VD_SCR_TI_10",
    "Scrubbing checks all variables: several that time out together are all deleted",
    requirements="VD-SCR-01 VD-SCR-05",
    stimulus=(
        "twelve variables of four producers with timeouts from 100 ms to 650 ms are created, and three with timeout 0"
    ),
    expect="a VarDelete of each of the twelve within the time allowed, and of none of the three",
    window=40,
    needs=_WIRE,
)
def all_variables(bench: Bench) -> None:
    shorten_scrubbing(bench)
    peers = [bench.peer() for _ in range(4)]
    names = bench.identifiers.var_ids(12)
    kept = bench.identifiers.var_ids(3)
    begun = bench.now()
    timeouts = {name: 100 + 50 * number for number, name in enumerate(names)}
    for number, peer in enumerate(peers):
        mine = [peer.create(each, timeout=timeouts[each]) for each in names[number::4]]
        peer.send_all([*mine, *(peer.create(each) for each in kept[number : number + 1])])
    since = Change(begun, bench.now())
    deadline = since.after + latest(bench, max(timeouts.values()))
    bench.until(
        lambda _: {each.var_id for each in bench.instructions(_DELETE)} >= set(names),
        (deadline - bench.now()) / bench.period,
    )
    deleted = {each.var_id for each in bench.instructions(_DELETE)}
    if not deleted & set(names):
        not_by_consumers(bench, names[0])
        return
    bench.complete(sorted(set(names) - deleted), "a VarDelete of each variable after its timeout", "VD-SCR-05")
    for name in sorted(deleted & set(names)):
        check_time(bench, bench.instructions(_DELETE, name)[0], since, timeouts[name], "VD-SCR-01")
    bench.none(sorted(deleted & set(kept)), "no VarDelete of the variables with timeout 0", "VD-SCR-05")


@case(
    "TC_VD_SCR_TI_11",
    "With a short scrubbing period a variable exists only slightly longer than its timeout",
    requirements="VD-SCR-01 VD-SCR-03",
    stimulus=(
        "VARDISPAR_SCRUBBING_PERIOD = 100 ms; the application creates a variable with the former period as timeout, or "
        "1000 ms if that is longer"
    ),
    expect="the first VarDelete at most 100 ms after the timeout, plus tolerance and reaction time",
    window=60,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "UT-Reset", "VD-SetParameter")),
)
def not_much_longer(bench: Bench) -> None:
    first, scale = scrubbing_period_ms(bench), bench.session.timing_scale
    bench.must("VD-SetParameter", name="VARDISPAR_SCRUBBING_PERIOD", value=round(100 * scale))
    # The current scrubbing period may still run to its end, but ends before the timeout.
    name, timeout_ms = bench.identifiers.own_var_id(), max(first, round(1000 * scale))
    since = create_own(bench, name, timeout_ms)
    tolerance = bench.sut.pixit.timer_tolerance_ms * scale
    most = round((timeout_ms + 100 * scale + tolerance) * MS + bench.sut.reaction * bench.period)
    bench.until_instruction(_DELETE, name, 2 * most / bench.period)
    found = bench.required(
        next(iter(bench.instructions(_DELETE, name)), None),
        "a VarDelete of the node's own variable",
        "VD-SCR-01",
        seen=f"none in {2 * most / MS:.0f} ms",
    )
    most += since.after - since.before
    took = found.heard.time - since.before
    what = "time from the creation to the VarDelete"
    bench.within(took, (timeout_ms - 2) * MS, most, what, late="above", unit="ms", frames=[found])
