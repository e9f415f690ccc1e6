"""dcp-bp.md: Other BP Management Services; Initialization, Runtime and Shutdown."""

from __future__ import annotations

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.test_steps.bp_clients import (
    ACTIVATE,
    CLEAR,
    CLIENT,
    DEACTIVATE,
    DEREGISTER,
    EMPTY,
    LIST,
    OK,
    ONCE,
    QUERY,
    REGISTER,
    REPEAT,
    TRANSMIT,
    UNKNOWN_PROTOCOL,
    BPClient,
    registered,
    until,
)
from dcp_conformance.test_system.bench import Bench

V1_2 = SpecVersion.V1_2
_SWITCHES = Needs(since=V1_2, entities=(), ut=(*CLIENT, ACTIVATE, DEACTIVATE))


# -- BP-MGMT-Deactivate, BP-MGMT-Activate ------------------------------------------------------------------------------


@case(
    "TC_BP_MGT_BV_01",
    "Deactivated BP sends nothing, and continues when it is activated",
    requirements="BP-MGT-01 BP-MGT-02 BP-MGT-05 BP-TX-07",
    stimulus="a client repeats a payload; BP-MGMT-Deactivate; five periods later BP-MGMT-Activate",
    expect="BP-STATUS-OK both times; silence, then beacons with the same payload",
    needs=_SWITCHES,
    window=12,
)
def switched_off(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        payload = client.put_on_air("beacons before the deactivation")
        bench.expect_status(OK, DEACTIVATE, "BP-MGT-01")
        # A beacon sent before the deactivation may still be in transit to the tester.
        quiet_from = bench.now() + bench.period // 5
        try:
            bench.wait(5)
            bench.none([heard for heard in bench.heard if heard.time >= quiet_from], "silence", "BP-MGT-02 BP-TX-07")
        finally:
            bench.expect_status(OK, ACTIVATE, "BP-MGT-05")
        bench.some(client.until_sent(payload), "beacons with the payload after activation", "BP-MGT-05")


@case(
    "TC_BP_MGT_BV_02",
    "Beacons received while BP is inactive are discarded",
    requirements="BP-MGT-03 BP-RX-13",
    stimulus="while BP is inactive, a block for a client and the summary of an unknown variable; then BP-MGMT-Activate",
    expect="no indication and no request, not even after activation; beacons received after activation are processed",
    needs=Needs(since=V1_2, ut=(REGISTER, DEREGISTER, ACTIVATE, DEACTIVATE)),
    window=10,
)
def deaf(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        peer, var_id, early, late = bench.peer(), bench.unknown_id(), b"while inactive", b"while active"
        with bench.services.deactivated("BP"):
            peer.send(Block(client.prot_id, early), peer.summary(var_id, 1))
            bench.wait(max(1.5, bench.session.known.processing))
        peer.send(Block(client.prot_id, late))
        until(bench, lambda: late in client.received())
        bench.require_alive("a time of inactivity", "BP-MGT-05")
        received = client.received()
        bench.some(late in received, "an indication of the payload received after activation", "BP-MGT-05")
        bench.proved(
            early not in received, "no indication of the payload received while BP was inactive", "an indication of it"
        )
        asked = bench.instructions(ICType.REQUEST_VARCREATES, var_id)
        bench.none(asked, "no request for the variable received while BP was inactive")


@case(
    "TC_BP_MGT_BO_01",
    "Deactivated BP still serves its clients",
    requirements="BP-MGT-04 BP-TXP-09",
    stimulus="while BP is inactive: register, list, submit, query, clear, deregister; requests that must be rejected",
    expect="the same answers as while BP is active; the submitted payload is sent after activation",
    needs=Needs(since=V1_2, entities=(), ut=(*CLIENT, LIST, QUERY, CLEAR, ACTIVATE, DEACTIVATE)),
    window=8,
)
def serves_while_inactive(bench: Bench) -> None:
    client = BPClient(bench, ONCE)
    prot_id, payload = client.prot_id, client.payload()
    with bench.services.deactivated("BP"):
        bench.expect_status(UNKNOWN_PROTOCOL, QUERY, "BP-MGT-04", protId=prot_id)
        bench.expect_status(OK, REGISTER, "BP-MGT-04", **client.registration)
        bench.proved(prot_id in registered(bench), "the client in the list", "not in the list", "BP-MGT-04")
        if bench.sut.pics.transmit_payload_confirm is not False:
            bench.expect_status(EMPTY, TRANSMIT, "BP-MGT-04", protId=prot_id, payload="")
        for number, method, params in (
            (1, TRANSMIT, {"payload": payload.hex()}),
            (0, CLEAR, {}),
            (1, TRANSMIT, {"payload": payload.hex()}),
        ):
            if method != TRANSMIT or bench.sut.pics.transmit_payload_confirm is not False:
                bench.expect_status(OK, method, "BP-MGT-04 BP-TXP-09", protId=prot_id, **params)
            else:
                bench.call(method, protId=prot_id, **params)
            bench.answered(client.number(), number, f"buffered payloads after {method}", "BP-MGT-04")
        bench.wait(2)
        bench.none(
            client.sent(), "no payload sent while BP is inactive", "BP-MGT-02 BP-TXP-09", seen="the payload was sent"
        )
    bench.some(client.until_sent(payload), "the payload is sent after activation", "BP-MGT-04")
    bench.expect_status(OK, DEREGISTER, "BP-MGT-04", protId=prot_id)


@case(
    "TC_BP_MGT_BO_02",
    "Activating active BP and deactivating inactive BP have no effect",
    requirements="BP-MGT-01 BP-MGT-05",
    stimulus="BP-MGMT-Activate while BP is active; BP-MGMT-Deactivate twice; BP-MGMT-Activate once",
    expect="BP-STATUS-OK each time; BP is active at the end",
    needs=_SWITCHES,
)
def switched_twice(bench: Bench) -> None:
    bench.expect_status(OK, ACTIVATE, "BP-MGT-05")
    try:
        bench.expect_status(OK, DEACTIVATE, "BP-MGT-01")
        bench.expect_status(OK, DEACTIVATE, "BP-MGT-01")
    finally:
        bench.expect_status(OK, ACTIVATE, "BP-MGT-05")
    with BPClient(bench, ONCE) as client:
        client.transmit(client.payload())
        bench.some(
            client.until_sent(), "BP is active and sends a payload", "BP-MGT-05", seen="a payload is not sent in time"
        )


@case(
    "TC_BP_MGT_BO_04",
    "Repeated activation of active BP does not delay its beacons",
    requirements="BP-MGT-05 BP-TX-01",
    stimulus="a client repeats a payload; BP-MGMT-Activate five times per period for eight periods",
    expect="beacons with the payload continue",
    needs=_SWITCHES,
    window=12,
)
def activated_again_and_again(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.put_on_air("beacons before the first activation")
        since = bench.now()
        # A slow upper tester calls less often, which only makes the test easier.
        while bench.now() < since + 8 * bench.period:
            bench.must(ACTIVATE)
            bench.wait(0.2)
        count = len(client.frames(after=since))
        bench.some(count >= 4, "at least 4 beacons in 8 periods", seen=count)


@case(
    "TC_BP_MGT_BV_04",
    "BP serves its other clients while VarDis is inactive",
    requirements="BP-TX-01 BP-RX-08",
    stimulus="a client repeats a payload; VD-MGMT-Deactivate; six periods later a beacon with a block for the client",
    expect="beacons with the payload while VarDis is inactive, and an indication of the block",
    needs=Needs(since=V1_2, ut=(*CLIENT, "VD-MGMT-Activate", "VD-MGMT-Deactivate")),
    window=12,
)
def without_vardis(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client:
        client.put_on_air("beacons before the deactivation")
        with bench.services.deactivated("VD"):
            since = bench.now()
            bench.wait(6)
            count = len(client.frames(after=since))
            bench.some(count >= 3, "at least 3 beacons in 6 periods", "BP-TX-01", seen=count)
            octets = bytes(range(9))
            bench.peer().send(Block(client.prot_id, octets))
            bench.some(octets in client.until_received(), "an indication of the block", "BP-RX-08")


# -- initialization ----------------------------------------------------------------------------------------------------


@case(
    "TC_BP_INI_BV_03",
    "After its start BP has no clients other than SRP and VarDis",
    requirements="BP-INI-01",
    stimulus="a client registers; UT-Reset; BP-ListRegisteredProtocols",
    expect="no registered protocols other than SRP and VarDis",
    needs=Needs(entities=(), ut=(REGISTER, LIST, "UT-Reset")),
)
def no_clients(bench: Bench) -> None:
    client = BPClient(bench, ONCE)
    bench.must(REGISTER, **client.registration)
    bench.must("UT-Reset")
    bench.none(set(registered(bench)) - {BP_PROTID_SRP, BP_PROTID_VARDIS}, "no protocols other than SRP and VarDis")


@case(
    "TC_BP_INI_BV_04",
    "BP is active after its start",
    requirements="BP-INI-03",
    stimulus="BP-MGMT-Deactivate, UT-Reset; a client submits a payload",
    expect="a beacon with the payload, without BP-MGMT-Activate",
    needs=Needs(since=V1_2, entities=(), ut=(*CLIENT, DEACTIVATE, "UT-Reset")),
)
def active_after_start(bench: Bench) -> None:
    bench.must(DEACTIVATE)
    bench.must("UT-Reset")
    with BPClient(bench, ONCE) as client:
        client.transmit(client.payload())
        bench.some(client.until_sent(), "a beacon with the payload")
