"""dcp-bp.md: Transmit Path, what fits into a beacon.

Which client is served first, and how many of them, is free; what is too large must wait.
"""

from __future__ import annotations

from contextlib import ExitStack

from dcp_spec.constants import BP_MAX_PAYLOADS

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.clients import (
    CLIENT,
    DEREGISTER,
    ONCE,
    REPEAT,
    BPClient,
    areas_of_fixed_size,
    block_header_octets,
    header_octets,
    listed,
    needed,
    queue_mode,
    room,
)
from dcp_conformance.gaps import between_beacons
from dcp_conformance.heard import Heard

_SENDER = Needs(entities=(), ut=CLIENT)


_FITTING = Needs(entities=(), ut=CLIENT, when=areas_of_fixed_size)


def sizes_for(bench: Bench, octets: int) -> tuple[int, int]:
    """Sizes of two payloads whose blocks have so many octets together."""
    first = octets // 2 - block_header_octets(bench)
    return first, octets - first - 2 * block_header_octets(bench)


@case(
    "TC_BP_TX_BV_01",
    "Payloads that do not fit into one beacon together go into two ({variant})",
    requirements="BP-TX-04 BP-FMT-02",
    stimulus="two clients submit payloads whose blocks have {variant} more than a beacon has room for",
    expect="both payloads, in different beacons, none of which is larger than BPPAR_MAXIMUM_PACKET_SIZE",
    needs=_FITTING,
    variants={"one-octet": 1, "a-header": None, "almost-all-of-it": 0.9},
)
def do_not_fit_together(bench: Bench, more: float | None) -> None:
    space = room(bench)
    # With one octet too much for blocks and header they still fit if only blocks count (X04).
    extra = header_octets(bench) + 1 if more is None else round(more * space) if more < 1 else round(more)
    fitting(bench, space + extra, together=False)


@case(
    "TC_BP_TX_BV_02",
    "Payloads that just fit into one beacon together are sent",
    requirements="BP-FMT-02 BP-TX-03",
    stimulus="two clients submit payloads whose blocks have exactly as many octets as a beacon has room for",
    expect="both payloads; whether they share the beacon is reported",
    needs=_FITTING,
)
def fit_together(bench: Bench) -> None:
    fitting(bench, room(bench), together=True)


def fitting(bench: Bench, octets: int, *, together: bool) -> None:
    """Let two clients submit payloads of so many octets in all, and look at the beacons that they come in."""
    first, second = sizes_for(bench, octets)
    with BPClient(bench, ONCE, size=first) as one, BPClient(bench, ONCE, size=second) as two:
        starts: list[int] = []

        def act() -> list[bytes]:
            # What was sent in an attempt before does not count.
            starts.append(len(bench.heard))
            payloads = [one.payload(first), two.payload(second)]
            one.transmit(payloads[0])
            two.transmit(payloads[1])
            return payloads

        # Otherwise they come in different beacons by themselves.
        payloads = between_beacons(
            bench, "two payloads are submitted", act, lambda heard: one.in_frame(heard) or two.in_frame(heard)
        )
        start = starts[-1]
        bench.until(lambda _: one.frames(start) and two.frames(start), 2 * bench.reaction)
        sent = [*one.sent(start), *two.sent(start)]
        bench.check(
            sorted(sent) == sorted(payloads),
            "both payloads once",
            listed(sent, payloads),
            "BP-TX-04",
            shown=len(sent) > len(payloads),
        )
        shared = [heard for heard in one.frames(start) if two.in_frame(heard)]
        if together:
            bench.info("Do payloads share a beacon that just has room for them?", "yes" if shared else "no", "BP-TX-03")
        elif shared and octets - room(bench) <= header_octets(bench):
            bench.reading("X04", "blocks-only")
        else:
            bench.check(
                not shared, "they come in different beacons", "they share one", "BP-TX-04", frames=shared, shown=True
            )
        check_sizes(bench, start)


def check_sizes(bench: Bench, since: int) -> None:
    """Check that no beacon is larger than it may be; X04 leaves open whether the header counts."""
    limit = bench.bound("BPPAR_MAXIMUM_PACKET_SIZE")
    margin = header_octets(bench) if bench.readings.get("X04") == "blocks-only" else 0
    large = [heard for heard in bench.heard[since:] if len(heard.octets) > limit + margin]
    found = f"{max(len(heard.octets) for heard in large)} octets" if large else ""
    bench.check(not large, f"no beacon of more than {limit} octets", found, "BP-FMT-02", frames=large, shown=True)


