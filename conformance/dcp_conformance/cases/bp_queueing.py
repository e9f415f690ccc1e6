"""dcp-bp.md: Data Types, queueing modes; Transmit Path.

Payloads are submitted between two beacons; what is on the air afterwards shows what the queue or buffer has done.
"""

from __future__ import annotations

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.clients import (
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
from dcp_conformance.findings import part_of
from dcp_conformance.gaps import between_beacons

V1_1 = SpecVersion.V1_1
_SENDER = Needs(entities=(), ut=CLIENT)
_QUEUES = {"droptail": DROPTAIL, "drophead": DROPHEAD}


def until_done(client: BPClient, since: int) -> list[bytes]:
    """Wait until nothing of a client is sent any more; what was sent from a mark on."""
    client.bench.until_quiet(client.in_frame, since=since)
    return client.sent(since)


# -- queues ------------------------------------------------------------------------------------------------------------


@case(
    "TC_BP_QM_BV_01",
    "A full queue of mode DROPTAIL discards the new payload, and the status is OK",
    requirements="BP-QM-01 BP-TXP-04 BP-TXP-09",
    stimulus="a client with maxEntries 2 submits A, B, C between two beacons",
    expect="BP-STATUS-OK each time; A, then B on the air, and no C",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT),
    smoke=True,
)
def droptail(bench: Bench) -> None:
    full_queue(bench, DROPTAIL, [0, 1], "BP-QM-01", "BP-TXP-04", "BP-TXP-09")


@case(
    "TC_BP_QM_BV_02",
    "A full queue of mode DROPHEAD drops its oldest payload for the new one, and the status is OK",
    requirements="BP-QM-02 BP-TXP-05",
    stimulus="a client with maxEntries 2 submits A, B, C between two beacons",
    expect="BP-STATUS-OK each time; B, then C on the air, and no A",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT),
)
def drophead(bench: Bench) -> None:
    full_queue(bench, DROPHEAD, [1, 2], "BP-QM-02", "BP-TXP-05")


def full_queue(bench: Bench, mode: QueueingMode, kept: list[int], /, *requirements: str) -> None:
    """Submit one payload too many; those at the places ``kept`` must be sent, in order."""
    with BPClient(bench, mode, entries=2) as client:
        start = bench.mark()
        events = len(bench.traffic.events)
        payloads = client.submit(3, must=False)
        said = [each.text for each in bench.traffic.events[events:] if each.direction == "answer"]
        refused = [text for text in said if not text.endswith(("STATUS-OK", "STATUS_OK"))]
        if no_confirm(bench) is None:
            bench.check(not refused, "each submission is answered with OK", f"{refused}", *requirements[1:], shown=True)
        sent = [each for each in until_done(client, start) if each in payloads]
        right = [payloads[place] for place in kept]
        expected = f"payloads {listed(right, payloads)} on the air"
        bench.check(
            sent == right,
            expected,
            f"{listed(sent, payloads)}",
            *requirements,
            frames=client.frames(start),
            shown=not part_of(sent, right),
        )


@case(
    "TC_BP_QM_BV_03",
    "A queue sends each payload once, in the order of submission ({variant})",
    requirements="BP-QM-03",
    stimulus="a client with mode {variant} and maxEntries 5 submits five payloads between two beacons",
    expect="each of them in one beacon, in order",
    variants={name: each for name, each in each_mode(*CLIENT).items() if each.value.is_queue},
    window=8,
)
def fifo(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode, entries=5) as client:
        start = bench.mark()
        payloads = client.submit(5)
        sent = [each for each in until_done(client, start) if each in payloads]
        expected = f"payloads {listed(payloads, payloads)}"
        bench.check(
            sent == payloads,
            expected,
            f"{listed(sent, payloads)}",
            frames=client.frames(start),
            shown=not part_of(sent, payloads),
        )


