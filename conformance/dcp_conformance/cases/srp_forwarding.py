"""dcp-srp.md: Purpose."""

from __future__ import annotations

from collections.abc import Sequence

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.clients import talking
from dcp_conformance.heard import Heard
from dcp_conformance.services import safety_data, srp_blocks

#: Rounds of the case, each with the records of other neighbours.
_ROUNDS = 6


@case(
    "TC_SRP_FWD_BV_01",
    "Received state reports are never passed on",
    requirements="SRP-RX-06",
    stimulus="six rounds: a record of a neighbour, or one with the identifier of a node further away, and two beacons; "
    "in every other round the implementation has safety data of its own to send",
    expect="beacons without any of these records, and no record of another node",
    window=24,
    needs=Needs(entities=("srp",)),
    smoke=True,
)
def never_forwarded(bench: Bench) -> None:
    upper = bench.session.upper
    hands_down = upper is not None and "SRP-UpdateSafetyData" in upper.methods
    mark, foreign = bench.mark(), []
    with talking(bench, clients=0):
        for number in range(_ROUNDS):
            if hands_down and number % 2:
                # A buffer with one place would keep only the last of both.
                bench.must("SRP-UpdateSafetyData", sData=safety_data(bench, number))
            peer = bench.peer()
            # One record at a time, or each would overwrite the one before.
            report = bench.report(peer.node_id if number < _ROUNDS - 2 else bench.node_id(), number)
            foreign.append(bench.forge.srp(report).octets)
            peer.send(report)
            # If it has nothing to say, there are no beacons to look at.
            bench.beacons(2, 3)
        if bench.pics.vardis is not False:
            bench.require_alive("state reports of neighbours")
        bench.beacons(2, bench.reaction)
    _check(bench, bench.heard[mark:], foreign)
    if not bench.heard[mark:]:
        bench.info("beacons after the records", "none came: the implementation has nothing to say")
    bench.check(True, f"{len(bench.heard) - mark} beacons without foreign records")


def _check(bench: Bench, frames: Sequence[Heard], foreign: Sequence[bytes]) -> None:
    for heard in frames:
        if any(octets in heard.octets for octets in foreign):
            bench.fail("no beacon contains a received record", "one does", frames=[heard], shown=True)
        own = heard.sender or bench.sut_id
        senders = [bench.codec.decode_report(block).node_id for block in srp_blocks(heard) if _whole(bench, block)]
        if any(node_id != own for node_id in senders):
            bench.fail("no record of another node", f"nodeId is {senders[0].hex(':')}", frames=[heard], shown=True)


def _whole(bench: Bench, block: bytes) -> bool:
    return len(block) == len(bench.forge.srp(bench.report(bench.sut_id, 0)).octets)
