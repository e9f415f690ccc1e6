"""dcp-bp.md: Payload Exchange and Buffer Management, Payload Transmission Indication.

Indications to clients: payloads received for them, and their own payloads sent.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, QueueingMode

from dcp_conformance.definitions.case import DENIED, LISTENS, REPLACES, Needs, Variant, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.suite.srp.init import bring_back, no_way_back
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import (
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
    wait_for_notifications,
)
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.upper_tester import Notification

_RECEPTION = Needs(entities=(), ut=(REGISTER, DEREGISTER))
_SMALL = 256
#: Time in beacon periods in which a duplicate indication would arrive.
_AFTERWARDS = 1.5


def pattern(size: int, start: int = 0) -> bytes:
    """Return ``size`` octets with all values, starting from a value that depends on ``start``."""
    return bytes((start + 37 * index) % 256 for index in range(size))


def _largest(bench: Bench) -> int:
    """Return a payload size in octets that every node of the profile can receive."""
    return min(_SMALL, bench.profile.bp.payload_area or _SMALL)


def _registrable(bench: Bench) -> int:
    """Return the largest payload size, in octets, that a client can register and the bearer can carry."""
    fits = bench.sut.bound("BPPAR_MAXIMUM_PACKET_SIZE") - header_octets(bench) - block_header_octets(bench)
    return min(largest_payload(bench), fits, bench.profile.bp.payload_area or fits)


# -- BP-ReceivePayload.indication --------------------------------------------------------------------------------------


@case(
    "TC_BP_RXP_BV_01",
    "A received payload is indicated once and unchanged (octets: {variant})",
    requirements="BP-RXP-01 BP-RXP-02 UWB-06",
    stimulus="a beacon with a block for a registered client (payload octets: {variant})",
    expect="one BP-ReceivePayload.indication with the protId, the length and the octets of the payload",
    needs=_RECEPTION,
    variants={"1": 1, "2": 2, "37": 37, "255": 255, "256": 256, "1000": 1000, "as-many-as-fit": 0xFFFF},
)
def unchanged(bench: Bench, size: int) -> None:
    octets = pattern(min(size, _largest(bench) if size <= _SMALL else _registrable(bench)), size % 251)
    with BPClient(bench, ONCE, size=len(octets)) as client:
        bench.peer().send(Block(client.prot_id, octets))
        received = bench.required(client.until_received(), "an indication of the payload", "BP-RXP-01 UWB-06")
        bench.answered(received[0], octets, "the payload, as sent", "BP-RXP-01")
        observed = next(
            each.params.get("length")
            for each in bench.receiver.notifications
            if each.params.get("protId") == client.prot_id
        )
        bench.answered(observed, len(octets), "length", "BP-RXP-01")
        bench.wait(_AFTERWARDS)
        bench.repeated(len(client.received()), 1, "indications", "BP-RXP-02")


@case(
    "TC_BP_RXP_BV_02",
    "Payloads are indicated to the client of their protocol and to no other",
    requirements="BP-RXP-03 BP-RXP-02",
    alone=LISTENS,
    stimulus=(
        "two clients; one beacon with a block for each, and one with blocks of unregistered protocols, also with the "
        "least and the greatest identifier"
    ),
    expect="each client gets one indication, of its own payload",
    needs=_RECEPTION,
)
def right_client(bench: Bench) -> None:
    with BPClient(bench, ONCE) as one, BPClient(bench, REPEAT) as two:
        peer, first, second = bench.peer(), pattern(9), pattern(9, 1)
        greatest = (1 << (8 * bench.profile.types.protocol_id.width)) - 1
        others = [Block(each, pattern(9, 2)) for each in (unused_protocol_id(bench), 0, greatest)]
        for blocks in ([Block(one.prot_id, first)], others, [*others[1:], Block(two.prot_id, second)]):
            peer.send(*blocks)
        two.until_received()
        bench.wait(_AFTERWARDS)
        for client, right in ((one, first), (two, second)):
            received = client.received()
            known = [first, second, pattern(9, 2)]
            observed = f"indications of payloads {listed(received, known)}"
            mine = f"one indication of payload {listed([right], known)}"
            bench.only(set(received), {right}, mine, "BP-RXP-03", seen=observed)
            bench.repeated(received.count(right), 1, mine, "BP-RXP-02")
        ours = {one.prot_id, two.prot_id}
        strange = [
            each
            for each in bench.receiver.notifications
            if each.method.startswith("BP-R") and each.params.get("protId") not in ours
        ]
        bench.none(strange, "no indication for an unregistered protocol", "BP-RXP-03")


#: Number of times the blocks are sent until all of them are indicated.
_ATTEMPTS = 2


def _all_received(wanted: Mapping[BPClient, list[bytes]], received: Callable[[BPClient], list[bytes]]) -> bool:
    return all(len(received(client)) >= len(right) for client, right in wanted.items())


@case(
    "TC_BP_RXP_BV_03",
    "Each block of a registered client is indicated, in the order of the blocks ({variant})",
    requirements="BP-RX-07 BP-RX-08",
    stimulus="a beacon with blocks of two clients (1, 2) and of an unregistered protocol (0), in the order {variant}",
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

        # Frames may be lost, and a receiver with few buffers may lose payloads.
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
            bench.in_order(
                received, right, expected, "BP-RX-07 BP-RX-08", seen=f"indications of blocks {listed(received, known)}"
            )


@case(
    "TC_BP_RXP_BO_01",
    "No payload is indicated before registration or after deregistration",
    requirements="BP-REG-10 BP-DRG-04",
    stimulus=(
        "beacons with a block of a protocol before its registration, while it is registered, and after its "
        "deregistration"
    ),
    expect="an indication of the second payload only",
    needs=Needs(entities=(), ut=("UT-Subscribe", REGISTER, DEREGISTER)),
)
def while_registered(bench: Bench) -> None:
    client, peer = BPClient(bench, ONCE), bench.peer()
    bench.must("UT-Subscribe", protIds=[client.prot_id])
    try:
        early, right, late = (pattern(8, start) for start in range(3))
        peer.send(Block(client.prot_id, early))
        # The beacon and the service request reach the implementation through different channels: without a pause their
        # order is undefined.
        bench.wait(bench.session.known.processing)
        with client:
            peer.send(Block(client.prot_id, right))
            client.until_received()
            bench.wait(0.5)
        peer.send(Block(client.prot_id, late))
        bench.wait(_AFTERWARDS)
        received = client.received()
        bench.some(
            right in received, "an indication of the payload received while the client is registered", "BP-REG-10"
        )
        bench.proved(
            early not in received,
            "no indication of the payload received before registration",
            "an indication of it",
            "BP-REG-10",
        )
        bench.proved(
            late not in received,
            "no indication of the payload received after deregistration",
            "an indication of it",
            "BP-DRG-04",
        )
    finally:
        bench.call("UT-Subscribe")


@case(
    "TC_BP_RXP_BI_01",
    "A receiver survives a block of length 0 for a client",
    requirements="BP-RX-16",
    stimulus="a beacon with an empty block for a client, then one with a payload",
    expect="an indication of the payload; the case reports whether the empty block is indicated (X46)",
    needs=_RECEPTION,
    robustness=True,
)
def empty_block(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        peer, octets = bench.peer(), pattern(6)
        peer.send(Block(client.prot_id, b""))
        peer.send(Block(client.prot_id, octets))
        until(bench, lambda: octets in client.received())
        bench.some(octets in client.received(), "an indication of the payload in the next beacon")
        bench.reading("X46", "deliver-empty" if b"" in client.received() else "ignore-empty")


@case(
    "TC_BP_RXP_BV_04",
    "A payload larger than the receiving client's maxPayloadSize is indicated as a whole or not at all",
    requirements="BP-RXP-01",
    stimulus="a client with maxPayloadSize 10; a beacon with a block of 11 octets",
    expect="an indication of all octets or none: maxPayloadSize limits the payloads that the client submits",
    needs=_RECEPTION,
)
def larger_than_own(bench: Bench) -> None:
    with BPClient(bench, ONCE, size=10) as client:
        peer, large, small = bench.peer(), pattern(11), pattern(4)
        peer.send(Block(client.prot_id, large))
        peer.send(Block(client.prot_id, small))
        until(bench, lambda: small in client.received())
        received = client.received()
        bench.every(received, lambda each: each in (large, small), "indications of complete payloads")
        bench.some(small in received, "an indication of the payload of the next beacon")
        bench.reading("X49", "deliver-larger" if large in received else "discard-larger")


@case(
    "TC_BP_RXP_BV_05",
    "After {variant} was deregistered, its identifier belongs to the client that registers it",
    requirements="BP-RXP-03 BP-DRG-05",
    alone=REPLACES,
    stimulus=(
        "BP-DeregisterProtocol for the identifier of {variant}; the tester registers it; a beacon with a block of it"
    ),
    expect="an indication to the tester's client",
    window=6,
    destructive=True,
    variants={
        "SRP": Variant(int(BP_PROTID_SRP), needs=Needs(entities=("srp",), ut=(REGISTER, DEREGISTER), when=no_way_back)),
        "VarDis": Variant(int(BP_PROTID_VARDIS), needs=Needs(ut=(REGISTER, DEREGISTER), when=no_way_back)),
    },
)
def taken_over(bench: Bench, prot_id: int) -> None:
    # A call without an answer may still have been executed.
    deregistered = True
    try:
        answer = bench.call(DEREGISTER, protId=prot_id)
        deregistered = answer.ok
        # On a node without this protocol the identifier is not in use.
        if not answer.ok and not answer.is_status(UNKNOWN_PROTOCOL):
            bench.inconclusive("an identifier that can be deregistered", str(answer))
        with BPClient(bench, ONCE, prot_id=prot_id) as client:
            octets = pattern(9)
            bench.peer().send(Block(prot_id, octets))
            received = client.until_received()
            bench.some(octets in received, "an indication of the payload")
    finally:
        if deregistered:
            bring_back(bench)


# -- BP-PayloadTransmitted.indication ----------------------------------------------------------------------------------


def no_indication(bench: Bench) -> str | None:
    """Return why BP-PayloadTransmitted cannot be judged, or None; for ``Needs.when``."""
    claimed = bench.sut.pics.payload_transmitted_indication
    if claimed is False:
        return f"the PICS denies payload_transmitted_indication ({DENIED} fails for that)"
    if claimed is None and not bench.profile.behaviour.payload_transmitted_indication:
        return (
            f"implementations of the profile {bench.profile.name} have no BP-PayloadTransmitted, and the PICS "
            f"does not mention it ({DENIED} fails for that)"
        )
    return None


def both(*conditions: Callable[[Bench], str | None] | None) -> Callable[[Bench], str | None]:
    """Combine conditions for ``Needs.when``: the result returns the first reason that one of them gives."""
    return lambda bench: next((why for each in conditions if each is not None and (why := each(bench))), None)


@case(
    "TC_BP_PTI_BV_01",
    "A client gets an indication when its payload is put into a beacon ({variant})",
    requirements="BP-PTI-01",
    stimulus="a client with mode {variant} submits a payload",
    expect="one BP-PayloadTransmitted.indication with its protId; with mode REPEAT one for each beacon",
    variants={
        name: Variant(each.value, needs=dataclasses.replace(each.needs, when=both(each.needs.when, no_indication)))
        for name, each in each_mode(*CLIENT).items()
    },
)
def told_of_transmission(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode) as client:
        early = len(indications(bench, TRANSMITTED, client.prot_id))
        bench.answered(early, 0, "indications before a payload is submitted")
        client.transmit(client.payload())
        heard = client.until_sent()
        needed(bench, heard, "a beacon with the payload")
        told = until(bench, lambda: bool(indications(bench, TRANSMITTED, client.prot_id)), 1)
        bench.some(told, "an indication of the transmission", seen="no indication within one period after the beacon")
        if mode is not REPEAT:
            bench.wait(_AFTERWARDS)
            bench.repeated(len(indications(bench, TRANSMITTED, client.prot_id)), 1, "indications for one payload")


@case(
    "TC_BP_PTI_BV_05",
    "Each client whose payload is in a beacon gets an indication, with the same nextBeaconGenerationEpoch",
    requirements="BP-PTI-01 BP-PTI-02",
    stimulus="between two beacons, each of three clients submits a payload",
    expect="one indication for each client; the same epoch for payloads that share a beacon",
    needs=Needs(entities=(), ut=CLIENT, when=no_indication),
    window=8,
)
def each_client(bench: Bench) -> None:
    with BPClient(bench, ONCE) as one, BPClient(bench, ONCE) as two, BPClient(bench, ONCE) as three:
        clients, start, since = (one, two, three), 0, [0, 0, 0]

        def told(place: int) -> list[Notification]:
            return indications(bench, TRANSMITTED, clients[place].prot_id)[since[place] :]

        def act() -> None:
            nonlocal start
            start = bench.mark()
            for place, client in enumerate(clients):
                since[place] += len(told(place))
                client.transmit(client.payload())

        def any_of(heard: ReceivedBeacon) -> bool:
            return any(client.in_frame(heard) for client in clients)

        between_beacons(bench, "submission of three payloads", act, any_of)
        bench.until(lambda _: all(client.frames(start) for client in clients), 2 * bench.sut.reaction)
        needed(bench, all(client.frames(start) for client in clients), "beacons with the three payloads")
        until(bench, lambda: all(told(place) for place in range(3)), 1)
        bench.wait(_AFTERWARDS)
        for place, client in enumerate(clients):
            bench.repeated(len(told(place)), 1, "indications", "BP-PTI-01", frames=client.frames(start))
        for heard in {id(each): each for client in clients for each in client.frames(start)}.values():
            epochs = {
                epoch
                for place, client in enumerate(clients)
                if client.in_frame(heard) and len(told(place)) == 1
                for epoch in [told(place)[0].params.get("nextBeaconGenerationEpoch")]
                if isinstance(epoch, int)
            }
            apart = max(epochs) - min(epochs) if epochs else 0
            what = "the same nextBeaconGenerationEpoch for all payloads of a beacon"
            bench.none(apart > bench.period // 2, what, "BP-PTI-02", seen=f"{apart / MS:.0f} ms apart", frames=[heard])


@case(
    "TC_BP_PTI_BV_02",
    "A client with mode REPEAT gets an indication for each beacon that its payload is put into",
    requirements="BP-PTI-03",
    stimulus="a client with mode REPEAT submits one payload; the implementation sends it in six beacons",
    expect="an indication for each of the beacons",
    needs=Needs(entities=(), ut=CLIENT, when=no_indication),
    window=8,
)
def told_of_each_repetition(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        for _ in range(6):
            client.until_sent()
        frames = client.frames()
        wait_for_notifications(bench)
        count, most = len(indications(bench, TRANSMITTED, client.prot_id)), len(client.frames())
        bench.required(len(frames) >= 6, "six beacons with the payload", "BP-QM-05", seen=len(frames))
        near = len(frames) - 1 <= count <= most + 1
        beacons = f"{len(frames)} beacons" if most == len(frames) else f"{len(frames)} to {most} beacons"
        bench.some(near, f"one indication for each of {beacons}", seen=f"{count} indications", frames=frames)
