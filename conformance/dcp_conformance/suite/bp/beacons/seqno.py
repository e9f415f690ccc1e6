"""dcp-bp.md: Transmit Path; Initialization, Runtime and Shutdown.

Beacon sequence numbers.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from dcp_conformance.definitions.case import LISTENS, Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.bp_clients import needed, some_beacons, talking
from dcp_conformance.test_system.bench import Bench


@case(
    "TC_BP_HDR_BV_08",
    "seqno increases by one with every beacon",
    requirements="BP-HDR-08",
    stimulus="payloads to send in every period",
    expect="consecutive sequence numbers modulo 2^32 in ten beacons",
    window=12,
    needs=Needs(entities=(), header=("seqno",)),
)
def consecutive(bench: Bench) -> None:
    with talking(bench):
        frames = some_beacons(bench, 10)
    for before, after in itertools.pairwise(frames):
        if not bench.successive(before, after):
            return


def first_number(bench: Bench, old: Sequence[ReceivedBeacon], new: Sequence[ReceivedBeacon]) -> ReceivedBeacon:
    """Return the first beacon sent after a restart.

    Frames sent before the restart may be heard after it: if the sequence numbers decrease, the first beacon is the one
    where they do.
    """
    bench.needed(new, "a beacon after the restart")
    for before, after in itertools.pairwise([*old[-1:], *new]):
        if before.seqno is not None and after.seqno is not None and after.seqno < before.seqno:
            return after
    return new[0]


def check_first_number(bench: Bench, heard: ReceivedBeacon) -> None:
    """Check the sequence number of the first beacon; from 1.1 on, whether it is 0 or 1 is a reading (X03)."""
    first = heard.seqno
    if first is None:
        bench.inconclusive("a decodable first beacon", f"{heard.problem}")
    if bench.features.first_beacon_seqno == 1:
        bench.some(first == 1, "seqno 1 in the first beacon", "BP-INI-02 BP-HDR-13", seen=first, frames=[heard])
        return
    bench.some(
        first in (0, 1), "seqno 0 in the first beacon, or 1 (X03)", "BP-INI-02 BP-HDR-12", seen=first, frames=[heard]
    )
    if first in (0, 1):
        bench.reading("X03", "increment-then-write" if first else "write-then-increment")


@case(
    "TC_BP_INI_BV_01",
    "Sequence numbers start over after a reset",
    requirements="BP-INI-02 BP-HDR-12 BP-HDR-13",
    stimulus="some beacons, UT-Reset, a summary that causes a request",
    expect="seqno 0 in the first beacon (1 in version 1.0; X03)",
    window=8,
    needs=Needs(ut=("UT-Reset",), header=("seqno",)),
)
def numbers_after_reset(bench: Bench) -> None:
    bench.probes.probe()
    bench.probes.probe()
    bench.must("UT-Reset")
    # Beacons sent before the reset may still be in transit to the tester.
    from_now = bench.now() + bench.period // 50
    bench.probes.probe()
    check_first_number(bench, first_number(bench, (), [heard for heard in bench.heard if heard.time >= from_now]))


@case(
    "TC_BP_INI_BV_02",
    "Sequence numbers start over after a restart of the implementation",
    requirements="BP-INI-02 BP-HDR-12 BP-HDR-13 BP-INI-03",
    stimulus="some beacons, a restart of the implementation, a summary that causes a request",
    expect="a beacon without any activation, with seqno 0 (1 in version 1.0; X03)",
    window=8,
    needs=Needs(header=("seqno",), restart=True),
    destructive=True,
)
def numbers_after_restart(bench: Bench) -> None:
    bench.probes.probe()
    bench.probes.probe()
    start = bench.mark()
    bench.control.restart()
    check_first_number(bench, first_number(bench, bench.heard[:start], bench.heard[start:]))


@case(
    "TC_BP_HDR_BV_09",
    "No sequence number is used while there is nothing to send",
    requirements="BP-HDR-09",
    alone=LISTENS,
    stimulus="a stimulus for a beacon, six periods without any, another stimulus",
    expect="consecutive sequence numbers before and after the pause",
    window=12,
    needs=Needs(header=("seqno",)),
)
def idle_gap(bench: Bench) -> None:
    needed(bench, bench.probes.probe() or bench.probes.probe(), "a beacon with the answer to a probe")
    # The answer may be followed by one or two further beacons.
    bench.until_quiet(lambda heard: heard, 6)
    last = bench.heard[-1]
    pause = bench.wait(6)
    needed(bench, bench.probes.probe() or bench.probes.probe(), "a beacon with the answer to a probe")
    following = bench.heard[bench.heard.index(last) + 1]
    if bench.successive(last, following) and pause:
        bench.inconclusive("no beacon during the pause", f"{len(pause)} beacons")
