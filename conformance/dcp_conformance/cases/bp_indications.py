"""dcp-bp.md: Payload Exchange and Buffer Management, Payload Transmission Indication.

What clients are told: payloads that were received for them, and payloads of theirs that have gone.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, QueueingMode

from dcp_conformance.bench import Bench
from dcp_conformance.case import DENIED, Needs, Variant, case
from dcp_conformance.cases.srp_init import bring_back, no_way_back
from dcp_conformance.clients import (
    CLIENT,
    DEREGISTER,
    ONCE,
    REGISTER,
    REPEAT,
    TRANSMITTED,
    UNKNOWN_PROTOCOL,
    BPClient,
    block_header_octets,
    each_mode,
    header_octets,
    indications,
    largest_payload,
    listed,
    needed,
    until,
    unused_protocol_id,
)
from dcp_conformance.findings import part_of
from dcp_conformance.forge import Block

_RECEPTION = Needs(entities=(), ut=(REGISTER, DEREGISTER))
_SMALL = 256
#: Beacon periods in which a second indication of the same payload would have come.
_AFTERWARDS = 1.5


def pattern(size: int, start: int = 0) -> bytes:
    """Octets of all values, one after the other."""
    return bytes((start + 37 * index) % 256 for index in range(size))


def _largest(bench: Bench) -> int:
    """A payload that every node of the profile can receive, in octets."""
    return min(_SMALL, bench.profile.bp.payload_area or _SMALL)


def _registrable(bench: Bench) -> int:
    """The largest payload that a client may have, and that a beacon of the profile's bearer carries."""
    fits = bench.bound("BPPAR_MAXIMUM_PACKET_SIZE") - header_octets(bench) - block_header_octets(bench)
    return min(largest_payload(bench), fits, bench.profile.bp.payload_area or fits)


# -- BP-ReceivePayload.indication --------------------------------------------------------------------------------------


@case(
    "TC_BP_RXP_BV_01",
    "A received payload of {variant} octets is indicated once, unchanged",
    requirements="BP-RXP-01 BP-RXP-02 UWB-06",
    stimulus="a client registers; a beacon with a block of its protocol with {variant} octets",
    expect="one BP-ReceivePayload.indication with protId, length {variant} and these octets",
    needs=_RECEPTION,
    variants={"1": 1, "2": 2, "37": 37, "255": 255, "256": 256, "1000": 1000, "as-many-as-fit": 0xFFFF},
)
def unchanged(bench: Bench, size: int) -> None:
    octets = pattern(min(size, _largest(bench) if size <= _SMALL else _registrable(bench)), size % 251)
    with BPClient(bench, ONCE, size=len(octets)) as client:
        bench.peer().send(Block(client.prot_id, octets))
        received = client.until_received()
        bench.require(received, "an indication", "there is none in time", "BP-RXP-01", "UWB-06")
        bench.check(
            received[0] == octets,
            f"the {len(octets)} octets",
            f"{len(received[0])}: {received[0][:32].hex()}",
            "BP-RXP-01",
            shown=True,
        )
        said = next(
            each.params.get("length") for each in bench.notifications if each.params.get("protId") == client.prot_id
        )
        bench.check(said == len(octets), f"length {len(octets)}", f"length {said}", "BP-RXP-01", shown=True)
        bench.wait(_AFTERWARDS)
        count = len(client.received())
        bench.check(count == 1, "one indication", f"{count} indications", "BP-RXP-02", shown=count > 1)


@case(
    "TC_BP_RXP_BV_02",
    "Payloads go to the client of their protocol and to no other",
    requirements="BP-RXP-03 BP-RXP-02",
    stimulus="two clients; beacons with a block for the one, for the other, and for nobody",
    expect="each client is told of its own payload once",
    needs=_RECEPTION,
)
def right_client(bench: Bench) -> None:
    with BPClient(bench, ONCE) as one, BPClient(bench, REPEAT) as two:
        peer, first, second = bench.peer(), pattern(9), pattern(9, 1)
        for prot_id, octets in (
            (one.prot_id, first),
            (unused_protocol_id(bench), pattern(9, 2)),
            (two.prot_id, second),
        ):
            peer.send(Block(prot_id, octets))
        two.until_received()
        bench.wait(_AFTERWARDS)
        for client, right in ((one, first), (two, second)):
            received = client.received()
            known = [first, second, pattern(9, 2)]
            said = f"it is told of {listed(received, known)}"
            mine = f"a client is told of payload {listed([right], known)} once"
            bench.check(
                right in received and set(received) == {right}, mine, said, "BP-RXP-03", shown=set(received) - {right}
            )
            bench.check(received.count(right) == 1, mine, said, "BP-RXP-02", shown=received.count(right) > 1)
        ours = {one.prot_id, two.prot_id}
        strange = [
            each
            for each in bench.notifications
            if each.method.startswith("BP-R") and each.params.get("protId") not in ours
        ]
        bench.check(
            not strange,
            "no indication for a protocol of nobody",
            f"{len(strange)} indications",
            "BP-RXP-03",
            shown=True,
        )


