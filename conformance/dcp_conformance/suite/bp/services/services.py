"""dcp-bp.md: Payload Exchange and Buffer Management.

Statuses and confirms of the services; other modules test what queues and buffers send.
"""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import FILLS, Needs, Variant, case
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import (
    CLEAR,
    CLIENT,
    DEREGISTER,
    EMPTY,
    LIST,
    OK,
    ONCE,
    QUERY,
    REGISTER,
    REPEAT,
    TOO_LARGE,
    TRANSMIT,
    UNKNOWN_PROTOCOL,
    BPClient,
    block_header_octets,
    each_mode,
    largest_payload,
    no_confirm,
    room,
    unused_protocol_id,
)
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.upper_tester import Answer

V1_1 = SpecVersion.V1_1


# -- BP-TransmitPayload ------------------------------------------------------------------------------------------------

_TRANSMIT = Needs(entities=(), ut=CLIENT, when=no_confirm)


@case(
    "TC_BP_TXP_BO_01",
    "A payload for an unregistered identifier is rejected ({variant})",
    requirements="BP-TXP-01 BP-REG-10",
    stimulus="BP-TransmitPayload {variant}",
    expect="BP-STATUS-UNKNOWN-PROTOCOL, and no beacon with the payload",
    needs=_TRANSMIT,
    variants={"before-registration": False, "after-deregistration": True},
)
def transmit_unregistered(bench: Bench, registered_before: bool) -> None:
    client = BPClient(bench, ONCE)
    if registered_before:
        bench.must(REGISTER, **client.registration)
        bench.must(DEREGISTER, protId=client.prot_id)
    payload = client.payload()
    bench.expect_status(UNKNOWN_PROTOCOL, TRANSMIT, protId=client.prot_id, payload=payload.hex())
    with client:
        bench.wait(2)
    bench.none(
        client.sent(),
        "the payload is not sent, not even after a registration",
        "BP-REG-10",
        seen="the payload was sent",
    )


@case(
    "TC_BP_TXP_BV_01",
    "A payload of exactly maxPayloadSize octets is accepted and sent unchanged ({variant})",
    requirements="BP-TXP-02 BP-FMT-01",
    alone=FILLS,
    stimulus="BP-TransmitPayload with exactly maxPayloadSize octets: {variant}",
    expect="BP-STATUS-OK and a beacon with exactly these octets",
    needs=_TRANSMIT,
    variants={"1": 1, "64": 64, "255": 255, "256": 256, "the-largest": None},
)
def full_size(bench: Bench, size: int | None) -> None:
    if size is None:
        # Before 1.1, the limit for registrations ignores the BP header, so a client may register payloads too large to
        # be sent.
        fits = room(bench) - block_header_octets(bench)
        size = min(largest_payload(bench), fits, bench.profile.bp.payload_area or fits)
    with BPClient(bench, ONCE, size=size) as client:
        payload = client.payload(size)
        bench.expect_status(OK, TRANSMIT, "BP-TXP-02", protId=client.prot_id, payload=payload.hex())
        bench.required(client.until_sent(), "a beacon with the payload", "BP-TXP-02")
        bench.answered(client.sent(), [payload], "the payload unchanged", "BP-FMT-01")


@case(
    "TC_BP_TXP_BI_01",
    "A payload of more than maxPayloadSize octets is rejected (excess octets: {variant})",
    requirements="BP-TXP-02",
    stimulus="BP-TransmitPayload with more than maxPayloadSize octets (excess octets: {variant})",
    expect="BP-STATUS-PAYLOAD-TOO-LARGE; the payload is neither buffered nor sent",
    needs=Needs(entities=(), ut=(*CLIENT, QUERY)),
    # With 256 octets more, the low octet of the length is a permitted length.
    variants={"1": 1, "100": 100, "256": 256},
)
def too_large(bench: Bench, more: int) -> None:
    with BPClient(bench, ONCE, size=20) as client:
        octets = client.payload(20 + more)
        answer = bench.call(TRANSMIT, protId=client.prot_id, payload=octets.hex())
        if no_confirm(bench) is None:
            bench.services.check_status(answer, (TOO_LARGE,), TRANSMIT)
        bench.answered(client.number(), 0, "buffered payloads")
        bench.wait(2)
        bench.none(
            client.sent(),
            "no beacon with a payload of the client",
            seen="at least one such beacon",
            frames=client.frames(),
        )


