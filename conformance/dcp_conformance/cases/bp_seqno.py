"""dcp-bp.md: Transmit Path; Initialization, Runtime and Shutdown.

The sequence numbers of beacons.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.clients import needed, some_beacons, talking
from dcp_conformance.heard import Heard


@case(
    "TC_BP_HDR_BV_08",
    "seqno grows by one with every beacon",
    requirements="BP-HDR-08",
    stimulus="something to send in every period",
    expect="consecutive numbers modulo 2^32 in ten beacons",
    window=12,
    needs=Needs(entities=(), header=("seqno",)),
)
def consecutive(bench: Bench) -> None:
    with talking(bench):
        frames = some_beacons(bench, 10)
    for before, after in itertools.pairwise(frames):
        if before.seqno is None or after.seqno is None:
            bench.inconclusive("beacons that can be read", f"{before.problem or after.problem}")
        if (after.seqno - before.seqno) % BP_SEQNO_MODULUS != 1:
            expected, said = f"{(before.seqno + 1) % BP_SEQNO_MODULUS} follows {before.seqno}", f"{after.seqno} does"
            bench.fail(expected, said, frames=[before, after], numbers=True)
    bench.check(True, "consecutive numbers")


def first_number(bench: Bench, old: Sequence[Heard], new: Sequence[Heard]) -> Heard:
    """The first beacon after a restart: where the numbers go down, if the first new ones are of the time before it."""
    if not new:
        bench.inconclusive("a beacon after the restart", "there is none")
    for before, after in itertools.pairwise([*old[-1:], *new]):
        if before.seqno is not None and after.seqno is not None and after.seqno < before.seqno:
            return after
    return new[0]


def check_first_number(bench: Bench, heard: Heard) -> None:
    """Check the number of the very first beacon; which one it is in 1.1 and later is a reading."""
    first = heard.seqno
    if first is None:
        bench.inconclusive("a first beacon that can be read", f"{heard.problem}")
    if bench.features.first_beacon_seqno == 1:
        bench.check(
            first == 1, "the first beacon has seqno 1", f"it has {first}", "BP-INI-02", "BP-HDR-13", frames=[heard]
        )
        return
    bench.check(
        first in (0, 1),
        "the first beacon has seqno 0, or 1 (X03)",
        f"it has {first}",
        "BP-INI-02",
        "BP-HDR-12",
        frames=[heard],
    )
    if first in (0, 1):
        bench.reading("X03", "increment-then-write" if first else "write-then-increment")


@case(
    "TC_BP_INI_BV_01",
    "After a reset sequence numbers start again",
    requirements="BP-INI-02 BP-HDR-12 BP-HDR-13",
    stimulus="some beacons, UT-Reset, a request for a beacon",
    expect="the first beacon has seqno 0 (1 in version 1.0; X03)",
    window=8,
    needs=Needs(ut=("UT-Reset",), header=("seqno",)),
)
def numbers_after_reset(bench: Bench) -> None:
    bench.probe()
    bench.probe()
    bench.must("UT-Reset")
    # Some of the time before may be on its way to the tester still.
    from_now = bench.now() + bench.period // 50
    bench.probe()
    check_first_number(bench, first_number(bench, (), [heard for heard in bench.heard if heard.time >= from_now]))


@case(
    "TC_BP_INI_BV_02",
    "After a restart sequence numbers start again",
    requirements="BP-INI-02 BP-HDR-12 BP-HDR-13 BP-INI-03",
    stimulus="some beacons, a restart of the implementation, a request for a beacon",
    expect="a beacon without any activation, with seqno 0 (1 in version 1.0; X03)",
    window=8,
    needs=Needs(header=("seqno",), restart=True),
    destructive=True,
)
def numbers_after_restart(bench: Bench) -> None:
    bench.probe()
    bench.probe()
    start = bench.mark()
    bench.restart()
    check_first_number(bench, first_number(bench, bench.heard[:start], bench.heard[start:]))


@case(
    "TC_BP_HDR_BV_09",
    "No number is used up while there is nothing to send",
    requirements="BP-HDR-09",
    stimulus="a beacon is provoked, then nothing for six periods, then another one",
    expect="the number after the pause is the next one",
    window=12,
    needs=Needs(header=("seqno",)),
)
def idle_gap(bench: Bench) -> None:
    needed(bench, bench.probe() or bench.probe(), "a beacon with the answer to a probe")
    # What the answer has set off may take another beacon or two.
    bench.until_quiet(lambda heard: heard, 6)
    last = bench.heard[-1]
    pause = bench.wait(6)
    needed(bench, bench.probe() or bench.probe(), "a beacon with the answer to a probe")
    following = bench.heard[bench.heard.index(last) + 1]
    if last.seqno is None or following.seqno is None:
        bench.inconclusive("beacons that can be read", f"{last.problem or following.problem}")
    if (following.seqno - last.seqno) % BP_SEQNO_MODULUS != 1:
        said = f"{following.seqno}"
        bench.fail(f"{last.seqno + 1} follows {last.seqno} after a pause", said, frames=[last, following], numbers=True)
    if pause:
        bench.inconclusive("a pause in which it has nothing to send", f"{len(pause)} beacons came")
    bench.check(True, "consecutive numbers")
