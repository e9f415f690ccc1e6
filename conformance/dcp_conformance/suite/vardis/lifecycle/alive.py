"""dcp-vardis.md: Scrubbing Process.

VarCreates that restart a timeout and those that do not, instructions cancelled by a timeout, and the effect of
deactivation.
"""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate
from dcp_conformance.definitions.case import TIMES_DELETION, Needs, Variant, case
from dcp_conformance.test_steps.services import created_again, described, several_repetitions
from dcp_conformance.test_steps.timeouts import (
    Change,
    check_not_kept,
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
    sent,
    shorten_scrubbing,
    updated_in_time,
)
from dcp_conformance.test_steps.variable_queries import ask, check_state
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_SUMMARY = ICType.SUMMARIES
_WIRE = Needs(since=SpecVersion.V2_0)
_OWN = Needs(since=SpecVersion.V2_0, ut=("RTDB-Create",))
_MANAGE = ("VD-MGMT-Activate", "VD-MGMT-Deactivate")


def _earlier(peer: Peer, record: VarCreate) -> VarCreate:
    spec = record.spec
    assert spec.creation_time is not None
    return peer.create(spec.var_id, seqno=9, timeout=spec.timeout or 0, creation_time=spec.creation_time - 1)


@case(
    "TC_VD_SCR_TI_13",
    "A VarCreate that is not later does not extend the life of a variable ({variant})",
    requirements="VD-SCR-06 VD-PC-01 VD-SCR-01",
    stimulus="a variable with timeout 500 ms is created; then another VarCreate every 150 ms ({variant})",
    expect="the VarDelete within the time allowed after the creation",
    window=40,
    needs=_WIRE,
    variants={"the-same-VarCreate": lambda _, record: record, "an-earlier-VarCreate": _earlier},
)
def not_kept_by_creates(bench: Bench, make: Callable[[Peer, VarCreate], VarCreate]) -> None:
    check_not_kept(bench, lambda peer, record: peer.send(make(peer, record)), "VarCreates")


