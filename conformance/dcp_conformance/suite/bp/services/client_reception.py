"""dcp-bp.md: Receive Path, observed through a client protocol of the tester.

Processing of received beacons can be observed in BP-ReceivePayload.indication, so that implementations without VarDis
are decided too. A beacon that must be ignored is followed by a valid one that must be indicated.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import random
from collections.abc import Callable, Iterator, Sequence

from dcp_spec.constants import BP_SEQNO_MODULUS, SpecVersion

from dcp_conformance.definitions.case import LISTENS, Needs, Variant, case
from dcp_conformance.frames.builder import Block, Lies
from dcp_conformance.suite.bp.beacons.receive import length_is_of_blocks, lengths
from dcp_conformance.suite.bp.beacons.seqno import check_first_number, first_number
from dcp_conformance.suite.bp.services.parameters import SET, SIZE
from dcp_conformance.test_steps.bp_clients import (
    ACTIVATE,
    CLIENT,
    DEACTIVATE,
    DEREGISTER,
    ONCE,
    REGISTER,
    BPClient,
    block_header_octets,
    header_octets,
    listed,
    needed,
    until,
    unused_protocol_id,
)
from dcp_conformance.test_steps.services import binary_identifiers
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.judgement.matchers import part_of
from dcp_conformance.test_system.sending.peers import Peer

V1_1, V1_2, V2_0 = SpecVersion.V1_1, SpecVersion.V1_2, SpecVersion.V2_0
_RECEPTION = Needs(entities=(), ut=(REGISTER, DEREGISTER))
_LENGTHS = dataclasses.replace(lengths(), entities=(), ut=_RECEPTION.ut)
#: Blocks in one beacon: more than a fixed-size buffer of a receiver is likely to hold.
_MANY = 40


def after(bench: Bench, client: BPClient, peer: Peer, what: str, *requirements: str) -> list[bytes]:
    """Send a valid beacon, wait for the indication of its payload, and return the payloads indicated before it.

    Fails and stops the case if two valid beacons in a row are not indicated: the receiver has stopped working after
    ``what``.
    """
    honest = [b"honest\x01", b"honest\x02"]
    for octets in honest:
        peer.send(Block(client.prot_id, octets))
        if until(bench, lambda: not set(honest).isdisjoint(client.received())):
            # The first one may be indicated only after the second was sent.
            return list(itertools.takewhile(lambda each: each not in honest, client.received()))
    bench.missing(
        f"the payload of a valid beacon after {what} is indicated",
        "two valid beacons, neither indicated",
        *requirements,
    )
    return None


def check_ignored(bench: Bench, send: Callable[[Peer, Block], object], what: str, *requirements: str) -> None:
    """Check that no payload of the beacon sent by ``send``, which gets a block of a registered client, is indicated."""
    with BPClient(bench, ONCE) as client:
        peer, hidden = bench.peer(), b"hidden"
        send(peer, Block(client.prot_id, hidden))
        received = after(bench, client, peer, what)
        bench.proved(hidden not in received, f"{what} is discarded", "its payload is indicated", *requirements)


@dataclasses.dataclass(frozen=True)
class _Fault:
    """An invalid header that a receiver must reject."""

    what: str
    requirement: str
    field: str
    lies: Callable[[Bench], Lies]
    since: SpecVersion = SpecVersion.V1_0


_FAULTS: dict[str, _Fault] = {
    "version": _Fault("a beacon with another version", "BP-RX-01", "version", lambda _: {"bp.version": 2}),
    "magic": _Fault("a beacon with another magicNo", "BP-RX-02", "magicNo", lambda _: {"bp.magicNo": 0x497F}),
    "length-0": _Fault("a beacon with length 0", "BP-RX-03", "length", lambda _: {"bp.length": 0}, V1_2),
    "no-payloads": _Fault("a beacon with numPayloads 0", "BP-RX-04", "numPayloads", lambda _: {"bp.numPayloads": 0}),
    "network": _Fault(
        "a beacon with another networkId",
        "BP-RX-05",
        "networkId",
        lambda bench: {"bp.networkId": bench.sut.parameter("BPPAR_NETWORK_ID") ^ 1},
        V2_0,
    ),
}


@case(
    "TC_BP_CRX_BI_01",
    "No payload of a beacon with an invalid header is indicated ({variant})",
    requirements="BP-RX-01",
    stimulus="a beacon with a block for a client and an invalid header ({variant}); then a valid beacon",
    expect="an indication of the second payload only",
    variants={
        name: Variant(
            fault,
            requirements=fault.requirement,
            needs=dataclasses.replace(
                _RECEPTION,
                since=fault.since,
                header=(fault.field,),
                when=length_is_of_blocks if fault.field == "length" else None,
            ),
        )
        for name, fault in _FAULTS.items()
    },
)
def wrong_header(bench: Bench, fault: _Fault) -> None:
    check_ignored(bench, lambda peer, block: peer.send(block, lies=fault.lies(bench)), fault.what, fault.requirement)


@case(
    "TC_BP_CRX_BI_02",
    "No payload of a beacon with the node's own senderId is indicated",
    requirements="BP-RX-06",
    stimulus="a beacon with a block for a client and the implementation's own senderId; then a valid beacon",
    expect="an indication of the second payload only",
    needs=dataclasses.replace(_RECEPTION, ut=CLIENT, header=("senderId",)),
)
def own_sender(bench: Bench) -> None:
    if bench.session.sut_id is None:
        with BPClient(bench, ONCE) as client:
            client.put_on_air("a beacon of the implementation")
    check_ignored(
        bench, lambda peer, block: peer.send(block, sender=bench.identifiers.sut_id), "a beacon with its own senderId"
    )


@case(
    "TC_BP_CRX_BV_01",
    "Each of 40 blocks in a beacon is indicated, in order",
    requirements="BP-RX-07 BP-RXP-02",
    stimulus="a beacon with 40 blocks for a client, of different lengths",
    expect="40 indications, in order",
    needs=_RECEPTION,
)
def many_blocks(bench: Bench) -> None:
    if bench.profile.bp.payload_area:
        bench.verdicts.not_applicable(f"a beacon of the profile {bench.profile.name} has no room for {_MANY} blocks")
    with BPClient(bench, ONCE) as client:
        payloads = [bytes([number, *range(number % 3)]) for number in range(_MANY)]
        bench.peer().send(*(Block(client.prot_id, octets) for octets in payloads))
        received = client.until_received(_MANY)
        places = [payloads.index(each) for each in received if each in payloads]
        bench.in_order(
            received,
            payloads,
            f"{_MANY} indications, in the order of the blocks",
            seen=f"indications of blocks {places}",
        )


@case(
    "TC_BP_CRX_BV_02",
    "Receivers accept any beacon sequence number ({variant})",
    requirements="BP-RX-10",
    stimulus="beacons of one sender with blocks for a client; sequence numbers: {variant}",
    expect="an indication for each beacon",
    needs=dataclasses.replace(_RECEPTION, since=V1_1, header=("seqno",)),
    variants={"repeated": (41, 41, 41), "decreasing": (999, 5, 0), "wrapping": (BP_SEQNO_MODULUS - 1, 0, 1)},
)
def any_number(bench: Bench, numbers: Sequence[int]) -> None:
    with BPClient(bench, ONCE) as client:
        peer, payloads = bench.peer(), [bytes([65 + place]) for place in range(len(numbers))]
        for number, octets in zip(numbers, payloads, strict=True):
            peer.seqno = number
            peer.send(Block(client.prot_id, octets))
        received = client.until_received(len(payloads))
        observed = f"indications of payloads {listed(received, payloads)}"
        bench.some(
            set(received) >= set(payloads), f"indications of payloads {listed(payloads, payloads)}", seen=observed
        )


@case(
    "TC_BP_CRX_BI_03",
    "A block that extends past the end of its beacon is not indicated ({variant})",
    requirements="BP-RX-09",
    stimulus=(
        "a beacon with two blocks for a client, the second with a length {variant} octets too large; then a valid "
        "beacon"
    ),
    expect="no indication of the second block; the first is indicated, or the beacon is discarded (X48)",
    needs=dataclasses.replace(_RECEPTION, since=V1_1, header=("numPayloads",), when=length_is_of_blocks),
    variants={"1": 1, "4": 4, "1000": 1000},
)
def past_the_end(bench: Bench, more: int) -> None:
    with BPClient(bench, ONCE, size=128) as client:
        # Long enough not to need padding by the bearer.
        peer, good, bad = bench.peer(), b"good" * 6, b"bad!" * 16
        blocks = [Block(client.prot_id, octets) for octets in (good, bad)]
        peer.send(*blocks, lies={"payloads[1].length": len(bad) + more})
        received = after(bench, client, peer, "a block that extends past the end of its beacon")
        bench.every(received, good, "at most an indication of the first block")
        bench.reading("X48", "deliver-blocks" if good in received else "discard-beacon")


@case(
    "TC_BP_CRX_BI_04",
    "A receiver survives numPayloads {variant} in a beacon of two blocks",
    requirements="BP-RX-12",
    stimulus="a beacon with two blocks for a client and numPayloads {variant}; then a valid beacon",
    expect="the case reports which payloads are indicated (X47, X48)",
    needs=dataclasses.replace(_RECEPTION, header=("numPayloads",)),
    variants={"1": 1, "3": 3},
)
def other_count(bench: Bench, claimed: int) -> None:
    with BPClient(bench, ONCE) as client:
        peer, payloads = bench.peer(), [b"first" * 6, b"second" * 6]
        blocks = [Block(client.prot_id, octets) for octets in payloads]
        peer.send(*blocks, lies={"bp.numPayloads": claimed})
        received = after(bench, client, peer, "a wrong numPayloads", "BP-RX-16")
        bench.proved(
            part_of(received, payloads),
            "indications of complete blocks only",
            f"indications of {[each.hex() for each in received]}",
        )
        if bench.profile.has_header_field("length"):
            bench.reading("X48", "deliver-blocks" if received else "discard-beacon")
        elif claimed < len(payloads):
            whole = len(received) > claimed
            bench.reading("X47", "whole-frame" if whole else "counted-blocks")


@case(
    "TC_BP_CRX_BV_03",
    "Padding after the end of a beacon is ignored ({variant})",
    requirements="BP-RX-14",
    stimulus="a beacon with a block for a client, followed by octets that its length does not count",
    expect="indications of this block and of that of the next beacon",
    needs=_LENGTHS,
    variants={"1-zero": b"\0", "46-zeros": bytes(46), "200-zeros": bytes(200), "7-others": bytes(range(200, 207))},
)
def padding(bench: Bench, octets: bytes) -> None:
    with BPClient(bench, ONCE) as client:
        peer, inside = bench.peer(), b"inside"
        peer.send(Block(client.prot_id, inside), padding=octets)
        received = after(bench, client, peer, "padding")
        bench.some(inside in received, "the block before the padding is indicated")
        bench.proved(set(received) <= {inside}, "no other indication", [each.hex() for each in received])


@case(
    "TC_BP_CRX_BI_05",
    "A receiver survives a length that reaches past the end of the frame, observed by a client ({variant})",
    requirements="BP-RX-15",
    stimulus=(
        "a beacon with a block for a client, its length beyond the end of the frame ({variant}); then a valid beacon"
    ),
    expect="an indication of the second payload; whether the first is indicated is a reading (X02)",
    needs=_LENGTHS,
    variants={"1-octet": 1, "as-far-as-possible": None},
    destructive=True,
)
def length_beyond_frame(bench: Bench, more: int | None) -> None:
    with BPClient(bench, ONCE) as client:
        peer, octets = bench.peer(), b"beyond"
        block = Block(client.prot_id, octets)
        honest = len(peer.beacon(block)) - header_octets(bench)
        peer.send(block, lies={"bp.length": 0xFFFF if more is None else honest + more})
        received = after(bench, client, peer, "a length past the end of the frame", "BP-RX-15")
        bench.reading("X02", "frame-size" if octets in received else "length-field")
        bench.passed("the payload of the next beacon is indicated")


@case(
    "TC_BP_CRX_BI_06",
    "A receiver survives octets that are not a beacon, observed by a client",
    requirements="BP-RX-16",
    stimulus="a beacon truncated after each of its octets, and 20 frames of random octets; then a valid beacon",
    expect="an indication for the valid beacon only",
    needs=_RECEPTION,
    destructive=True,
)
def no_beacons(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        peer, rng = bench.peer(), random.Random(3)  # noqa: S311 - the same octets every time, no secret
        # In blocks of fixed size most octets carry no meaning.
        whole = peer.beacon(Block(client.prot_id, b"whole"))
        for end in range(header_octets(bench) + (0 if bench.profile.bp.payload_area else len(b"whole"))):
            peer.send_octets(whole[:end])
        for _ in range(20):
            peer.send_octets(rng.randbytes(rng.choice((0, 1, 17, 46, 100))))
        received = after(bench, client, peer, "octets that are not a beacon", "BP-RX-16")
        bench.none(received, "no indication", seen=[each.hex() for each in received])


@case(
    "TC_BP_CRX_BO_01",
    "Beacons received while BP is inactive are never indicated to a client",
    requirements="BP-MGT-03 BP-RX-13",
    stimulus="a block for a client while BP is inactive; BP-MGMT-Activate; then a valid beacon",
    expect="an indication of the second payload only",
    needs=dataclasses.replace(_RECEPTION, since=V1_2, ut=(REGISTER, DEREGISTER, ACTIVATE, DEACTIVATE)),
    window=6,
)
def deaf_for_clients(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        peer, early = bench.peer(), b"while inactive"
        with bench.services.deactivated("BP"):
            peer.send(Block(client.prot_id, early))
            bench.wait(max(1, bench.session.known.processing))
        received = after(bench, client, peer, "a time of inactivity", "BP-MGT-05")
        bench.proved(
            early not in received, "no indication of a payload received while BP was inactive", "an indication of it"
        )


@case(
    "TC_BP_CRX_BV_04",
    "Blocks of unregistered protocols and empty blocks do not hide the blocks after them",
    requirements="BP-RX-08 BP-RX-07",
    stimulus=(
        "a beacon with four blocks: unregistered protocol, the same empty, a client's empty, the client's with octets"
    ),
    expect="an indication of the last block; whether the empty block is indicated is a reading (X46)",
    needs=_RECEPTION,
)
def after_other_blocks(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        peer, octets, nobody = bench.peer(), b"behind", unused_protocol_id(bench)
        peer.send(
            Block(nobody, b"nobody"), Block(nobody, b""), Block(client.prot_id, b""), Block(client.prot_id, octets)
        )
        received = after(bench, client, peer, "blocks of an unregistered protocol")
        bench.some(octets in received, "an indication of the last block")
        bench.proved(set(received) <= {b"", octets}, "no other indication", [each.hex() for each in received])
        bench.reading("X46", "deliver-empty" if b"" in received else "ignore-empty")


@case(
    "TC_BP_INI_BV_05",
    "Sequence numbers start over after a reset, observed in a client's payloads",
    requirements="BP-INI-02 BP-HDR-12 BP-HDR-13",
    stimulus="two payloads of a client, UT-Reset, a third payload",
    expect="seqno 0 in the first beacon (1 in version 1.0; X03)",
    window=8,
    needs=Needs(entities=(), ut=(*CLIENT, "UT-Reset"), header=("seqno",)),
)
def numbers_after_reset(bench: Bench) -> None:
    for _ in range(2):
        with BPClient(bench, ONCE) as client:
            client.put_on_air()
    bench.must("UT-Reset")
    start = bench.mark()
    with BPClient(bench, ONCE) as client:
        client.put_on_air()
    check_first_number(bench, first_number(bench, bench.heard[:start], bench.heard[start:]))


@contextlib.contextmanager
def _without_room(bench: Bench) -> Iterator[None]:
    """Keep a client's payload from being sent, if parameters can be set: it does not fit into a beacon."""
    if SET not in bench.services.upper.methods or bench.profile.bp.payload_area:
        yield
        return
    with BPClient(bench, ONCE) as client:
        payload, old = client.payload(64), bench.sut.parameter(SIZE)
        too_small = header_octets(bench) + block_header_octets(bench) + len(payload) // 2
        if bench.call(SET, name=SIZE, value=too_small).ok:
            client.transmit(payload)
        try:
            yield
        finally:
            bench.call(SET, name=SIZE, value=old)


