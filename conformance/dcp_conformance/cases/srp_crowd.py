"""dcp-srp.md: Receive Path and The Neighbour Table: more neighbours than anybody expects."""

from __future__ import annotations

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.services import neighbours, until_neighbour

_MANY = 1001
#: Reports that are sent without a pause: a receive buffer holds them.
_AT_ONCE = 25


@case(
    "TC_SRP_NT_BV_04",
    "1,001 neighbours are survived, and the table is right for the first and the last of them",
    requirements="SRP-RX-03 BP-RX-16",
    stimulus="a record of each of 1,001 neighbours; then another one of the first three and of the last three",
    expect="entries of these six with the newer records; how many there are in all is reported (a profile may say that "
    "the table has room for fewer: then the last three are those that it has room for)",
    window=60,
    needs=Needs(ut=("SRP-NeighbourTable",), entities=("srp",)),
    destructive=True,
)
def many_neighbours(bench: Bench) -> None:
    # Stations of the tester may have reported already, and keep their places in a table that is full.
    before = len(neighbours(bench))
    peers = [bench.peer() for _ in range(_MANY)]
    for number, peer in enumerate(peers):
        peer.send(bench.report(peer.node_id, 1))
        if number % _AT_ONCE == _AT_ONCE - 1:
            bench.wait(0.05)
    listed = len(neighbours(bench))
    # Of a table that is known to be smaller, those that it has room for must be right.
    limit = bench.profile.limits.max_neighbours
    room = _MANY if limit is None else min(_MANY, limit - before)
    for peer in (*peers[:3], *peers[room - 3 : room]):
        # By now the older ones may have timed out, or have made room for others.
        peer.send(bench.report(peer.node_id, 2))
        entry = until_neighbour(bench, peer.node_id, 2)
        number = peers.index(peer) + 1
        what = f"an entry of neighbour {number} of {_MANY} with the number of its last record, 2"
        bench.check(entry is not None, what, "there is none")
    bench.info(f"How many entries are there after records of {_MANY} neighbours?", f"{listed}", "SRP-NT-02")
