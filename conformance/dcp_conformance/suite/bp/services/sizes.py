"""dcp-bp.md: Service Interface and Receive Path: names, numbers and identifiers beyond those of usual clients."""

from __future__ import annotations

from contextlib import ExitStack

from dcp_spec.constants import BP_MAX_PAYLOADS, BP_SEQNO_MODULUS, QueueingMode, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.frames.builder import Block, Lies
from dcp_conformance.suite.bp.beacons.receive import check_processed
from dcp_conformance.test_steps.bp_clients import (
    CLIENT,
    DEREGISTER,
    LIST,
    ONCE,
    REGISTER,
    REPEAT,
    BPClient,
    areas_of_fixed_size,
    each_mode,
    listed,
    queue_mode,
    registered,
    unused_protocol_id,
)
from dcp_conformance.test_steps.pacing import paced
from dcp_conformance.test_steps.services import parameters_set
from dcp_conformance.test_system.bench import MS, Bench

V1_1 = SpecVersion.V1_1
#: Number of clients, of damaged beacons before a valid one, and of senders.
_CLIENTS, _DAMAGED, _SENDERS = 40, 12, 150
_PERIOD = "BPPAR_BEACON_PERIOD"


@case(
    "TC_BP_LST_BV_03",
    "The list has the whole name of a client ({variant})",
    requirements="BP-LST-01 BP-LST-03",
    stimulus="a client registers with a name of this length ({variant}) in octets",
    expect="the same name in BP-ListRegisteredProtocols",
    needs=Needs(entities=(), ut=(REGISTER, DEREGISTER, LIST)),
    variants={
        **{f"{length}": "".join(chr(0x41 + place % 26) for place in range(length)) for length in (32, 64, 128, 255)},
        "100-utf-8": "\u00e9" * 50,
    },
)
def whole_name(bench: Bench, name: str) -> None:
    with BPClient(bench, ONCE, name=name) as client:
        bench.fields(client.entry() or {}, protocolName=name)


@case(
    "TC_BP_LST_BV_04",
    "The list has maxEntries as registered ({variant})",
    requirements="BP-LST-01",
    stimulus="a client with a queue registers with maxEntries {variant}",
    expect="the same maxEntries in BP-ListRegisteredProtocols, unless the registration is refused",
    needs=Needs(V1_1, entities=(), ut=(REGISTER, DEREGISTER, LIST)),
    variants={f"{number}": number for number in (128, 256, 300, 1000)},
)
def whole_number(bench: Bench, number: int) -> None:
    client = BPClient(bench, queue_mode(bench), entries=number)
    answer = client.register()
    if not answer.ok:
        bench.info(f"Can maxEntries be {number}?", f"no: {answer}")
        return
    try:
        bench.fields(client.entry() or {}, maxEntries=number)
    finally:
        bench.call(DEREGISTER, protId=client.prot_id)


@case(
    "TC_BP_REG_BV_08",
    f"{_CLIENTS} clients can be registered at the same time",
    requirements="BP-REG-06 BP-LST-01 BP-LST-03",
    stimulus=f"{_CLIENTS} clients register; each of them submits a payload",
    expect="all clients in the list, and a beacon with each payload; a limit of the memory is reported",
    window=50,
    needs=Needs(entities=(), ut=(*CLIENT, LIST), when=lambda bench: bench.sut.lacks("clients", _CLIENTS + 2) or None),
)
def many_clients(bench: Bench) -> None:
    clients = [BPClient(bench, ONCE, size=8) for _ in range(_CLIENTS)]
    with ExitStack() as stack:
        for number, client in enumerate(clients):
            answer = client.register()
            if not answer.ok:
                bench.info("How many clients can be registered?", f"{number}: {answer}")
                return
            stack.callback(bench.call, DEREGISTER, protId=client.prot_id)
        entries, start = registered(bench), bench.mark()
        bench.none([each.prot_id for each in clients if each.prot_id not in entries], "each client in the list")
        payloads = {client.prot_id: client.payload(8) for client in clients}
        for client in clients:
            client.transmit(payloads[client.prot_id])

        def left() -> list[str]:
            return [f"{each.prot_id:#x}" for each in clients if payloads[each.prot_id] not in each.sent(start)]

        bench.until(lambda _: not left(), 2 * _CLIENTS)
        bench.complete(left(), "a beacon with the payload of each client", "BP-REG-06")