@case(
    "TC_BP_HDR_BV_12",
    "No sequence number is used while no client has a payload",
    requirements="BP-HDR-09",
    alone=LISTENS,
    stimulus=(
        "a payload of a client, six periods without any, another payload; if parameters can be set, in the second half "
        "of the pause a payload waits that does not fit"
    ),
    expect="consecutive sequence numbers before and after the pause",
    window=12,
    needs=Needs(entities=(), ut=CLIENT, header=("seqno",)),
)
def idle_clients(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        client.put_on_air()
        bench.until_quiet(lambda heard: heard, 6)
        last, pause = bench.heard[-1], bench.wait(3)
        with _without_room(bench):
            pause += bench.wait(3)
        client.put_on_air("a beacon with the second payload")
    following = bench.heard[bench.heard.index(last) + 1]
    if bench.successive(last, following) and pause:
        bench.inconclusive("no beacon during the pause", f"{len(pause)} beacons")


@case(
    "TC_BP_HDR_BV_13",
    "protocolId and length of a block have two octets each, observed in a client's payload",
    requirements="BP-HDR-11 BP-FMT-01 DATA-01",
    stimulus="a payload of 258 octets for a protocol identifier with two different octets",
    expect="both octets of the identifier, both octets of the length, then the payload",
    needs=Needs(
        entities=(), ut=CLIENT, when=lambda bench: "blocks have a fixed size" if bench.profile.bp.payload_area else None
    ),
)
def block_header(bench: Bench) -> None:
    with BPClient(bench, ONCE, size=258) as client:
        payload = client.payload(258)
        client.transmit(payload)
        found = bench.until(lambda heard: heard if payload in heard.octets else None)
        needed(bench, found, "a beacon with the payload")
        assert found is not None
        place = found.octets.index(payload)
        head, right = found.octets[place - 4 : place], client.prot_id.to_bytes(2) + len(payload).to_bytes(2)
        expected = f"octets {right.hex(' ')} before the payload"
        broken = () if head == right else broken_by(head, right)
        bench.answered(head, right, expected, *broken, frames=[found])


def broken_by(head: bytes, right: bytes) -> Iterator[str]:
    """Yield the requirements that a wrong block header breaks."""
    (prot_id, length), (right_id, right_length) = ((each[:2], each[2:]) for each in (head, right))
    if prot_id not in (right_id, right_id[::-1]):
        # If the first field has an unexpected value, the boundary between the fields is unknown.
        yield "BP-HDR-11"
        return
    if right_id[::-1] == prot_id or right_length[::-1] == length:
        yield "DATA-01"
    if length not in (right_length, right_length[::-1]):
        # With a non-zero upper octet the length has 16 bits and is wrong; otherwise its upper octet may be missing.
        yield "BP-FMT-01" if length[0] else "BP-HDR-11"


@case(
    "TC_BP_CRX_BV_05",
    "Any other node identifier is accepted as a sender ({variant})",
    requirements="DATA-04",
    stimulus="a beacon with a block for a client and a special senderId: {variant}",
    expect="an indication of the block",
    needs=Needs(entities=(), ut=CLIENT, header=("senderId",), when=binary_identifiers),
    variants={
        "zeros": lambda own: bytes(len(own)),
        "ones": lambda own: b"\xff" * len(own),
        "own-but-for-the-last-bit": lambda own: own[:-1] + bytes([own[-1] ^ 1]),
    },
)
def any_sender(bench: Bench, made: Callable[[bytes], bytes]) -> None:
    with BPClient(bench, ONCE) as client:
        if bench.session.sut_id is None:
            client.put_on_air("a beacon of the implementation")
        bench.peer().send(Block(client.prot_id, b"from anybody"), sender=made(bench.identifiers.sut_id))
        bench.some(client.until_received(), "an indication of the block")
