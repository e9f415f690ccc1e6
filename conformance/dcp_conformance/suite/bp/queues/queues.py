"""dcp-bp.md: Data Types, queueing modes: queues of many entries."""

from __future__ import annotations

from contextlib import ExitStack

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import (
    CLEAR,
    CLIENT,
    DEREGISTER,
    DROPHEAD,
    DROPTAIL,
    OK,
    QUERY,
    REGISTER,
    BPClient,
    needed,
    queue_mode,
)
from dcp_conformance.test_system.bench import Bench

V1_1, V1_2 = SpecVersion.V1_1, SpecVersion.V1_2
_MANY = 64
_BEYOND_OCTET = 300
_SWITCHES = ("BP-MGMT-Activate", "BP-MGMT-Deactivate")
_BEYOND = 2
"""Number of payloads submitted in excess of the length of the queue."""


@case(
    "TC_BP_QM_BV_12",
    "A queue of 64 entries keeps 64 payloads in order; its mode determines which of more payloads it keeps ({variant})",
    requirements="BP-QM-03",
    stimulus=(
        "between two beacons, a client with mode {variant} and maxEntries 64 (or the number in the PIXIT) submits two "
        "payloads more"
    ),
    expect="64 payloads, each sent once and in order: the first 64 (DROPTAIL) or the last 64 (DROPHEAD)",
    window=80,
    variants={
        name: Variant(mode, requirements=f"BP-QM-03 {own}", needs=Needs(since=V1_1, entities=(), ut=CLIENT))
        for name, mode, own in (("droptail", DROPTAIL, "BP-QM-01"), ("drophead", DROPHEAD, "BP-QM-02"))
    },
)
def many_entries(bench: Bench, mode: QueueingMode) -> None:
    dropping = "BP-QM-01" if mode is DROPTAIL else "BP-QM-02"
    most = min(_MANY, bench.sut.capacity("queue_entries") or _MANY)
    with BPClient(bench, mode, entries=most) as client:

        def act() -> tuple[list[bytes], int | None]:
            # Other cases check the status for a full queue (BP-TXP-04, BP-TXP-05).
            payloads = client.transmit_new(most + _BEYOND, must=False)
            return payloads, client.number() if QUERY in bench.services.upper.methods else None

        start = bench.mark()
        what = f"submission of {most + _BEYOND} payloads"
        payloads, number = between_beacons(bench, what, act, client.in_frame, flush=2 * most)
        if number is not None:
            bench.answered(number, most, "buffered payloads", dropping)
        bench.until_quiet(client.in_frame, 2 * most, start)
        sent = [each for each in client.sent(start) if each in payloads]
        kept = payloads[:most] if mode is DROPTAIL else payloads[_BEYOND:]
        places = [payloads.index(each) for each in sent]
        ordered = places == sorted(set(places))
        bench.proved(ordered, "each payload at most once, in the order of submission", f"payloads {places}", "BP-QM-03")
        wrong = sorted(places[index] for index, each in enumerate(sent) if each not in kept)
        bench.none(wrong, "none of the payloads that a full queue drops", dropping)
        missing = [payloads.index(each) for each in kept if each not in sent]
        bench.complete(missing, f"all {most} payloads that the queue keeps", dropping)


