"""dcp-vardis.md: Runtime."""

from __future__ import annotations

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import LISTENS, Needs, case
from dcp_conformance.suite.vardis.composition.summaries import SUMMARIES, summarises
from dcp_conformance.test_steps.repetitions import check_order
from dcp_conformance.test_system.bench import MS, Bench

CHECK_PERIOD = "VARDISPAR_BUFFER_CHECK_PERIOD"
_CREATE = ICType.CREATE_VARIABLES


@case(
    "TC_VD_RUN_BV_01",
    "While repetitions of a record remain, every beacon has it",
    requirements="VD-RUN-01",
    stimulus="a variable with many repetitions is created",
    expect="its VarCreate in consecutive beacons",
    window=20,
    needs=Needs(
        when=lambda bench: None if bench.sut.rep_cnt(10) >= 3 else "the implementation does not accept repCnt 3"
    ),
)
def no_beacon_without(bench: Bench) -> None:
    peer, name, mark = bench.peer(), bench.var_id(), bench.mark()
    count = bench.sut.rep_cnt(10)
    peer.send(peer.create(name, rep_cnt=count))
    having = bench.required(
        bench.until_quiet(lambda heard: heard.about(_CREATE, name), since=mark), "the VarCreate is forwarded"
    )
    first, last = bench.heard.index(having[0]), bench.heard.index(having[-1])
    idle = [each for each in bench.heard[first : last + 1] if not each.has_vardis]
    text = f"{len(idle)} of {last + 1 - first} beacons without one"
    bench.none(idle, "a VarDis block in every beacon while something is pending", seen=text)
    without = last + 1 - first - len(having)
    text = f"{without} beacons between them without it"
    bench.none(without, f"the VarCreate in {count} consecutive beacons", seen=text, frames=having[:1])


@case(
    "TC_VD_RUN_BV_02",
    "While a variable is known, every beacon has a VarDis block with summaries",
    requirements="VD-RUN-01",
    stimulus="a variable is created; then no more records",
    expect="ten consecutive beacons with a VarDis block",
    window=14,
    needs=Needs(when=summarises),
)
def summaries_in_every_beacon(bench: Bench) -> None:
    peer, name = bench.peer(), bench.var_id()
    bench.learn(peer, peer.create(name))
    frames = bench.beacons(10)
    bench.some(len(frames) == 10, "ten beacons", seen=len(frames))
    bench.none([each for each in frames if not each.has_vardis], "a VarDis block in every beacon")


@case(
    "TC_VD_RUN_BV_03",
    "Payloads are composed as long as there are records to send",
    requirements="VD-RUN-01",
    stimulus="one summary of an unknown variable after the other, each after the request for the one before",
    expect="a request for each of the variables within the implementation's reaction time",
    window=40,
)
def in_succession(bench: Bench) -> None:
    peer = bench.peer()
    for number in range(8):
        unknown = bench.unknown_id()
        peer.send(peer.summary(unknown, 1))
        bench.required(
            bench.until_instruction(ICType.REQUEST_VARCREATES, unknown),
            f"a request for unknown variable {number + 1} of 8",
        )


@case(
    "TC_VD_RUN_TI_01",
    "After a time without payloads, the next one is composed within the buffer check period",
    requirements="VD-RUN-02",
    alone=LISTENS,
    stimulus="no records until no beacon has a VarDis block; then a summary of an unknown variable",
    expect="the request within VARDISPAR_BUFFER_CHECK_PERIOD plus one beacon period",
    window=8,
)
def after_idling(bench: Bench) -> None:
    bench.wait(2.5)
    _check_wake_up(bench, bench.sut.bound(CHECK_PERIOD))


@case(
    "TC_VD_RUN_TI_02",
    "After a time without payloads, the next one is composed within the buffer check period of {variant} ms",
    requirements="VD-RUN-02",
    stimulus=(
        "the buffer check period is set; no records until no beacon has a VarDis block; then a summary of an "
        "unknown variable"
    ),
    expect="the request within {variant} ms plus one beacon period; the same again",
    window=30,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter")),
    variants={"10": 10, "400": 400},
)
def after_idling_with_period(bench: Bench, period_ms: int) -> None:
    bench.must("VD-SetParameter", name=CHECK_PERIOD, value=period_ms)
    for _ in range(2):
        bench.wait(2.5)
        _check_wake_up(bench, period_ms)


def _check_wake_up(bench: Bench, period_ms: int) -> None:
    """Check that VarDis sends a payload in time although BP has none of it."""
    # Without a reset, deletions caused by an earlier case may still be sent.
    bench.until_quiet(lambda heard: heard.has_vardis)
    if any(each.has_vardis for each in bench.wait(1.5)):
        bench.inconclusive("beacons without a VarDis block", "variables from other sources are still summarised")
    unknown, peer = bench.unknown_id(), bench.peer()
    peer.send(peer.summary(unknown, 1))
    started = bench.now()
    # Intervals between beacons vary (jitter), and a slow machine must not cause a failure.
    scale = bench.session.timing_scale
    allowed = round((period_ms + bench.sut.pixit.timer_tolerance_ms) * MS * scale) + round(1.5 * bench.period)
    found = bench.until(
        lambda heard: heard if heard.instructions(ICType.REQUEST_VARCREATES, unknown) else None,
        3 * allowed / bench.period,
    )
    took = (found.time if found is not None else bench.now()) - started
    bench.required(found, f"a request after at most {allowed / MS:.0f} ms", seen=f"none in {3 * allowed / MS:.0f} ms")
    what = f"a beacon with the payload after at most {allowed / MS:.0f} ms (composed within {period_ms} ms)"
    bench.some(took <= allowed, what, seen=f"{took / MS:.0f} ms", frames=bench.heard[-1:])


