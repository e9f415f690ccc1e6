"""dcp-bp.md: Claims of the PICS about BP, for options that the specification leaves open.

Only claimed options are judged: an implementation that does not claim an option need not have it.
"""

from __future__ import annotations

from dcp_spec.constants import SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.bp_clients import CLIENT, ONCE, REPEAT, BPClient
from dcp_conformance.test_steps.services import until_neighbour
from dcp_conformance.test_system.bench import Bench

_PERIOD = "BPPAR_BEACON_PERIOD"
_STANDARD = frozenset({"nodeId", "sData", "tStamp", "seqno", "receptionTime"})
#: Submitted payloads, and how many of them must be sent early to show that submissions trigger beacons.
_ATTEMPTS, _EARLY = 6, 5


@case(
    "TC_BP_CLAIM_TI_01",
    "A new payload triggers an early beacon, as the PICS claims",
    requirements="BP-TXP-07",
    stimulus="six payloads, each submitted right after a beacon",
    expect="at least five of the six payloads are sent within half a period",
    window=12,
    needs=Needs(entities=(), ut=CLIENT, pics=("triggered_beacons",)),
)
def triggered(bench: Bench) -> None:
    delays: list[float] = []
    # The other client keeps the implementation sending, so that there are beacons to submit after.
    with BPClient(bench, REPEAT) as steady, BPClient(bench, ONCE) as client:
        steady.transmit(steady.payload())
        for _ in range(_ATTEMPTS):
            bench.needed(bench.beacons(1), "beacons with the payload of a client with mode REPEAT", "silence")
            payload = client.payload()
            client.transmit(payload)
            # Measured from the end of the call: the upper tester may have taken long.
            submitted = bench.now()
            heard = bench.required(client.until_sent(payload), "the payload is sent")
            delays.append((heard.time - submitted) / bench.period)
    early = sum(delay < 0.5 for delay in delays)
    shown = ", ".join(f"{delay:.2f}" for delay in delays)
    bench.some(
        early >= _EARLY,
        "at least 5 of 6 payloads within half a period of their submission",
        seen=f"sent after {shown} periods",
    )


@case(
    "TC_BP_CLAIM_BV_01",
    "The implementation estimates losses from sequence numbers, as the PICS claims",
    requirements="BP-RX-11",
    stimulus="two neighbours send state reports; every other beacon of one of them is missing",
    expect="neighbour table entries that differ in a field other than those taken from the reports",
    window=20,
    needs=Needs(entities=("srp",), ut=("SRP-NeighbourTable",), pics=("loss_estimation",)),
)
def losses(bench: Bench) -> None:
    steady, lossy = bench.peer(), bench.peer()
    for number in range(12):
        for peer in (steady, lossy):
            peer.send(bench.records.report(peer.node_id, number))
        # This beacon is built but not sent.
        lossy.beacon(bench.records.report(lossy.node_id, number))
        bench.wait(0.5)
    entries = [until_neighbour(bench, peer.node_id) for peer in (steady, lossy)]
    if entries[0] is None or entries[1] is None:
        bench.inconclusive("both neighbours in the neighbour table", "at least one is missing")
    differing = sorted(
        name
        for name in set(entries[0]) & set(entries[1]) - _STANDARD
        if entries[0][name] != entries[1][name] and not name.lower().endswith(("age", "agems", "time"))
    )
    bench.some(differing, "a field that differs between a neighbour with losses and one without")
    bench.info("Which fields of the neighbour table show losses?", ", ".join(differing) or "none")


@case(
    "TC_BP_CLAIM_BV_02",
    "Parameters can be set while BP runs, as the PICS claims",
    requirements="BP-PAR-01",
    stimulus="BP-SetParameter with another beacon period, and back",
    expect="BP-STATUS-OK both times, and the value that was set",
    window=2,
    needs=Needs(entities=(), ut=("BP-GetParameters", "BP-SetParameter"), pics=("runtime_parameters",)),
)
def settable(bench: Bench) -> None:
    before = bench.must("BP-GetParameters").result.get("parameters", {}).get(_PERIOD)
    bench.proved(isinstance(before, int | float), f"{_PERIOD} in the answer to BP-GetParameters", before, stop=True)
    try:
        bench.expect_status("BP-STATUS-OK", "BP-SetParameter", name=_PERIOD, value=before * 2)
        bench.answered(bench.must("BP-GetParameters").result.get("parameters", {}).get(_PERIOD), before * 2, _PERIOD)
    finally:
        bench.expect_status("BP-STATUS-OK", "BP-SetParameter", name=_PERIOD, value=before)


@case(
    "TC_BP_CLAIM_BI_01",
    "A rejected parameter value is reported, as the PICS claims",
    requirements="BP-PAR-07",
    stimulus="BP-SetParameter with a beacon period of 0",
    expect="a status other than OK, and the old value",
    window=2,
    needs=Needs(
        since=SpecVersion.V1_1, entities=(), ut=("BP-GetParameters", "BP-SetParameter"), pics=("parameter_feedback",)
    ),
)
def reported(bench: Bench) -> None:
    before = bench.must("BP-GetParameters").result.get("parameters", {}).get(_PERIOD)
    answer = bench.call("BP-SetParameter", name=_PERIOD, value=0)
    bench.proved(not answer.ok, "a status other than OK", str(answer))
    after = bench.must("BP-GetParameters").result.get("parameters", {}).get(_PERIOD)
    bench.answered(after, before, f"{_PERIOD}, as before", "BP-PAR-07")