@case(
    "TC_BP_QM_BV_16",
    "A queue of 300 entries keeps 300 payloads ({variant})",
    requirements="BP-QM-03",
    stimulus=(
        "while BP is inactive, a client with mode {variant} and maxEntries 300 submits 302 payloads; BP-MGMT-Activate, "
        "and BP-ClearBuffer after three periods"
    ),
    expect="300 buffered payloads; the payloads sent are the first of those that the queue keeps, in order",
    window=12,
    variants={
        name: Variant(
            mode,
            requirements=f"BP-QM-03 {own}",
            needs=Needs(
                V1_2,
                entities=(),
                ut=(*CLIENT, CLEAR, QUERY, *_SWITCHES),
                when=lambda bench: bench.sut.lacks("queue_entries", _BEYOND_OCTET) or None,
            ),
        )
        for name, mode, own in (("droptail", DROPTAIL, "BP-QM-01"), ("drophead", DROPHEAD, "BP-QM-02"))
    },
)
def beyond_an_octet(bench: Bench, mode: QueueingMode) -> None:
    dropping = "BP-QM-01" if mode is DROPTAIL else "BP-QM-02"
    client = BPClient(bench, mode, size=8, entries=_BEYOND_OCTET)
    answer = client.register()
    if not answer.ok:
        bench.info(f"Can maxEntries be {_BEYOND_OCTET}?", f"no: {answer}")
        return
    with ExitStack() as stack:
        stack.callback(bench.call, DEREGISTER, protId=client.prot_id)
        with bench.services.deactivated("BP"):
            bench.wait(0.2)
            start = bench.mark()
            payloads = client.transmit_new(_BEYOND_OCTET + _BEYOND, 8, must=False)
            bench.answered(client.number(), _BEYOND_OCTET, "buffered payloads", dropping)
        bench.wait(3)
        bench.must(CLEAR, protId=client.prot_id)
        sent = client.sent(start)
        needed(bench, sent, "beacons with the payloads")
        kept = payloads[:_BEYOND_OCTET] if mode is DROPTAIL else payloads[_BEYOND:]
        places = [payloads.index(each) for each in sent]
        # A beacon may be lost at the tester.
        first = list(range(payloads.index(kept[0]), max(places) + 1))
        bench.in_order(places, first, "the first payloads that the queue keeps, in order", "BP-QM-03", dropping)


@case(
    "TC_BP_QM_BV_15",
    "A queue of 1.0 has no maximum length: it keeps 66 payloads in order, and BP reports their number",
    requirements="BP-QM-03 BP-QM-10 BP-QRY-02",
    stimulus="between two beacons, a client with mode BP_QMODE_QUEUE submits 66 payloads",
    expect="BP-QueryNumberBufferedPayloads answers 66; each payload is sent once and in order",
    window=80,
    needs=Needs(until=SpecVersion.V1_0, entities=(), ut=(*CLIENT, QUERY)),
)
def unbounded(bench: Bench) -> None:
    count = _MANY + _BEYOND
    with BPClient(bench, QueueingMode.QUEUE) as client:

        def act() -> tuple[list[bytes], int | None]:
            return client.transmit_new(count), client.number()

        start = bench.mark()
        what = f"submission of {count} payloads"
        payloads, number = between_beacons(bench, what, act, client.in_frame, flush=2 * count)
        bench.answered(number, count, "buffered payloads", "BP-QRY-02")
        bench.until_quiet(client.in_frame, 2 * count, start)
        places = [payloads.index(each) for each in client.sent(start) if each in payloads]
        bench.in_order(places, range(count), "each payload once, in the order of submission", "BP-QM-03", seen=places)


@case(
    "TC_BP_REG_BV_05",
    "maxEntries 1 and 64 are accepted; the case reports which larger values are",
    requirements="BP-REG-05 BP-QM-09",
    stimulus="BP-RegisterProtocol with maxEntries 1, 64, 255, 256, 65535 and 4294967295",
    expect="BP-STATUS-OK for 1 and 64, or the capacity in the PIXIT; the specification has no upper limit",
    needs=Needs(since=V1_1, entities=(), ut=(REGISTER, DEREGISTER)),
)
def bounds_of_entries(bench: Bench) -> None:
    declared = bench.sut.capacity("queue_entries")
    for entries in (1, min(_MANY, declared or _MANY)):
        client = BPClient(bench, queue_mode(bench), entries=entries)
        if bench.expect_status(OK, REGISTER, **client.registration).ok:
            bench.must(DEREGISTER, protId=client.prot_id)
    accepted = []
    for entries in (255, 256, 0xFFFF, 0xFFFFFFFF):
        client = BPClient(bench, queue_mode(bench), entries=entries)
        if client.register().ok:
            accepted.append(entries)
            bench.must(DEREGISTER, protId=client.prot_id)
    bench.info("Which larger values of maxEntries are accepted?", ", ".join(map(str, accepted)) or "none", "BP-REG-01")
