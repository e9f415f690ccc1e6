"""dcp-bp.md: Transmit Path, timing of beacons.

The specification gives the long-term rate of beacons, not the time of each one. The verdict is therefore statistical:
it needs a confidence interval, and a result that is not significant is not a failure.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Sequence
from typing import NamedTuple

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.definitions.case import LISTENS, Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.lower_tester import OnThisMachine
from dcp_conformance.suite.bp.services.indications import no_indication
from dcp_conformance.test_steps.bp_clients import (
    CLIENT,
    ONCE,
    REGISTER,
    REPEAT,
    TRANSMITTED,
    BPClient,
    indications,
    some_beacons,
    talking,
    wait_for_notifications,
)
from dcp_conformance.test_steps.jitter import SHIFT, Intervals, compare, intervals
from dcp_conformance.test_steps.services import parameters_set
from dcp_conformance.test_system.bench import MS, Bench

PERIOD = "BPPAR_BEACON_PERIOD"
#: 99 % quantile (two-sided) of the normal distribution, in standard deviations; it approximates that of sample means.
QUANTILE = 2.576
CONFIDENCE = "99 %"
#: Fewer intervals do not show their variance well enough.
LEAST = 25
MOST = 300
#: A gap in the sequence numbers counts as missed beacons up to this number of beacons per typical interval elapsed.
_MOST_MISSED = 2
#: A beacon period in ms of which a third is at least as long as usual periods.
_DIVISIBLE = 90


class Estimate(NamedTuple):
    """The mean interval between beacons and the half-width of its confidence interval, in ns."""

    mean: float
    margin: float
    intervals: Sequence[float]

    def __str__(self) -> str:
        size, mean, margin = len(self.intervals), self.mean / MS, self.margin / MS
        return f"a mean of {mean:.2f} ms \u00b1 {margin:.2f} ms ({size} intervals, {CONFIDENCE} confidence)"


def estimate(frames: Sequence[ReceivedBeacon]) -> Estimate:
    """Estimate the mean interval between beacons (at least three).

    Sequence numbers count the beacons between two that were heard, so that beacons missed by the tester do not increase
    the mean. A gap larger than the elapsed time allows is a fault of the sequence numbers, which other cases check.
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
    return Estimate(mean, QUANTILE * math.sqrt(_variance_of_sum(intervals)) / len(intervals), intervals)


def _variance_of_sum(intervals: Sequence[float]) -> float:
    """Return the variance of the sum of intervals, from that of one and the covariance of neighbours.

    If each beacon varies around a point of a strict grid, a long interval precedes a short one, and the sum hardly
    varies. Only a significant covariance counts, because the others are results of chance.
    """
    count, variance = len(intervals), statistics.variance(intervals)
    mean = statistics.fmean(intervals)
    covariance = sum((one - mean) * (two - mean) for one, two in itertools.pairwise(intervals)) / (count - 1)
    if covariance > -QUANTILE * variance / math.sqrt(count):
        return count * variance
    return max(variance, count * variance + 2 * (count - 1) * covariance)


def measure(bench: Bench, period: float, *, least: int = LEAST, most: int = MOST) -> Estimate | None:
    """Listen until the mean interval is known to be within the tolerance of the period or outside of it.

    Returns None if too few beacons arrive. After ``most`` intervals, returns the estimate reached so far.
    """
    tolerance = bench.sut.pixit.period_tolerance * period
    start = bench.mark()
    bench.beacons(least + 1, 3 * least + bench.sut.reaction)
    while len(frames := bench.heard[start:]) >= 3:
        found = estimate(frames)
        off = abs(found.mean - period)
        if off + found.margin <= tolerance or off - found.margin > tolerance or len(found.intervals) >= most:
            return found
        if not bench.beacons(10, 30):
            break
    return None


def _always(found: Estimate, limit: float) -> bool:
    """Return whether all intervals exceed a limit in ns: a busy machine makes some of them long."""
    return min(found.intervals) > limit


def overload(bench: Bench) -> str:
    """Return why the processor may be too busy for an implementation on this machine; otherwise empty."""
    return bench.lower.overload() if isinstance(bench.lower, OnThisMachine) else ""


