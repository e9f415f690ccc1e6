"""dcp-bp.md: Transmit Path, what fits into a beacon.

The specification leaves open which clients are served first and how many of them; a payload that does not fit must
wait.
"""

from __future__ import annotations

from contextlib import ExitStack

from dcp_spec.constants import BP_MAX_PAYLOADS, SpecVersion

from dcp_conformance.definitions.case import FILLS, LISTENS, Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import (
    CLIENT,
    DEREGISTER,
    ONCE,
    REPEAT,
    BPClient,
    areas_of_fixed_size,
    block_header_octets,
    header_octets,
    listed,
    queue_mode,
    room,
)
from dcp_conformance.test_system.bench import Bench

_SENDER = Needs(entities=(), ut=CLIENT)
#: Attempts to get a beacon without blocks of other protocols.
_ATTEMPTS = 6

_FITTING = Needs(entities=(), ut=CLIENT, when=areas_of_fixed_size)


def sizes_for(bench: Bench, octets: int) -> tuple[int, int]:
    """Return the sizes of two payloads whose blocks together have `octets` octets."""
    first = octets // 2 - block_header_octets(bench)
    return first, octets - first - 2 * block_header_octets(bench)


@case(
    "TC_BP_TX_BV_01",
    "Payloads that together do not fit into one beacon are sent in two (excess: {variant})",
    requirements="BP-TX-04 BP-FMT-02",
    alone=FILLS,
    stimulus="two clients submit payloads whose blocks together exceed the room in a beacon; excess: {variant}",
    expect="both payloads in different beacons, neither larger than BPPAR_MAXIMUM_PACKET_SIZE",
    needs=_FITTING,
    variants={"one-octet": 1, "a-header": None, "almost-all-of-it": 0.9},
)
def do_not_fit_together(bench: Bench, more: float | None) -> None:
    space = room(bench)
    # If the header does not count (X04), an excess of one octet over blocks and header still fits.
    extra = header_octets(bench) + 1 if more is None else round(more * space) if more < 1 else round(more)
    fitting(bench, space + extra, together=False)


@case(
    "TC_BP_TX_BV_02",
    "Payloads that together just fit into one beacon are sent",
    requirements="BP-FMT-02 BP-TX-03",
    alone=FILLS,
    stimulus="two clients submit payloads whose blocks together exactly fill the room in a beacon",
    expect="both payloads; the case reports whether they share a beacon",
    needs=_FITTING,
)
def fit_together(bench: Bench) -> None:
    fitting(bench, room(bench), together=True)


def fitting(bench: Bench, octets: int, *, together: bool) -> None:
    """Let two clients submit payloads of `octets` octets in total and check the beacons that carry them."""
    first, second = sizes_for(bench, octets)
    # Much larger payloads do not fit together in any beacon.
    close = not together and octets - room(bench) <= header_octets(bench) + 1
    with BPClient(bench, ONCE, size=first) as one, BPClient(bench, ONCE, size=second) as two:
        start = others = 0

        def act() -> list[bytes]:
            nonlocal start, others
            # Payloads sent in an earlier attempt do not count.
            start = len(bench.heard)
            # Another protocol may have a block in every beacon, as VarDis has for summaries.
            others = octets_of_others(bench.heard[-1]) if close and bench.heard else 0
            sizes = sizes_for(bench, octets - others)
            payloads = [one.payload(sizes[0]), two.payload(sizes[1])]
            one.transmit(payloads[0])
            two.transmit(payloads[1])
            return payloads

        def ours(heard: ReceivedBeacon) -> bool:
            return bool(one.in_frame(heard) or two.in_frame(heard))

        def octets_of_others(heard: ReceivedBeacon) -> int:
            """Return the size of the blocks of other protocols in a beacon."""
            blocks = [data for prot_id, data in heard.blocks if prot_id not in (one.prot_id, two.prot_id)]
            return sum(block_header_octets(bench) + len(data) for data in blocks)

        def disturbed() -> bool:
            """Return whether the first beacon had other room for the two payloads, because of another block."""
            found = next((heard for heard in bench.heard[start:] if ours(heard)), None)
            return close and found is not None and octets_of_others(found) != others

        for _ in range(_ATTEMPTS):
            # Submitted across a beacon, they would be sent in different beacons in any case.
            payloads = between_beacons(bench, "submission of two payloads", act, ours)
            bench.until(lambda _: one.frames(start) and two.frames(start), 2 * bench.sut.reaction)
            if not disturbed():
                break
        bench.only([*one.sent(start), *two.sent(start)], payloads, "both payloads, each sent once", "BP-TX-04")
        shared = [heard for heard in one.frames(start) if two.in_frame(heard)]
        if disturbed():
            # The room in the beacon was another one, so that nothing follows from what shares it.
            check_sizes(bench, start)
            if bench.verdicts.all_hold():
                bench.inconclusive(
                    "a beacon with room for exactly these payloads, which this case needs",
                    f"another block in the beacon, of another size than before, in each of {_ATTEMPTS} attempts",
                )
            return
        if together:
            bench.info("Do payloads share a beacon that just has room for them?", "yes" if shared else "no", "BP-TX-03")
        elif shared and octets - room(bench) <= header_octets(bench):
            bench.reading("X04", "blocks-only")
        else:
            bench.none(shared, "the payloads in different beacons", "BP-TX-04")
        check_sizes(bench, start)