@case(
    "TC_BP_REG_BV_09",
    "Any protocol identifier can be registered, and its payloads are sent and delivered ({variant})",
    requirements="BP-HDR-11 BP-RXP-03 BP-REG-06",
    stimulus="a client registers under this identifier ({variant}), submits a payload and receives one",
    expect="a beacon with the payload under this identifier; an indication of the received payload",
    window=8,
    needs=Needs(entities=(), ut=CLIENT),
    variants={f"{number:04x}": number for number in (0x00FF, 0x0101, 0x0102, 0x8001, 0xFFFE)},
)
def any_identifier(bench: Bench, number: int) -> None:
    if number >= 1 << (8 * bench.profile.types.protocol_id.width):
        bench.verdicts.not_applicable(f"in the profile {bench.profile.name} protocol identifiers have fewer octets")
    with BPClient(bench, REPEAT, prot_id=number) as client:
        payload, octets = client.payload(), bytes(range(7))
        client.transmit(payload)
        bench.some(client.until_sent(payload), "a beacon with the payload", "BP-HDR-11", "BP-REG-06")
        bench.peer().send(Block(number, octets))
        received = client.until_received()
        bench.only(received, [octets], "the payload received", "BP-RXP-03", "BP-HDR-11")


@case(
    "TC_BP_RX_BV_08",
    "A beacon may have 255 blocks",
    requirements="BP-RX-07 BP-RX-08 BP-HDR-07",
    stimulus=(
        "a beacon with 254 blocks of an unregistered protocol, one octet each, and the summary of an unknown variable"
    ),
    expect="a request for the variable",
    needs=Needs(header=("numPayloads",), when=areas_of_fixed_size),
)
def most_blocks(bench: Bench) -> None:
    peer, var_id, start = bench.peer(), bench.unknown_id(), bench.mark()
    other = Block(unused_protocol_id(bench), b"x")
    peer.send(*[other] * (BP_MAX_PAYLOADS - 1), peer.summary(var_id, 1))
    check_processed(bench, [var_id], start, "the last of 255 blocks")


@case(
    "TC_BP_RX_BV_09",
    f"Beacons are processed after those of {_SENDERS} other senders",
    requirements="BP-RX-07 DATA-04",
    stimulus=(
        f"a beacon of each of {_SENDERS} senders with a block of an unregistered protocol; then summaries of unknown "
        "variables from the first of them and from a new one"
    ),
    expect="requests for both variables",
    window=10,
)
def many_senders(bench: Bench) -> None:
    peers = [bench.peer() for _ in range(_SENDERS + 1)]
    block = Block(unused_protocol_id(bench), b"x")
    for peer in peers[:-1]:
        peer.send(block)
    names, start = bench.identifiers.unknown_ids(2), bench.mark()
    for peer, name in zip((peers[0], peers[-1]), names, strict=True):
        peer.send(peer.summary(name, 1))
    check_processed(bench, names, start, "a beacon of the first sender and one of a new sender")


@case(
    "TC_BP_QM_BV_17",
    "Equal payloads are different payloads ({variant})",
    requirements="BP-QM-03",
    stimulus="between two beacons, a client with mode {variant} and maxEntries 4 submits A, A, B, B",
    expect="four beacons with A, A, B, B",
    window=10,
    variants={name: each for name, each in each_mode(*CLIENT).items() if each.value.is_queue},
)
def equal_payloads(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode, entries=4) as client:
        payloads = [client.payload(), client.payload()]
        right = [payloads[each] for each in (0, 0, 1, 1)]
        start, _ = client.submit_between("submission of four payloads", lambda: right)
        bench.until_quiet(client.in_frame, since=start)
        sent = client.sent(start)
        bench.in_order(sent, right, "payloads A, A, B, B", seen=listed(sent, payloads))