def check_mean(bench: Bench, found: Estimate | None, period: float, *requirements: str, sure: bool = True) -> None:
    """Check a mean interval: only one that is significantly outside of the tolerance is a failure.

    ``sure``: whether the implementation had payloads to send all the time; if not, too few beacons are not a failure.
    """
    found = bench.needed(found, "enough beacons to estimate their mean interval", "too few beacons", *requirements)
    tolerance = bench.sut.pixit.period_tolerance * period
    low, high = found.mean - found.margin, found.mean + found.margin
    expected = f"a mean interval of {period / MS:g} ms \u00b1 {bench.sut.pixit.period_tolerance:.0%}"
    if low > period + tolerance and not sure:
        observed = (
            f"{found}; but the implementation may have had no payload to send (an upper tester could decide this)"
        )
        bench.inconclusive(expected, observed, *requirements)
    if low > period + tolerance and not _always(found, period + tolerance) and (why := overload(bench)):
        # An implementation on this machine has to wait for the processor in many periods.
        bench.inconclusive(expected, f"{found}; but {why}", *requirements, overload=why)
    if low > period + tolerance or high < period - tolerance:
        bench.some(False, expected, *requirements, seen=found)
    elif low < period - tolerance or high > period + tolerance:
        bench.inconclusive(expected, f"{found}: too few beacons for their variance", *requirements)
    else:
        bench.passed(f"{expected}; measured: {found}", *requirements)


@case(
    "TC_BP_TX_TI_01",
    "The mean interval between beacons is one beacon period",
    requirements="BP-TX-01 BP-TX-02",
    stimulus="payloads to send all the time, for at least 25 intervals and until the result is significant",
    expect=(
        "a mean interval of BPPAR_BEACON_PERIOD within the tolerance (PIXIT), with 99 % confidence; the case "
        "reports the jitter"
    ),
    window=300,
    needs=Needs(entities=()),
)
def mean_period(bench: Bench) -> None:
    period = bench.sut.parameter(PERIOD) * MS
    with talking(bench) as clients:
        bench.until(lambda heard: heard.octets)
        found = measure(bench, period)
    if found is not None and found.mean > 0:
        spread = statistics.stdev(found.intervals) / found.mean
        least, most = min(found.intervals) / MS, max(found.intervals) / MS
        observed = f"{least:.1f} ms to {most:.1f} ms, standard deviation {spread:.1%} of the mean"
        bench.info("How much do the intervals between beacons vary?", observed, "BP-TX-02")
        if bench.sut.pics.jitter:
            bench.some(spread > 0.002, "intervals that vary, as the PICS claims", "BP-TX-02", seen=observed)
    check_mean(bench, found, period, "BP-TX-01", sure=bool(clients))


@case(
    "TC_BP_TX_TI_02",
    "A new beacon period takes effect (factor {variant})",
    requirements="BP-PAR-02 BP-PAR-12 BP-TX-01",
    stimulus="BPPAR_BEACON_PERIOD is multiplied by {variant} while a client repeats a payload",
    expect="a mean interval of the new period, with 99 % confidence",
    window=60,
    needs=Needs(entities=(), ut=(*CLIENT, "BP-SetParameter")),
    # 0.45 of a usual period is not a multiple of 10 ms.
    variants={"0.5": 0.5, "2": 2.0, "0.45": 0.45},
)
def other_period(bench: Bench, factor: float) -> None:
    with BPClient(bench, REPEAT) as client:
        client.put_on_air("beacons before the change")
        wanted = round(bench.sut.parameter(PERIOD) * factor)
        with parameters_set(bench, "BP", **{PERIOD: wanted}):
            value: float = wanted
            if bench.services.offers("BP-GetParameters"):
                # The resolution of times is up to the implementation.
                observed = (bench.must("BP-GetParameters").result.get("parameters") or {}).get(PERIOD)
                if isinstance(observed, int | float) and abs(observed - value) < abs(value - value / factor) / 2:
                    value = observed
            # The beacon already scheduled is sent as scheduled; the new period begins after it.
            bench.beacons(1)
            found = measure(bench, round(value * MS), least=15)
            check_mean(bench, found, round(value * MS))


