"""dcp-srp.md: Purpose."""

from __future__ import annotations

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.bp_clients import talking
from dcp_conformance.test_steps.services import safety_data, srp_blocks
from dcp_conformance.test_system.bench import Bench

#: Rounds of the case, each with records of different neighbours.
_ROUNDS = 6


@case(
    "TC_SRP_FWD_BV_01",
    "Received state reports are never forwarded",
    requirements="SRP-RX-06",
    stimulus=(
        "six rounds: a record of a neighbour, or one with the identifier of a more distant node, and two beacons; "
        "in every other round the implementation has safety data of its own to send"
    ),
    expect="beacons without any of these records, and no record of another node",
    window=24,
    needs=Needs(entities=("srp",)),
)
def never_forwarded(bench: Bench) -> None:
    hands_down = bench.services.offers("SRP-UpdateSafetyData")
    mark, foreign = bench.mark(), []
    with talking(bench, clients=0):
        for number in range(_ROUNDS):
            if hands_down and number % 2:
                # A buffer of one entry would keep only the last of the two.
                bench.must("SRP-UpdateSafetyData", sData=safety_data(bench, number))
            peer = bench.peer()
            # One record at a time; otherwise each would overwrite the one before.
            report = bench.records.report(peer.node_id if number < _ROUNDS - 2 else bench.identifiers.node_id(), number)
            foreign.append(bench.builder.srp(report).octets)
            peer.send(report)
            # If the implementation has nothing to send, there are no beacons to inspect.
            bench.beacons(2, 3)
        if bench.sut.pics.vardis is not False:
            bench.require_alive("state reports of neighbours")
        bench.beacons(2, bench.sut.reaction)
    for heard in bench.heard[mark:]:
        if any(octets in heard.octets for octets in foreign):
            bench.wrong("no beacon with a received record", "a beacon contains one", frames=[heard])
        own = heard.sender or bench.identifiers.sut_id
        senders = [bench.codec.decode_report(block).node_id for block in srp_blocks(heard) if _whole(bench, block)]
        if any(node_id != own for node_id in senders):
            bench.wrong("no record of another node", f"a record with nodeId {senders[0].hex(':')}", frames=[heard])
    if not bench.heard[mark:]:
        bench.info("Were there beacons after the records?", "no: the implementation had nothing to send")
    bench.passed(f"no received record in {len(bench.heard) - mark} beacons")


def _whole(bench: Bench, block: bytes) -> bool:
    return len(block) == len(bench.builder.srp(bench.records.report(bench.identifiers.sut_id, 0)).octets)
