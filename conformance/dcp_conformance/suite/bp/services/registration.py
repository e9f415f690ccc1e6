"""dcp-bp.md: Registration and De-Registration of Client Protocols.

Registration of client protocols. The expected status is that of the first check that fails, in the order of the
specification.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.test_steps.bp_clients import (
    ALREADY_REGISTERED,
    CLEAR,
    CLIENT,
    DEREGISTER,
    DROPHEAD,
    DROPTAIL,
    ILLEGAL_QUEUE,
    ILLEGAL_SIZE,
    LIST,
    OK,
    ONCE,
    QUERY,
    REGISTER,
    REPEAT,
    UNKNOWN_MODE,
    BPClient,
    areas_of_fixed_size,
    each_mode,
    largest_payload,
    unused_protocol_id,
)
from dcp_conformance.test_steps.confirm_times import check_confirm_time
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.upper_tester.base import INTERNAL_ERROR

V1_0, V1_1 = SpecVersion.V1_0, SpecVersion.V1_1


def expect(bench: Bench, status: str, client: BPClient, /, *requirements: str, **changes: Any) -> None:
    """Check the status of a registration with changed parameters, and undo a registration that succeeds."""
    answer = bench.expect_status(status, REGISTER, *requirements, **{**client.registration, **changes})
    if answer.ok:
        bench.call(DEREGISTER, protId=client.prot_id)


# -- BP-RegisterProtocol -----------------------------------------------------------------------------------------------


@case(
    "TC_BP_REG_BV_01",
    "A client registers with mode {variant}, and the list has the registered values",
    requirements="BP-REG-01 BP-REG-06 BP-REG-12 BP-LST-01 BP-LST-03",
    stimulus="BP-RegisterProtocol with mode {variant}, then BP-ListRegisteredProtocols",
    expect="BP-STATUS-OK; an entry with the same values and the time of the registration",
    variants=each_mode(*CLIENT, LIST),
)
def register(bench: Bench, mode: QueueingMode) -> None:
    client = BPClient(bench, mode, size=48, entries=3, several=True, name="tester of this mode")
    before = bench.lower.wall()
    answer = bench.expect_status(OK, REGISTER, "BP-REG-01 BP-REG-06 BP-REG-12", **client.registration)
    after = bench.lower.wall()
    if not answer.ok:
        return
    entry = client.entry()
    bench.call(DEREGISTER, protId=client.prot_id)
    if not bench.proved(entry is not None, "the client in the list", "not in the list", "BP-REG-06") or entry is None:
        return
    for listed, right in client.listing().items():
        what = f"{listed}, as registered"
        bench.answered(entry.get(listed), right, what, "BP-LST-01 BP-LST-03 BP-REG-01 BP-REG-12")
    stamp, margin = entry.get("timeStampRegistration"), round(bench.sut.pixit.clock_tolerance_ms * MS)
    near = isinstance(stamp, int) and before - margin <= stamp <= after + margin
    bench.proved(
        near, "the time of the request in timeStampRegistration", f"{stamp!r}", "BP-REG-06 BP-LST-01 BP-LST-03"
    )


@case(
    "TC_BP_REG_BV_02",
    "The confirm of a registration contains the node's own identifier",
    requirements="BP-REG-07",
    stimulus="BP-RegisterProtocol; the client submits a payload",
    expect="the senderId of the beacon with the payload as ownNodeIdentifier",
    needs=Needs(since=V1_1, entities=(), ut=CLIENT, header=("senderId",)),
)
def own_identifier(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        told = str(client.answer.result.get("ownNodeIdentifier", "nothing"))
        client.transmit(client.payload())
        heard = client.until_sent()
        if heard is None or heard.sender is None:
            bench.inconclusive("a beacon with the payload", "none in time")
        same = told.replace(":", "").lower() == heard.sender.hex()
        bench.proved(same, f"ownNodeIdentifier {heard.sender.hex(':')}, as in senderId", told, frames=[heard])


@case(
    "TC_BP_REG_TI_01",
    "Confirms of registrations are immediate and do not wait for a beacon",
    requirements="BP-REG-08",
    stimulus="ten registrations and deregistrations",
    expect="a median time to the confirm of less than half a beacon period",
    needs=Needs(since=V1_1, entities=(), ut=(REGISTER, DEREGISTER)),
)
def immediate_confirm(bench: Bench) -> None:
    delays, others = [], []
    for _ in range(10):
        client = BPClient(bench, ONCE)
        start = bench.now()
        bench.must(REGISTER, **client.registration)
        delays.append(bench.now() - start)
        start = bench.now()
        bench.must(DEREGISTER, protId=client.prot_id)
        others.append(bench.now() - start)
    check_confirm_time(bench, delays, others)


@case(
    "TC_BP_REG_BV_03",
    "maxPayloadSize may be as large as the room in a beacon",
    requirements="BP-REG-04 BP-REG-11",
    stimulus="BP-RegisterProtocol with the largest maxPayloadSize, and with 1",
    expect="BP-STATUS-OK",
    needs=Needs(entities=(), ut=(REGISTER, DEREGISTER), when=areas_of_fixed_size),
)
def largest_size(bench: Bench) -> None:
    for size in (largest_payload(bench), 1):
        expect(bench, OK, BPClient(bench, ONCE), maxPayloadSize=size)


@case(
    "TC_BP_REG_BV_04",
    "Modes without a queue ignore maxEntries ({variant})",
    requirements="BP-QM-09",
    stimulus="BP-RegisterProtocol with mode {variant} and maxEntries 0",
    expect="BP-STATUS-OK",
    needs=Needs(since=V1_1, entities=(), ut=(REGISTER, DEREGISTER)),
    variants={"once": ONCE, "repeat": REPEAT},
)
def entries_of_buffers(bench: Bench, mode: QueueingMode) -> None:
    expect(bench, OK, BPClient(bench, mode), maxEntries=0)


@case(
    "TC_BP_REG_BV_06",
    "In 1.0, a client that only receives may register with maxPayloadSize 0",
    requirements="BP-REG-06",
    stimulus="BP-RegisterProtocol with maxPayloadSize 0",
    expect="BP-STATUS-OK: 1.0 has an upper limit only",
    needs=Needs(until=SpecVersion.V1_0, entities=(), ut=(REGISTER, DEREGISTER)),
)
def size_zero_in_1_0(bench: Bench) -> None:
    expect(bench, OK, BPClient(bench, ONCE), maxPayloadSize=0)


@case(
    "TC_BP_REG_BV_07",
    "Every protocol identifier can be registered ({variant})",
    requirements="BP-REG-01 BP-RXP-03",
    stimulus=(
        "BP-RegisterProtocol with protId {variant}; the client submits a payload; a beacon with a block for it between "
        "two of an unregistered protocol"
    ),
    expect="BP-STATUS-OK, a beacon with the payload, and an indication of the block for it only",
    needs=Needs(entities=(), ut=CLIENT),
    variants={"0": 0, "255": 0xFF, "256": 0x100, "the-largest": None},
)
def any_identifier(bench: Bench, prot_id: int | None) -> None:
    largest = (1 << 8 * bench.profile.types.protocol_id.width) - 1
    client = BPClient(bench, ONCE, prot_id=largest if prot_id is None else min(prot_id, largest))
    answer = client.register()
    bench.services.require_asked(answer, "BP-STATUS-OK for the registration")
    if answer.is_status(ALREADY_REGISTERED):
        bench.inconclusive("an unregistered protocol identifier", f"{client.prot_id} is already registered")
    bench.proved(answer.is_status(OK), "BP-STATUS-OK for the registration", answer, stop=True)
    try:
        client.transmit(client.payload())
        bench.some(client.until_sent(), "a beacon with the payload")
        octets, other = bytes(range(7)), Block(unused_protocol_id(bench), b"of another protocol")
        bench.peer().send(other, Block(client.prot_id, octets), other)
        received = client.until_received()
        bench.some(octets in received, "an indication of the block", "BP-REG-01")
        bench.only(set(received), {octets}, "no indication of another block", "BP-RXP-03")
    finally:
        bench.call(DEREGISTER, protId=client.prot_id)


@case(
    "TC_BP_REG_BI_01",
    "A maxPayloadSize of 0 is rejected",
    requirements="BP-REG-03",
    stimulus="BP-RegisterProtocol with maxPayloadSize 0",
    expect="BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE",
    needs=Needs(since=V1_1, entities=(), ut=(REGISTER, DEREGISTER)),
)
def size_zero(bench: Bench) -> None:
    expect(bench, ILLEGAL_SIZE, BPClient(bench, ONCE), maxPayloadSize=0)


@case(
    "TC_BP_REG_BI_02",
    "A maxPayloadSize larger than the room in a beacon is rejected ({variant})",
    requirements="BP-REG-04 BP-REG-11",
    stimulus="BP-RegisterProtocol with too large a maxPayloadSize ({variant})",
    expect="BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE",
    needs=Needs(entities=(), ut=(REGISTER, DEREGISTER), when=areas_of_fixed_size),
    variants={
        "by-one": lambda bench: largest_payload(bench) + 1,
        "maximum-packet-size": lambda bench: bench.sut.bound("BPPAR_MAXIMUM_PACKET_SIZE"),
        "65535": lambda _: 0xFFFF,
        "65536-too-large": lambda _: (1 << 16) + 64,
    },
)
def size_too_large(bench: Bench, size: Callable[[Bench], int]) -> None:
    client = BPClient(bench, ONCE)
    answer = client.register(maxPayloadSize=size(bench))
    if not answer.asked and size(bench) > 0xFFFF:
        bench.info("Can sizes of more than 16 bits be requested?", f"no: {answer}")
        return
    bench.services.check_status(answer, (ILLEGAL_SIZE,), REGISTER)
    if answer.ok:
        bench.call(DEREGISTER, protId=client.prot_id)


@case(
    "TC_BP_REG_BI_03",
    "A queue of no entries is rejected ({variant})",
    requirements="BP-REG-05 BP-QM-09",
    stimulus="BP-RegisterProtocol with mode {variant} and maxEntries 0; then with 1",
    expect="BP-STATUS-ILLEGAL-DROPPING-QUEUE-SIZE; then BP-STATUS-OK",
    needs=Needs(since=V1_1, entities=(), ut=(REGISTER, DEREGISTER)),
    variants={"droptail": DROPTAIL, "drophead": DROPHEAD},
)
def no_entries(bench: Bench, mode: QueueingMode) -> None:
    client = BPClient(bench, mode)
    expect(bench, ILLEGAL_QUEUE, client, maxEntries=0)
    expect(bench, OK, client, maxEntries=1)


@case(
    "TC_BP_REG_BO_01",
    "A second registration of an identifier is rejected and changes nothing",
    requirements="BP-REG-02",
    stimulus="BP-RegisterProtocol twice, the second time with other parameters, while a payload is buffered",
    expect="BP-STATUS-PROTOCOL-ALREADY-REGISTERED; the list entry and the buffered payload as before",
    needs=Needs(entities=(), ut=(*CLIENT, LIST, QUERY)),
)
def already_registered(bench: Bench) -> None:
    with BPClient(bench, REPEAT, size=20) as client:
        client.transmit(client.payload())
        before = client.fields()
        changes: dict[str, Any] = {"maxPayloadSize": 40, "queueingMode": str(ONCE), "name": "other"}
        bench.expect_status(ALREADY_REGISTERED, REGISTER, **{**client.registration, **changes})
        bench.answered(client.fields(), before, "the registration unchanged")
        bench.answered(client.number(), 1, "buffered payloads, as before")
        start = bench.mark()
        client.until_sent()
        bench.beacons(1)
        bench.some(len(client.frames(start)) >= 1, "further beacons with the payload")


_DOUBLE: Mapping[str, tuple[str, Callable[[Bench], dict[str, Any]]]] = {
    "duplicate-and-size-0": (ALREADY_REGISTERED, lambda _: {"maxPayloadSize": 0}),
    "duplicate-and-too-large": (ALREADY_REGISTERED, lambda bench: {"maxPayloadSize": largest_payload(bench) + 1}),
    "duplicate-and-no-entries": (ALREADY_REGISTERED, lambda _: {"queueingMode": str(DROPTAIL), "maxEntries": 0}),
    "size-0-and-no-entries": (
        ILLEGAL_SIZE,
        lambda _: {"maxPayloadSize": 0, "queueingMode": str(DROPHEAD), "maxEntries": 0},
    ),
    "too-large-and-no-entries": (
        ILLEGAL_SIZE,
        lambda bench: {"maxPayloadSize": largest_payload(bench) + 1, "queueingMode": str(DROPTAIL), "maxEntries": 0},
    ),
}


@case(
    "TC_BP_REG_BI_04",
    "The first failing check of a registration determines the status ({variant})",
    requirements="BP-REG-09 DATA-11",
    stimulus="BP-RegisterProtocol with two faults: {variant}",
    expect="the status of the first failing check",
    variants={
        name: Variant(
            fault,
            # 1.0 has only two of these checks.
            needs=Needs(
                since=V1_0 if name == "duplicate-and-too-large" else V1_1,
                entities=(),
                ut=(REGISTER, DEREGISTER),
                when=areas_of_fixed_size,
            ),
        )
        for name, fault in _DOUBLE.items()
    },
)
def two_faults(bench: Bench, fault: tuple[str, Callable[[Bench], dict[str, Any]]]) -> None:
    status, changes = fault
    client = BPClient(bench, ONCE)
    if status == ALREADY_REGISTERED:
        with client:
            bench.expect_status(status, REGISTER, **{**client.registration, **changes(bench)})
    else:
        expect(bench, status, client, **changes(bench))


@case(
    "TC_BP_REG_BI_05",
    "An unknown queueing mode is rejected, at the latest by BP-ClearBuffer ({variant})",
    requirements="BP-QM-06 BP-CLR-04",
    stimulus="BP-RegisterProtocol with mode {variant}; if it succeeds, BP-ClearBuffer",
    expect=(
        "a status other than BP-STATUS-OK, or an error; if the registration succeeds, "
        "BP-STATUS-UNKNOWN-QUEUEING-MODE for BP-ClearBuffer (X06)"
    ),
    needs=Needs(since=V1_1, entities=(), ut=(REGISTER, DEREGISTER, CLEAR)),
    variants={"BP_QMODE_LIFO": "BP_QMODE_LIFO", "BP_QMODE_QUEUE": str(QueueingMode.QUEUE)},
)
def unknown_mode(bench: Bench, mode: str) -> None:
    client = BPClient(bench, mode)
    answer = client.register()
    if not answer.asked:
        bench.info("Does the upper tester accept an unknown queueing mode?", str(answer))
        return
    if not answer.ok:
        # An internal error of the implementation is not a rejection.
        if bench.some(answer.code != INTERNAL_ERROR, "a rejection of the registration", "BP-QM-06", seen=answer):
            bench.reading("X06", "refuse-at-registration")
        return
    cleared = bench.expect_status(UNKNOWN_MODE, CLEAR, "BP-QM-06 BP-CLR-04", protId=client.prot_id)
    if cleared.is_status(UNKNOWN_MODE):
        bench.reading("X06", "refuse-at-clear")
    bench.call(DEREGISTER, protId=client.prot_id)
