"""dcp-bp.md: Data Types, queueing modes; Transmit Path.

Payloads are submitted between two beacons; the beacons sent afterwards show what the queue or buffer kept.
"""

from __future__ import annotations

from math import inf

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import LISTENS, Needs, case
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import (
    CLEAR,
    CLIENT,
    DROPHEAD,
    DROPTAIL,
    ONCE,
    QUERY,
    REPEAT,
    BPClient,
    each_mode,
    listed,
    needed,
    no_confirm,
)
from dcp_conformance.test_system.bench import Bench

V1_1 = SpecVersion.V1_1
_SENDER = Needs(entities=(), ut=CLIENT)
_QUEUES = {"droptail": DROPTAIL, "drophead": DROPHEAD}


def until_done(client: BPClient, since: int) -> list[bytes]:
    """Wait until no more payloads of a client are sent; return those sent since a mark."""
    client.bench.until_quiet(client.in_frame, since=since)
    return client.sent(since)


# -- queues ------------------------------------------------------------------------------------------------------------


@case(
    "TC_BP_QM_BV_01",
    "A full queue of mode DROPTAIL discards the new payload, and the status is BP-STATUS-OK",
    requirements="BP-QM-01 BP-TXP-04 BP-TXP-09",
    stimulus="between two beacons, a client with maxEntries 2 submits A, B, C",
    expect="BP-STATUS-OK each time; A is sent, then B, and never C",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT),
    value=(DROPTAIL, 0),
)
@case(
    "TC_BP_QM_BV_02",
    "A full queue of mode DROPHEAD drops its oldest payload for the new one, and the status is BP-STATUS-OK",
    requirements="BP-QM-02 BP-TXP-05",
    stimulus="between two beacons, a client with maxEntries 2 submits A, B, C",
    expect="BP-STATUS-OK each time; B is sent, then C, and never A",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT),
    value=(DROPHEAD, 1),
)
def full_queue(bench: Bench, kept: tuple[QueueingMode, int]) -> None:
    mode, first = kept
    dropping, *statuses = bench.case.requirements
    with BPClient(bench, mode, entries=2) as client:
        start = bench.mark()
        events = len(bench.traffic.events)
        payloads = client.submit(3, must=False)
        observed = [each.text for each in bench.traffic.events[events:] if each.direction == "answer"]
        refused = [text for text in observed if not text.endswith(("STATUS-OK", "STATUS_OK"))]
        if no_confirm(bench) is None:
            bench.none(refused, "BP-STATUS-OK for each submission", *statuses)
        sent = [each for each in until_done(client, start) if each in payloads]
        right = payloads[first : first + 2]
        expected = f"payloads {listed(right, payloads)} in the beacons"
        bench.in_order(
            sent, right, expected, dropping, *statuses, seen=listed(sent, payloads), frames=client.frames(start)
        )


@case(
    "TC_BP_QM_BV_03",
    "A queue sends each payload once, in the order of submission ({variant})",
    requirements="BP-QM-03",
    stimulus="between two beacons, a client with mode {variant} and maxEntries 5 submits five payloads",
    expect="one beacon with each of them, in order",
    variants={name: each for name, each in each_mode(*CLIENT).items() if each.value.is_queue},
    window=8,
)
def fifo(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode, entries=5) as client:
        start = bench.mark()
        payloads = client.submit(5)
        sent = [each for each in until_done(client, start) if each in payloads]
        expected = f"payloads {listed(payloads, payloads)}"
        bench.in_order(sent, payloads, expected, seen=listed(sent, payloads), frames=client.frames(start))


