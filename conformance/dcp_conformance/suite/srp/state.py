"""dcp-srp.md: Receive Path, The Neighbour Table, Service SRP-UpdateSafetyData.

Clocks of neighbours that are set back, a small swarm, and services while BP is inactive.
"""

from __future__ import annotations

from dcp_spec.constants import SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.services import neighbours, safety_data, until_neighbour
from dcp_conformance.test_system.bench import MS, Bench

_TABLE = Needs(ut=("SRP-NeighbourTable",), entities=("srp",))
#: Number of neighbours in a small swarm: a smaller table would be of little use.
_SWARM = 8


@case(
    "TC_SRP_RX_BV_06",
    "A record replaces the stored one even if its tStamp is older",
    requirements="SRP-RX-03",
    stimulus="a record with seqno 5, then one of the same node with seqno 6 and a tStamp one hour earlier",
    expect="the entry has the second record: a filter may only use sequence numbers",
    needs=_TABLE,
    value=3600,
)
@case(
    "TC_SRP_RX_BV_11",
    "A record that has the tStamp of the stored one replaces it",
    requirements="SRP-RX-03",
    stimulus="a record with seqno 5, then one of the same node with seqno 6 and the same tStamp",
    expect="the entry has the second record: only sequence numbers may be used as a filter",
    needs=_TABLE,
    value=0,
)
def not_later(bench: Bench, seconds: int) -> None:
    before = seconds * bench.profile.types.timestamp.per_second
    first, peer = max(bench.records.creation_time(), before), bench.peer()
    peer.send(bench.records.report(peer.node_id, 5, t_stamp=first))
    bench.needed(until_neighbour(bench, peer.node_id, 5), "an entry with the first record", "no such entry")
    peer.send(bench.records.report(peer.node_id, 6, t_stamp=first - before))
    entry = until_neighbour(bench, peer.node_id, 6)
    bench.some(entry, "an entry with the second record", seen="the entry still has the first record")


@case(
    "TC_SRP_NT_BV_05",
    "The table holds at least eight neighbours",
    requirements="SRP-RX-03 SRP-NT-02",
    stimulus="a record of each of eight neighbours",
    expect="entries of all eight",
    needs=_TABLE,
)
def small_swarm(bench: Bench) -> None:
    peers = [bench.peer() for _ in range(_SWARM)]
    for _ in range(2):
        # A record may be lost. Querying after each record would let the first entry time out if the upper tester is
        # slow.
        for peer in peers:
            peer.send(bench.records.report(peer.node_id, 1))
        # Entries time out by the clock, however long the beacon period is.
        for _ in range(10):
            bench.waiting.wait_ns(200 * MS)
            missing = {peer.node_id for peer in peers} - set(neighbours(bench))
            if not missing:
                break
        if not missing:
            break
    bench.complete(missing, f"entries of all {_SWARM} neighbours")


@case(
    "TC_SRP_SRV_BO_02",
    "SRP accepts requests while BP is inactive, because it remains registered",
    requirements="SRP-SRV-01 SRP-SRV-03",
    stimulus="SRP-UpdateSafetyData while BP is inactive",
    expect="SRP-STATUS-OK",
    needs=Needs(
        since=SpecVersion.V1_2, ut=("SRP-UpdateSafetyData", "BP-MGMT-Deactivate", "BP-MGMT-Activate"), entities=("srp",)
    ),
)
def bp_inactive(bench: Bench) -> None:
    with bench.services.deactivated("BP"):
        bench.expect_status("SRP-STATUS-OK", "SRP-UpdateSafetyData", sData=safety_data(bench, 1))