@case(
    "TC_VD_RUN_BO_01",
    "Inactive VarDis generates no payloads, and continues where it stopped when it is activated",
    requirements="VD-RUN-03",
    stimulus="VarDis is deactivated while it repeats a VarCreate, and activated eight periods later",
    expect=(
        "no VarDis block while VarDis is inactive, except one that BP had already buffered; the case reports how many "
        "of the remaining repetitions follow (X37)"
    ),
    window=40,
    needs=Needs(since=SpecVersion.V1_2, ut=("VD-MGMT-Activate", "VD-MGMT-Deactivate")),
)
def only_while_active(bench: Bench) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(15)
    peer.send(peer.create(name, rep_cnt=count))
    bench.required(bench.until_instruction(_CREATE, name), "the VarCreate is forwarded")
    with bench.services.deactivated("VD"):
        bench.wait(2)
        mark = peer.stimulate(peer.summary(bench.unknown_id(), 1))
        bench.wait(max(6, bench.session.known.processing))
        bench.none([each for each in bench.heard[mark:] if each.has_vardis], "no VarDis block while VarDis is inactive")
    bench.some(bench.probes.probe(), "VarDis answers a probe after its activation")
    if count > 6:
        bench.waiting.repeated(_CREATE, name, 0)
        total = len(bench.instructions(_CREATE, name))
        kept = f"all {count} repetitions" if total == count else f"{total} of {count} repetitions"
        bench.info("What happens to pending records while VarDis is inactive?", f"{kept} were sent")


@case(
    "TC_VD_RUN_BV_04",
    "A payload has the current values at the time of its composition",
    requirements="VD-RUN-01 VD-CMP-09",
    stimulus="a variable is updated ten times, faster than beacons are sent",
    expect="the last VarUpdate in exactly repCnt beacons; sequence numbers do not decrease",
    window=16,
)
def newest_only(bench: Bench) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(3)
    bench.learn(peer, peer.create(name, rep_cnt=count))
    mark = bench.mark()
    for number in range(1, 11):
        peer.send(peer.update(name, number, bytes((number,))))
        bench.wait(0.2)
    found = bench.waiting.repeated(ICType.UPDATES, name, mark)
    numbers = check_order(bench, found, "VD-RUN-01")
    bench.repeated(numbers.count(10), count, "beacons with the last VarUpdate", "VD-CMP-09", frames=found[-4:])


@case(
    "TC_VD_RUN_BV_05",
    "A change of VARDISPAR_MAX_SUMMARIES affects later payloads",
    requirements="VD-PAR-01",
    stimulus="four variables are known; the parameter is set to 1, then to 4",
    expect="payloads with one summary, then with four",
    window=14,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter")),
)
def parameter_takes_effect(bench: Bench) -> None:
    peer, names = bench.peer(), bench.identifiers.var_ids(4)
    bench.learn(peer, *(peer.create(each) for each in names))
    for most in (1, 4):
        bench.must("VD-SetParameter", name=SUMMARIES, value=most)
        # The payload composed before may still be sent.
        bench.beacons(2)
        frames = bench.beacons(2)
        counts = [len(each.instructions(ICType.SUMMARIES)) for each in frames]
        bench.answered(counts, [most] * 2, "summaries in each payload", frames=frames)


def _own_period(bench: Bench, periods: float) -> int:
    """Set the buffer check period to a number of beacon periods; return it in ms. The next case's reset restores it."""
    value = max(1, min(65_000, round(periods * bench.period / MS)))
    bench.must("VD-SetParameter", name=CHECK_PERIOD, value=value)
    return value


@case(
    "TC_VD_RUN_BV_06",
    "The next payload is composed when one was sent, not at the next buffer check",
    requirements="VD-RUN-01",
    stimulus="VARDISPAR_BUFFER_CHECK_PERIOD = 12 beacon periods; then a variable with many repetitions is created",
    expect="the VarCreate in consecutive beacons",
    window=50,
    needs=Needs(
        ut=("UT-Reset", "VD-SetParameter"),
        when=lambda bench: None if bench.sut.rep_cnt(5) >= 3 else "the implementation does not accept repCnt 3",
    ),
)
def composed_when_sent(bench: Bench) -> None:
    _own_period(bench, 12)
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(5)
    peer.send(peer.create(name, rep_cnt=count))
    bench.required(bench.until_instruction(_CREATE, name, 30), "the VarCreate is forwarded")
    bench.wait(count + bench.sut.reaction)
    bench.repeated(bench.receiver.frames_with(_CREATE, name), count, "VarCreates in consecutive beacons")


@case(
    "TC_VD_RUN_TI_03",
    "Frequent buffer checks neither lose payloads nor compose too many",
    requirements="VD-RUN-02 VD-SCP-02",
    stimulus="VARDISPAR_BUFFER_CHECK_PERIOD = a tenth of a beacon period; a variable is created and updated",
    expect="VarCreate and VarUpdate in exactly repCnt beacons each",
    window=40,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter")),
)
def checked_often(bench: Bench) -> None:
    _own_period(bench, 0.1)
    peer, name, count, mark = bench.peer(), bench.var_id(), bench.sut.rep_cnt(4), bench.mark()
    peer.send(peer.create(name, rep_cnt=count))
    bench.check_repeated(_CREATE, name, count, mark)
    mark = peer.stimulate(peer.update(name, 1))
    bench.check_repeated(ICType.UPDATES, name, count, mark)
