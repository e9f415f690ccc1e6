"""dcp-architecture.md: Beaconing Protocol, State Reporting Protocol and Variable Dissemination Protocol.

An event in one of the protocols, or of one of its clients, changes no state of the others.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.suite.bp.services.parameters import NETWORK, SET, SIZE
from dcp_conformance.suite.srp.soft_state import TIMEOUT, brief_timeout, lifetime
from dcp_conformance.test_steps.bp_clients import CLEAR, CLIENT, QUERY, REPEAT, BPClient
from dcp_conformance.test_steps.services import neighbours, parameters_set, teach_variable, until_neighbour
from dcp_conformance.test_steps.state_reports import Reporter
from dcp_conformance.test_steps.variable_queries import ask
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

_CREATE, _DELETE = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES
_TABLE, _UPDATE = "SRP-NeighbourTable", "SRP-UpdateSafetyData"
_EVERY = (*CLIENT, QUERY, _TABLE, _UPDATE)
_REPETITIONS = 4


def _client_goes(bench: Bench, _: Peer) -> None:
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        if CLEAR in bench.services.upper.methods:
            bench.must(CLEAR, protId=client.prot_id)
        client.transmit(client.payload())


def _vardis_pauses(bench: Bench, _: Peer) -> None:
    with bench.services.deactivated("VD"):
        pass


def _bp_pauses(bench: Bench, _: Peer) -> None:
    with bench.services.deactivated("BP"):
        bench.wait(0.2)


def _set(name: str, changed: Callable[[int], int]) -> Callable[[Bench, Peer], None]:
    def act(bench: Bench, _: Peer) -> None:
        with parameters_set(bench, "BP", **{name: changed(bench.sut.parameter(name))}):
            pass

    return act


def _deletes(bench: Bench, peer: Peer) -> None:
    peer.send(peer.delete(teach_variable(bench, peer)))
    bench.wait(1.5)


def _needs(*methods: str, since: SpecVersion = SpecVersion.V1_0, header: tuple[str, ...] = ()) -> Needs:
    return Needs(since, ut=(*_EVERY, *methods), entities=("srp", "vardis"), header=header)


_EVENTS: dict[str, tuple[Callable[[Bench, Peer], None], str, Needs]] = {
    "a-client-goes": (_client_goes, "BP-DRG-02 BP-CLR-03", _needs()),
    "a-variable-is-deleted": (_deletes, "VD-PD-04", _needs()),
    "VarDis-pauses": (
        _vardis_pauses,
        "VD-MGT-05",
        _needs("VD-MGMT-Activate", "VD-MGMT-Deactivate", since=SpecVersion.V1_2),
    ),
    "BP-pauses": (
        _bp_pauses,
        "BP-MGT-04 BP-MGT-05",
        _needs("BP-MGMT-Activate", "BP-MGMT-Deactivate", since=SpecVersion.V1_2),
    ),
    "the-network-changes": (
        _set(NETWORK, lambda old: old ^ 0x0102),
        "BP-PAR-02",
        _needs(SET, since=SpecVersion.V2_0, header=("networkId",)),
    ),
    "the-packet-size-changes": (_set(SIZE, lambda old: old - 7), "BP-PAR-02", _needs(SET)),
}


@case(
    "TC_DCP_KEEP_BO_01",
    "An event in one protocol changes nothing in the others ({variant})",
    requirements="VD-PC-07",
    stimulus=(
        "a variable, a state report of a neighbour, a client that repeats a payload; while a VarCreate is repeated and "
        "safety data wait for a beacon: {variant}"
    ),
    expect=(
        "the variable is known with its value; the entry of the neighbour is as before; the VarCreate is in repCnt "
        "beacons, the report is sent, and the payload of the client is kept"
    ),
    window=16,
    variants={
        name: Variant(act, requirements=f"VD-PC-07 VD-PC-09 SRP-NT-01 SRP-SRV-03 BP-QM-05 {requirements}", needs=needs)
        for name, (act, requirements, needs) in _EVENTS.items()
    },
)
def kept(bench: Bench, act: Callable[[Bench, Peer], None]) -> None:
    own = bench.case.requirements[5:]
    with ExitStack() as stack:
        client = stack.enter_context(BPClient(bench, REPEAT))
        payload, peer, reporter = client.payload(), bench.peer(), Reporter(bench)
        client.transmit(payload)
        known = teach_variable(bench, peer, value=b"known", seqno=5)
        begun = bench.now()
        peer.send(bench.records.report(peer.node_id, 7))
        before = until_neighbour(bench, peer.node_id, 7)
        name, count, start = bench.var_id(), bench.sut.rep_cnt(_REPETITIONS), bench.mark()
        peer.send(peer.create(name, rep_cnt=count))
        # Other cases decide whether it is forwarded at all.
        if bench.until_instruction(_CREATE, name, 2 * bench.sut.reaction) is None:
            bench.inconclusive("a forwarded VarCreate, which this case needs", "none in time")
        submitted, values = bench.mark(), reporter.submit()
        act(bench, peer)
        after = neighbours(bench).get(peer.node_id)
        if bench.now() - begun < bench.sut.parameter(TIMEOUT) * MS * 3 // 4:
            same = before is None or _fields(after[0] if after else {}) == _fields(before)
            bench.proved(same, "the entry of the neighbour, as before", after or "no entry", "SRP-NT-01", *own)
        if not any(heard.report and reporter.is_own(heard) for heard in bench.heard[submitted:]):
            reporter.awaited(values, "SRP-SRV-03", *own)
        bench.passed("a beacon with the safety data", "SRP-SRV-03")
        # Beacons may have room for the payloads of one protocol only.
        bench.answered(client.number(), 1, "buffered payloads of the client, as before", "BP-QM-05", *own)
        bench.every(client.sent(start), payload, "the payload unchanged", "BP-QM-05", *own)
        # A deactivation of VarDis may cancel the repetitions (X37).
        if "VD-MGMT-Deactivate" not in bench.case.needs.ut:
            bench.check_repeated(_CREATE, name, count, start, "VD-PC-09", *own)
    # The client may have taken the room of VarDis.
    held = ask(bench, known).record
    value = held and (held.upd.value, held.upd.seqno)
    bench.equal(value, (bench.records.value(b"known"), 5), "the variable with its value", "VD-PC-07", *own)


def _fields(entry: dict[str, Any]) -> list[object]:
    return [entry.get(name) for name in ("sData", "tStamp", "seqno", "receptionTime")]


@case(
    "TC_DCP_KEEP_BO_02",
    "The expiry of a neighbour's entry changes nothing of its variables",
    requirements="VD-SCR-02 SRP-RUN-02",
    alone="it shortens the timeout of neighbours",
    stimulus="a state report and a VarCreate without timeout of a neighbour; then none until its entry is removed",
    expect="no VarDelete of the variable, which is known with its value",
    window=45,
    needs=Needs(SpecVersion.V2_0, ut=(_TABLE,), entities=("srp", "vardis")),
)
def variables_of_the_silent(bench: Bench) -> None:
    with brief_timeout(bench) as length:
        peer, start = bench.peer(), bench.mark()
        name, begun = teach_variable(bench, peer, value=b"kept"), bench.now()
        peer.send(bench.records.report(peer.node_id, 1))
        until_neighbour(bench, peer.node_id)
        lifetime(bench, [peer], begun, length * MS)
        held = ask(bench, name).record
        bench.equal(held and held.upd.value, bench.records.value(b"kept"), "the variable with its value", "VD-SCR-02")
        bench.none(bench.instructions(_DELETE, name, start), "no VarDelete of the variable", "VD-SCR-02")
