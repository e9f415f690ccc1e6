"""Whether an implementation is alive, asked in four ways.

Is its process there, do beacons come, is a marker answered (a summary of a variable that nobody has must bring a
request), does the upper tester answer. Silence alone is no death: of several markers one is enough.
"""

from __future__ import annotations

from typing import Final

from dcp_spec.constants import seqno_modulus

from dcp_conformance.errors import StopCase, UpperTesterError
from dcp_conformance.fuzz.steps import Effect
from dcp_conformance.sut.control import SutControl
from dcp_conformance.test_system.bench import Bench

#: Markers of which one must be answered.
PROBES: Final = 4
#: Beacon periods that an answer may take of one who has much to say.
_LONG: Final = 100.0
#: Beacon periods without a beacon, for those who have nothing else to show.
_SILENCE: Final = 10.0
#: Sequence numbers of beacons count as begun again below this: late frames of others are never that far off.
_BEGINNING: Final = 1000


def ailing(bench: Bench, control: SutControl | None, probes: int = PROBES) -> Effect | None:
    """What is wrong with an implementation; None if it lives and answers."""
    if (gone := dead(control)) is not None:
        return gone
    begun = bench.mark()
    for _ in range(probes):
        if _answers(bench):
            return None
        if (gone := dead(control)) is not None:
            return gone
    beacons = len(bench.heard) - begun
    if _is_busy(bench, begun) and _answers(bench, _LONG):
        return None
    came = f"{beacons} beacons came" if beacons else "no beacon came"
    detail = f"none of {probes} markers was answered; {came}{_upper_tester(bench)}"
    # Who has nothing to say sends no beacons either, so that their absence is no effect of its own.
    return Effect("mute", detail, 0, "mute")


def dead(control: SutControl | None, at: int = 0) -> Effect | None:
    """The effect of a process that is gone; None if it is there, or nobody knows."""
    if control is None or control.alive() is not False:
        return None
    return Effect("dead", control.why_dead() or "the process is gone", at, "dead")


def begun_again(bench: Bench, before: int | None = None) -> Effect | None:
    """The effect of an implementation that somebody else starts again: its sequence numbers begin anew, or its upper
    tester has hung up. ``before``: the last number before this bench.
    """
    half = seqno_modulus(bench.profile.types.bp_seqno.width) // 2
    for heard in bench.heard:
        number = heard.seqno
        if number is None:
            continue
        if before is not None and number < min(before, _BEGINNING) and before - number < half:
            return Effect("dead", f"it has begun anew: sequence number {number} follows {before}", 0, "begun anew")
        before = number
    if bench.session.upper is not None:
        try:
            bench.session.upper.poll()
        except UpperTesterError as error:
            return Effect("dead", f"it answers, but has begun anew or hung up: {error}", 0, "begun anew")
    return None


def last_number(bench: Bench) -> int | None:
    """The sequence number of the last beacon that was heard; None if there was none."""
    return next((heard.seqno for heard in reversed(bench.heard) if heard.seqno is not None), None)


def _is_busy(bench: Bench, since: int) -> bool:
    """Whether it has so much to say that an answer stands at the end of a long row."""
    most = bench.sut.parameter("VARDISPAR_MAX_PAYLOAD_SIZE")
    return any(len(heard.octets) > most // 2 for heard in bench.heard[since:])


def _answers(bench: Bench, periods: float | None = None) -> bool:
    if bench.sut.pics.vardis is False:
        # Nobody there who could answer.
        return _signs_of_life(bench)
    try:
        return bench.probes.probe(periods)
    except StopCase:
        # Every identifier was spoken of. One that it does not know may be among them; else any sign of life has to do.
        bench.identifiers.created.clear()
    try:
        return bench.probes.probe(periods) or _signs_of_life(bench)
    except StopCase:
        return _signs_of_life(bench)


def _signs_of_life(bench: Bench) -> bool:
    return bool(bench.beacons(1, _SILENCE)) or _upper_tester(bench).endswith("answers")


def _upper_tester(bench: Bench) -> str:
    """What the upper tester has to say to that, as the end of a sentence; empty without one."""
    upper = bench.session.upper
    if upper is None or "UT-Hello" not in upper.methods:
        return ""
    try:
        upper.call("UT-Hello", {})
    except UpperTesterError as error:
        return f", and {error}"
    return ", its upper tester answers"