@case(
    "TC_BP_QM_BV_04",
    "A queue holds maxEntries payloads, and BP reports its length ({variant})",
    requirements="BP-QRY-02 BP-REG-06",
    stimulus="a client with mode {variant} and maxEntries 3 submits four payloads one by one",
    expect="BP-QueryNumberBufferedPayloads answers 0, then 1, 2, 3, 3",
    needs=Needs(since=V1_1, entities=(), ut=(*CLIENT, QUERY)),
    variants=_QUEUES,
)
def queue_length(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode, entries=3) as client:

        def act() -> list[int | None]:
            found = [client.number()]
            for _ in range(4):
                client.transmit(client.payload())
                found.append(client.number())
            return found

        # A beacon in between would take a payload from the queue.
        numbers = between_beacons(bench, "submission of four payloads", act, client.in_frame)
        bench.answered(numbers[0], 0, "payloads in the queue after registration", "BP-REG-06")
        bench.answered(numbers[1:], [1, 2, 3, 3], "numbers of buffered payloads", "BP-QRY-02")


@case(
    "TC_BP_QM_BV_05",
    "With allowMultiplePayloads false a beacon has at most one payload of a client ({variant})",
    requirements="BP-QM-07",
    stimulus="between two beacons, a client with mode {variant} submits four small payloads",
    expect="four beacons with one payload each",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT),
    variants=_QUEUES,
    window=8,
)
def one_per_beacon(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode, entries=4, several=False) as client:
        start = bench.mark()
        client.submit(4)
        until_done(client, start)
        frames = client.frames(start)
        needed(bench, frames, "beacons with the payloads")
        counts = [len(client.in_frame(each)) for each in frames]
        bench.answered(max(counts), 1, "payloads of the client in each beacon", frames=frames)


@case(
    "TC_BP_QM_BV_06",
    "With allowMultiplePayloads true several payloads of a client may share a beacon",
    requirements="BP-QM-08 BP-TX-03",
    alone=LISTENS,
    stimulus="between two beacons, a client with allowMultiplePayloads true submits four small payloads",
    expect="each payload once and in order; the case reports how many share a beacon",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT),
    window=8,
)
def several_per_beacon(bench: Bench) -> None:
    with BPClient(bench, DROPTAIL, entries=4, several=True) as client:
        start = bench.mark()
        payloads = client.submit(4)
        sent = [each for each in until_done(client, start) if each in payloads]
        bench.in_order(sent, payloads, "each payload once, in order", "BP-QM-03", seen=listed(sent, payloads))
        counts = [len(client.in_frame(each)) for each in client.frames(start)]
        bench.info("How many payloads of one client are in each beacon?", ", ".join(map(str, counts)))
        if bench.sut.pics.multiple_payloads:
            bench.some(
                max(counts, default=0) > 1, "several payloads in a beacon, as the PICS claims", "BP-QM-08", seen=counts
            )


# -- buffers -----------------------------------------------------------------------------------------------------------