@case(
    "TC_VD_SCR_TI_14",
    "A renewed creation of a variable restarts its timeout ({variant})",
    requirements="VD-SCR-03 VD-SCR-01",
    alone=TIMES_DELETION,
    stimulus=(
        "a variable with timeout 900 ms is created ({variant}), and again after two thirds of it; then no more records"
    ),
    expect="the VarDelete within the time allowed after the second creation, and not earlier",
    window=60,
    needs=_WIRE,
    variants={
        "received": Variant(False, requirements="VD-SCR-03 VD-SCR-01 VD-PC-07"),
        "own": Variant(True, requirements="VD-SCR-03 VD-SCR-01 VD-CRE-10", needs=_OWN),
    },
)
def restarted_timeout(bench: Bench, own: bool) -> None:
    shorten_scrubbing(bench)
    peer, name = bench.peer(), bench.identifiers.own_var_id() if own else bench.var_id()
    timeout_ms = max(lasting(bench, 900, 8), round(4 * bench.session.slow_call / MS))
    first = create_own(bench, name, timeout_ms) if own else learn(bench, peer, name, timeout_ms)
    bench.waiting.wait_ns(max(0, first.before + timeout_ms * MS * 2 // 3 - bench.now()))
    if own:
        before = bench.now()
        created_again(bench, name, timeout=timeout_ms)
        since = Change(before, bench.now())
    else:
        since = learn(bench, peer, name, timeout_ms)
    if since.after - first.before >= timeout_ms * MS:
        bench.inconclusive("a second creation within the timeout", "it took longer")
    found = deleted(bench, name, since, timeout_ms)
    if found is None and not own:
        not_by_consumers(bench, name)
        return
    found = bench.required(found, "a VarDelete of the variable", "VD-SCR-01")
    took, requirements = found.heard.time - since.before, bench.case.requirements
    check_time(bench, found, since, timeout_ms, *(requirements if took < (timeout_ms - 2) * MS else ("VD-SCR-01",)))


@case(
    "TC_VD_SCR_TI_16",
    "A timeout cancels the pending repetitions of an update and resets the counters",
    requirements="VD-SCR-04",
    stimulus="a variable with many repetitions and a timeout is created and updated; then no more records",
    expect="after the first VarDelete no VarUpdate, VarCreate or summary; countUpdate and countCreate are 0",
    window=75,
    needs=Needs(since=SpecVersion.V2_0, when=several_repetitions),
)
def update_cancelled(bench: Bench) -> None:
    former = scrubbing_period_ms(bench)
    if shorten_scrubbing(bench) < former:
        # The former period may still run to its end, and the repetitions with it.
        bench.waiting.wait_ns(round(1.1 * former * MS))
    peer, name, count, timeout_ms = bench.peer(), bench.var_id(), bench.sut.rep_cnt(15), lasting(bench, 100)
    peer.send(peer.create(name, timeout=timeout_ms, rep_cnt=count))
    since = sent(bench, peer, peer.update(name, 1))
    found = deleted_by_consumer(bench, name, since, timeout_ms)
    entry = {}
    if bench.services.offers("RTDB-DescribeVariable"):
        entry = described(bench.must("RTDB-DescribeVariable", varId=name))
    for counter in ("countCreate", "countUpdate"):
        bench.answered(entry.get(counter, 0), 0, counter)
    bench.check_repeated(_DELETE, name, count, 0)
    begun = bench.heard.index(found.heard)
    for kind in (_UPDATE, _CREATE, _SUMMARY):
        bench.none(bench.instructions(kind, name, begun), f"no {kind.label} record after the first VarDelete")
    if len(bench.instructions(_UPDATE, name)) - len(bench.instructions(_UPDATE, name, begun)) >= count:
        bench.verdicts.not_applicable("all repetitions of the update were sent before the VarDelete")


@case(
    "TC_VD_SCR_TI_17",
    "A long timeout is not truncated ({variant} ms)",
    requirements="VD-TYP-04 VD-SCR-03",
    stimulus="a variable with timeout {variant} ms is created; then no more records for two scrubbing periods",
    expect="no VarDelete: the variable still exists",
    window=40,
    needs=_WIRE,
    variants={"32767": 32_767, "32768": 32_768, "65535": 65_535},
)
def long_timeout(bench: Bench, timeout_ms: int) -> None:
    period = shorten_scrubbing(bench)
    peer, name = bench.peer(), bench.var_id()
    learn(bench, peer, name, timeout_ms)
    bench.waiting.wait_ns(round((2 * period + (bench.sut.pixit.timer_tolerance_ms * bench.session.timing_scale)) * MS))
    bench.beacons(2)
    bench.none(bench.instructions(_DELETE, name), "no VarDelete of the variable")
    held = ask(bench, name)
    check_state(bench, held, "alive", "state of the variable")


@case(
    "TC_VD_SCR_TI_18",
    "Scrubbing continues after a deactivation",
    requirements="VD-SCR-01 VD-MGT-05",
    stimulus="VD-MGMT-Deactivate, VD-MGMT-Activate; the application creates a variable with timeout 300 ms",
    expect="its VarDelete within the time allowed",
    window=40,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", *_MANAGE)),
)
def after_deactivation(bench: Bench) -> None:
    shorten_scrubbing(bench)
    with bench.services.deactivated("VD"):
        bench.wait(3)
    name, timeout_ms = bench.identifiers.own_var_id(), 300
    since = create_own(bench, name, timeout_ms)
    found = deleted_by_producer(bench, name, since, timeout_ms)
    check_time(bench, found, since, timeout_ms, "VD-SCR-01")


@case(
    "TC_VD_SCR_TI_19",
    "A variable that times out while VarDis is inactive is deleted; the case reports how soon (X36)",
    requirements="VD-SCR-01",
    stimulus=(
        "the application creates a variable with timeout 300 ms; VarDis is inactive until the timeout and a "
        "scrubbing period have passed; then VD-MGMT-Activate"
    ),
    expect="no VarDelete while VarDis is inactive; one within a scrubbing period after activation",
    window=60,
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", *_MANAGE)),
)
def while_inactive(bench: Bench) -> None:
    period = shorten_scrubbing(bench)
    # The variable must still exist when VarDis is deactivated.
    name, timeout_ms = bench.identifiers.own_var_id(), updated_in_time(bench, 300)
    since = create_own(bench, name, timeout_ms)
    with bench.services.deactivated("VD"):
        bench.waiting.wait_ns(max(0, since.after + latest(bench, timeout_ms) - bench.now()))
        mark = bench.mark()
    activated = bench.now()
    tolerance = bench.sut.pixit.timer_tolerance_ms * bench.session.timing_scale
    most = (period + tolerance) * MS / bench.period + bench.sut.reaction
    bench.required(
        bench.until_instruction(_DELETE, name, most) or bench.instructions(_DELETE, name, mark),
        "a VarDelete of the node's own variable after the activation",
    )
    took = bench.instructions(_DELETE, name)[0].heard.time - activated
    at_once = took <= 2.5 * bench.period and period * MS > 3 * bench.period
    bench.info(
        "When is a variable deleted that timed out while VarDis was inactive? (X36)",
        f"{took / MS:.0f} ms after the activation" + (", as if scrubbing had continued" if at_once else ""),
    )