@case(
    "TC_BP_TXP_BI_02",
    "An empty payload is rejected and changes nothing ({variant})",
    requirements="BP-TXP-03",
    stimulus="a client with mode {variant} and buffered payloads submits an empty payload",
    expect="BP-STATUS-EMPTY-PAYLOAD if the service is confirmed; the number of buffered payloads as before",
    variants=each_mode(*CLIENT, QUERY, since=V1_1),
)
def empty_payload(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode) as client:

        def act() -> tuple[int | None, Answer, int | None]:
            client.transmit_new(2 if mode.is_queue else 1)
            return client.number(), bench.call(TRANSMIT, protId=client.prot_id, payload=""), client.number()

        # Except with mode REPEAT, a beacon in between would take a payload from the buffer.
        what = "submission and counting of payloads"
        result = act() if mode is REPEAT else between_beacons(bench, what, act, client.in_frame)
        before, answer, after = result
        if no_confirm(bench) is None:
            bench.services.check_status(answer, (EMPTY,), TRANSMIT)
        bench.answered(after, before, "buffered payloads, as before")
        if mode is REPEAT:
            start = bench.mark()
            bench.some(client.until_sent(), "the payload is still repeated", frames=bench.heard[start:])


@case(
    "TC_BP_TXP_BV_02",
    "In 1.0, an empty payload clears the buffer ({variant})",
    requirements="BP-TXP-13",
    stimulus="a client with mode {variant} and a buffered payload submits an empty payload",
    expect="BP-STATUS-OK, and no buffered payload",
    needs=Needs(until=SpecVersion.V1_0, entities=(), ut=(*CLIENT, QUERY)),
    variants={"once": ONCE, "repeat": REPEAT},
)
def empty_payload_clears(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode) as client:
        client.transmit(client.payload())
        bench.expect_status(OK, TRANSMIT, protId=client.prot_id, payload="")
        bench.answered(client.number(), 0, "buffered payloads")


@case(
    "TC_BP_TXP_BI_04",
    "In 1.0, an empty payload for a queue is rejected and does not clear the queue",
    requirements="BP-QM-03",
    stimulus="a client with mode QUEUE submits four payloads, then an empty one",
    expect="BP-STATUS-EMPTY-PAYLOAD; all four payloads are sent",
    needs=Needs(until=SpecVersion.V1_0, entities=(), ut=CLIENT, when=no_confirm),
    window=12,
)
def empty_payload_for_queue(bench: Bench) -> None:
    with BPClient(bench, QueueingMode.QUEUE) as client:
        start = bench.mark()
        payloads = client.transmit_new(4)
        bench.expect_status(EMPTY, TRANSMIT, protId=client.prot_id, payload="")
        bench.until_quiet(client.in_frame, since=start)
        sent = client.sent(start)
        bench.complete([payload.hex() for payload in payloads if payload not in sent], "all four payloads are sent")


@case(
    "TC_BP_QM_BV_20",
    "In 1.0, a queue has no maximum length",
    requirements="BP-QM-03",
    stimulus="a client with mode QUEUE, and maxEntries 1 if the upper tester takes it, submits eight payloads",
    expect="BP-STATUS-OK each time; all payloads are sent, in order",
    needs=Needs(until=SpecVersion.V1_0, entities=(), ut=CLIENT, when=no_confirm),
    window=20,
)
def unbounded_queue(bench: Bench) -> None:
    with BPClient(bench, QueueingMode.QUEUE, entries=1) as client:
        start = bench.mark()
        payloads = [client.payload() for _ in range(8)]
        for payload in payloads:
            bench.expect_status(OK, TRANSMIT, protId=client.prot_id, payload=payload.hex())
        bench.until_quiet(client.in_frame, since=start)
        sent = client.sent(start)
        places = [payloads.index(each) for each in sent if each in payloads]
        bench.in_order(places, range(8), "payloads 0 to 7, in order")


@case(
    "TC_BP_TXP_BI_03",
    "The first failing check of a submission determines the status ({variant})",
    requirements="BP-TXP-10 DATA-11",
    stimulus="BP-TransmitPayload with two faults: {variant}",
    expect="BP-STATUS-UNKNOWN-PROTOCOL",
    needs=_TRANSMIT,
    variants={"unknown-and-too-large": 1 << 10, "unknown-and-empty": 0},
)
def submission_with_two_faults(bench: Bench, size: int) -> None:
    octets = bytes(min(size, largest_payload(bench) + 1))
    prot_id = unused_protocol_id(bench)
    bench.expect_status(UNKNOWN_PROTOCOL, TRANSMIT, protId=prot_id, payload=octets.hex())


