"""dcp-architecture.md: the wireless bearer (UWB), temporary loss of the link."""

from __future__ import annotations

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.bp_clients import talking
from dcp_conformance.test_system.bench import Bench

#: Beacon periods during which the link is down.
_AWAY = 8


@case(
    "TC_DCP_LINK_BV_01",
    "The implementation continues after its link was down",
    requirements="UWB-01",
    stimulus="payloads to send in every period; the implementation's link is down for eight periods",
    expect="beacons and answers afterwards; the case reports how the sequence numbers continue",
    window=40,
    needs=Needs(entities=(), link=True),
    destructive=True,
    robustness=True,
)
def down_and_up(bench: Bench) -> None:
    with talking(bench):
        before = bench.needed(bench.beacons(2), "beacons before the link goes down")
        with bench.control.link_down():
            bench.wait(_AWAY)
        mark = bench.mark()
        answers = bench.sut.pics.vardis is not False and any(bench.probes.probe() for _ in range(4))
        after = bench.heard[mark:] or bench.beacons(1, 4 * bench.sut.reaction)
        bench.some(after, "beacons after the link is up again")
        if bench.sut.pics.vardis is not False:
            bench.some(answers, "an answer of VarDis after the link is up again", seen="no answer to four probes")
        numbers = [each.seqno for each in (before[-1], *after[:1]) if each.seqno is not None]
        if len(numbers) == 2:
            went_on = "continued" if numbers[1] > numbers[0] else "restarted"
            bench.info(
                "What happened to seqno while the link was down?", f"it {went_on}: {numbers[0]}, then {numbers[1]}"
            )