def check_sizes(bench: Bench, since: int) -> None:
    """Check that no beacon exceeds the maximum size; X04 leaves open whether the header counts."""
    limit = bench.sut.bound("BPPAR_MAXIMUM_PACKET_SIZE")
    margin = header_octets(bench) if bench.verdicts.readings.get("X04") == "blocks-only" else 0
    bench.every(
        bench.heard[since:],
        lambda heard: len(heard.octets) <= limit + margin,
        f"no beacon of more than {limit} octets",
        "BP-FMT-02",
    )


@case(
    "TC_BP_TX_BV_03",
    "The payload at the head of a queue is not overtaken by a later one",
    requirements="BP-TX-06 BP-TX-04",
    alone=LISTENS,
    stimulus=(
        "a client repeats a payload that fills most of a beacon; another client queues two large payloads and "
        "then a small one"
    ),
    expect="the small payload is never sent before a large one",
    needs=_FITTING,
    window=14,
)
def head_of_line(bench: Bench) -> None:
    space, header = room(bench), block_header_octets(bench)
    filler, large, small = space * 3 // 4 - header, space // 2 - header, 8
    with (
        BPClient(bench, REPEAT, size=filler) as constant,
        BPClient(bench, queue_mode(bench), size=large, entries=4) as client,
    ):
        constant.put_on_air("beacons with the first payload", size=filler)
        # The clients may take turns: the repeated payload is the first in one of two beacons.
        sizes = (large, large, small)
        # If the first has already been sent, there is nothing to overtake.
        start, payloads = client.submit_between("submission of three payloads", lambda: [*map(client.payload, sizes)])
        bench.until(lambda heard: payloads[-1] in client.in_frame(heard), 12)
        sent = [payloads.index(each) for each in client.sent(start) if each in payloads]
        overtaken, late = 2 in sent and sent != [0, 1, 2], {0, 1} <= set(sent)
        what, frames = "the small payload is sent after the large ones", client.frames(start)
        bench.none(overtaken, what, "BP-TX-06", seen=listed(client.sent(start), payloads), frames=frames, given=late)
        shared = [
            heard
            for heard in client.frames(start)
            if set(payloads[:2]) & set(client.in_frame(heard)) and constant.in_frame(heard)
        ]
        bench.none(shared, "a large payload and the repeated one in different beacons", "BP-TX-04")
        if not late:
            bench.info(
                "Can a payload that always fits delay a larger one indefinitely?",
                "yes, for at least 12 periods",
                "BP-TX-03",
            )


@case(
    "TC_BP_TX_BV_07",
    "With allowMultiplePayloads, no payload overtakes one that does not fit any more",
    requirements="BP-TX-06 BP-QM-03",
    alone=FILLS,
    stimulus="between two beacons, a client queues a small payload, one of the largest size, and a small one",
    expect="the three payloads in this order",
    needs=Needs(since=SpecVersion.V1_1, entities=(), ut=CLIENT, when=areas_of_fixed_size),
    window=8,
)
def large_among_small(bench: Bench) -> None:
    large = room(bench) - block_header_octets(bench)
    with BPClient(bench, queue_mode(bench), size=large, entries=4, several=True) as client:
        sizes = (8, large, 8)
        start, payloads = client.submit_between("submission of three payloads", lambda: [*map(client.payload, sizes)])
        bench.until(lambda _: set(payloads) <= set(client.sent(start)), 8)
        sent = [each for each in client.sent(start) if each in payloads]
        places = [payloads.index(each) for each in sent]
        what, frames = "the payloads in the order of submission", client.frames(start)
        bench.none(places != sorted(places), what, seen=listed(sent, payloads), frames=frames, given=1 in places)


