"""dcp-vardis.md: Scrubbing Process: many variables, creations after an expiry, and each kind of change."""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.suite.vardis.composition.summaries import summarises
from dcp_conformance.test_steps.services import (
    NOT_PRODUCER,
    create_request,
    created_again,
    entry_of,
    listed,
    parameters_set,
    produced,
    several_repetitions,
)
from dcp_conformance.test_steps.timeouts import (
    Change,
    check_time,
    create_own,
    deleted,
    deleted_by_consumer,
    lasting,
    latest,
    learn,
    not_by_consumers,
    scrubbing_period_ms,
    sent,
    shorten_scrubbing,
)
from dcp_conformance.test_steps.variable_queries import teach_variables
from dcp_conformance.test_system.bench import MS, Bench

_CREATE, _DELETE, _SUMMARY = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.SUMMARIES
_PERIOD = "VARDISPAR_SCRUBBING_PERIOD"
_WIRE = Needs(SpecVersion.V2_0)
_OWN = Needs(SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Update"))
#: ms. Twice as long is later than any tolerance of a check.
_LONG = 4_000
#: Received and own variables that expire together, and others beside them.
_CROWD, _OWNED, _OTHERS = 60, 20, 10


@case(
    "TC_VD_SCR_TI_20",
    "Each kind of variable is deleted after its own timeout ({variant})",
    requirements="VD-SCR-01 VD-SCR-03 VD-SCR-05",
    stimulus=(
        f"a variable with timeout {_LONG} ms ({{variant}}), updated after its creation, or two more a scrubbing "
        "period apart; then no more records"
    ),
    expect="each first VarDelete neither before the timeout since the last change, nor later than allowed",
    window=110,
    variants={
        "received": Variant((False, ""), needs=_WIRE),
        "received-and-updated": Variant((False, "updated"), requirements="VD-SCR-01 VD-SCR-03 VD-SCR-06", needs=_WIRE),
        "received-and-update-rejected": Variant(
            (False, "rejected"),
            requirements="VD-SCR-01 VD-SCR-03 VD-UPD-03",
            needs=Needs(SpecVersion.V2_0, ut=("RTDB-Update",)),
        ),
        "own": Variant((True, ""), needs=_OWN),
        "own-and-updated": Variant((True, "updated"), requirements="VD-SCR-01 VD-SCR-03 VD-UPD-08", needs=_OWN),
    },
)
def kinds(bench: Bench, what: tuple[bool, str]) -> None:
    own, then = what
    timeout_ms, peer = lasting(bench, _LONG), bench.peer()
    changes: dict[int, Change] = {}
    # If scrubbing is too rare, one of three variables is deleted too late, whenever the traversals are.
    for _ in range(1 if then else 3):
        if changes:
            bench.waiting.wait_ns(scrubbing_period_ms(bench) * MS)
        name = bench.identifiers.own_var_id() if own else bench.var_id()
        changes[name] = create_own(bench, name, timeout_ms) if own else learn(bench, peer, name, timeout_ms)
    if then == "rejected":
        bench.waiting.wait_ns(timeout_ms * MS * 3 // 4)
        bench.expect_status(NOT_PRODUCER, "RTDB-Update", "VD-UPD-03", varId=name, value="77")
    elif then:
        bench.wait(2)
        before = bench.now()
        if own:
            bench.must("RTDB-Update", varId=name, value="77")
            changes[name] = Change(before, bench.now())
        else:
            changes[name] = sent(bench, peer, peer.update(name, 1, b"w"))
    for each, since in changes.items():
        found = deleted(bench, each, since, timeout_ms)
        if found is None and not own:
            # A node that deletes only its own variables (X26) does not delete this one later either.
            found = deleted(bench, each, Change(bench.now(), bench.now()), timeout_ms)
            if found is None:
                not_by_consumers(bench, each)
                return
        if found is None:
            bench.some(None, "a VarDelete of the variable", seen=f"none in {latest(bench, timeout_ms) / MS:.0f} ms")
            return
        check_time(bench, found, since, timeout_ms)


@case(
    "TC_VD_SCR_TI_25",
    "The timeout of a received variable begins with its reception, whatever its creationTime ({variant})",
    requirements="VD-SCR-03 VD-PC-07",
    stimulus=f"a variable with timeout {_LONG} ms and a creationTime {{variant}}; then no more records",
    expect="the first VarDelete neither before the timeout since the reception, nor later than allowed",
    window=60,
    needs=_WIRE,
    variants={"an-hour-ago": -1, "in-an-hour": 1},
)
def since_reception(bench: Bench, hours: int) -> None:
    # The identifier may have a later creationTime than others for an hour: no other case must use it.
    timeout_ms, peer, name = lasting(bench, _LONG), bench.peer(), bench.unknown_id()
    stamp = bench.records.current_time(hours)
    before = bench.now()
    bench.learn(peer, peer.create(name, timeout=timeout_ms, creation_time=stamp))
    since = Change(before, bench.now())
    check_time(bench, deleted_by_consumer(bench, name, since, timeout_ms), since, timeout_ms)


@case(
    "TC_VD_SCR_TI_26",
    "Creations of other variables do not postpone scrubbing",
    requirements="VD-SCR-01 VD-SCR-04",
    stimulus="RTDB-Create with a short timeout; then RTDB-Create of another variable, three times per scrubbing period",
    expect="the first VarDelete of the first variable in time",
    window=60,
    needs=Needs(
        SpecVersion.V2_0,
        ut=("RTDB-Create",),
    ),
)
def not_postponed(bench: Bench) -> None:
    period_ms = shorten_scrubbing(bench)
    timeout_ms, other = lasting(bench, 200), bench.identifiers.own_var_id()
    name = bench.identifiers.own_var_id()
    since = create_own(bench, name, timeout_ms)
    # Twice as long as allowed, so that a node that waits for the last creation is late in any case.
    end = since.after + 2 * latest(bench, timeout_ms)
    while bench.now() < end and not bench.instructions(_DELETE, name):
        bench.call("RTDB-Create", **create_request(bench, other))
        bench.waiting.wait_ns(period_ms * MS // 3)
    found = next(iter(bench.instructions(_DELETE, name)), None)
    if found is None:
        bench.some(None, "a VarDelete of the variable", seen=f"none in {2 * latest(bench, timeout_ms) / MS:.0f} ms")
        return
    check_time(bench, found, since, timeout_ms)


def _holds(count: int) -> Callable[[Bench], str | None]:
    return lambda bench: bench.sut.lacks("variables", count + 2 * _OTHERS) or None


@case(
    "TC_VD_SCR_TI_21",
    "Many variables that time out together are deleted together, and no others ({variant})",
    requirements="VD-SCR-01 VD-SCR-02 VD-SCR-03 VD-SCR-05",
    stimulus=(
        f"ten variables with timeout 0 or the longest, {_CROWD} received variables or {_OWNED} own ones "
        f"({{variant}}) with a timeout of 300 ms, and ten others again"
    ),
    expect="VarDeletes of all those within the time allowed, and of no others",
    window=60,
    variants={
        "received": Variant(_CROWD, needs=Needs(SpecVersion.V2_0, when=_holds(_CROWD))),
        "own": Variant(0, needs=Needs(SpecVersion.V2_0, ut=("RTDB-Create",), when=_holds(_OWNED))),
    },
)
def crowd(bench: Bench, count: int) -> None:
    shorten_scrubbing(bench)
    # All must be forwarded before the first of them times out.
    timeout_ms = lasting(bench, 300, 8 + round(2 * bench.teaching.periods(count)))
    longest = min(bench.sut.longest_timeout, 60_000)
    peer, others = bench.peer(), bench.identifiers.var_ids(2 * _OTHERS)
    stay = [peer.create(each, value=b"v", descr=b"d", timeout=place % 2 * longest) for place, each in enumerate(others)]
    teach_variables(bench, peer, stay[:_OTHERS])
    before = bench.now()
    if count:
        names = bench.identifiers.var_ids(count)
        teach_variables(bench, peer, [peer.create(each, value=b"v", descr=b"d", timeout=timeout_ms) for each in names])
    else:
        names = [produced(bench, value=b"v", descr="d", timeout=timeout_ms) for _ in range(_OWNED)]
    since = Change(before, bench.now())
    peer.send_all(stay[_OTHERS:])
    wanted, end = set(names), since.after + latest(bench, timeout_ms)
    bench.until(
        lambda _: wanted <= {each.var_id for each in bench.instructions(_DELETE)}, (end - bench.now()) / bench.period
    )
    found = {each.var_id for each in bench.instructions(_DELETE)}
    if count and not found & wanted:
        not_by_consumers(bench, names[0])
        return
    bench.complete(sorted(wanted - found), f"VarDeletes of the {len(names)} variables", "VD-SCR-01", "VD-SCR-05")
    wrong = [each for each in bench.instructions(_DELETE) if each.var_id in others]
    bench.none(wrong, "no VarDelete of the others", "VD-SCR-02", "VD-SCR-03")


@case(
    "TC_VD_SCR_TI_22",
    "A variable that is created again after its timeout is as new ({variant})",
    requirements="VD-SCR-04 VD-CRE-11 VD-PC-02",
    stimulus=(
        "a variable with many repetitions and a short timeout; at its first VarDelete it is created again "
        "({variant}) with a long timeout"
    ),
    expect=(
        "VarCreates with the new timeout, and no VarDelete after the first of them; summaries; alive in the database"
    ),
    window=60,
    variants={
        "by-another-node": Variant(False, requirements="VD-SCR-04 VD-PC-02 VD-PC-07 VD-PC-08", needs=_WIRE),
        "by-its-application": Variant(True, requirements="VD-SCR-04 VD-CRE-03 VD-CRE-10 VD-CRE-11", needs=_OWN),
    },
)
def as_new(bench: Bench, own: bool) -> None:
    shorten_scrubbing(bench)
    peer, count = bench.peer(), bench.sut.rep_cnt(15)
    timeout_ms = lasting(bench, 200)
    longer_ms = min(bench.sut.longest_timeout, max(30_000, 8 * timeout_ms))
    name = bench.identifiers.own_var_id() if own else bench.var_id()
    since = create_own(bench, name, timeout_ms, count) if own else learn(bench, peer, name, timeout_ms, count)
    deleted_by_consumer(bench, name, since, timeout_ms)
    start, recreated = bench.mark(), bench.now()
    again, descr = bench.sut.rep_cnt(4), bench.records.descr(b"once more")
    if own:
        created_again(bench, name, rep_cnt=again, descr=descr.decode(), timeout=longer_ms)
    else:
        peer.send(peer.create(name, rep_cnt=again, descr=descr, timeout=longer_ms))
    made = bench.required(bench.until_instruction(_CREATE, name), "a VarCreate of the new creation")
    begun = next(place for place, each in enumerate(bench.heard[start:], start) if each.about(_CREATE, name) is made)
    spec = made.spec
    bench.answered((spec.timeout, spec.rep_cnt, spec.descr), (longer_ms, again, descr), "timeout, repCnt and descr")
    bench.check_repeated(_CREATE, name, again, begun)
    # Longer than the first timeout, but shorter than the second one.
    until = recreated + min(max(4 * timeout_ms, 1_000), longer_ms * 3 // 4) * MS
    bench.waiting.wait_ns(max(0, until - bench.now()))
    bench.none(bench.instructions(_DELETE, name, begun), "no VarDelete after the VarCreate")
    if summarises(bench) is None:
        bench.some(bench.instructions(_SUMMARY, name, begun), "a summary of the variable", "VD-SCR-04")


@case(
    "TC_VD_SCR_TI_23",
    "Variables that scrubbing has deleted are described like others that are deleted",
    requirements="VD-DDB-02 VD-SCR-04 VD-DB-02 VD-DVA-03",
    stimulus="a received variable and an own one time out; RTDB-DescribeDatabase, RTDB-DescribeVariable",
    expect="both in the list; isDeleted true in their entries",
    window=40,
    needs=Needs(SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-DescribeDatabase", "RTDB-DescribeVariable")),
)
def described(bench: Bench) -> None:
    shorten_scrubbing(bench)
    timeout_ms, peer, name = lasting(bench, 200), bench.peer(), bench.var_id()
    learn(bench, peer, name, timeout_ms)
    own = bench.identifiers.own_var_id()
    since = create_own(bench, own, timeout_ms)
    bench.required(deleted(bench, own, since, timeout_ms), "a VarDelete of the own variable", "VD-SCR-01")
    names = [own, name] if bench.instructions(_DELETE, name) else [own]
    found = listed(bench)
    bench.none([each for each in names if each not in found], "the deleted variables in the list", "VD-DDB-02")
    for each in names:
        bench.fields(entry_of(bench, each) or {}, "VD-DVA-03 VD-SCR-04 VD-DB-02", isDeleted=True)


@case(
    "TC_VD_SCR_TI_24",
    "A shorter VARDISPAR_SCRUBBING_PERIOD applies at once, and a timeout also while records are repeated",
    requirements="VD-PAR-01 VD-SCR-01 VD-SCR-03 VD-SCR-04",
    stimulus=(
        "VARDISPAR_SCRUBBING_PERIOD = 65000 ms, and after the former period 100 ms; the application creates a variable "
        "with the most repetitions and a timeout of three beacon periods"
    ),
    expect="a VarDelete in time",
    window=60,
    needs=Needs(SpecVersion.V2_0, ut=("RTDB-Create", "UT-Reset", "VD-SetParameter"), when=several_repetitions),
)
def shorter_period(bench: Bench) -> None:
    first, scale = scrubbing_period_ms(bench), bench.session.timing_scale
    period_ms = round(100 * scale)
    with parameters_set(bench, "VD", **{_PERIOD: 65_000}):
        # The former period may still run to its end; the long one must have begun.
        bench.waiting.wait_ns(round(1.1 * first * MS))
        bench.must("VD-SetParameter", name=_PERIOD, value=period_ms)
        count, timeout_ms = bench.sut.rep_cnt(15), round(3 * bench.period / MS)
        name = bench.identifiers.own_var_id()
        since = create_own(bench, name, timeout_ms, count)
        tolerance = bench.sut.pixit.timer_tolerance_ms * scale
        most = round((timeout_ms + period_ms + tolerance) * MS + bench.sut.reaction * bench.period)
        bench.until_instruction(_DELETE, name, 3 * most / bench.period)
        found = bench.required(next(iter(bench.instructions(_DELETE, name)), None), "a VarDelete of the variable")
        least, took = (timeout_ms - 2) * MS, found.heard.time - since.before
        most += since.after - since.before
        bench.within(took, least, most, "time until the VarDelete", late="above", unit="ms", frames=[found])


@case(
    "TC_VD_RUN_TI_04",
    "A shorter VARDISPAR_BUFFER_CHECK_PERIOD applies at once, not after a long period that has begun",
    requirements="VD-PAR-01 VD-RUN-02",
    stimulus=(
        "with an empty database VARDISPAR_BUFFER_CHECK_PERIOD = 65000 ms; ten periods later the former value; "
        "RTDB-Create"
    ),
    expect="a VarCreate within ten seconds",
    window=110,
    needs=Needs(ut=("RTDB-Create", "UT-Reset", "VD-SetParameter")),
)
def shorter_check(bench: Bench) -> None:
    bench.must("UT-Reset")
    name = "VARDISPAR_BUFFER_CHECK_PERIOD"
    with parameters_set(bench, "VD", **{name: 65_000}):
        bench.wait(10)
        bench.must("VD-SetParameter", name=name, value=bench.sut.parameter(name))
        var_id, start = bench.identifiers.own_var_id(), bench.mark()
        bench.must("RTDB-Create", **create_request(bench, var_id))
        bench.until_instruction(_CREATE, var_id, 10_000 * MS / bench.period)
        found = bench.instructions(_CREATE, var_id, start)
        bench.some(found, "a VarCreate of the variable", seen="none in 10 s", frames=found[:1], patience=20)