_DAMAGES: dict[str, tuple[str, Lies, int | None]] = {
    "version": ("BP-RX-01", {"bp.version": 2}, None),
    "length-0": ("BP-RX-03", {"bp.length": 0}, None),
    "length-too-long": ("BP-RX-15", {"bp.length": 4000}, None),
    "no-blocks": ("BP-RX-04", {"bp.numPayloads": 0}, None),
    "block-too-long": ("BP-RX-09", {"payloads[0].length": 4000}, None),
    "cut-off": ("BP-RX-16", {}, 12),
}


@case(
    "TC_BP_RX_BO_01",
    f"A beacon is processed after {_DAMAGED} damaged beacons of the same sender ({{variant}})",
    requirements="BP-RX-07",
    stimulus=(
        f"{_DAMAGED} beacons of a neighbour with the summary of an unknown variable, each damaged ({{variant}}); "
        "then a valid beacon of it"
    ),
    expect="a request for the variable of the valid beacon",
    window=8,
    variants={
        name: Variant(
            (lies, cut),
            requirements=f"BP-RX-07 BP-RX-16 {own}",
            needs=Needs(header=tuple(each.removeprefix("bp.") for each in lies if each.startswith("bp."))),
        )
        for name, (own, lies, cut) in _DAMAGES.items()
    },
)
def after_damage(bench: Bench, damage: tuple[Lies, int | None]) -> None:
    lies, cut = damage
    peer, (damaged, valid) = bench.peer(), bench.identifiers.unknown_ids(2)
    for _ in paced(bench, range(_DAMAGED)):
        peer.send(peer.summary(damaged, 1), lies=lies, cut=cut)
    start = peer.stimulate(peer.summary(valid, 1))
    check_processed(bench, [valid], start, "a beacon after damaged ones of its sender", "BP-RX-07", "BP-RX-16")


@case(
    "TC_BP_HDR_TI_01",
    "Beacons are counted with 32 bits",
    requirements="BP-HDR-08",
    stimulus="a client repeats a payload with a beacon period of 1 ms (or the shortest) until 65,600 beacons were sent",
    expect="the sequence number of a beacon is above 65,535, and never falls",
    window=700,
    needs=Needs(entities=(), ut=(*CLIENT, "BP-SetParameter"), header=("seqno",)),
    long=True,
)
def counts_far(bench: Bench) -> None:
    with BPClient(bench, REPEAT, size=8) as client, parameters_set(bench, "BP", **{_PERIOD: 1}):
        client.put_on_air(size=8)
        begun, deadline = bench.heard[-1], bench.now() + 300_000 * MS
        last = begun
        while bench.now() < deadline and (last.seqno or 0) <= _SIXTEEN_BITS:
            del bench.heard[:-1]
            bench.waiting.wait_ns(500 * MS)
            if not bench.heard:
                break
            before, last = last, bench.heard[-1]
            if before.seqno is None or last.seqno is None:
                bench.inconclusive("beacons that can be read", f"{last.problem or before.problem}")
            if (last.seqno - before.seqno) % BP_SEQNO_MODULUS > 1 << 31:
                bench.answered(last.seqno, f"above {before.seqno}", "sequence number", frames=[before, last], stop=True)
        if (last.seqno or 0) <= _SIXTEEN_BITS:
            bench.inconclusive("65,536 beacons in five minutes", f"{(last.seqno or 0) - (begun.seqno or 0)}")
        bench.passed("a sequence number above 65,535", frames=[last])


_SIXTEEN_BITS = 0xFFFF
