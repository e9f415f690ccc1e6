"""dcp-bp.md: Service Interface; Other BP Management Services.

State that must not change: the registration, payloads and list entry of a client while other clients and services act.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.frames.builder import Block
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
    LIST,
    ONCE,
    QUERY,
    REGISTER,
    REPEAT,
    TRANSMIT,
    TRANSMITTED,
    BPClient,
    indications,
    listed,
    needed,
    no_confirm,
    registered,
    until,
    unused_protocol_id,
    wait_for_notifications,
)
from dcp_conformance.test_steps.confirm_times import check_confirm_time
from dcp_conformance.test_system.bench import MS, Bench

from .indications import no_indication

V1_0, V1_1, V1_2 = SpecVersion.V1_0, SpecVersion.V1_1, SpecVersion.V1_2


# -- what others do ----------------------------------------------------------------------------------------------------


def _another(bench: Bench, *, cleared: bool = False) -> None:
    """Let a second client register, submit a payload and deregister."""
    with BPClient(bench, REPEAT) as other:
        other.transmit(other.payload())
        if cleared:
            bench.must(CLEAR, protId=other.prot_id)


def _paused(bench: Bench, _: BPClient) -> None:
    with bench.services.deactivated("BP"):
        bench.wait(0.2)


def _second_registration(bench: Bench, client: BPClient) -> None:
    changes = {"maxPayloadSize": 30, "queueingMode": str(ONCE), "name": "second", "maxEntries": 9}
    bench.expect_status(ALREADY_REGISTERED, REGISTER, "BP-REG-02", **{**client.registration, **changes})


def _received(bench: Bench, client: BPClient) -> None:
    bench.peer().send(Block(client.prot_id, b"received"))
    until(bench, lambda: b"received" in client.received())


_Event = Callable[[Bench, BPClient], object]
#: Events with their requirements, the version that has them, and the methods that they need.
_EVENTS: dict[str, tuple[str, _Event, SpecVersion, tuple[str, ...]]] = {
    "registered-again": ("BP-REG-02", _second_registration, V1_0, ()),
    "another-came-and-went": ("BP-DRG-02", lambda bench, _: _another(bench), V1_0, ()),
    "another-was-cleared": ("BP-CLR-03", lambda bench, _: _another(bench, cleared=True), V1_1, (CLEAR,)),
    "unknown-was-deregistered": (
        "BP-DRG-01",
        lambda bench, _: bench.call(DEREGISTER, protId=unused_protocol_id(bench)),
        V1_0,
        (),
    ),
    "too-large-was-refused": (
        "BP-TXP-02",
        lambda bench, client: bench.call(TRANSMIT, protId=client.prot_id, payload=bytes(65).hex()),
        V1_0,
        (),
    ),
    "was-listed": ("BP-LST-01 BP-LST-03", lambda bench, _: bench.must(LIST), V1_0, ()),
    "has-received": ("BP-RXP-01", _received, V1_0, ()),
    "was-paused": ("BP-MGT-05", _paused, V1_2, (ACTIVATE, DEACTIVATE)),
}


@case(
    "TC_BP_KEEP_BO_01",
    "Registration and buffered payloads of a client do not change (event: {variant})",
    requirements="BP-REG-02",
    stimulus="a client repeats a payload; then the event {variant}, of this or another client",
    expect="the list entry and the number of payloads as before; beacons with the payload continue",
    window=8,
    variants={
        name: Variant(
            act,
            requirements=f"BP-REG-06 BP-QM-05 {requirements}",
            needs=Needs(since, entities=(), ut=(*CLIENT, LIST, QUERY, *methods)),
        )
        for name, (requirements, act, since, methods) in _EVENTS.items()
    },
)
def kept(bench: Bench, act: _Event) -> None:
    own = bench.case.requirements[2:]
    with BPClient(bench, REPEAT, name="first") as client:
        payload = client.payload()
        client.transmit(payload)
        needed(bench, client.until_sent(payload), "a beacon with the payload")
        before, number = client.fields(), client.number()
        act(bench, client)
        after, now = client.fields(), client.number()
        bench.answered(after, before, "the list entry, as before", *own, "BP-REG-06")
        bench.answered(now, number, "buffered payloads, as before", *own, "BP-QM-05")
        start = bench.mark()
        bench.some(client.until_sent(), "further beacons with the payload", *own, "BP-QM-05")
        bench.every(client.sent(start), payload, "the payload unchanged", *own, "BP-QM-05")


@case(
    "TC_BP_LST_BV_02",
    "The list reports the registered values of each client, and they do not change",
    requirements="BP-LST-01 BP-LST-03 BP-REG-06",
    stimulus=(
        "three registrations that differ in every parameter, half a beacon period apart; "
        "BP-ListRegisteredProtocols at once and again after payloads were sent"
    ),
    expect="for each client the registered values and the time of registration, both times",
    needs=Needs(entities=(), ut=(*CLIENT, LIST)),
)
def own_fields(bench: Bench) -> None:
    both = bench.features.allow_multiple_payloads
    queue = DROPTAIL if both else QueueingMode.QUEUE
    # The resolution of registration times is up to the implementation.
    pause = max(bench.period // 2, 50 * MS)
    clients = [
        BPClient(bench, ONCE, size=11, entries=2, name="one"),
        BPClient(bench, queue, size=22, entries=3, several=True, name="the second"),
        BPClient(bench, DROPHEAD if both else REPEAT, size=60, entries=200, name="3"),
    ]
    with clients[0]:
        bench.waiting.wait_ns(pause)
        with clients[1]:
            bench.waiting.wait_ns(pause)
            with clients[2]:
                first = registered(bench)
                _check_fields(bench, clients, first)
                for client in clients:
                    client.transmit(client.payload(9))
                needed(bench, clients[1].until_sent(), "a beacon with a payload")
                second = registered(bench)
    for client in clients:
        was, is_now = first.get(client.prot_id), second.get(client.prot_id)
        named = {name: (was or {}).get(name) for name in ("timeStampRegistration", *client.listing())}
        same = all((is_now or {}).get(name) == value for name, value in named.items())
        bench.proved(same, f"{named}, as before", f"{is_now}", "BP-LST-01 BP-LST-03")


def _check_fields(bench: Bench, clients: list[BPClient], entries: dict[int, dict[str, Any]]) -> None:
    stamps = []
    for client in clients:
        entry = entries.get(client.prot_id) or {}
        stamps.append(entry.get("timeStampRegistration"))
        for name, right in client.listing().items():
            bench.answered(entry.get(name), right, name, "BP-LST-01 BP-LST-03")
    # The clock may be set in between, so only the difference of the times is checked.
    good = None not in stamps and len(set(stamps)) == len(clients)
    bench.proved(good, "a different registration time for each client", stamps, "BP-REG-06 BP-LST-01 BP-LST-03")


# -- queues of one place, several payloads at once ---------------------------------------------------------------------


@case(
    "TC_BP_QM_BV_14",
    "A queue of one entry keeps the payload that its mode determines ({variant})",
    requirements="BP-QM-01",
    stimulus="between two beacons, a client with mode {variant} and maxEntries 1 submits A and B; later C",
    expect="A (DROPTAIL) or B (DROPHEAD), then C, each once; one buffered payload after each submission",
    window=8,
    variants={
        "droptail": Variant(DROPTAIL, requirements="BP-QM-01 BP-QRY-02 BP-QM-03"),
        "drophead": Variant(DROPHEAD, requirements="BP-QM-02 BP-QRY-02 BP-QM-03"),
    },
    needs=Needs(V1_1, entities=(), ut=(*CLIENT, QUERY)),
)
def one_place(bench: Bench, mode: QueueingMode) -> None:
    dropping = bench.case.requirements[0]
    with BPClient(bench, mode, entries=1) as client:

        def act() -> tuple[list[bytes], list[int | None]]:
            payloads, numbers = [client.payload() for _ in range(3)], []
            for payload in payloads[:2]:
                client.transmit(payload, must=False)
                numbers.append(client.number())
            return payloads, numbers

        start = bench.mark()
        payloads, numbers = between_beacons(bench, "submission of two payloads", act, client.in_frame)
        bench.answered(numbers, [1, 1], "buffered payloads after each submission", "BP-QRY-02")
        bench.until_quiet(client.in_frame, since=start)
        client.transmit(payloads[2], must=False)
        client.until_sent(payloads[2])
        bench.wait(1)
        sent = [each for each in client.sent(start) if each in payloads]
        right = [payloads[0 if mode is DROPTAIL else 1], payloads[2]]
        what = f"payloads {listed(right, payloads)}"
        bench.in_order(sent, right, what, f"{dropping} BP-QM-03", seen=listed(sent, payloads))


@case(
    "TC_BP_PTI_BV_03",
    "A client with several payloads in a beacon gets indications for them",
    requirements="BP-PTI-01",
    stimulus="between two beacons, a client that allows several payloads in a beacon submits four",
    expect="an indication for each payload, or for each beacon with payloads of the client (X44)",
    window=8,
    needs=Needs(V1_1, entities=(), ut=CLIENT, when=no_indication),
)
def told_of_several(bench: Bench) -> None:
    with BPClient(bench, DROPTAIL, entries=4, several=True) as client:
        # Indications from an attempt that a beacon interrupted do not count.
        start = told = 0

        def act() -> None:
            nonlocal start, told
            start, told = bench.mark(), len(indications(bench, TRANSMITTED, client.prot_id))
            client.transmit_new(4)

        between_beacons(bench, "submission of four payloads", act, client.in_frame)
        bench.until_quiet(client.in_frame, since=start)
        wait_for_notifications(bench)
        frames, payloads = client.frames(start), len(client.sent(start))
        needed(bench, frames, "beacons with the payloads")
        count = len(indications(bench, TRANSMITTED, client.prot_id)) - told
        # One for each beacon is permitted, too.
        right = count if count == len(frames) else payloads
        if bench.repeated(count, right, "indications", frames=frames) and payloads != len(frames):
            bench.reading("X44", "per-payload" if count == payloads else "per-beacon")


# -- confirms ----------------------------------------------------------------------------------------------------------


@case(
    "TC_BP_REG_BI_06",
    "The confirm of a rejected registration also contains the node's own identifier",
    requirements="BP-REG-13",
    stimulus="BP-RegisterProtocol twice with the same identifier, and once with maxPayloadSize 0",
    expect="the same ownNodeIdentifier in all three confirms",
    needs=Needs(V1_1, entities=(), ut=(REGISTER, DEREGISTER)),
)
def identifier_of_refused(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        told = client.answer.result.get("ownNodeIdentifier")
        if told is None:
            bench.inconclusive(
                "a confirm of BP-RegisterProtocol with ownNodeIdentifier", "the confirm has none (BP-REG-07)"
            )
        other = BPClient(bench, ONCE)
        for answer in (client.register(), other.register(maxPayloadSize=0)):
            bench.services.require_asked(answer, "a confirm of BP-RegisterProtocol")
            if answer.ok:
                bench.inconclusive("a rejected registration", f"{answer}")
            bench.answered(answer.result.get("ownNodeIdentifier"), told, "ownNodeIdentifier")


_IMMEDIATE = {
    "deregister": (DEREGISTER, "BP-DRG-06"),
    "transmit": (TRANSMIT, "BP-TXP-14"),
    "clear": (CLEAR, "BP-CLR-05"),
    "query": (QUERY, "BP-QRY-04"),
}


@case(
    "TC_BP_GEN_TI_01",
    "Confirms are immediate and do not wait for a beacon ({variant})",
    requirements="BP-DRG-06",
    stimulus="seven requests of the service for a client, each timed along with a registration",
    expect="a median time to the confirm of less than half a beacon period",
    variants={
        name: Variant(
            method,
            requirements=requirement,
            needs=Needs(V1_1, entities=(), ut=(*CLIENT, method), when=no_confirm if method == TRANSMIT else None),
        )
        for name, (method, requirement) in _IMMEDIATE.items()
    },
)
def immediate(bench: Bench, method: str) -> None:
    delays, others = [], []
    for _ in range(7):
        client = BPClient(bench, REPEAT)
        params = {"protId": client.prot_id} | ({"payload": client.payload().hex()} if method == TRANSMIT else {})
        start = bench.now()
        bench.must(REGISTER, **client.registration)
        others.append(bench.now() - start)
        try:
            start = bench.now()
            # A rejected request might be confirmed without being processed.
            bench.must(method, **params)
            delays.append(bench.now() - start)
        finally:
            if method != DEREGISTER:
                bench.call(DEREGISTER, protId=client.prot_id)
    check_confirm_time(bench, delays, others)


# -- activation --------------------------------------------------------------------------------------------------------


@case(
    "TC_BP_MGT_TI_01",
    "Beacons omitted while BP is inactive are not sent after activation",
    requirements="BP-MGT-05 BP-TX-01",
    stimulus="a client repeats a payload for eight periods; BP is inactive for ten periods, then active for eight",
    expect="in the last eight periods at most four beacons more than twice the number in the first eight",
    window=28,
    needs=Needs(V1_2, entities=(), ut=(*CLIENT, ACTIVATE, DEACTIVATE)),
)
def no_arrears(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.put_on_air()
        before = len(bench.wait(8))
        with bench.services.deactivated("BP"):
            bench.wait(10)
            start = bench.mark()
        bench.wait(8)
        count, most = len(bench.heard) - start, 2 * before + 4
        bench.proved(count <= most, f"at most {most} beacons in 8 periods ({before} before the inactive time)", count)


@case(
    "TC_BP_MGT_BV_14",
    "Deactivation and activation of BP do not change queues and buffers",
    requirements="BP-MGT-04 BP-MGT-05 BP-QM-03 BP-QM-04 BP-QM-05 BP-QM-07",
    stimulus=(
        "after a beacon, a client of each mode submits a payload and BP is deactivated; a client with a queue submits "
        "two more; BP-MGMT-Activate"
    ),
    expect="each payload in a beacon, those of the queue in order and each once",
    window=10,
    needs=Needs(V1_2, entities=(), ut=(*CLIENT, QUERY, ACTIVATE, DEACTIVATE)),
)
def queue_across_activation(bench: Bench) -> None:
    with ExitStack() as stack:
        clients = [stack.enter_context(BPClient(bench, mode, entries=3)) for mode in (DROPTAIL, DROPHEAD, ONCE, REPEAT)]
        queue, repeating = clients[0], clients[-1]
        repeating.transmit(repeating.payload())
        repeating.until_sent()
        start = bench.mark()
        waiting = [(client, client.payload()) for client in clients]
        for client, payload in waiting:
            client.transmit(payload)
        with bench.services.deactivated("BP"):
            bench.wait(0.2)
            early = len(queue.sent(start))
            told = len(indications(bench, TRANSMITTED, queue.prot_id))
            payloads = [waiting[0][1], queue.payload(), queue.payload()]
            for payload in payloads[1:]:
                queue.transmit(payload)
            bench.answered(queue.number(), 3 - early, "buffered payloads", "BP-MGT-04")
            bench.answered(
                len(indications(bench, TRANSMITTED, queue.prot_id)) - told,
                0,
                "indications of a transmission while BP is inactive",
                "BP-MGT-04",
            )
        # Others may have their turns in between.
        bench.until(lambda _: set(payloads) <= set(queue.sent(start)), 24)
        bench.until_quiet(queue.in_frame, since=start)
        sent = [each for each in queue.sent(start) if each in payloads]
        bench.in_order(sent, payloads, "payloads A, B, C", "BP-MGT-05 BP-QM-03", seen=listed(sent, payloads))
        several = [each for each in queue.frames(start) if len(queue.in_frame(each)) > 1]
        bench.none(several, "at most one payload of the client in each beacon", "BP-MGT-05 BP-QM-07", frames=several)
        bench.until(lambda _: all(payload in client.sent(start) for client, payload in waiting), 24)
        lost = [client.registration["queueingMode"] for client, payload in waiting if payload not in client.sent(start)]
        bench.complete(lost, "the payloads that waited at the deactivation", "BP-MGT-04 BP-QM-03 BP-QM-04 BP-QM-05")
