"""Variables with timeouts: how to create them, and until when they must be deleted.

A variable with timeout t is deleted between t and t plus one scrubbing period after its last change. The beacon with
the VarDelete may come one reaction time later, and timers may be late (PIXIT timer_tolerance_ms).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.errors import StopCase
from dcp_conformance.frames.received import Instruction
from dcp_conformance.test_steps.services import create_request
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

_DELETE = ICType.DELETE_VARIABLES


class Change(NamedTuple):
    """Interval in which a frame or call of the tester changed a variable: two times of its clock, in ns."""

    before: int
    after: int


#: A scrubbing period in ms that is short enough for cases.
SHORT = 200


def scrubbing_period_ms(bench: Bench) -> int:
    """Return VARDISPAR_SCRUBBING_PERIOD in ms."""
    return bench.sut.parameter("VARDISPAR_SCRUBBING_PERIOD")


def shorten_scrubbing(bench: Bench) -> int:
    """Shorten a long scrubbing period for this case, if it can be set and reset; return the period in ms from now on.

    The current period may still run to its end, so deadlines depend on the initial one.
    """
    period = scrubbing_period_ms(bench)
    if period > SHORT and bench.services.offers("UT-Reset", "VD-SetParameter"):
        answer = bench.call("VD-SetParameter", name="VARDISPAR_SCRUBBING_PERIOD", value=SHORT)
        if answer.ok:
            return SHORT
    return period


def latest(bench: Bench, timeout_ms: int) -> int:
    """Return the time in ns within which the VarDelete must be received."""
    tolerance = bench.sut.pixit.timer_tolerance_ms * bench.session.timing_scale
    return round((timeout_ms + scrubbing_period_ms(bench) + tolerance) * MS + bench.sut.reaction * bench.period)


def deleted(bench: Bench, name: int, since: Change, timeout_ms: int) -> Instruction | None:
    """Wait for the first VarDelete until its deadline; ``since``: the last change."""
    left = since.after + latest(bench, timeout_ms) - bench.now()
    if not bench.instructions(_DELETE, name):
        bench.until_instruction(_DELETE, name, max(0.0, left / bench.period))
    found = next(iter(bench.instructions(_DELETE, name)), None)
    if found is None:
        bench.sut.bound("VARDISPAR_SCRUBBING_PERIOD")
    return found


def check_not_kept(bench: Bench, act: Callable[[Peer, VarCreate], object], what: str) -> None:
    """Check that a timeout of 500 ms passes although ``act`` sends ``what`` about the variable every 150 ms."""
    shorten_scrubbing(bench)
    peer, timeout_ms = bench.peer(), 500
    record, silent = (peer.create(each, seqno=5, timeout=timeout_ms) for each in bench.identifiers.var_ids(2))
    name = record.spec.var_id
    since = sent(bench, peer, record, silent)
    deadline = since.after + latest(bench, timeout_ms)
    while bench.now() < deadline and not bench.instructions(_DELETE, name):
        bench.waiting.wait_ns(150 * MS)
        if not bench.instructions(_DELETE, name):
            act(peer, record)
    found = bench.instructions(_DELETE, name)
    if not found and not bench.instructions(_DELETE, silent.spec.var_id):
        # If only producers scrub (X26), this cannot be tested.
        not_by_consumers(bench, name)
        return
    bench.required(found, f"a VarDelete of the variable, as of the one without further {what}")
    check_time(bench, found[0], since, timeout_ms)


def deleted_by_consumer(bench: Bench, name: int, since: Change, timeout_ms: int) -> Instruction:
    """As :func:`deleted`; without a VarDelete report the reading by which only producers scrub, and stop the case."""
    found = deleted(bench, name, since, timeout_ms)
    if found is None:
        not_by_consumers(bench, name)
        raise StopCase
    return found


def deleted_by_producer(bench: Bench, name: int, since: Change, timeout_ms: int) -> Instruction:
    """As :func:`deleted`, for a variable of the implementation's own; fails and stops the case without a VarDelete."""
    found = deleted(bench, name, since, timeout_ms)
    seen = f"none in {latest(bench, timeout_ms) / MS:.0f} ms"
    return bench.required(found, "a VarDelete of the node's own variable", seen=seen)


def check_time(
    bench: Bench, found: Instruction, since: Change, timeout_ms: int, *requirements: str, received: object = True
) -> None:
    """Check that a VarDelete was sent neither too early nor too late after the last change.

    ``received``: whether the implementation is known to have received that change.
    """
    took = found.heard.time - since.before
    # Clocks with a resolution of milliseconds may differ by one at both ends.
    least, most = (timeout_ms - 2) * MS, latest(bench, timeout_ms) + since.after - since.before
    if took > most:
        bench.sut.bound("VARDISPAR_SCRUBBING_PERIOD")
    what = "time from the last change to the VarDelete"
    bench.within(took, least, most, what, *requirements, late="above", unit="ms", frames=[found], given=received)


def sent(bench: Bench, peer: Peer, *records: VardisRecord) -> Change:
    """Send records in one beacon and return when."""
    before = bench.now()
    peer.send(*records)
    return Change(before, bench.now())


def learn(bench: Bench, peer: Peer, name: int, timeout_ms: int, rep_cnt: int = 1) -> Change:
    """Teach the implementation a variable with a timeout, and return when it was sent."""
    since = sent(bench, peer, peer.create(name, timeout=timeout_ms, rep_cnt=rep_cnt))
    if bench.until_instruction(ICType.CREATE_VARIABLES, name) is None:
        bench.inconclusive("a forwarded VarCreate of a variable with a timeout", "none in time")
    return since


def not_by_consumers(bench: Bench, name: int) -> None:
    """Report the other reading of X26, by which only producers scrub, if the variable still exists."""
    still = bench.until_instruction(ICType.SUMMARIES, name, 8)
    if still:
        scrubs(bench, by_consumers=False)
    text = "no: it is still summarised" if still else "unknown: neither a VarDelete nor a summary"
    bench.info("Does a consumer delete a variable after its timeout?", text)


def scrubs(bench: Bench, *, by_consumers: bool) -> None:
    """Report which nodes scrub a variable (X26). Fails and stops the case if an earlier case of the run refutes it."""
    session = bench.session
    if by_consumers:
        session.consumer_scrubs = session.consumer_scrubs or bench.case.id
        bench.reading("X26", "every-node")
    elif earlier := session.consumer_scrubs:
        what = f"a VarDelete after the timeout by a consumer, as in {earlier}"
        bench.missing(what, "the variable is still summarised", "VD-SCR-01", "VD-SCR-05")
    else:
        bench.reading("X26", "producer-only")


def create_own(bench: Bench, name: int, timeout_ms: int, count: int = 1) -> Change:
    """Let the application create a variable, and return when."""
    before = bench.now()
    bench.must("RTDB-Create", **create_request(bench, name, rep_cnt=count, timeout=timeout_ms))
    return Change(before, bench.now())


def updated_in_time(bench: Bench, timeout_ms: int) -> int:
    """Return a timeout in ms that calls of the upper tester can keep up with: this one, or longer if they are slow."""
    return max(timeout_ms, round(4 * bench.session.slow_call / MS))


def lasting(bench: Bench, timeout_ms: int, beacons: int = 3) -> int:
    """Return a timeout in ms that is longer than ``beacons`` beacons take: this one, or longer if beacons are rare.

    A variable that times out before its VarCreate is sent is never sent, which is correct.
    """
    return max(timeout_ms, round(1.2 * beacons * bench.sut.slowness * bench.period / MS))
