"""Measure how fast an implementation reacts at the start of a run, so that slow but legal ones are waited for.

An implementation may process its buffer every few hundred milliseconds only, compose a payload well before it is sent,
or take one received payload each time it polls. The specification sets no bound, so the tester measures: it asks a few
questions one by one, then several at once, and adds a margin to the worst answer. It measures the delay of the upper
tester's notifications, too.
"""

from __future__ import annotations

from dcp_spec.constants import ICType, QueueingMode

from dcp_conformance.errors import StopCase, UpperTesterError
from dcp_conformance.frames.builder import Block
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.bp_clients import CLIENT, BPClient
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.known import Reaction
from dcp_conformance.test_system.session import FLOOR

#: Number of questions asked one by one, and number of questions asked at once.
_SINGLE, _BURST = 5, 10
#: The longest wait for an answer: beacon periods or ns, whichever is longer.
_PATIENCE = (25, 5_000_000_000)
#: Factor for the slowest sample, and margin added to it, in beacon periods.
_FACTOR, _MARGIN = 1.5, 1.0
#: Answers to a burst within this number of periods belong together: a payload was composed during the burst.
_TOGETHER = 1.5
_CHECK_PERIOD = "VARDISPAR_BUFFER_CHECK_PERIOD"
#: Number of measurements, the factor for the longest time, and the longest wait for an indication in ns.
_NOTIFIED, _LATER, _LONGEST = 2, 1.5, 1_000_000_000
#: Delays in ns up to which notifications count as immediate, and the interval of looking for them.
_IMMEDIATE, _LOOK = 30_000_000, 5_000_000


def measure(bench: Bench) -> Reaction:
    """Ask an implementation a few questions (summaries of unknown variables) and measure the time to its requests.

    Takes about eight beacon periods, or up to ``_PATIENCE`` if nothing is answered. Leaves no variables.
    Frames that are received during this time belong to ``bench``, which must not be that of a case. Raises
    ``LowerTesterError``.
    """
    samples: list[float] = []
    for number in range(_SINGLE):
        times = _ask(bench, 1)
        if not times:
            break
        samples += times
        # Hit different phases of its timers; the second question follows the first answer at once.
        bench.wait(0.2 * number)
    if not samples:
        return Reaction()
    periods = max(FLOOR, _FACTOR * max(*samples, _told(bench)) + _MARGIN)
    burst = _ask(bench, _BURST)
    spread = max(burst, default=0.0) - min(burst, default=0.0)
    each = _FACTOR * spread / (len(burst) - 1) if spread > _TOGETHER else 0.0
    return Reaction(periods, each, tuple(samples))


def _told(bench: Bench) -> float:
    """The buffer check period, if it is known, plus the beacon after it, in beacon periods.

    With something to say in every beacon it does not look, and answers faster than it will when it is idle.
    """
    told = bench.session.parameters.get(_CHECK_PERIOD, bench.sut.pixit.buffer_check_period_ms)
    return float(told) * 1e6 / bench.period + 1 if isinstance(told, int | float) else 0.0


def _ask(bench: Bench, count: int) -> list[float]:
    """Send ``count`` questions at once, each in a beacon. Returns the times to the answers, in beacon periods.

    Fewer questions where fewer identifiers are left.
    """
    while count and not bench.identifiers.has_unknown_ids(count):
        count //= 2
    peer, waiting = bench.peer(), set(bench.identifiers.unknown_ids(count))
    begun = bench.now()
    for each in sorted(waiting):
        peer.send(peer.summary(each, 1))
    found: list[float] = []

    def answered(heard: ReceivedBeacon) -> bool:
        new = waiting & {each.var_id for each in heard.instructions(ICType.REQUEST_VARCREATES)}
        found.extend([(heard.time - begun) / bench.period] * len(new))
        waiting.difference_update(new)
        return bool(new)

    patience = max(_PATIENCE[0], _PATIENCE[1] / bench.period)
    # The limit is for each answer.
    while waiting:
        if not bench.until(answered, patience):
            break
    return found


def notification_delay(bench: Bench) -> int:
    """Return the time in ns by which notifications may be late; 0 if none is received, or if they are immediate.

    It includes the time in which a received frame is processed. Without BP-ReceivePayload.indication, this takes a
    second. Raises ``LowerTesterError``.
    """
    if not bench.services.offers(*CLIENT):
        return 0
    longest = 0
    try:
        with BPClient(bench, QueueingMode.ONCE) as client:
            for number in range(_NOTIFIED):
                bench.peer().send(Block(client.prot_id, bytes([number]) * 4))
                begun = bench.now()
                while len(client.received()) <= number:
                    if bench.now() - begun > _LONGEST:
                        return 0
                    bench.waiting.wait_ns(_LOOK)
                longest = max(longest, bench.now() - begun)
    except (StopCase, UpperTesterError):
        # Cases about these services will report it.
        return 0
    return round(_LATER * longest) if longest > _IMMEDIATE else 0
