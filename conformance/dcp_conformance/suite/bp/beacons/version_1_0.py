"""dcp-bp.md: Service `BP-TransmitPayload`; Transmit Path. Rules that exist in version 1.0 only."""

from __future__ import annotations

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import (
    CLIENT,
    EMPTY,
    OK,
    QUERY,
    TRANSMIT,
    BPClient,
    listed,
    needed,
    no_confirm,
)
from dcp_conformance.test_system.bench import Bench

V1_0 = SpecVersion.V1_0
_QUEUE = QueueingMode.QUEUE
_COUNTED = Needs(until=V1_0, entities=(), ut=(*CLIENT, QUERY))


@case(
    "TC_BP_TXP_BI_14",
    "In 1.0, mode QUEUE rejects an empty payload and keeps the buffered ones",
    requirements="BP-TXP-12",
    stimulus="a client with mode QUEUE and two buffered payloads submits an empty payload",
    expect="BP-STATUS-EMPTY-PAYLOAD; two buffered payloads as before",
    needs=_COUNTED,
)
def empty_payload(bench: Bench) -> None:
    with BPClient(bench, _QUEUE) as client:

        def act() -> tuple[int | None, int | None]:
            client.transmit_new(2)
            before = client.number()
            bench.expect_status(EMPTY, TRANSMIT, protId=client.prot_id, payload="")
            return before, client.number()

        before, after = between_beacons(bench, "submission and counting of payloads", act, client.in_frame)
        bench.answered(after, before, "buffered payloads, as before")


@case(
    "TC_BP_QM_BV_13",
    "In 1.0, a queue keeps all payloads, and each beacon takes one of them",
    requirements="BP-QM-10 BP-QRY-02 BP-QM-03 BP-TXP-09",
    stimulus="between two beacons, a client with mode QUEUE submits six payloads and queries their number after each",
    expect="BP-STATUS-OK and 1 to 6 buffered payloads; then one payload in each beacon, in the order of submission",
    needs=_COUNTED,
    window=10,
)
def one_from_the_queue(bench: Bench) -> None:
    with BPClient(bench, _QUEUE) as client:

        def act() -> tuple[list[bytes], list[int | None]]:
            payloads, numbers = [client.payload() for _ in range(6)], []
            for payload in payloads:
                answer = client.transmit(payload, must=False)
                if no_confirm(bench) is None:
                    bench.services.check_status(answer, (OK,), TRANSMIT, "BP-TXP-09")
                numbers.append(client.number())
            return payloads, numbers

        start = bench.mark()
        payloads, numbers = between_beacons(bench, "submission of six payloads", act, client.in_frame)
        bench.answered(numbers, list(range(1, 7)), "buffered payloads after the submissions", "BP-QRY-02")
        bench.until_quiet(client.in_frame, since=start)
        frames = client.frames(start)
        needed(bench, frames, "beacons with the payloads")
        counts = [len(client.in_frame(each)) for each in frames]
        bench.answered(max(counts), 1, "payloads of the client in each beacon", "BP-QM-10", frames=frames)
        sent = [each for each in client.sent(start) if each in payloads]
        observed = listed(sent, payloads)
        bench.in_order(sent, payloads, "all payloads in the order of submission", "BP-QM-03", seen=observed)
