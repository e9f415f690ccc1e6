"""dcp-srp.md: Receive Path and The Neighbour Table: a very large number of neighbours."""

from __future__ import annotations

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.services import neighbours, until_neighbour
from dcp_conformance.test_system.bench import Bench

_MANY = 1001
#: Reports sent without a pause: few enough for a receive buffer.
_AT_ONCE = 25


@case(
    "TC_SRP_NT_BV_04",
    "A node survives 1,001 neighbours, and the table is correct for the first and last of them",
    requirements="SRP-RX-03 BP-RX-16",
    alone="it fills the neighbour table",
    stimulus="a record of each of 1,001 neighbours; then another one of the first three and the last three",
    expect=(
        "entries of these six with the newer records; the case reports the total number of entries (if the profile "
        "limits the size of the table, the last three are those that it can hold)"
    ),
    window=60,
    needs=Needs(ut=("SRP-NeighbourTable",), entities=("srp",)),
    destructive=True,
)
def many_neighbours(bench: Bench) -> None:
    # Peers of earlier cases may still have entries and take up space in a full table.
    before = len(neighbours(bench))
    peers = [bench.peer() for _ in range(_MANY)]
    for number, peer in enumerate(peers):
        peer.send(bench.records.report(peer.node_id, 1))
        if number % _AT_ONCE == _AT_ONCE - 1:
            bench.wait(0.05)
    listed = len(neighbours(bench))
    # If the profile limits the table, the entries that it can hold must be correct.
    limit = bench.sut.capacity("neighbours")
    room = _MANY if limit is None else min(_MANY, limit - before)
    for peer in (*peers[:3], *peers[room - 3 : room]):
        # The older entries may have timed out by now, or may have been replaced by others.
        peer.send(bench.records.report(peer.node_id, 2))
        entry = until_neighbour(bench, peer.node_id, 2)
        number = peers.index(peer) + 1
        bench.some(entry, f"an entry of neighbour {number} of {_MANY} with the sequence number of its last record, 2")
    bench.info(f"How many entries does the table have after records of {_MANY} neighbours?", f"{listed}", "SRP-NT-02")
