"""dcp-bp.md: Registration and De-Registration of Client Protocols.

Effects of deregistration, and the list of registered clients.
"""

from __future__ import annotations

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.test_steps.bp_clients import (
    CLIENT,
    DEREGISTER,
    LIST,
    LISTED,
    OK,
    ONCE,
    QUERY,
    REGISTER,
    REPEAT,
    TRANSMIT,
    UNKNOWN_PROTOCOL,
    BPClient,
    each_mode,
    needed,
    queue_mode,
    registered,
)
from dcp_conformance.test_system.bench import Bench

V1_1 = SpecVersion.V1_1
_REGISTRATION = Needs(entities=(), ut=(REGISTER, DEREGISTER))


@case(
    "TC_BP_DRG_BV_01",
    "A deregistered client is removed from the list",
    requirements="BP-DRG-02",
    stimulus="BP-RegisterProtocol, BP-DeregisterProtocol, BP-ListRegisteredProtocols, with a payload buffered",
    expect="BP-STATUS-OK; no entry in the list; its buffered payloads can no longer be queried",
    needs=Needs(entities=(), ut=(*CLIENT, LIST, QUERY)),
)
def deregister(bench: Bench) -> None:
    client = BPClient(bench, REPEAT)
    bench.must(REGISTER, **client.registration)
    client.transmit(client.payload())
    bench.expect_status(OK, DEREGISTER, protId=client.prot_id)
    bench.none(client.entry(), "no entry for the client")
    bench.expect_status(UNKNOWN_PROTOCOL, QUERY, protId=client.prot_id)


@case(
    "TC_BP_DRG_BO_01",
    "BP-DeregisterProtocol rejects an identifier that is not registered",
    requirements="BP-DRG-01",
    stimulus="BP-DeregisterProtocol for an identifier never registered, then twice for a registered one",
    expect="BP-STATUS-UNKNOWN-PROTOCOL, BP-STATUS-OK, BP-STATUS-UNKNOWN-PROTOCOL",
    needs=_REGISTRATION,
)
def deregister_unknown(bench: Bench) -> None:
    client = BPClient(bench, ONCE)
    bench.expect_status(UNKNOWN_PROTOCOL, DEREGISTER, protId=client.prot_id)
    bench.must(REGISTER, **client.registration)
    bench.must(DEREGISTER, protId=client.prot_id)
    bench.expect_status(UNKNOWN_PROTOCOL, DEREGISTER, protId=client.prot_id)


@case(
    "TC_BP_DRG_BV_02",
    "After deregistration no payload of the client is sent ({variant})",
    requirements="BP-DRG-03",
    stimulus="a client with mode {variant} submits payloads and deregisters when the first is sent",
    expect="no beacon with a payload of the client",
    variants=each_mode(*CLIENT),
)
def silent_after_deregistration(bench: Bench, mode: QueueingMode) -> None:
    client = BPClient(bench, mode, entries=4)
    bench.must(REGISTER, **client.registration)
    if mode is not ONCE:
        client.transmit(client.payload())
    client.transmit_new(4 if mode.is_queue else 1)
    if mode is not ONCE:
        needed(bench, client.until_sent(), "beacons with a payload of the client")
    bench.must(DEREGISTER, protId=client.prot_id)
    # A beacon sent before the deregistration may still be in transit to the tester.
    quiet_from = bench.now() + bench.period // 5
    bench.wait(4)
    client.check_silent(quiet_from)


@case(
    "TC_BP_DRG_BV_03",
    "A client that registers again has no buffered payloads ({variant})",
    requirements="BP-DRG-05 BP-REG-06",
    stimulus="a client with mode {variant} submits payloads, deregisters and registers again at once",
    expect="no buffered payload, and none is sent",
    variants=each_mode(*CLIENT, QUERY),
)
def registers_again(bench: Bench, mode: QueueingMode) -> None:
    client = BPClient(bench, mode)
    bench.must(REGISTER, **client.registration)
    client.transmit_new(3 if mode.is_queue else 1)
    bench.must(DEREGISTER, protId=client.prot_id)
    quiet_from = bench.now() + bench.period // 5
    with client:
        bench.answered(client.number(), 0, "buffered payloads")
        bench.wait(3)
        client.check_silent(quiet_from)


@case(
    "TC_BP_LST_BV_01",
    "All registered clients are listed, without their buffered payloads",
    requirements="BP-LST-01 BP-LST-02 BP-LST-03 BP-LST-04",
    stimulus="three registrations with one payload each; BP-ListRegisteredProtocols",
    expect="BP-STATUS-OK, each client once, and from 1.1 on no payload",
    needs=Needs(entities=(), ut=(*CLIENT, LIST)),
)
def list_clients(bench: Bench) -> None:
    modes = (ONCE, REPEAT, queue_mode(bench))
    with BPClient(bench, modes[0]) as one, BPClient(bench, modes[1]) as two, BPClient(bench, modes[2]) as three:
        clients = (one, two, three)
        payloads = [client.payload(24) for client in clients]
        for client, payload in zip(clients, payloads, strict=True):
            client.transmit(payload)
        answer = bench.expect_status(OK, LIST, "BP-LST-01 BP-LST-03")
        listed = [each.get("protocolId") for each in answer.result.get("protocols") or [] if isinstance(each, dict)]
        for client in clients:
            count = listed.count(client.prot_id)
            bench.answered(count, 1, f"entries of client {client.prot_id:#x}", "BP-LST-01 BP-LST-03")
        text = str(answer.result).lower()
        shown = [payload.hex() for payload in payloads if payload.hex() in text]
        # In 1.0 the list holds complete client records, with the buffered payloads.
        if bench.profile.spec_version >= V1_1:
            bench.none(shown, "no buffered payload in the list", "BP-LST-04")
        entries = [each for each in answer.result.get("protocols") or [] if isinstance(each, dict)]
        further = sorted({name for each in entries for name in each} - LISTED)
        bench.info("Which additional fields does the list of clients have?", ", ".join(further) or "none", "BP-LST-02")


@case(
    "TC_BP_REC_BV_01",
    "A client that returns can deregister its old registration and register again",
    requirements="BP-REC-01",
    stimulus=(
        "a client registers, submits a payload and disconnects; another connection deregisters and registers the "
        "same identifier"
    ),
    expect="both calls succeed; the case reports whether the registration outlives the connection",
    needs=Needs(since=V1_1, entities=(), ut=(*CLIENT, LIST)),
)
def comes_back(bench: Bench) -> None:
    other = bench.services.upper.another()
    client = BPClient(bench, REPEAT)
    if other is None:
        bench.info("Can a restarted client register again?", "unknown: the upper tester has only one connection")
        return
    try:
        bench.services.call_on(other, REGISTER, **client.registration)
        bench.services.call_on(other, TRANSMIT, protId=client.prot_id, payload=client.payload().hex())
    finally:
        other.close()
    bench.wait(0.5)
    kept = client.prot_id in registered(bench)
    bench.info("Does a registration outlive the connection of its client?", "yes" if kept else "no")
    bench.call(DEREGISTER, protId=client.prot_id)
    answer = client.register()
    bench.call(DEREGISTER, protId=client.prot_id)
    bench.info("Can a restarted client register again?", "yes" if answer.ok else str(answer))