# -- BP-ClearBuffer, BP-QueryNumberBufferedPayloads --------------------------------------------------------------------


@case(
    "TC_BP_CLR_BO_01",
    "BP-ClearBuffer rejects an identifier that is not registered",
    requirements="BP-CLR-01",
    stimulus="BP-ClearBuffer for an unregistered identifier",
    expect="BP-STATUS-UNKNOWN-PROTOCOL",
    needs=Needs(since=V1_1, entities=(), ut=(CLEAR,)),
)
def clear_unknown(bench: Bench) -> None:
    bench.expect_status(UNKNOWN_PROTOCOL, CLEAR, protId=unused_protocol_id(bench))


@case(
    "TC_BP_CLR_BV_01",
    "A cleared buffer is empty until the next submission ({variant})",
    requirements="BP-CLR-02",
    stimulus=(
        "a client with mode {variant} submits payloads, clears its buffer, waits 3 periods, and submits another payload"
    ),
    expect="BP-STATUS-OK; no buffered payload, and only the last payload is sent",
    variants={
        name: Variant(each.value, requirements="BP-CLR-02" if each.value.is_queue else "BP-CLR-03", needs=each.needs)
        for name, each in each_mode(*CLIENT, CLEAR, QUERY, since=V1_1).items()
    },
)
def clear(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode) as client:
        client.transmit_new(3 if mode.is_queue else 1)
        bench.expect_status(OK, CLEAR, protId=client.prot_id)
        quiet_from = bench.now() + bench.period // 5
        bench.answered(client.number(), 0, "buffered payloads")
        bench.wait(3)
        client.check_silent(quiet_from)
        payload, start = client.payload(), bench.mark()
        client.transmit(payload)
        bench.some(client.until_sent(payload), "a payload submitted afterwards is sent")
        bench.every(client.sent(start), payload, "no other payload is sent")


@case(
    "TC_BP_QRY_BO_01",
    "BP-QueryNumberBufferedPayloads rejects an identifier that is not registered",
    requirements="BP-QRY-01",
    stimulus="BP-QueryNumberBufferedPayloads for an unregistered identifier",
    expect="BP-STATUS-UNKNOWN-PROTOCOL",
    needs=Needs(entities=(), ut=(QUERY,)),
)
def query_unknown(bench: Bench) -> None:
    bench.expect_status(UNKNOWN_PROTOCOL, QUERY, protId=unused_protocol_id(bench))


@case(
    "TC_BP_GEN_BV_01",
    "Every service of BP confirms each request with a status",
    requirements="DATA-10 BP-TXP-11",
    stimulus="each BP service that the upper tester offers, for a client of the tester",
    expect="one confirm for each request, with a status",
    needs=Needs(entities=(), ut=(REGISTER, DEREGISTER)),
)
def confirms(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        requests: dict[str, dict[str, Any]] = {
            LIST: {},
            TRANSMIT: {"protId": client.prot_id, "payload": client.payload().hex()},
            QUERY: {"protId": client.prot_id},
            CLEAR: {"protId": client.prot_id},
            "BP-MGMT-Activate": {},
        }
        extras = {REGISTER: set(client.answer.result) - {"status", "ownNodeIdentifier"}}
        for method, params in requests.items():
            if method not in bench.services.upper.methods:
                continue
            if method == TRANSMIT and no_confirm(bench):
                bench.info("Is BP-TransmitPayload confirmed?", "no", "BP-TXP-08")
                continue
            answer = bench.expect_status(
                OK, method, *(("BP-TXP-11", "DATA-10") if method == TRANSMIT else ("DATA-10",)), **params
            )
            extras[method] = set(answer.result) - {"status", "number", "protocols"}
    told = "; ".join(f"{method}: {', '.join(sorted(names))}" for method, names in extras.items() if names)
    bench.info("Do confirms of BP have additional parameters?", told or "no", "BP-GEN-01")
    if TRANSMIT in extras:
        bench.info("Is BP-TransmitPayload confirmed?", "yes", "BP-TXP-08")
