"""Check in four ways whether an implementation is alive.

The checks are: its process runs; it sends beacons; it answers a marker (a summary of an unknown variable, which must
cause a request); its upper tester answers. Frames can be lost, so one answered marker of several is enough.
"""

from __future__ import annotations

from typing import Final

from dcp_conformance.errors import StopCase, UpperTesterError
from dcp_conformance.frames.header_rules import judge
from dcp_conformance.sut.control import SutControl
from dcp_conformance.test_system.bench import Bench
from dcp_spec.constants import seqno_modulus

from dcp_codec.codec import Codec
from dcp_codec.errors import Problem
from dcp_lab.fuzz.steps import Effect

#: Number of markers, one of which must be answered.
PROBES: Final = 4
#: Beacon periods that an answer may take if the implementation has many records to send.
_LONG: Final = 100.0
#: Beacon periods to wait for a beacon of an implementation that cannot answer markers.
_SILENCE: Final = 10.0
#: A beacon sequence number below this, after a larger one, indicates a restart; reordering changes it by less.
_BEGINNING: Final = 1000


def bad_beacon(codec: Codec, octets: bytes, problem: Problem, step: int) -> Effect:
    """Return the effect of a beacon that cannot be decoded, with the requirement for senders that it violates."""
    broken = judge(octets, codec)
    rules = broken[0].requirements if broken else ()
    return Effect("bad-beacon", f"an invalid beacon: {problem}", step, " ".join((problem.reason, *rules)))


def lifelessness(bench: Bench, control: SutControl | None) -> Effect | None:
    """Return the effect if an implementation is dead or mute; None if it is alive and answers."""
    if (gone := dead(control)) is not None:
        return gone
    begun = bench.mark()
    for _ in range(PROBES):
        if _answers(bench):
            return None
        if (gone := dead(control)) is not None:
            return gone
    beacons = len(bench.heard) - begun
    most = bench.sut.parameter("VARDISPAR_MAX_PAYLOAD_SIZE")
    # Where beacons are more than half full, the answer may be queued after many other records.
    if any(len(heard.octets) > most // 2 for heard in bench.heard[begun:]) and _answers(bench, _LONG):
        return None
    came = f"{beacons} beacons came" if beacons else "no beacon came"
    detail = f"none of {PROBES} markers was answered; {came}{_upper_tester(bench)}"
    # Without payloads no beacons are sent, so missing beacons alone are not an effect.
    return Effect("mute", detail, 0, "mute")


def dead(control: SutControl | None, at: int = 0) -> Effect | None:
    """Return the effect of a process that has ended; None if it runs, or its process id is unknown."""
    if control is None or control.alive() is not False:
        return None
    return Effect("dead", control.why_dead() or "the process is gone", at, "dead")


def begun_again(bench: Bench, before: int | None = None) -> Effect | None:
    """Return the effect of a restart that the tester did not cause; None if there was none.

    Signs are beacon sequence numbers that start again, and a closed connection to the upper tester. ``before``: the
    last sequence number before this bench; None if unknown.
    """
    half = seqno_modulus(bench.profile.types.bp_seqno.width) // 2
    for heard in bench.heard:
        number = heard.seqno
        if number is None:
            continue
        if before is not None and number < min(before, _BEGINNING) and before - number < half:
            return Effect("dead", f"it has restarted: sequence number {number} follows {before}", 0, "restarted")
        before = number
    if bench.session.upper is not None:
        try:
            bench.session.upper.poll()
        except UpperTesterError as error:
            detail = f"it answers, but has restarted or closed the connection: {error}"
            return Effect("dead", detail, 0, "restarted")
    return None


def last_number(bench: Bench) -> int | None:
    """Return the sequence number of the last received beacon; None if there was none."""
    return next((heard.seqno for heard in reversed(bench.heard) if heard.seqno is not None), None)


def _answers(bench: Bench, periods: float | None = None) -> bool:
    if bench.sut.pics.vardis is False:
        # Without VarDis no marker is answered.
        return _signs_of_life(bench)
    try:
        return _marker(bench, periods)
    except StopCase:
        # No unused identifier is left. Try used ones, one of which may be unknown to it; then accept any sign of life.
        bench.identifiers.created.clear()
    try:
        return _marker(bench, periods) or _signs_of_life(bench)
    except StopCase:
        return _signs_of_life(bench)


def _marker(bench: Bench, periods: float | None) -> bool:
    """Send a marker about an unknown variable: the case does not know in which state the others are."""
    return bench.probes.ask(bench.session.known.question, periods)


def _signs_of_life(bench: Bench) -> bool:
    return bool(bench.beacons(1, _SILENCE)) or _upper_tester(bench).endswith("answers")


def _upper_tester(bench: Bench) -> str:
    """Return whether the upper tester answers, as the end of a sentence; empty if there is no upper tester."""
    upper = bench.session.upper
    if upper is None or "UT-Hello" not in upper.methods:
        return ""
    try:
        upper.call("UT-Hello", {})
    except UpperTesterError as error:
        return f", and {error}"
    return ", its upper tester answers"