@case(
    "TC_BP_QM_BV_04",
    "A queue is as long as it was registered to be, and BP says how long it is ({variant})",
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

        # A beacon in between would take one out.
        numbers = between_beacons(bench, "four payloads are submitted", act, client.in_frame)
        bench.check(
            numbers[0] == 0, "a new queue is empty", f"{numbers[0]} payloads are in it", "BP-REG-06", shown=True
        )
        bench.check(numbers[1:] == [1, 2, 3, 3], "lengths 1, 2, 3, 3", f"{numbers[1:]}", "BP-QRY-02", shown=True)


@case(
    "TC_BP_QM_BV_05",
    "With allowMultiplePayloads false there is one payload of a client per beacon ({variant})",
    requirements="BP-QM-07",
    stimulus="a client with mode {variant} submits four small payloads between two beacons",
    expect="four beacons with one each",
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
        bench.check(max(counts) == 1, "one payload per beacon", f"{counts}", frames=frames, shown=True)


@case(
    "TC_BP_QM_BV_06",
    "With allowMultiplePayloads true several payloads of a client may share a beacon",
    requirements="BP-QM-08 BP-TX-03",
    stimulus="a client that allows it submits four small payloads between two beacons",
    expect="each payload once and in order; how many of them share a beacon is reported",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT),
    window=8,
)
def several_per_beacon(bench: Bench) -> None:
    with BPClient(bench, DROPTAIL, entries=4, several=True) as client:
        start = bench.mark()
        payloads = client.submit(4)
        sent = [each for each in until_done(client, start) if each in payloads]
        bench.check(
            sent == payloads,
            "all of them once, in order",
            listed(sent, payloads),
            "BP-QM-03",
            shown=not part_of(sent, payloads),
        )
        counts = [len(client.in_frame(each)) for each in client.frames(start)]
        bench.info("How many payloads of one client share a beacon?", ", ".join(map(str, counts)))
        if bench.pics.multiple_payloads:
            bench.check(
                max(counts, default=0) > 1, "several share a beacon, as the PICS claims", f"{counts}", "BP-QM-08"
            )


# -- buffers -----------------------------------------------------------------------------------------------------------


@case(
    "TC_BP_QM_BV_07",
    "Mode ONCE sends the newest payload, once",
    requirements="BP-QM-04 BP-TXP-06",
    stimulus="a client with mode ONCE submits A and B between two beacons",
    expect="B in one beacon, and no A",
    needs=_SENDER,
)
def once(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        start = bench.mark()
        payloads = client.submit(2)
        sent = [each for each in until_done(client, start) if each in payloads]
        bench.check(
            sent == payloads[1:],
            "payload B once",
            listed(sent, payloads),
            frames=client.frames(start),
            shown=not part_of(sent, payloads[1:]),
        )


@case(
    "TC_BP_QM_BV_08",
    "Mode REPEAT keeps a payload until the next one",
    requirements="BP-QM-05 BP-TXP-06",
    stimulus="a client with mode REPEAT submits A; five beacons later B",
    expect="A in each beacon of the client, then B in each, and A no more",
    needs=_SENDER,
    window=12,
)
def repeat(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        old, new = client.payload(), client.payload()
        client.transmit(old)
        for _ in range(5):
            client.until_sent()
        repeated = client.sent()
        bench.check(len(repeated) >= 5, "A in five beacons", f"in {len(repeated)}", "BP-QM-05", frames=client.frames())
        start = bench.mark()
        client.transmit(new)
        submitted = bench.now()
        for _ in range(3):
            client.until_sent(new)
        sent = client.sent(start)
        # A beacon that was being prepared when B came may have A still.
        late = [heard for heard in client.frames(start, after=submitted) if old in client.in_frame(heard)]
        again = new in sent and old in sent[sent.index(new) :]
        right = sent.count(new) >= 3 and not again and len(late) <= 1
        bench.check(
            right, "B only", listed(sent, [old, new]), frames=client.frames(start), shown=again or len(late) > 1
        )


@case(
    "TC_BP_QM_BV_09",
    "A payload of mode REPEAT is transmitted repeatedly",
    requirements="BP-QM-05 BP-TX-05",
    stimulus="a client with mode REPEAT and small payload; six beacons",
    expect="the payload in them; other protocols may keep it back",
    needs=_SENDER,
    window=8,
)
def repeat_in_every_beacon(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        needed(bench, client.until_sent(), "a beacon with the payload")
        frames = bench.beacons(6)
        bare = [heard for heard in frames if not client.in_frame(heard)]
        bench.check(len(frames) == 6, "six beacons", f"{len(frames)} in {2 * 6 + bench.reaction:g} periods")
        if len(bare) == len(frames):
            bench.inconclusive("beacons with the payload again", "all have blocks of other protocols only")
        if bare:
            # How many payloads a beacon has and which is free, and a beacon without any is another case's matter.
            bench.info(
                "Does a payload of another protocol keep back one of mode REPEAT?", f"in {len(bare)} of 6 beacons"
            )
        bench.check(True, "the payload is transmitted repeatedly")


@case(
    "TC_BP_QM_BV_10",
    "A buffer counts as one payload or none ({variant})",
    requirements="BP-QRY-03 BP-TX-05 BP-TXP-06",
    stimulus="a client with mode {variant} submits two payloads; one is sent",
    expect="BP-QueryNumberBufferedPayloads answers 0, 1, 1; after transmission 0 (ONCE) or 1 (REPEAT)",
    needs=Needs(entities=(), ut=(*CLIENT, QUERY)),
    variants={"once": ONCE, "repeat": REPEAT},
)
def buffer_count(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode) as client:
        start = 0

        def act() -> list[int | None]:
            nonlocal start
            # A payload of an earlier attempt has left already.
            start = bench.mark()
            found = [client.number()]
            for _ in range(2):
                client.transmit(client.payload())
                found.append(client.number())
            return found

        # With REPEAT it stays in the buffer.
        numbers = (
            act() if mode is REPEAT else between_beacons(bench, "two payloads are submitted", act, client.in_frame)
        )
        bench.check(numbers == [0, 1, 1], "0, then 1, then 1", f"{numbers}", "BP-QRY-03", "BP-TXP-06", shown=True)
        if not client.frames(start):
            client.until_sent()
        needed(bench, client.frames(start), "a beacon with the payload")
        right, number = 1 if mode is REPEAT else 0, client.number()
        bench.check(number == right, f"{right} after transmission", f"{number}", "BP-QRY-03", "BP-TX-05", shown=True)


@case(
    "TC_BP_QM_BV_11",
    "A cleared payload of mode REPEAT disappears from the beacons",
    requirements="BP-QM-05 BP-CLR-03",
    stimulus="a client with mode REPEAT clears its buffer when its payload is on the air",
    expect="no further beacon with it",
    needs=Needs(since=V1_1, entities=(), ut=(*CLIENT, CLEAR)),
)
def clear_repeated(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        needed(bench, client.until_sent(), "a beacon with the payload")
        bench.must(CLEAR, protId=client.prot_id)
        quiet_from = bench.now() + bench.period // 5
        bench.wait(4)
        frames = client.frames(after=quiet_from)
        bench.check(not frames, "no beacon with it", f"{len(frames)} beacons", frames=frames, shown=True)
