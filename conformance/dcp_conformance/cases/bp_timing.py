"""dcp-bp.md: Transmit Path, timing of beacons.

The specification says what the number of beacons tends to, not when a single one is due. The verdict is therefore
statistical: it needs an interval of confidence, and one that cannot be told yet is no failure.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Sequence
from typing import NamedTuple

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.bench import MS, Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.cases.bp_indications import no_indication
from dcp_conformance.clients import (
    CLIENT,
    ONCE,
    REGISTER,
    REPEAT,
    TRANSMITTED,
    BPClient,
    indications,
    needed,
    some_beacons,
    talking,
)
from dcp_conformance.heard import Heard
from dcp_conformance.jitter import SHIFT, Intervals, compare, intervals
from dcp_conformance.lower import OnThisMachine
from dcp_conformance.services import parameters_set

PERIOD = "BPPAR_BEACON_PERIOD"
#: Of a normal distribution: 99 % of it lie within so many standard deviations. The means of samples are normal enough.
QUANTILE = 2.576
CONFIDENCE = "99 %"
#: Fewer intervals say too little about how much they vary.
LEAST = 25
MOST = 300
#: A gap in the numbers is believed up to this many beacons for each usual interval that passed.
_MOST_MISSED = 2


class Estimate(NamedTuple):
    """The mean interval between beacons with its interval of confidence, in ns."""

    mean: float
    margin: float
    intervals: Sequence[float]

    def __str__(self) -> str:
        size, mean, margin = len(self.intervals), self.mean / MS, self.margin / MS
        return f"a mean of {mean:.2f} ms \u00b1 {margin:.2f} ms ({size} intervals, {CONFIDENCE} confidence)"


def estimate(frames: Sequence[Heard]) -> Estimate:
    """The mean interval between these beacons, at least three of them.

    Sequence numbers say how many beacons lie between two that were heard, so that a beacon that the tester has missed
    does not make the mean larger. A gap for which there was no time is a fault of the numbers, which other cases judge.
    """
    usual = statistics.median(after.time - before.time for before, after in itertools.pairwise(frames))
    intervals, beacons = [], 0
    for before, after in itertools.pairwise(frames):
        count = 1
        if before.seqno is not None and after.seqno is not None:
            count = (after.seqno - before.seqno) % BP_SEQNO_MODULUS or 1
        if count > 1 + _MOST_MISSED * (after.time - before.time) / max(1, usual):
            count = 1
        beacons += count
        intervals.append((after.time - before.time) / count)
    mean = (frames[-1].time - frames[0].time) / beacons
    return Estimate(mean, QUANTILE * statistics.stdev(intervals) / math.sqrt(len(intervals)), intervals)


def measure(bench: Bench, period: float, *, least: int = LEAST, most: int = MOST) -> Estimate | None:
    """Listen until the mean can be said to be the period within the tolerance, or not to be; None if nothing comes.

    After ``most`` intervals the estimate is returned as it is then.
    """
    tolerance = bench.pixit.period_tolerance * period
    start = bench.mark()
    bench.beacons(least + 1, 3 * least + bench.reaction)
    while len(frames := bench.heard[start:]) >= 3:
        found = estimate(frames)
        off = abs(found.mean - period)
        if off + found.margin <= tolerance or off - found.margin > tolerance or len(found.intervals) >= most:
            return found
        if not bench.beacons(10, 30):
            break
    return None


def check_mean(bench: Bench, found: Estimate | None, period: float, *requirements: str, sure: bool = True) -> None:
    """Check a mean. Only one that lies outside of the tolerance for certain is a failure.

    ``sure``: whether there was always something to send; else too few beacons are none.
    """
    if found is None:
        bench.inconclusive("enough beacons for a mean", "there are too few", *requirements)
    tolerance = bench.pixit.period_tolerance * period
    low, high = found.mean - found.margin, found.mean + found.margin
    expected = f"a mean interval of {period / MS:g} ms \u00b1 {bench.pixit.period_tolerance:.0%}"
    if low > period + tolerance and not sure:
        said = f"{found}; but it may have had nothing to send (with an upper tester this can be decided)"
        bench.inconclusive(expected, said, *requirements)
    if low > period + tolerance and isinstance(bench.lower, OnThisMachine) and (why := bench.lower.overload()):
        # An implementation on this machine waits for its turn in every period.
        bench.inconclusive(expected, f"{found}; but {why}", *requirements)
    if low > period + tolerance or high < period - tolerance:
        bench.check(False, expected, str(found), *requirements)
    elif low < period - tolerance or high > period + tolerance:
        bench.inconclusive(expected, f"{found}: the sample is too small for how much they vary", *requirements)
    else:
        bench.check(True, f"{expected}; measured: {found}", "", *requirements)


@case(
    "TC_BP_TX_TI_01",
    "In the long run there is one beacon per period",
    requirements="BP-TX-01 BP-TX-02",
    stimulus="something to send all the time; at least 25 intervals between beacons, more until the verdict is certain",
    expect="the mean interval is BPPAR_BEACON_PERIOD within the tolerance (PIXIT), with 99 % confidence; jitter is "
    "reported",
    window=300,
    needs=Needs(entities=()),
)
def mean_period(bench: Bench) -> None:
    period = bench.parameter(PERIOD) * MS
    with talking(bench) as clients:
        bench.until(lambda heard: heard.octets)
        found = measure(bench, period)
    if found is not None and found.mean > 0:
        spread = statistics.stdev(found.intervals) / found.mean
        least, most = min(found.intervals) / MS, max(found.intervals) / MS
        said = f"{least:.1f} to {most:.1f} ms, standard deviation {spread:.1%} of the mean"
        bench.info("How much do the intervals between beacons vary?", said, "BP-TX-02")
        if bench.pics.jitter:
            bench.check(spread > 0.002, "intervals that vary, as the PICS claims", said, "BP-TX-02")
    check_mean(bench, found, period, "BP-TX-01", sure=bool(clients))


@case(
    "TC_BP_TX_TI_02",
    "Another beacon period takes effect ({variant})",
    requirements="BP-PAR-02 BP-PAR-12",
    stimulus="BPPAR_BEACON_PERIOD is multiplied by {variant} while a client repeats a payload",
    expect="the mean interval follows, with 99 % confidence",
    window=60,
    needs=Needs(entities=(), ut=(*CLIENT, "BP-SetParameter")),
    variants={"0.5": 0.5, "2": 2.0},
)
def other_period(bench: Bench, factor: float) -> None:
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        needed(bench, client.until_sent(), "beacons before")
        wanted = round(bench.parameter(PERIOD) * factor)
        with parameters_set(bench, "BP", **{PERIOD: wanted}):
            value: float = wanted
            if bench.session.upper is not None and "BP-GetParameters" in bench.session.upper.methods:
                # The resolution of times is the implementation's own.
                said = (bench.must("BP-GetParameters").result.get("parameters") or {}).get(PERIOD)
                if isinstance(said, int | float) and abs(said - value) < abs(value - value / factor) / 2:
                    value = said
            # The beacon that was due already comes when it was due, the next one is the first of the new period.
            bench.beacons(1)
            found = measure(bench, round(value * MS), least=15)
            check_mean(bench, found, round(value * MS))


@case(
    "TC_BP_TX_TI_03",
    "What a new payload does to the time of the next beacon",
    requirements="BP-TXP-07 BP-TX-02",
    stimulus="a client submits a payload five times, in different phases of the period, when nothing else is sent",
    expect="a beacon with it each time; the delays are reported",
    window=20,
    needs=Needs(entities=(), ut=CLIENT),
)
def delay_of_payloads(bench: Bench) -> None:
    delays = []
    with BPClient(bench, ONCE) as client:
        for number in range(5):
            payload = client.payload()
            start = bench.now()
            client.transmit(payload)
            heard = client.until_sent(payload)
            if heard is None:
                bench.inconclusive("a beacon with each payload", f"{number} of 5 came in time")
            delays.append(max(0, heard.time - start) / MS)
            bench.wait(0.3 + 0.2 * number)
    said = f"{', '.join(f'{delay:.0f}' for delay in delays)} ms at a period of {bench.parameter(PERIOD)} ms"
    bench.info("How long does a payload wait for its beacon?", said)
    triggered = statistics.median(delays) < bench.parameter(PERIOD) / 10
    bench.info("Does a new payload bring the next beacon forward?", "it seems so" if triggered else "no", "BP-TXP-07")


@case(
    "TC_BP_PTI_TI_01",
    "nextBeaconGenerationEpoch is when the next beacon is prepared",
    requirements="BP-PTI-02",
    stimulus="a client repeats a payload; ten indications and the beacons that follow them",
    expect="most epochs are nearer to the beacon that follows than to any other, by the implementation's own clock",
    window=14,
    needs=Needs(entities=(), ut=(*CLIENT, "BP-ListRegisteredProtocols"), when=no_indication),
)
def epoch_of_next_beacon(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        offset = clock_offset(bench, client)
        client.transmit(client.payload())
        for _ in range(11):
            client.until_sent()
        bench.wait(0.3)
        frames = client.frames()
        told = indications(bench, TRANSMITTED, client.prot_id)
        bench.require(told, "indications", "there are none", "BP-PTI-01")
        epochs = [each.params.get("nextBeaconGenerationEpoch") for each in told]
        numbers = [each - offset for each in epochs if isinstance(each, int)]
        bench.require(len(numbers) == len(epochs), "an epoch in each indication", f"{epochs[:3]}", shown=True)
        # The next beacon, whoever has a payload in it.
        following = [bench.heard[place + 1 :][:1] for place in map(bench.heard.index, frames)]
        pairs = [(number, each[0].wall) for number, each in zip(numbers, following, strict=False) if each]
        if len(pairs) < 8 or abs(len(told) - len(frames)) > 1:
            bench.inconclusive("an indication for each of ten beacons", f"{len(told)} for {len(frames)} beacons")
        errors = [(epoch - wall) / MS for epoch, wall in pairs]
        middle, limit = statistics.median(errors), bench.parameter(PERIOD) / 2
        said = f"{middle:.1f} ms from it (median of {len(errors)}), {min(errors):.1f} to {max(errors):.1f} ms"
        bench.check(abs(middle) < limit, f"epochs within {limit:g} ms of the next beacon", said, frames=frames[:8])
        bench.info("How exact is nextBeaconGenerationEpoch?", said)


def clock_offset(bench: Bench, client: BPClient) -> int:
    """How far the implementation's clock is ahead of the tester's in ns, by the time stamp of a registration."""
    stamps = []
    for _ in range(5):
        bench.call("BP-DeregisterProtocol", protId=client.prot_id)
        before = bench.lower.wall()
        bench.must(REGISTER, **client.registration)
        after = bench.lower.wall()
        stamp = (client.entry() or {}).get("timeStampRegistration")
        if isinstance(stamp, int):
            stamps.append((after - before, stamp - (before + after) // 2))
    if not stamps:
        bench.inconclusive("the time of a registration", "BP-ListRegisteredProtocols does not tell it")
    # The shortest call is the most exact one.
    return min(stamps)[1]


@case(
    "TC_BP_HDR_BV_10",
    "seqno counts beyond what one octet holds",
    requirements="BP-HDR-08",
    stimulus="a client repeats a payload with a quarter of the beacon period, until more than 256 beacons were sent",
    expect="a number above 255, and none that starts again",
    window=150,
    needs=Needs(entities=(), ut=(*CLIENT, "BP-SetParameter", "UT-Reset"), header=("seqno",)),
)
def beyond_an_octet(bench: Bench) -> None:
    short = max(2, round(bench.period / 4 / MS))
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        with parameters_set(bench, "BP", **{PERIOD: short}):
            frames = bench.beacons(262)
    _check_beyond_an_octet(bench, frames)


def _check_beyond_an_octet(bench: Bench, frames: Sequence[Heard]) -> None:
    numbers = [each.seqno for each in frames if each.seqno is not None]
    if len(numbers) < 258:
        bench.inconclusive("258 beacons that can be read", f"there are {len(numbers)}")
    back = [after for before, after in itertools.pairwise(frames) if (after.seqno or 0) < (before.seqno or 0)]
    said = f"{max(numbers)} is the greatest of {len(numbers)}"
    bench.check(max(numbers) > 255 and not back, "numbers that go on above 255", said, frames=back[:2])


@case(
    "TC_BP_HDR_BV_11",
    "seqno counts beyond what one octet holds, at the beacon period as it is",
    requirements="BP-HDR-08",
    stimulus="something to send in every period, until more than 256 beacons were sent",
    expect="a number above 255, and none that starts again",
    window=600,
    needs=Needs(entities=(), header=("seqno",)),
    long=True,
)
def beyond_an_octet_by_waiting(bench: Bench) -> None:
    with talking(bench):
        frames = bench.beacons(262)
    _check_beyond_an_octet(bench, frames)


#: Intervals that are compared after each start, at least.
_COMPARED = 24


@case(
    "TC_BP_TX_TI_04",
    "Whether the jitter of the beacons is the same after each start",
    requirements="BP-TX-02",
    stimulus="two restarts; something to send in every period",
    expect="nothing in particular; nodes that are started together stay in step if it is the same",
    window=60,
    needs=Needs(entities=(), restart=True),
)
def jitter_after_starts(bench: Bench) -> None:
    first, second = _after_start(bench), _after_start(bench)
    said = {
        "strict": "beacons are strictly periodic",
        "same": "yes: nodes that are started together stay in step",
        "different": "no",
        "coarse": "it cannot be told: there are too few different intervals",
    }
    bench.info("Is the jitter the same after each start?", said[compare(first, second, bench.period)])


def _after_start(bench: Bench) -> Intervals:
    bench.restart()
    with talking(bench):
        return intervals(some_beacons(bench, _COMPARED + SHIFT + 1))