#: Beacons that are sent until all of their blocks are indicated.
_ATTEMPTS = 2


def _all_received(wanted: Mapping[BPClient, list[bytes]], received: Callable[[BPClient], list[bytes]]) -> bool:
    return all(len(received(client)) >= len(right) for client, right in wanted.items())


@case(
    "TC_BP_RXP_BV_03",
    "Each block of a registered client gives an indication, in the order of the blocks ({variant})",
    requirements="BP-RX-07 BP-RX-08",
    stimulus="a beacon with blocks of two clients (1, 2) and of nobody (0), in the order {variant}",
    expect="an indication for each block of a client, in order",
    needs=_RECEPTION,
    variants={"1-2-1": (1, 2, 1), "0-1-0-2": (0, 1, 0, 2), "1-1-1-1": (1, 1, 1, 1), "2-0": (2, 0), "1": (1,)},
)
def each_block(bench: Bench, layout: Sequence[int]) -> None:
    with BPClient(bench, ONCE) as one, BPClient(bench, ONCE) as two:
        prot_ids = {0: unused_protocol_id(bench), 1: one.prot_id, 2: two.prot_id}
        earlier: set[bytes] = set()

        def received_of(client: BPClient) -> list[bytes]:
            return [each for each in client.received() if each not in earlier]

        # Frames get lost on the air, and payloads where a receiver has room for few.
        for attempt in range(_ATTEMPTS):
            start = attempt * len(layout)
            blocks = [Block(prot_ids[who], pattern(5 + number, start + number)) for number, who in enumerate(layout)]
            known = [octets for _, octets in blocks]
            bench.peer().send(*blocks)
            wanted = {who: [octets for prot_id, octets in blocks if prot_id == who.prot_id] for who in (one, two)}
            right_now = functools.partial(_all_received, wanted, received_of)
            if until(bench, right_now) or attempt == _ATTEMPTS - 1:
                break
            earlier.update(known)
        for client, right in wanted.items():
            received = received_of(client)
            expected = f"indications of blocks {listed(right, known)}"
            bench.check(
                received == right,
                expected,
                f"of {listed(received, known)}",
                "BP-RX-07",
                "BP-RX-08",
                shown=not part_of(received, right),
            )


@case(
    "TC_BP_RXP_BO_01",
    "Nothing is indicated before registration and after deregistration",
    requirements="BP-REG-10 BP-DRG-04",
    stimulus="beacons with a block of a protocol before it is registered, meanwhile, and after it is deregistered",
    expect="an indication of the second payload only",
    needs=Needs(entities=(), ut=("UT-Subscribe", REGISTER, DEREGISTER)),
)
def while_registered(bench: Bench) -> None:
    client, peer = BPClient(bench, ONCE), bench.peer()
    bench.must("UT-Subscribe", protIds=[client.prot_id])
    try:
        early, right, late = (pattern(8, start) for start in range(3))
        peer.send(Block(client.prot_id, early))
        # What was sent on the air and what is asked at the services take different ways to the implementation.
        bench.wait(0.5)
        with client:
            peer.send(Block(client.prot_id, right))
            client.until_received()
            bench.wait(0.5)
        peer.send(Block(client.prot_id, late))
        bench.wait(_AFTERWARDS)
        received = client.received()
        bench.check(
            right in received, "the payload is indicated while the client is registered", "it is not", "BP-REG-10"
        )
        bench.check(early not in received, "nothing is indicated before registration", "it is", "BP-REG-10", shown=True)
        bench.check(late not in received, "nothing is indicated after deregistration", "it is", "BP-DRG-04", shown=True)
    finally:
        bench.call("UT-Subscribe")


