"""dcp-bp.md: Other BP Management Services; Transmit Path.

State that activation and deactivation of BP must not change, and queues larger than a beacon.
"""

from __future__ import annotations

from dcp_spec.constants import SpecVersion

from dcp_conformance.definitions.case import FILLS, Needs, case
from dcp_conformance.suite.bp.queues.fitting import check_sizes
from dcp_conformance.test_steps.bp_clients import (
    ACTIVATE,
    CLIENT,
    DEACTIVATE,
    DROPTAIL,
    OK,
    QUERY,
    REPEAT,
    BPClient,
    areas_of_fixed_size,
    block_header_octets,
    listed,
    needed,
    room,
)
from dcp_conformance.test_system.bench import Bench

V1_1, V1_2 = SpecVersion.V1_1, SpecVersion.V1_2


@case(
    "TC_BP_TX_BV_06",
    "With allowMultiplePayloads true, payloads that together do not fit into one beacon are sent in several",
    requirements="BP-FMT-02 BP-TX-04 BP-QM-03",
    alone=FILLS,
    stimulus="a client with allowMultiplePayloads true submits five payloads; a beacon has room for two",
    expect="each payload once and in order, in beacons not larger than BPPAR_MAXIMUM_PACKET_SIZE",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT, when=areas_of_fixed_size),
    window=10,
)
def several_that_do_not_fit(bench: Bench) -> None:
    size = room(bench) * 2 // 5 - block_header_octets(bench)
    with BPClient(bench, DROPTAIL, size=size, entries=5, several=True) as client:
        start = bench.mark()
        payloads = client.submit(5, size)
        bench.until(lambda _: payloads[-1] in client.sent(start), 5 * bench.sut.reaction)
        check_sizes(bench, start)
        sent = [each for each in client.sent(start) if each in payloads]
        bench.some(sent == payloads, "each payload once, in order", "BP-TX-04 BP-QM-03", seen=listed(sent, payloads))


@case(
    "TC_BP_MGT_BV_03",
    "Sequence numbers continue when BP is deactivated and activated",
    requirements="BP-HDR-08 BP-MGT-05",
    stimulus="a client repeats a payload; BP-MGMT-Deactivate, BP-MGMT-Activate after more than two beacon periods",
    expect="the next sequence number in the first beacon after activation",
    needs=Needs(since=V1_2, entities=(), ut=(*CLIENT, ACTIVATE, DEACTIVATE), header=("seqno",)),
    window=10,
)
def numbers_continue(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        needed(bench, len(bench.beacons(3)) == 3, "beacons before the deactivation")
        with bench.services.deactivated("BP"):
            # A beacon sent before the deactivation may still be in transit to the tester.
            bench.wait(2.5)
            last = bench.heard[-1]
        found = bench.beacons(1)
        needed(bench, found, "a beacon after activation")
        bench.successive(last, bench.heard[bench.heard.index(last) + 1], "BP-HDR-08")


@case(
    "TC_BP_MGT_BO_03",
    "BP-MGMT-Activate while BP is active does not change buffered payloads",
    requirements="BP-MGT-05",
    stimulus="a client repeats a payload; BP-MGMT-Activate; BP-QueryNumberBufferedPayloads before and after it",
    expect="BP-STATUS-OK; one payload both times; beacons with it continue",
    needs=Needs(since=V1_2, entities=(), ut=(*CLIENT, QUERY, ACTIVATE)),
    window=8,
)
def activated_twice(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        payload = client.payload()
        client.transmit(payload)
        needed(bench, client.until_sent(payload), "a beacon with the payload")
        before = client.number()
        bench.expect_status(OK, ACTIVATE)
        bench.answered(client.number(), before, "buffered payloads, as before")
        bench.some(client.until_sent(payload), "further beacons with the payload")
