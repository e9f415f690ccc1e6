"""dcp-bp.md: Service Interface, registrations of one identifier in succession; Other BP Management Services.

A client must behave according to its registration, whatever happened under its identifier before: an earlier
registration with other values, requests that were refused, or a registration while BP is inactive.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from typing import Any

from dcp_spec.constants import SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.suite.bp.services.indications import no_indication
from dcp_conformance.suite.bp.services.parameters import NETWORK, PERIOD, SET, SIZE
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import (
    ACTIVATE,
    ALREADY_REGISTERED,
    CLEAR,
    CLIENT,
    DEACTIVATE,
    DEREGISTER,
    DROPHEAD,
    DROPTAIL,
    EMPTY,
    ILLEGAL_QUEUE,
    ILLEGAL_SIZE,
    LIST,
    OK,
    ONCE,
    QUERY,
    REGISTER,
    REPEAT,
    TOO_LARGE,
    TRANSMIT,
    TRANSMITTED,
    UNKNOWN_PROTOCOL,
    BPClient,
    areas_of_fixed_size,
    each_mode,
    indications,
    largest_payload,
    listed,
    needed,
    no_confirm,
    queue_mode,
    until,
)
from dcp_conformance.test_steps.services import parameters_set, until_neighbour
from dcp_conformance.test_system.bench import MS, Bench

V1_1, V1_2, V2_0 = SpecVersion.V1_1, SpecVersion.V1_2, SpecVersion.V2_0
_OBSERVED = (*CLIENT, LIST, QUERY)
_SWITCHED = (*_OBSERVED, CLEAR, ACTIVATE, DEACTIVATE)
_WAIT = 2_500
"""How long payloads wait while BP is inactive, in ms."""


class _Registered:
    """The required effects of a registration. Requirements are those of its mode."""

    def __init__(self, client: BPClient, *own: str) -> None:
        self.client = client
        self.bench = client.bench
        self.mode = client.registration["queueingMode"]
        self.size: int = client.registration["maxPayloadSize"]
        queue = self.mode in (DROPTAIL, DROPHEAD)
        self.places: int = client.registration["maxEntries"] if queue else 1
        self.query = "BP-QRY-02" if queue else "BP-QRY-03"
        kept = {DROPTAIL: "BP-QM-01", DROPHEAD: "BP-QM-02", ONCE: "BP-QM-04", REPEAT: "BP-QM-05"}
        self.own = (*own, kept[self.mode])

    def kept(self, payloads: list[bytes]) -> list[bytes]:
        """Return those of the submitted payloads that the mode keeps."""
        return payloads[: self.places] if self.mode == DROPTAIL else payloads[-self.places :]

    def check_entry(self) -> object:
        """Check the entry in the list; return its time of registration."""
        entry = self.client.entry() or {}
        self.bench.fields(entry, "BP-LST-01 BP-LST-03 BP-REG-06", *self.own[:-1], **self.client.listing())
        return entry.get("timeStampRegistration")

    def check_refused(self) -> None:
        """Check that a payload that is too large is refused and not kept."""
        before = self.client.number()
        if no_confirm(self.bench) is None:
            payload = bytes(self.size + 1).hex()
            self.bench.expect_status(
                TOO_LARGE, TRANSMIT, "BP-TXP-02", *self.own, protId=self.client.prot_id, payload=payload
            )
        self.bench.answered(self.client.number(), before, "buffered payloads", "BP-TXP-02", *self.own)

    def submitted(self) -> tuple[list[bytes], list[int | None]]:
        """Submit one payload more than is kept, of the largest size; return them and the numbers after each."""
        payloads, numbers = [self.client.payload(self.size) for _ in range(self.places + 1)], []
        for payload in payloads:
            self.client.transmit(payload, must=False)
            numbers.append(self.client.number())
        return payloads, numbers

    def check_numbers(self, numbers: list[int | None]) -> None:
        """Check the numbers of buffered payloads after the submissions."""
        right = [*range(1, self.places + 1), self.places]
        self.bench.answered(numbers, right, "buffered payloads after each submission", self.query, *self.own)

    def check_sent(self, payloads: list[bytes], since: int) -> None:
        """Check which of the submitted payloads are sent, and in which order."""
        bench, client, kept = self.bench, self.client, self.kept(payloads)
        if self.mode == REPEAT:
            for _ in range(2):
                client.until_sent(kept[0])
            sent = client.sent(since)
            bench.repeated(sent, 2, "beacons with the payload", *self.own, most=float("inf"), frames=client.frames())
            bench.every(sent, lambda each: each == kept[0], "the last payload only", *self.own)
        else:
            # Others may have their turns in between.
            if not set(kept) <= set(client.sent(since)):
                bench.until(lambda _: set(kept) <= set(client.sent(since)), 8 * len(kept))
            bench.until_quiet(client.in_frame, since=since)
            sent = client.sent(since)
            what = f"payloads {listed(kept, payloads)}"
            order = ("BP-QM-03", *self.own) if self.mode in (DROPTAIL, DROPHEAD) else self.own
            bench.in_order(sent, kept, what, *order, seen=listed(sent, payloads))
        if not client.registration["allowMultiplePayloads"]:
            full = [each for each in client.frames(since) if len(client.in_frame(each)) > 1]
            bench.none(full, "at most one payload of the client in each beacon", "BP-QM-07", *self.own)

    def check(self) -> object:
        """Check all of it; return the time of registration."""
        bench, client = self.bench, self.client
        bench.expect_status(OK, QUERY, "BP-REG-06", *self.own, protId=client.prot_id)
        bench.answered(client.number(), 0, "buffered payloads after the registration", "BP-REG-06 BP-DRG-05")
        stamp = self.check_entry()
        self.check_refused()
        start = 0

        def act() -> tuple[list[bytes], list[int | None]]:
            nonlocal start
            if start and (left := client.number()):
                bench.inconclusive("an empty buffer before another attempt", f"{left} payloads of the last one in it")
            start = bench.mark()
            return self.submitted()

        if self.mode == REPEAT:
            payloads, numbers = act()
        else:
            payloads, numbers = between_beacons(bench, "submission of the payloads", act, client.in_frame)
        self.check_numbers(numbers)
        # A payload of the first attempts may be sent before the last one is submitted.
        self.check_sent(payloads, bench.mark() if self.mode == REPEAT else start)
        return stamp


def _values(mode: str, size: int, entries: int, name: str, *, several: bool = False) -> dict[str, Any]:
    return {
        "queueingMode": str(mode),
        "maxPayloadSize": size,
        "maxEntries": entries,
        "name": name,
        "allowMultiplePayloads": several,
    }


_TAIL = _values(DROPTAIL, 20, 1, "short")
_LONG_TAIL = _values(DROPTAIL, 40, 4, "a longer queue", several=True)
_HEAD = _values(DROPHEAD, 32, 3, "drops its head")
_ONCE = _values(ONCE, 48, 9, "once", several=True)
_REPEAT = _values(REPEAT, 12, 2, "repeats")
_PAIRS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "droptail-drophead": (_TAIL, _HEAD),
    "drophead-droptail": (_HEAD, _TAIL),
    "droptail-shorter": (_LONG_TAIL, _HEAD),
    "once-droptail": (_ONCE, _LONG_TAIL),
    "repeat-drophead": (_REPEAT, _HEAD),
    "once-repeat": (_ONCE, _REPEAT),
}


# -- further registrations ---------------------------------------------------------------------------------------------


@case(
    "TC_BP_LIFE_BV_01",
    "A client that registers again behaves as registered now, not as before ({variant})",
    requirements="BP-REG-06 BP-DRG-05",
    stimulus=(
        "an identifier is registered three times, the second time with other values ({variant}); each time a payload "
        "that is too large, one payload more than is kept, and one that is left at the deregistration"
    ),
    expect=(
        "each time an empty queue, the list entry as registered with a new time, and the payloads that mode, "
        "maxEntries and maxPayloadSize of this registration determine"
    ),
    window=24,
    variants={
        name: Variant(pair, needs=Needs(V1_1 if "drop" in name else SpecVersion.V1_0, entities=(), ut=_OBSERVED))
        for name, pair in _PAIRS.items()
    },
)
def further_lives(bench: Bench, pair: tuple[dict[str, Any], dict[str, Any]]) -> None:
    client, stamps = BPClient(bench, ONCE), []
    for values in (*pair, pair[0]):
        client.registration.update(values)
        with client:
            stamps.append(_Registered(client, "BP-REG-06", "BP-DRG-05").check())
            client.transmit(client.payload())
        # The resolution of registration times is up to the implementation.
        bench.waiting.wait_ns(max(bench.period // 2, 50 * MS))
    again = [each for each, other in pairwise(stamps) if each == other]
    bench.none(again, "a new time of each registration", "BP-REG-06 BP-LST-01 BP-LST-03", seen=f"{stamps}")


# -- refused requests --------------------------------------------------------------------------------------------------


def _too_large(client: BPClient) -> dict[str, Any]:
    return {"maxPayloadSize": largest_payload(client.bench) + 1}


_REFUSED: dict[str, tuple[str, Callable[[BPClient], dict[str, Any]], str]] = {
    "size-0": ("BP-REG-03", lambda _: {"maxPayloadSize": 0}, ILLEGAL_SIZE),
    "size-too-large": ("BP-REG-04 BP-REG-11", _too_large, ILLEGAL_SIZE),
    "entries-0": ("BP-REG-05", lambda _: {"maxEntries": 0}, ILLEGAL_QUEUE),
}


@case(
    "TC_BP_LIFE_BI_01",
    "A refused registration has no effect on a later one ({variant})",
    requirements="BP-REG-06",
    stimulus="BP-RegisterProtocol with an illegal value ({variant}), twice; then with legal values",
    expect="the status of the illegal value; then a client that behaves as registered",
    window=10,
    variants={
        name: Variant(value, requirements=f"BP-REG-06 {value[0]}", needs=Needs(V1_1, entities=(), ut=_OBSERVED))
        for name, value in _REFUSED.items()
    },
)
def refused_before(bench: Bench, refusal: tuple[str, Callable[[BPClient], dict[str, Any]], str]) -> None:
    requirement, wrong, status = refusal
    client = BPClient(bench, queue_mode(bench), size=24, entries=2)
    for _ in range(2):
        bench.expect_status(status, REGISTER, *requirement.split(), **{**client.registration, **wrong(client)})
    bench.expect_status(OK, REGISTER, "BP-REG-06", "BP-REG-09", **client.registration)
    with ExitStack() as stack:
        stack.callback(bench.call, DEREGISTER, protId=client.prot_id)
        _Registered(client, "BP-REG-06", "BP-REG-09").check()


@case(
    "TC_BP_LIFE_BI_02",
    "A refused second registration changes nothing of the first ({variant})",
    requirements="BP-REG-02",
    stimulus="a client registers with mode {variant}; then the same identifier with other values in every parameter",
    expect="ALREADY-REGISTERED; the client behaves as registered first",
    window=10,
    variants=each_mode(*_OBSERVED, since=V1_1),
)
def refused_duplicate(bench: Bench, mode: str) -> None:
    with BPClient(bench, mode, size=24, entries=2, name="the first") as client:
        other = BPClient(bench, DROPHEAD if mode != DROPHEAD else DROPTAIL, size=9, entries=4, several=True)
        bench.expect_status(
            ALREADY_REGISTERED, REGISTER, "BP-REG-02", **{**other.registration, "protId": client.prot_id}
        )
        _Registered(client, "BP-REG-02").check()


# -- while BP is inactive ----------------------------------------------------------------------------------------------


@case(
    "TC_BP_LIFE_BO_01",
    "Inactive BP processes the requests of its clients as active BP does",
    requirements="BP-MGT-04",
    stimulus=(
        "while BP is inactive, for a client of each mode: registrations that are refused and one that is not; payloads "
        "that are too large, empty, and one more than is kept; BP-ClearBuffer and the payloads again; another client "
        "registers, submits and deregisters; then BP-MGMT-Activate, and a beacon with a block for each of them"
    ),
    expect=(
        "the same statuses, list and numbers as while BP is active; afterwards the payloads that each mode keeps, and "
        "indications of all blocks except that of the client that has deregistered"
    ),
    window=16,
    needs=Needs(V1_2, entities=(), ut=_SWITCHED),
)
def while_inactive(bench: Bench) -> None:
    gone = BPClient(bench, DROPTAIL, size=24, entries=3)
    with ExitStack() as stack:
        with bench.services.deactivated("BP"):
            # A beacon that was sent before may still be in transit.
            bench.wait(0.2)
            start = bench.mark()
            clients = [BPClient(bench, mode, size=24, entries=3) for mode in (DROPTAIL, DROPHEAD, ONCE, REPEAT)]
            kept = []
            for client in clients:
                stack.callback(bench.call, DEREGISTER, protId=client.prot_id)
                expected = _Registered(client, "BP-MGT-04")
                kept.append((expected, _serve(bench, client, expected)))
            with gone:
                gone.transmit(gone.payload())
            bench.expect_status(UNKNOWN_PROTOCOL, QUERY, "BP-MGT-04", "BP-DRG-02", protId=gone.prot_id)
            bench.wait(1)
        for expected, payloads in kept:
            expected.check_sent(payloads, start)
        if no_indication(bench) is None:
            until(bench, lambda: all(indications(bench, TRANSMITTED, each.prot_id) for each in clients))
            told = [client for client in clients if indications(bench, TRANSMITTED, client.prot_id)]
            untold = [each.registration["queueingMode"] for each in clients if each not in told]
            bench.complete(untold, "indications of the payloads that were sent", "BP-MGT-04")
        bench.none(gone.sent(start), "no payload of the deregistered client", "BP-MGT-04 BP-DRG-03")
        blocks = [Block(each.prot_id, b"for %d" % place) for place, each in enumerate((gone, *clients))]
        for _ in range(2):
            # A beacon may be lost.
            bench.peer().send(*blocks)
            if until(bench, lambda: all(client.received() for client in clients)):
                break
        deaf = [client.registration["queueingMode"] for client in clients if not client.received()]
        bench.complete(deaf, "indications to the clients registered while BP was inactive", "BP-MGT-04 BP-REG-06")
        bench.none(gone.received(), "no indication to the deregistered client", "BP-MGT-04 BP-DRG-04")


def _serve(bench: Bench, client: BPClient, expected: _Registered) -> list[bytes]:
    """Make all requests of a client while BP is inactive; return the payloads that were submitted last."""
    prot_id = client.prot_id
    for requirement, wrong, status in (_REFUSED["size-0"], _REFUSED["size-too-large"]):
        bench.expect_status(
            status, REGISTER, "BP-MGT-04", *requirement.split(), **{**client.registration, **wrong(client)}
        )
    bench.expect_status(OK, REGISTER, "BP-MGT-04", **client.registration)
    expected.check_entry()
    expected.check_refused()
    expected.check_numbers(expected.submitted()[1])
    bench.expect_status(
        ALREADY_REGISTERED, REGISTER, "BP-MGT-04", "BP-REG-02", **{**client.registration, "maxEntries": 2}
    )
    if no_confirm(bench) is None:
        bench.expect_status(EMPTY, TRANSMIT, "BP-MGT-04", "BP-TXP-03", protId=prot_id, payload="")
    bench.answered(client.number(), expected.places, "buffered payloads after an empty one", "BP-MGT-04 BP-TXP-03")
    bench.expect_status(OK, CLEAR, "BP-MGT-04", "BP-CLR-02", "BP-CLR-03", protId=prot_id)
    bench.answered(client.number(), 0, "buffered payloads after BP-ClearBuffer", "BP-MGT-04 BP-CLR-02 BP-CLR-03")
    payloads, numbers = expected.submitted()
    expected.check_numbers(numbers)
    return payloads


@case(
    "TC_BP_LIFE_BO_02",
    "State reports received while BP is inactive are discarded",
    requirements="BP-MGT-03 BP-RX-13",
    stimulus="a record of a neighbour while BP is inactive; after activation a record of another neighbour",
    expect="no entry of the first, an entry of the second",
    window=8,
    needs=Needs(V1_2, entities=("srp",), ut=("SRP-NeighbourTable", ACTIVATE, DEACTIVATE)),
)
def reports_while_inactive(bench: Bench) -> None:
    early, late = bench.peer(), bench.peer()
    with bench.services.deactivated("BP"):
        early.send(bench.records.report(early.node_id, 1))
        bench.wait(max(1.5, bench.session.known.processing))
    late.send(bench.records.report(late.node_id, 1))
    bench.some(until_neighbour(bench, late.node_id), "an entry of the second neighbour", "BP-MGT-05")
    bench.none(until_neighbour(bench, early.node_id) and [early.node_id], "no entry of the first neighbour")


_SETTINGS: dict[str, tuple[str, Callable[[int], int]]] = {
    "period": (PERIOD, lambda old: 3 * old),
    "packet-size": (SIZE, lambda old: old - 7),
    "network": (NETWORK, lambda old: old ^ 0x0102),
}


@case(
    "TC_BP_LIFE_BO_03",
    "A parameter set while BP is inactive is used after activation ({variant})",
    requirements="BP-MGT-04 BP-PAR-02 BP-PAR-11",
    stimulus="a client repeats a payload; while BP is inactive BP-SetParameter ({variant}); BP-MGMT-Activate",
    expect=(
        "beacons at three times the period; the size of the largest payload that can be registered; the new network in "
        "beacons"
    ),
    window=30,
    variants={
        name: Variant(
            value,
            needs=Needs(
                V2_0 if name == "network" else V1_2,
                entities=(),
                ut=(*CLIENT, SET, ACTIVATE, DEACTIVATE),
                header=("networkId",) if name == "network" else (),
            ),
        )
        for name, value in _SETTINGS.items()
    },
)
def set_while_inactive(bench: Bench, setting: tuple[str, Callable[[int], int]]) -> None:
    name, changed = setting
    new = changed(bench.sut.bound(name) if name == SIZE else bench.sut.parameter(name))
    with BPClient(bench, REPEAT, size=8) as client, ExitStack() as stack:
        client.put_on_air(size=8)
        largest = largest_payload(bench)
        with bench.services.deactivated("BP"):
            stack.enter_context(parameters_set(bench, "BP", **{name: new}))
        if name == SIZE:
            other = BPClient(bench, ONCE)
            bench.expect_status(ILLEGAL_SIZE, REGISTER, **{**other.registration, "maxPayloadSize": largest - 6})
            bench.expect_status(OK, REGISTER, **{**other.registration, "maxPayloadSize": largest - 7})
            bench.call(DEREGISTER, protId=other.prot_id)
            return
        bench.wait(0.2)
        start = bench.mark()
        bench.wait(9 if name == PERIOD else 2)
        frames = client.frames(start)
        needed(bench, frames, "beacons after the activation")
        if name == PERIOD:
            bench.within(len(frames), 1, 6, "beacons in 9 former periods", late="below", frames=frames[:12])
        else:
            found = [
                each.beacon.bp.network_id for each in frames if each.beacon is not None and each.beacon.bp is not None
            ]
            bench.every(found, lambda each: each == new, f"networkId {new} in beacons", "BP-HDR-04", "BP-PAR-02")


@case(
    "TC_BP_LIFE_TI_01",
    "Payloads are kept however long they wait for a beacon",
    requirements="BP-QM-03 BP-QM-04 BP-QM-05 BP-MGT-04",
    stimulus=f"clients with a queue and each of the buffers submit payloads while BP is inactive for {_WAIT} ms",
    expect="the same number of buffered payloads at the end; afterwards each payload is sent",
    window=40,
    needs=Needs(V1_2, entities=(), ut=(*CLIENT, QUERY, ACTIVATE, DEACTIVATE)),
    long=True,
)
def long_wait(bench: Bench) -> None:
    with ExitStack() as stack:
        clients = [stack.enter_context(BPClient(bench, mode, entries=2)) for mode in (DROPTAIL, ONCE, REPEAT)]
        with bench.services.deactivated("BP"):
            bench.wait(0.2)
            start = bench.mark()
            payloads = {client.prot_id: client.payload() for client in clients}
            for client in clients:
                client.transmit(payloads[client.prot_id])
            bench.waiting.wait_ns(_WAIT * MS)
            numbers = [client.number() for client in clients]
        bench.answered(numbers, [1, 1, 1], "buffered payloads of each client")
        for client in clients:
            payload = payloads[client.prot_id]
            if payload not in client.sent(start):
                client.until_sent(payload)
            bench.some(payload in client.sent(start), f"the payload of mode {client.registration['queueingMode']}")


# -- parameters that change while payloads wait ------------------------------------------------------------------------


@case(
    "TC_BP_LIFE_BV_02",
    "Buffered payloads that do not fit after BPPAR_MAXIMUM_PACKET_SIZE was lowered stay buffered",
    requirements="BP-TX-04 BP-PAR-02 BP-TXP-02 BP-PAR-11",
    stimulus=(
        "a client of each mode submits a payload of the largest size; the packet size is lowered by half of it while "
        "BP is inactive, and BP is active for four periods; then the packet size is as before"
    ),
    expect="not sent, and one buffered payload; a further payload as large is accepted; afterwards they are sent",
    window=20,
    needs=Needs(V1_2, entities=(), ut=(*_SWITCHED, SET), when=areas_of_fixed_size),
)
def lowered(bench: Bench) -> None:
    size = bench.sut.bound(SIZE)
    large = min(largest_payload(bench), 400)
    with ExitStack() as registered:
        modes = (DROPTAIL, DROPHEAD, ONCE, REPEAT)
        clients = [registered.enter_context(BPClient(bench, mode, size=large, entries=2)) for mode in modes]
        kept: list[tuple[BPClient, list[bytes]]] = []
        with ExitStack() as stack:
            with bench.services.deactivated("BP"):
                bench.wait(0.2)
                start = bench.mark()
                for client in clients:
                    kept.append((client, [client.payload(large)]))
                    client.transmit(kept[-1][1][0])
                stack.enter_context(parameters_set(bench, "BP", **{SIZE: size - largest_payload(bench) + large // 2}))
            bench.wait(4)
            for client, payloads in kept:
                bench.none(client.frames(start), "no beacon with a payload that does not fit", "BP-TX-04 BP-FMT-02")
                bench.answered(client.number(), 1, "buffered payloads", "BP-TX-04", "BP-PAR-02")
                payloads.append(client.payload(large))
                answer = client.transmit(payloads[1], must=False)
                if no_confirm(bench) is None:
                    bench.services.check_status(answer, (OK,), TRANSMIT, "BP-TXP-02", "BP-PAR-11")
        for client, payloads in kept:
            if client.registration["queueingMode"] in (ONCE, REPEAT):
                del payloads[0]
            bench.until(lambda _, client=client, wanted=payloads: set(wanted) <= set(client.sent(start)), 24)  # type: ignore[misc]
            left = [each.hex()[:8] for each in payloads if each not in client.sent(start)]
            mode = client.registration["queueingMode"]
            bench.complete(
                left, f"the payloads of mode {mode} after the packet size was restored", "BP-TX-04", "BP-PAR-02"
            )