@case(
    "TC_BP_RXP_BI_01",
    "A block of length 0 for a client is survived",
    requirements="BP-RX-16",
    stimulus="a beacon with an empty block of a client's protocol and one with octets",
    expect="the octets are indicated; whether the empty block is, is reported",
    needs=_RECEPTION,
    robustness=True,
)
def empty_block(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        peer, octets = bench.peer(), pattern(6)
        peer.send(Block(client.prot_id, b""))
        peer.send(Block(client.prot_id, octets))
        until(bench, lambda: octets in client.received())
        bench.check(octets in client.received(), "the beacon behind it is processed", "it is not")
        bench.reading("X46", "deliver-empty" if b"" in client.received() else "ignore-empty")


@case(
    "TC_BP_RXP_BV_04",
    "What becomes of a payload that is larger than the receiver has registered",
    requirements="BP-RXP-01",
    stimulus="a client with maxPayloadSize 10; a beacon with a block of 11 octets",
    expect="an indication of all octets or none: the bound is on what the client itself submits",
    needs=_RECEPTION,
)
def larger_than_own(bench: Bench) -> None:
    with BPClient(bench, ONCE, size=10) as client:
        peer, large, small = bench.peer(), pattern(11), pattern(4)
        peer.send(Block(client.prot_id, large))
        peer.send(Block(client.prot_id, small))
        until(bench, lambda: small in client.received())
        received = client.received()
        whole = all(each in (large, small) for each in received)
        bench.check(
            whole and small in received, "whole payloads", f"{[each.hex() for each in received]}", shown=not whole
        )
        bench.reading("X49", "deliver-larger" if large in received else "discard-larger")


@case(
    "TC_BP_RXP_BV_05",
    "The identifier of {variant} belongs to the client that registers it after {variant} was deregistered",
    requirements="BP-RXP-03 BP-DRG-05",
    stimulus="BP-DeregisterProtocol of that identifier; the tester registers it; a beacon with a block of it",
    expect="the tester's client is told of the payload",
    window=6,
    destructive=True,
    variants={
        "SRP": Variant(int(BP_PROTID_SRP), needs=Needs(entities=("srp",), ut=(REGISTER, DEREGISTER), when=no_way_back)),
        "VarDis": Variant(int(BP_PROTID_VARDIS), needs=Needs(ut=(REGISTER, DEREGISTER), when=no_way_back)),
    },
)
def taken_over(bench: Bench, prot_id: int) -> None:
    # A call without an answer may have been carried out.
    deregistered = True
    try:
        answer = bench.call(DEREGISTER, protId=prot_id)
        deregistered = answer.ok
        # On a node without the protocol the identifier is free.
        if not answer.ok and not answer.is_status(UNKNOWN_PROTOCOL):
            bench.inconclusive("the identifier can be had", str(answer))
        with BPClient(bench, ONCE, prot_id=prot_id) as client:
            octets = pattern(9)
            bench.peer().send(Block(prot_id, octets))
            received = client.until_received()
            bench.check(octets in received, "an indication of the payload", "there is none in time")
    finally:
        if deregistered:
            bring_back(bench)


# -- BP-PayloadTransmitted.indication ----------------------------------------------------------------------------------


def no_indication(bench: Bench) -> str | None:
    """For ``Needs.when``: why BP-PayloadTransmitted cannot be judged."""
    claimed = bench.pics.payload_transmitted_indication
    if claimed is False:
        return f"the PICS denies payload_transmitted_indication ({DENIED} fails for that)"
    if claimed is None and not bench.profile.behaviour.payload_transmitted_indication:
        return (
            f"implementations of the profile {bench.profile.name} have no BP-PayloadTransmitted, and the PICS says "
            f"nothing ({DENIED} fails for that)"
        )
    return None


def both(*conditions: Callable[[Bench], str | None] | None) -> Callable[[Bench], str | None]:
    """For ``Needs.when``: the first reason that any of these gives."""
    return lambda bench: next((why for each in conditions if each is not None and (why := each(bench))), None)


@case(
    "TC_BP_PTI_BV_01",
    "A client is told when its payload is put into a beacon ({variant})",
    requirements="BP-PTI-01",
    stimulus="a client with mode {variant} submits a payload",
    expect="one BP-PayloadTransmitted.indication with its protId; with REPEAT one for each beacon",
    variants={
        name: Variant(each.value, needs=dataclasses.replace(each.needs, when=both(each.needs.when, no_indication)))
        for name, each in each_mode(*CLIENT).items()
    },
)
def told_of_transmission(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode) as client:
        early = len(indications(bench, TRANSMITTED, client.prot_id))
        bench.check(early == 0, "no indication before a payload is submitted", f"{early} indications", shown=True)
        client.transmit(client.payload())
        heard = client.until_sent()
        needed(bench, heard, "a beacon with the payload")
        told = until(bench, lambda: bool(indications(bench, TRANSMITTED, client.prot_id)), 1)
        bench.check(told, "an indication", "there is none within a period of the beacon")
        if mode is not REPEAT:
            bench.wait(_AFTERWARDS)
            count = len(indications(bench, TRANSMITTED, client.prot_id))
            bench.check(count == 1, "one indication for one payload", f"{count} indications", shown=count > 1)


@case(
    "TC_BP_PTI_BV_02",
    "A client with mode REPEAT is told each time that its payload is put into a beacon",
    requirements="BP-PTI-03",
    stimulus="a client with mode REPEAT submits one payload; six beacons with it",
    expect="an indication for each beacon",
    needs=Needs(entities=(), ut=CLIENT, when=no_indication),
    window=8,
)
def told_of_each_repetition(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        for _ in range(6):
            client.until_sent()
        # The indication of the last beacon may come a little later.
        bench.wait(0.3)
        frames, count = client.frames(), len(indications(bench, TRANSMITTED, client.prot_id))
        bench.require(len(frames) >= 6, "six beacons with the payload", f"{len(frames)}", "BP-QM-05")
        near = abs(count - len(frames)) <= 1
        bench.check(near, f"{len(frames)} indications for {len(frames)} beacons", f"{count}", frames=frames)
