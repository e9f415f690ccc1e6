"""dcp-srp.md: The Neighbour Table; The Sequence Number; Service SRP-UpdateSafetyData.

State that must not change: entries of other neighbours, the table while BP is inactive, and sequence numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dcp_spec.constants import SRP_SEQNO_MODULUS, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.suite.srp.soft_state import brief_timeout
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import CLEAR, DEREGISTER, QUERY, UNKNOWN_PROTOCOL, unused_protocol_id
from dcp_conformance.test_steps.confirm_times import check_confirm_time
from dcp_conformance.test_steps.services import neighbours, numeric_data, safety_data, until_neighbour
from dcp_conformance.test_steps.state_reports import Reporter
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

_TABLE = Needs(ut=("SRP-NeighbourTable",), entities=("srp",))
_UPDATE = "SRP-UpdateSafetyData"
_SWITCHES = ("BP-MGMT-Deactivate", "BP-MGMT-Activate")
V1_2 = SpecVersion.V1_2

#: Fields of an entry that the specification names, without the time of reception.
_FIELDS = ("sData", "tStamp", "seqno")


def _last_expires(bench: Bench) -> None:
    """Let the only entry of the neighbour table expire."""
    with brief_timeout(bench) as length:
        peer = bench.peer()
        peer.send(bench.records.report(peer.node_id, 1))
        bench.waiting.wait_ns(round(1.5 * length + bench.sut.pixit.timer_tolerance_ms) * MS)


def _hears(bench: Bench, node_id: bytes | None) -> None:
    """Send the implementation a record with a high sequence number; None: that of a neighbour."""
    peer = bench.peer()
    peer.send(bench.records.report(node_id or peer.node_id, 0x1234))
    bench.wait(1)


def _heard_of(bench: Bench, peers: list[Peer]) -> dict[bytes, dict[str, Any]]:
    """Return the entries of peers after all of them exist; inconclusive if one is not created."""
    entries = {peer.node_id: until_neighbour(bench, peer.node_id) for peer in peers}
    found = {node_id: entry for node_id, entry in entries.items() if entry is not None}
    if len(found) < len(peers):
        bench.inconclusive("entries of all neighbours, which this case needs", f"{len(found)}")
    return found


@case(
    "TC_SRP_NT_BV_16",
    "Each entry has the fields of its own record, and a record changes no other entry",
    requirements="SRP-RX-03 SRP-NT-01 SRP-NT-02",
    stimulus="records of three neighbours that differ in every field; then a second record of one of them",
    expect=(
        "three entries with their own sData, tStamp, seqno and nodeId; only one of them changes with the second record"
    ),
    needs=_TABLE,
)
def own_entries(bench: Bench) -> None:
    peers = [bench.peer() for _ in range(3)]
    values = [numeric_data(bench, number) for number in (1, 2, 3)]
    reports = [
        bench.records.report(peer.node_id, 1000 * number, **data)
        for number, (peer, data) in enumerate(zip(peers, values, strict=True), 1)
    ]
    begun = bench.now()
    for peer, report in zip(peers, reports, strict=True):
        peer.send(report)
    first = _heard_of(bench, peers)
    for peer, report, data in zip(peers, reports, values, strict=True):
        entry = first[peer.node_id]
        observed = ({name: entry.get("sData", {}).get(name) for name in data}, entry.get("tStamp"), entry.get("seqno"))
        bench.answered(observed, (data, report.t_stamp, report.seqno), "sData, tStamp and seqno")
    bench.wait(0.5)
    peers[1].send(bench.records.report(peers[1].node_id, 2001, **values[0]))
    # A single query: entries time out while a slow upper tester answers.
    bench.wait(1)
    second = {node_id: entries[0] for node_id, entries in neighbours(bench).items()}
    for place in (0, 2):
        was, is_now = first[peers[place].node_id], second.get(peers[place].node_id)
        if is_now is None and bench.now() - begun > bench.sut.parameter("SRPPAR_NEIGHBOUR_TABLE_TIMEOUT") * MS * 3 // 4:
            bench.verdicts.not_applicable("the calls of this case take longer than the neighbour table timeout")
        is_now = is_now or {}
        same = all(is_now.get(name) == was.get(name) for name in (*_FIELDS, "receptionTime"))
        bench.proved(same, f"{was}, as before", is_now, "SRP-RX-03")


@case(
    "TC_SRP_NT_BO_01",
    "Deactivation and activation of BP do not change the neighbour table",
    requirements="SRP-RX-03 SRP-RUN-02",
    stimulus="records of two neighbours; BP-MGMT-Deactivate, then immediately BP-MGMT-Activate",
    expect="both entries as before",
    needs=Needs(since=V1_2, ut=("SRP-NeighbourTable", *_SWITCHES), entities=("srp",)),
)
def table_across_activation(bench: Bench) -> None:
    peers = [bench.peer() for _ in range(2)]
    for number, peer in enumerate(peers):
        peer.send(bench.records.report(peer.node_id, number + 7))
    before, begun = _heard_of(bench, peers), bench.now()
    with bench.services.deactivated("BP"):
        during = neighbours(bench)
    after = neighbours(bench)
    if bench.now() - begun > bench.sut.parameter("SRPPAR_NEIGHBOUR_TABLE_TIMEOUT") * MS * 3 // 4:
        bench.verdicts.not_applicable("the calls of this case take longer than the neighbour table timeout")
    for node_id, entry in before.items():
        for when, table in (("while BP is inactive", during), ("afterwards", after)):
            is_now = table.get(node_id, [{}])[0]
            same = all(is_now.get(name) == entry.get(name) for name in (*_FIELDS, "receptionTime"))
            bench.proved(same, f"the entry unchanged {when}", is_now or "no entry")


@case(
    "TC_SRP_SEQ_BO_01",
    "Sequence numbers count submissions while BP is inactive, and only the newest record is sent",
    requirements="SRP-SEQ-01 SRP-TYP-07 SRP-SRV-03",
    stimulus="a submission of safety data; two more while BP is inactive; BP-MGMT-Activate",
    expect="the record of the last submission in a beacon, with a sequence number larger by two",
    window=8,
    needs=Needs(since=V1_2, ut=(_UPDATE, *_SWITCHES), entities=("srp",)),
)
def numbers_across_activation(bench: Bench) -> None:
    reporter = Reporter(bench)
    first = reporter.sent("SRP-SRV-03")
    with bench.services.deactivated("BP"):
        # A beacon sent before the deactivation may still be in transit to the tester.
        bench.wait(0.2)
        start = bench.mark()
        reporter.submit()
        values = reporter.submit()
    last = reporter.awaited(values, "SRP-SRV-03")
    reporter.check_grown(first, last, "SRP-SEQ-01")
    old = [
        heard
        for heard in bench.heard[start:]
        if heard.report is not None and reporter.is_own(heard) and heard.report.seqno == (last.report.seqno - 1)
    ]
    if last.values == values:
        bench.none(old, "only the newest record", "SRP-TYP-07")


@case(
    "TC_SRP_SEQ_BO_02",
    "Sequence numbers continue, whatever the node receives ({variant})",
    requirements="SRP-SEQ-01 SRP-TYP-06",
    alone="it needs an empty neighbour table",
    stimulus="a submission of safety data; {variant}; a second submission",
    expect="a second record whose sequence number is larger by one",
    window=60,
    needs=Needs(ut=(_UPDATE,), entities=("srp",)),
    variants={
        "the-last-neighbour-expires": _last_expires,
        "a-record-of-its-own": lambda bench: _hears(bench, bench.identifiers.sut_id),
        "a-record-of-a-neighbour": lambda bench: _hears(bench, None),
    },
)
def numbers_continue(bench: Bench, happens: Callable[[Bench], None]) -> None:
    reporter = Reporter(bench)
    first = reporter.sent("SRP-SRV-03")
    happens(bench)
    reporter.check_grown(first, reporter.sent("SRP-SRV-03"))


@case(
    "TC_SRP_RX_BV_10",
    "Each record in a beacon is processed",
    requirements="SRP-RX-03 BP-RX-07",
    stimulus="beacons with two SRP payloads: the record of the sender and that of another node, in either order",
    expect="entries of both nodes",
    needs=_TABLE,
)
def two_records(bench: Bench) -> None:
    for turned in (False, True):
        peers = [bench.peer(), bench.peer()]
        blocks = [bench.builder.srp(bench.records.report(each.node_id, 7)) for each in peers]
        for _ in range(2):
            # A beacon may be lost.
            peers[0].send(*(reversed(blocks) if turned else blocks))
            missing = [each for each in peers if until_neighbour(bench, each.node_id) is None]
            if not missing:
                break
        bench.complete([each.node_id.hex(":") for each in missing], "entries of both nodes")


@case(
    "TC_SRP_SEQ_BO_03",
    "A deactivation and activation of BP repeats no report that was sent",
    requirements="SRP-SRV-04 SRP-INI-03",
    stimulus="a submission of safety data; after its beacon BP-MGMT-Deactivate and BP-MGMT-Activate",
    expect="no further beacon with this record",
    window=10,
    needs=Needs(since=SpecVersion.V1_3, ut=(_UPDATE, *_SWITCHES), entities=("srp",)),
)
def not_repeated(bench: Bench) -> None:
    reporter = Reporter(bench)
    first = reporter.sent("SRP-SRV-03")
    with bench.services.deactivated("BP"):
        # A beacon sent before the deactivation may still be in transit to the tester.
        bench.wait(1)
        start = bench.mark()
    bench.wait(4)
    again = [
        heard for heard in bench.heard[start:] if heard.report is not None and heard.report.seqno == first.report.seqno
    ]
    bench.none(again, "no further beacon with the record", "SRP-SRV-04")


@case(
    "TC_SRP_RX_BV_12",
    "A neighbour may have any identifier ({variant})",
    requirements="SRP-RX-03 DATA-04",
    stimulus="a record whose nodeId is {variant}",
    expect="an entry of this node",
    needs=_TABLE,
    variants={"all-zeros": 0x00, "all-ones-but-one": 0xFE, "as-text": 0x41},
)
def any_identifier(bench: Bench, octet: int) -> None:
    if bench.profile.types.node_id.representation == "text":
        bench.verdicts.not_applicable(f"the identifiers of the profile {bench.profile.name} are texts")
    peer, width = bench.peer(), len(bench.identifiers.sut_id)
    node_id = bytes([octet] * width)
    for _ in range(2):
        # A beacon may be lost.
        peer.send(bench.records.report(node_id, 1))
        if until_neighbour(bench, node_id) is not None:
            break
    bench.some(until_neighbour(bench, node_id), f"an entry of {node_id.hex(':')}", seen="no such entry")


@case(
    "TC_SRP_SRV_TI_01",
    "Confirms of SRP-UpdateSafetyData are immediate and do not wait for a beacon",
    requirements="SRP-SRV-05",
    stimulus=(
        "seven submissions of safety data, each timed along with a query of parameters or neighbour table, if available"
    ),
    expect="a median time to the confirm of less than half a beacon period",
    needs=Needs(since=SpecVersion.V1_1, ut=(_UPDATE,), entities=("srp",)),
)
def immediate(bench: Bench) -> None:
    questions = [each for each in ("SRP-GetParameters", "SRP-NeighbourTable") if each in bench.services.upper.methods]
    delays, others = [], [0]
    for number in range(7):
        start = bench.now()
        bench.must(_UPDATE, sData=safety_data(bench, number))
        delays.append(bench.now() - start)
        for method in questions[:1]:
            start = bench.now()
            bench.call(method)
            others.append(bench.now() - start)
    check_confirm_time(bench, delays, others)


@case(
    "TC_SRP_RX_BV_07",
    "A neighbour's sequence number may have any value ({variant})",
    requirements="SRP-RX-03 SRP-TYP-01",
    stimulus="a record with sequence number {variant}",
    expect="an entry with this sequence number",
    needs=_TABLE,
    variants={
        "0": 0,
        "255": 255,
        "256": 256,
        "65535": 0xFFFF,
        "2147483648": 1 << 31,
        "4294967295": SRP_SEQNO_MODULUS - 1,
    },
)
def any_number(bench: Bench, seqno: int) -> None:
    if seqno >= 1 << (8 * bench.profile.types.srp_seqno.width):
        bench.verdicts.not_applicable(f"in the profile {bench.profile.name} the sequence number has fewer octets")
    peer = bench.peer()
    peer.send(bench.records.report(peer.node_id, seqno))
    entry = bench.required(until_neighbour(bench, peer.node_id), "an entry of the neighbour", "SRP-RX-03")
    bench.answered(entry.get("seqno"), seqno, "seqno")


def _refused(method: str, since: SpecVersion = SpecVersion.V1_0) -> Needs:
    return Needs(since=since, ut=(_UPDATE, method), entities=("srp",))


@case(
    "TC_SRP_SRV_BO_03",
    "A BP request for an unknown protocol does not remove a report that waits ({variant})",
    requirements="SRP-SRV-04",
    stimulus="between two beacons, safety data are submitted and {variant} is requested for an unregistered protocol",
    expect="a beacon with the report",
    window=12,
    variants={
        CLEAR: Variant(CLEAR, requirements="BP-CLR-01 SRP-SRV-04", needs=_refused(CLEAR, SpecVersion.V1_1)),
        DEREGISTER: Variant(DEREGISTER, requirements="BP-DRG-01 SRP-SRV-04", needs=_refused(DEREGISTER)),
        QUERY: Variant(QUERY, requirements="BP-QRY-01 SRP-SRV-04", needs=_refused(QUERY)),
    },
)
def refused(bench: Bench, method: str) -> None:
    if bench.session.slow_call > bench.period // 2:
        bench.verdicts.not_applicable("a call of this implementation takes longer than half of a beacon period")
    reporter, prot_id = Reporter(bench), unused_protocol_id(bench)

    def act() -> dict[str, Any]:
        values = reporter.submit()
        bench.expect_status(UNKNOWN_PROTOCOL, method, protId=prot_id)
        return values

    values = between_beacons(bench, f"safety data and {method}", act, reporter.is_own, flush=3)
    reporter.awaited(values, insist=False)
    bench.passed("a beacon with the report")