@case(
    "TC_BP_QM_BV_07",
    "Mode ONCE sends only the newest payload, once",
    requirements="BP-QM-04 BP-TXP-06",
    stimulus="between two beacons, a client with mode ONCE submits A and B",
    expect="B in one beacon; A in none",
    needs=_SENDER,
)
def once(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        start = bench.mark()
        payloads = client.submit(2)
        sent = [each for each in until_done(client, start) if each in payloads]
        bench.in_order(sent, payloads[1:], "payload B, once", seen=listed(sent, payloads), frames=client.frames(start))


@case(
    "TC_BP_QM_BV_08",
    "Mode REPEAT repeats a payload until the next one is submitted",
    requirements="BP-QM-05 BP-TXP-06",
    stimulus="a client with mode REPEAT submits A; after five beacons it submits B",
    expect="A in each beacon of the client, then B in each, without A",
    needs=_SENDER,
    window=12,
)
def repeat(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        old, new = client.payload(), client.payload()
        client.transmit(old)
        for _ in range(5):
            client.until_sent()
        bench.repeated(client.sent(), 5, "beacons with A", "BP-QM-05", most=inf, frames=client.frames())
        start = bench.mark()
        client.transmit(new)
        submitted = bench.now()
        for _ in range(3):
            client.until_sent(new)
        sent = client.sent(start)
        # A beacon that was in preparation when B was submitted may still contain A.
        late = [heard for heard in client.frames(start, after=submitted) if old in client.in_frame(heard)]
        bench.none(late[1:], "A in at most one beacon after the submission of B")
        after = sent[sent.index(new) :] if new in sent else []
        bench.proved(old not in after, "only B after B", listed(sent, [old, new]), frames=client.frames(start))
        bench.repeated(sent.count(new), 3, "beacons with B", most=inf, frames=client.frames(start))


@case(
    "TC_BP_QM_BV_09",
    "Mode REPEAT sends its payload repeatedly",
    requirements="BP-QM-05 BP-TX-05",
    stimulus="a client with mode REPEAT, allowMultiplePayloads true and a small payload; six beacons",
    expect="the payload once in each of these beacons; other protocols may delay it",
    needs=_SENDER,
    window=8,
)
def repeat_in_every_beacon(bench: Bench) -> None:
    with BPClient(bench, REPEAT, several=True) as client:
        client.put_on_air()
        frames = bench.beacons(6)
        # A buffer has one payload: allowMultiplePayloads does not matter for it.
        most = max([len(client.in_frame(heard)) for heard in frames], default=0)
        bench.none(most > 1, "the payload once in a beacon", "BP-QM-05", seen=f"{most} times", frames=frames)
        bare = [heard for heard in frames if not client.in_frame(heard)]
        bench.some(
            len(frames) == 6, "six beacons", seen=f"{len(frames)} beacons in {2 * 6 + bench.sut.reaction:g} periods"
        )
        if len(bare) == len(frames):
            bench.inconclusive("further beacons with the payload", "all beacons have only blocks of other protocols")
        if bare:
            # The number and choice of payloads in a beacon is free; another case checks beacons without payloads.
            bench.info(
                "Does a payload of another protocol delay one of mode REPEAT?", f"yes, in {len(bare)} of 6 beacons"
            )
        bench.passed("further beacons with the payload")


@case(
    "TC_BP_QM_BV_10",
    "A buffer holds at most one payload, and its count is 0 or 1 ({variant})",
    requirements="BP-QRY-03 BP-TX-05 BP-TXP-06",
    stimulus="a client with mode {variant} submits two payloads; one of them is sent",
    expect="BP-QueryNumberBufferedPayloads answers 0, 1, 1; after the transmission 0 (ONCE) or 1 (REPEAT)",
    needs=Needs(entities=(), ut=(*CLIENT, QUERY)),
    variants={"once": ONCE, "repeat": REPEAT},
)
def buffer_count(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode) as client:
        start = 0

        def act() -> list[int | None]:
            nonlocal start
            # The payload of an earlier attempt has already been sent.
            start = bench.mark()
            found = [client.number()]
            for _ in range(2):
                client.transmit(client.payload())
                found.append(client.number())
            return found

        # With REPEAT the payload stays in the buffer, so a beacon in between makes no difference.
        numbers = (
            act() if mode is REPEAT else between_beacons(bench, "submission of two payloads", act, client.in_frame)
        )
        bench.answered(numbers, [0, 1, 1], "buffered payloads", "BP-QRY-03 BP-TXP-06")
        if not client.frames(start):
            client.until_sent()
        needed(bench, client.frames(start), "a beacon with the payload")
        right, number = 1 if mode is REPEAT else 0, client.number()
        bench.answered(number, right, "buffered payloads after the transmission", "BP-QRY-03 BP-TX-05")


@case(
    "TC_BP_QM_BV_11",
    "A cleared payload of mode REPEAT is no longer sent",
    requirements="BP-QM-05 BP-CLR-03",
    stimulus="a client with mode REPEAT clears its buffer after its payload was sent",
    expect="no further beacon with the payload",
    needs=Needs(since=V1_1, entities=(), ut=(*CLIENT, CLEAR)),
)
def clear_repeated(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.put_on_air()
        bench.must(CLEAR, protId=client.prot_id)
        quiet_from = bench.now() + bench.period // 5
        bench.wait(4)
        bench.none(client.frames(after=quiet_from), "no further beacon with the payload")