@case(
    "TC_BP_TX_BV_04",
    "The payloads of several clients are all sent; the number of blocks in a beacon is free",
    requirements="BP-TX-03 BP-FMT-01",
    alone=FILLS,
    stimulus="four clients with different modes submit small payloads",
    expect="each payload unchanged; the case reports order and number of blocks",
    needs=_SENDER,
)
def several_clients(bench: Bench) -> None:
    with ExitStack() as stack:
        modes = (ONCE, REPEAT, queue_mode(bench), ONCE)
        clients = [stack.enter_context(BPClient(bench, mode)) for mode in modes]
        payloads = [client.payload(7 + number) for number, client in enumerate(clients)]
        start = bench.mark()
        for client, payload in zip(clients, payloads, strict=True):
            client.transmit(payload)
        bench.until(lambda _: all(client.frames(start) for client in clients), 2 * bench.sut.reaction)
        if not all(client.frames(start) for client in clients):
            # The repeated payload may be served first in every beacon.
            bench.call(DEREGISTER, protId=clients[1].prot_id)
            bench.until(lambda _: all(client.frames(start) for client in clients), 2 * bench.sut.reaction)
        for client, payload in zip(clients, payloads, strict=True):
            bench.only(set(client.sent(start)), {payload}, "the payload as submitted, and no other", "BP-FMT-01")
        first = next(
            (heard for heard in bench.heard[start:] if any(client.in_frame(heard) for client in clients)), None
        )
        if first is not None:
            ids = [client.prot_id for client in clients]
            bench.info(
                "Which of four clients does the first beacon serve, and in which order?",
                ", ".join(map(str, [ids.index(prot_id) + 1 for prot_id, _ in first.blocks if prot_id in ids])),
                "BP-TX-03",
            )


@case(
    "TC_BP_TX_BV_05",
    "A beacon never has more than 255 blocks",
    requirements="BP-TX-08",
    alone=FILLS,
    stimulus="260 clients submit a payload of one octet each",
    expect="all payloads, in beacons of at most 255 blocks with a correct numPayloads",
    needs=Needs(
        entities=(),
        ut=(*CLIENT, "UT-Reset"),
        when=lambda bench: (
            areas_of_fixed_size(bench)
            or (None if room(bench) > 260 * (block_header_octets(bench) + 1) else "a beacon has no room for 256 blocks")
        ),
    ),
)
def most_blocks(bench: Bench) -> None:
    clients = [BPClient(bench, ONCE, size=1) for _ in range(BP_MAX_PAYLOADS + 5)]
    for client in clients:
        if not (answer := client.register()).ok:
            if answer.code is None and not answer.known:
                bench.wrong("a status of the specification", answer, "BP-REG-01")
            registered = clients.index(client)
            declared = bench.sut.capacity("clients") or 0
            what = f"registrations of {declared} clients, as declared"
            bench.proved(registered >= declared, what, f"{registered}, then {answer}", "BP-REG-01")
            bench.info("How many clients can register?", f"{registered}")
            return
    start = 0
    ids = {client.prot_id for client in clients}

    def ours(heard: ReceivedBeacon) -> set[int]:
        return ids.intersection(prot_id for prot_id, _ in heard.blocks)

    def act() -> None:
        nonlocal start
        start = len(bench.heard)
        for client in clients:
            client.transmit(b"x")

    # Only if more than 255 payloads wait for the same beacon, there can be too many blocks in it.
    between_beacons(bench, f"submission of {len(clients)} payloads", act, ours, flush=2 * len(ids))

    # One block in each beacon is also allowed (BP-TX-03).
    frames = bench.until_quiet(ours, 2 * len(ids), start)
    seen = {prot_id for heard in frames for prot_id in ours(heard)}
    bench.every(
        bench.heard[start:],
        lambda heard: len(heard.blocks) <= BP_MAX_PAYLOADS,
        f"beacons of at most {BP_MAX_PAYLOADS} blocks",
    )
    bench.complete(ids - seen, "all 260 payloads are sent")