@case(
    "TC_BP_TX_BV_03",
    "The head of a queue blocks what stands behind it, and is not overtaken",
    requirements="BP-TX-06 BP-TX-04",
    stimulus="a client repeats a payload that fills most of a beacon; another one queues a large and a small payload",
    expect="the small payload never before the large one",
    needs=_FITTING,
    window=8,
)
def head_of_line(bench: Bench) -> None:
    space, header = room(bench), block_header_octets(bench)
    filler, large, small = space * 3 // 4 - header, space // 2 - header, 8
    with (
        BPClient(bench, REPEAT, size=filler) as constant,
        BPClient(bench, queue_mode(bench), size=large, entries=4) as client,
    ):
        constant.transmit(constant.payload(filler))
        needed(bench, constant.until_sent(), "beacons with the first payload")
        start = bench.mark()
        head, tail = client.payload(large), client.payload(small)
        client.transmit(head)
        client.transmit(tail)
        bench.until(lambda heard: tail in client.in_frame(heard), 8)
        sent = client.sent(start)
        overtaken = tail in sent and (head not in sent or sent.index(tail) < sent.index(head))
        bench.check(
            not overtaken,
            "the small payload waits",
            "it is sent first",
            "BP-TX-06",
            frames=client.frames(start),
            shown=head in sent,
        )
        shared = [
            heard for heard in client.frames(start) if head in client.in_frame(heard) and constant.in_frame(heard)
        ]
        bench.check(
            not shared,
            "the large payload is not sent together with the first",
            "it is",
            "BP-TX-04",
            frames=shared,
            shown=True,
        )
        if head not in sent:
            bench.info("Does a payload that always fits keep back a larger one?", "for 8 periods", "BP-TX-03")


@case(
    "TC_BP_TX_BV_04",
    "Payloads of several clients are all sent; how many share a beacon is free",
    requirements="BP-TX-03 BP-FMT-01",
    stimulus="four clients with different modes submit small payloads",
    expect="each of them unchanged; order and number of blocks are reported",
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
        bench.until(lambda _: all(client.frames(start) for client in clients), 2 * bench.reaction)
        if not all(client.frames(start) for client in clients):
            # One that is repeated may be served first in every beacon.
            bench.call(DEREGISTER, protId=clients[1].prot_id)
            bench.until(lambda _: all(client.frames(start) for client in clients), 2 * bench.reaction)
        for client, payload in zip(clients, payloads, strict=True):
            sent = set(client.sent(start))
            bench.check(
                sent == {payload},
                "the payload as it was submitted",
                f"{sorted(sent)!r}",
                "BP-FMT-01",
                shown=sent - {payload},
            )
        first = next(
            (heard for heard in bench.heard[start:] if any(client.in_frame(heard) for client in clients)), None
        )
        if first is not None:
            ids = [client.prot_id for client in clients]
            order = [ids.index(prot_id) + 1 for prot_id, _ in first.blocks if prot_id in ids]
            bench.info(
                "Which of four clients does a beacon serve, in which order?", ", ".join(map(str, order)), "BP-TX-03"
            )


@case(
    "TC_BP_TX_BV_05",
    "A beacon never has more than 255 blocks",
    requirements="BP-TX-08",
    stimulus="260 clients with a payload of one octet each",
    expect="all payloads on the air, in beacons of at most 255 blocks with the right numPayloads",
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
        if not client.register().ok:
            bench.info("How many clients can register?", f"{clients.index(client)}")
            return
    start = bench.mark()
    for client in clients:
        client.transmit(b"x")
    ids = {client.prot_id for client in clients}

    def ours(heard: Heard) -> set[int]:
        return ids.intersection(prot_id for prot_id, _ in heard.blocks)

    # One block in each beacon would be right, too (BP-TX-03).
    frames = bench.until_quiet(ours, 2 * len(ids), start)
    seen = {prot_id for heard in frames for prot_id in ours(heard)}
    large = [heard for heard in bench.heard[start:] if len(heard.blocks) > BP_MAX_PAYLOADS]
    said = f"{len(large[0].blocks)} in one" if large else ""
    bench.check(not large, f"beacons of at most {BP_MAX_PAYLOADS} blocks", said, frames=large, shown=True)
    lost = len(ids - seen)
    bench.check(not lost, "all 260 payloads", f"{lost} are missing")
