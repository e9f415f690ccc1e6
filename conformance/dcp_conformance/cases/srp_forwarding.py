"""dcp-srp.md: Purpose."""

from __future__ import annotations

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.services import safety_data, srp_blocks


@case(
    "TC_SRP_FWD_BV_01",
    "Received state reports are never forwarded",
    requirements="SRP-RX-06",
    stimulus="two records of each of three neighbours, and one with the identifier of a node further away",
    expect="four beacons without any of these records, and no record of another node",
    window=8,
    needs=Needs(entities=("srp",)),
    smoke=True,
)
def never_forwarded(bench: Bench) -> None:
    if bench.session.upper is not None and "SRP-UpdateSafetyData" in bench.session.upper.methods:
        # It has something of its own to say, and a buffer that could be overwritten.
        bench.must("SRP-UpdateSafetyData", sData=safety_data(bench, 1))
    mark = bench.mark()
    peers, foreign = [bench.peer() for _ in range(3)], []
    for seqno in (1, 2):
        for peer in peers:
            report = bench.report(peer.node_id, seqno)
            foreign.append(bench.forge.srp(report).octets)
            peer.send(report)
    far = bench.report(bench.node_id(), 1)
    foreign.append(bench.forge.srp(far).octets)
    peers[0].send(far)
    if bench.pics.vardis is not False:
        bench.require_alive("state reports of neighbours")
        # Something to say, so that there are beacons to look at.
        peers[1].send(peers[1].create(bench.var_id(), rep_cnt=1))
    bench.beacons(4, bench.reaction)
    for heard in bench.heard[mark:]:
        if any(octets in heard.octets for octets in foreign):
            bench.fail("no beacon contains a received record", "one does", frames=[heard], shown=True)
        own = heard.sender or bench.sut_id
        senders = [bench.codec.decode_report(block).node_id for block in srp_blocks(heard) if _whole(bench, block)]
        if any(node_id != own for node_id in senders):
            bench.fail("no record of another node", f"nodeId is {senders[0].hex(':')}", frames=[heard], shown=True)
    heard_any = len(bench.heard) > mark
    if not heard_any:
        bench.info("beacons after the records", "none came: the implementation has nothing to say")
    bench.check(True, f"{len(bench.heard) - mark} beacons without foreign records")


def _whole(bench: Bench, block: bytes) -> bool:
    return len(block) == len(bench.forge.srp(bench.report(bench.sut_id, 0)).octets)
