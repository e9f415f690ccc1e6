"""The implementation is there."""

from __future__ import annotations

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.lower import Arrival
from dcp_conformance.probe import looks_like


@case(
    "TC_DCP_SANITY_BV_01",
    "The implementation is there and takes part in the protocol",
    requirements="BP-RX-07",
    stimulus="a summary of a variable that nobody knows; without VarDis nothing",
    expect="a request for it in a beacon; without VarDis any beacon",
    window=8,
    needs=Needs(entities=()),
    smoke=True,
)
def sanity(bench: Bench) -> None:
    if bench.pics.vardis is False:
        bench.require(bench.beacons(1, 20), "a beacon of the implementation", "silence for 20 beacon periods")
        return
    # On the air something can get lost: three attempts, one answer.
    answered = any(bench.probe(8) for _ in range(3))
    why = "" if answered else _why(bench)
    bench.require(answered, "a beacon that requests the variable", f"no such beacon after three attempts; {why}")


def _why(bench: Bench) -> str:
    """What may be the matter, as far as the frames tell that were heard from whomever."""
    frames = [each for each in bench.traffic.events if each.direction in ("heard", "other")]
    if not frames:
        return "nothing was heard: is it running, on this link, with this EtherType or port?"
    arrivals = [Arrival(0, each.wall, each.frame[each.start :], each.frame, b"") for each in frames]
    count = f"{len(frames)} frames were heard, {len(bench.heard)} of them its own"
    if other := looks_like(arrivals, bench.codec):
        return f"{count}; {other}"
    return f"{count}: is this its network identifier, and does it have VarDis?"