@case(
    "TC_BP_TX_TI_03",
    "Reports the time from the submission of a payload to its beacon",
    requirements="BP-TXP-07 BP-TX-02",
    alone=LISTENS,
    stimulus="a client submits five payloads at different phases of the beacon period, without other traffic",
    expect="a beacon with each payload; the case reports the delays",
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
            heard = bench.needed(client.until_sent(payload), "a beacon with each payload", f"{number} of 5 in time")
            delays.append(max(0, heard.time - start) / MS)
            bench.wait(0.3 + 0.2 * number)
    observed = f"{', '.join(f'{delay:.0f}' for delay in delays)} ms, with a period of {bench.sut.parameter(PERIOD)} ms"
    bench.info("How long after its submission is a payload sent?", observed)
    triggered = statistics.median(delays) < bench.sut.parameter(PERIOD) / 10
    bench.info("Does a new payload trigger an early beacon?", "probably" if triggered else "no", "BP-TXP-07")


@case(
    "TC_BP_PTI_TI_01",
    "nextBeaconGenerationEpoch is the time at which the next beacon is prepared",
    requirements="BP-PTI-02",
    stimulus="a client repeats a payload; ten indications and the beacons after them",
    expect=(
        "a median difference between epoch and next beacon of less than half a period, on the implementation's clock"
    ),
    window=14,
    needs=Needs(entities=(), ut=(*CLIENT, "BP-ListRegisteredProtocols"), when=no_indication),
)
def epoch_of_next_beacon(bench: Bench) -> None:
    _check_epochs(bench, bench.sut.parameter(PERIOD))


@case(
    "TC_BP_PTI_TI_02",
    "nextBeaconGenerationEpoch follows a changed beacon period",
    requirements="BP-PTI-02 BP-PAR-02",
    stimulus="BPPAR_BEACON_PERIOD is divided by three (multiplied by three if it is less than 90 ms); then as before",
    expect="a median difference between epoch and next beacon of less than half of the new period",
    window=40,
    needs=Needs(
        entities=(),
        ut=(*CLIENT, "BP-ListRegisteredProtocols", "BP-SetParameter"),
        when=no_indication,
    ),
)
def epoch_after_change(bench: Bench) -> None:
    period = bench.sut.parameter(PERIOD)
    period = period // 3 if period >= _DIVISIBLE else 3 * period
    with parameters_set(bench, "BP", **{PERIOD: period}):
        _check_epochs(bench, period)


def _check_epochs(bench: Bench, period_ms: int) -> None:
    with BPClient(bench, REPEAT) as client:
        offset, uncertainty = clock_offset(bench, client)
        client.transmit(client.payload())
        for _ in range(11):
            client.until_sent()
        frames = client.frames()
        wait_for_notifications(bench)
        told = bench.required(indications(bench, TRANSMITTED, client.prot_id), "indications", "BP-PTI-01")
        epochs = [each.params.get("nextBeaconGenerationEpoch") for each in told]
        numbers = [each - offset for each in epochs if isinstance(each, int)]
        bench.answered(len(numbers), len(epochs), "indications with an epoch", stop=True)
        # The next beacon, of whichever client.
        following = [bench.heard[place + 1 :][:1] for place in map(bench.heard.index, frames)]
        pairs = [(number, each[0].wall) for number, each in zip(numbers, following, strict=False) if each]
        if len(pairs) < 8 or not len(frames) - 1 <= len(told) <= len(client.frames()) + 1:
            bench.inconclusive(
                "an indication for each of ten beacons", f"{len(told)} indications for {len(frames)} beacons"
            )
        errors = [(epoch - wall) / MS for epoch, wall in pairs]
        middle, limit = statistics.median(errors), period_ms / 2
        observed = f"{middle:.1f} ms off (median of {len(errors)}), {min(errors):.1f} ms to {max(errors):.1f} ms"
        if abs(middle) >= limit:
            if abs(change := clock_offset(bench, client)[0] - offset) >= limit * MS + 2 * uncertainty:
                bench.inconclusive("a clock that is not set during the case", f"it was set by {change / MS:.1f} ms")
            if abs(middle) - uncertainty / MS < limit:
                bench.inconclusive(
                    "the offset of the implementation's clock",
                    f"it is known with an uncertainty of {uncertainty / MS:.1f} ms, as long as half a call; {observed}",
                )
        bench.some(
            abs(middle) < limit,
            f"a median epoch within {limit:g} ms of the next beacon",
            seen=observed,
            frames=frames[:8],
        )
        bench.info("How precise is nextBeaconGenerationEpoch?", observed)


def clock_offset(bench: Bench, client: BPClient) -> tuple[int, int]:
    """Estimate the offset of the implementation's clock from the tester's in ns (positive if ahead), from the time
    stamps of registrations.

    Return the estimate and its uncertainty in ns: the time stamp may be of any moment of the call.
    """
    stamps = []
    for _ in range(5):
        bench.call("BP-DeregisterProtocol", protId=client.prot_id)
        before = bench.lower.wall()
        bench.must(REGISTER, **client.registration)
        after = bench.lower.wall()
        stamp = (client.entry() or {}).get("timeStampRegistration")
        if isinstance(stamp, int):
            stamps.append((after - before, stamp - (before + after) // 2))
    bench.needed(stamps, "the time of a registration", "not in BP-ListRegisteredProtocols")
    # The shortest call gives the most precise estimate.
    duration, offset = min(stamps)
    return offset, duration // 2


#: Shortest beacon period in ms that a case sets to get many beacons quickly.
_QUICK = 10


@case(
    "TC_BP_HDR_BV_10",
    "seqno does not wrap around at one octet",
    requirements="BP-HDR-08",
    stimulus=(
        "a client repeats a payload at a quarter of the beacon period, at least 10 ms, until the implementation has "
        "sent more than 256 beacons"
    ),
    expect="a sequence number above 255, and no restart",
    window=150,
    needs=Needs(entities=(), ut=(*CLIENT, "BP-SetParameter", "UT-Reset"), header=("seqno",)),
)
def beyond_an_octet(bench: Bench) -> None:
    period = bench.period / MS
    short = round(max(period / 4, min(period, _QUICK)))
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        with parameters_set(bench, "BP", **{PERIOD: short}):
            frames = bench.beacons(262)
    _check_beyond_an_octet(bench, frames)


def _check_beyond_an_octet(bench: Bench, frames: Sequence[ReceivedBeacon]) -> None:
    numbers = [each.seqno for each in frames if each.seqno is not None]
    if len(numbers) < 258:
        bench.inconclusive("258 decodable beacons", f"{len(numbers)}")
    back = [after for before, after in itertools.pairwise(frames) if (after.seqno or 0) < (before.seqno or 0)]
    observed = f"a maximum of {max(numbers)} in {len(numbers)} beacons"
    bench.some(
        max(numbers) > 255 and not back, "sequence numbers that increase beyond 255", seen=observed, frames=back[:2]
    )


@case(
    "TC_BP_HDR_BV_11",
    "seqno does not wrap around at one octet, at the configured beacon period",
    requirements="BP-HDR-08",
    stimulus="payloads to send in every period until the implementation has sent more than 256 beacons",
    expect="a sequence number above 255, and no restart",
    window=600,
    needs=Needs(entities=(), header=("seqno",)),
    long=True,
)
def beyond_an_octet_by_waiting(bench: Bench) -> None:
    with talking(bench):
        frames = bench.beacons(262)
    _check_beyond_an_octet(bench, frames)


#: Minimum number of intervals that are compared after each start; the larger one if few intervals decide nothing.
_COMPARED = (14, 24)


@case(
    "TC_BP_TX_TI_04",
    "Reports whether the jitter of the beacons is the same after each start",
    requirements="BP-TX-02",
    stimulus="two restarts; payloads to send in every period",
    expect="any result; if the jitter is the same, nodes that are started together keep sending at the same times",
    window=60,
    needs=Needs(entities=(), restart=True),
)
def jitter_after_starts(bench: Bench) -> None:
    for least in _COMPARED:
        found = compare(_after_start(bench, least), _after_start(bench, least), bench.period)
        if found != "coarse":
            break
    observed = {
        "strict": "the beacons are strictly periodic",
        "same": "yes: nodes that are started together keep sending at the same times",
        "different": "no",
        "coarse": "unknown: too few different intervals",
    }
    bench.info("Is the jitter the same after each start?", observed[found])


def _after_start(bench: Bench, least: int) -> Intervals:
    bench.control.restart()
    with talking(bench):
        return intervals(some_beacons(bench, least + SHIFT + 1))


@case(
    "TC_BP_TX_TI_05",
    "Payloads that are submitted more often than once per beacon period do not delay beacons",
    requirements="BP-TX-01 BP-QM-04",
    stimulus="a client with mode ONCE submits a payload every quarter of a beacon period, forty times",
    expect="beacons with payloads of the client while it submits",
    window=30,
    needs=Needs(entities=(), ut=CLIENT),
)
def not_delayed(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        start, times = bench.mark(), list[int]()
        for _ in range(40):
            client.transmit(client.payload())
            times.append(bench.now())
            bench.wait(0.25)
        bench.some(client.frames(start), "a beacon with a payload of the client within ten beacon periods")
        pause = max(after - before for before, after in itertools.pairwise(times))
        if pause > 0.6 * bench.period:
            # A beacon may have been sent after this pause.
            bench.inconclusive("payloads without a pause of a beacon period", f"a pause of {pause / MS:.0f} ms")
