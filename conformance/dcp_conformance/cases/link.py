"""dcp-architecture.md: the wireless bearer (UWB), when it carries nothing for a while."""

from __future__ import annotations

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.clients import talking

#: Beacon periods that the link is down.
_AWAY = 8


@case(
    "TC_DCP_LINK_BV_01",
    "After its link was down the implementation goes on",
    requirements="UWB-01",
    stimulus="something to send in every period; the implementation's link is down for eight periods, and up again",
    expect="beacons and answers afterwards; in which state it is then, is reported",
    window=40,
    needs=Needs(entities=(), link=True),
    destructive=True,
    robustness=True,
)
def down_and_up(bench: Bench) -> None:
    with talking(bench):
        before = bench.beacons(2)
        if not before:
            bench.inconclusive("beacons before the link goes down", "there are none")
        with bench.link_down():
            bench.wait(_AWAY)
        mark = bench.mark()
        answers = bench.pics.vardis is not False and any(bench.probe() for _ in range(4))
        after = bench.heard[mark:] or bench.beacons(1, 4 * bench.reaction)
        bench.check(after, "beacons after the link is up again", "there are none")
        if bench.pics.vardis is not False:
            bench.check(answers, "VarDis answers after the link is up again", "no answer to four probes")
        numbers = [each.seqno for each in (before[-1], *after[:1]) if each.seqno is not None]
        if len(numbers) == 2:
            went_on = "goes on" if numbers[1] > numbers[0] else "starts again"
            bench.info("What does seqno do while the link is down?", f"it {went_on}: {numbers[0]}, then {numbers[1]}")
