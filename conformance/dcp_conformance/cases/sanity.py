"""The implementation is there."""

from __future__ import annotations

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case


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
    bench.require(
        answered,
        "a beacon that requests the variable",
        f"no such beacon after three attempts; {len(bench.heard)} beacons were heard"
        + ("" if bench.heard else ": is it running, on this link, with this profile and network identifier?"),
    )
