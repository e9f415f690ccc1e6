"""dcp-srp.md: Runtime; Receive Path; The Neighbour Table: many entries, further lives of an entry, other timeouts."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

from dcp_spec.constants import BP_PROTID_SRP, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.suite.srp.soft_state import TIMEOUT, brief_timeout, entered, lifetime
from dcp_conformance.test_steps.bp_clients import talking
from dcp_conformance.test_steps.pacing import paced
from dcp_conformance.test_steps.services import (
    binary_identifiers,
    nanoseconds,
    neighbour,
    neighbours,
    parameters_set,
    reported_safety_data,
    timed,
    until_neighbour,
)
from dcp_conformance.test_steps.state_reports import Reporter, Sent
from dcp_conformance.test_steps.time_stamps import Stamps, check_apart
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

_TABLE = Needs(ut=("SRP-NeighbourTable",), entities=("srp",))
_SET = Needs(ut=("SRP-NeighbourTable", "SRP-SetParameter"), entities=("srp",))
_UPDATE = "SRP-UpdateSafetyData"
_SWITCHES = ("BP-MGMT-Deactivate", "BP-MGMT-Activate")
#: Neighbours of a crowd, and the fewest that are one.
_CROWD, _FEWEST = 64, 12
_DAMAGED, _BURST = 12, 90
_SIXTEEN_BITS = 1 << 16


# -- timeouts ----------------------------------------------------------------------------------------------------------


@case(
    "TC_SRP_NT_TI_06",
    "Of many entries exactly those are removed whose neighbours are silent",
    requirements="SRP-RUN-02 SRP-RX-03",
    stimulus="records of 64 neighbours (or as many as the profile allows); every second of them repeats its record",
    expect="the entries of the others are removed in time, all at about the same time; those that repeat stay",
    window=60,
    needs=_TABLE,
    alone="it shortens the timeout of neighbours",
)
def crowd(bench: Bench) -> None:
    most = min(_CROWD, bench.sut.capacity("neighbours") or _CROWD)
    if most < _FEWEST:
        bench.verdicts.not_applicable(f"the implementation stores at most {most} neighbours")
    # Beacons show that the implementation is not held up.
    with talking(bench), brief_timeout(bench) as length:
        peers = [bench.peer() for _ in range(most)]
        lively, silent = peers[::2], peers[1::2]
        numbers, steps = itertools.count(2), itertools.count(1)
        _report(bench, lively, 1)
        begun = bench.now()
        _report(bench, silent, 1)
        # Nothing about the removal follows from entries whose records were lost.
        for peer in peers[-2:]:
            until_neighbour(bench, peer.node_id)

        def renew() -> None:
            if next(steps) % 5 == 0:
                _report(bench, lively, next(numbers))

        lifetime(bench, silent, begun, length * MS, renew)
        _report(bench, lively, next(numbers))
        # A beacon period may be longer than the timeout.
        bench.waiting.wait_ns(min(round(bench.period), length * MS // 4))
        table = neighbours(bench)
        gone = [peer.node_id for peer in lively if peer.node_id not in table]
        bench.complete(gone, "the entries of the neighbours that repeat their records")


def _report(bench: Bench, peers: Iterable[Peer], seqno: int) -> None:
    for peer in peers:
        peer.send(bench.records.report(peer.node_id, seqno))


_TIMEOUTS: dict[str, tuple[int, ...]] = {"lowered": (3000, 400), "raised": (400, 900)}


@case(
    "TC_SRP_NT_TI_07",
    "The timeout in force decides, also about entries made before it was set ({variant})",
    requirements="SRP-RUN-02 SRP-PAR-01",
    stimulus="a record with another SRPPAR_NEIGHBOUR_TABLE_TIMEOUT; while it is in the table the timeout is {variant}",
    expect="the entry remains for the last timeout since the reception of the record, and is removed in time",
    window=30,
    needs=_SET,
    variants=_TIMEOUTS,
)
def changed_timeout(bench: Bench, values: tuple[int, ...]) -> None:
    first, *others = (round(each * bench.session.timing_scale) for each in values)
    with parameters_set(bench, "SRP", **{TIMEOUT: first}):
        peer, begun = entered(bench)
        for value in others:
            bench.must("SRP-SetParameter", name=TIMEOUT, value=value)
        lifetime(bench, [peer], begun, others[-1] * MS)


@case(
    "TC_SRP_NT_TI_08",
    "A long timeout applies ({variant} ms)",
    requirements="SRP-RUN-02 SRP-PAR-01",
    stimulus="SRPPAR_NEIGHBOUR_TABLE_TIMEOUT = {variant} ms; one record",
    expect="the entry remains for this time and is removed in time",
    window=800,
    needs=_SET,
    long=True,
    variants={"20000": 20_000, "40000": 40_000},
)
def long_timeout(bench: Bench, milliseconds: int) -> None:
    with parameters_set(bench, "SRP", **{TIMEOUT: milliseconds}):
        peer, begun = entered(bench)
        lifetime(bench, [peer], begun, milliseconds * MS)


# -- entries -----------------------------------------------------------------------------------------------------------


@case(
    "TC_SRP_RX_BO_02",
    "A neighbour whose entry was removed is entered again with its next record, and removed again ({variant})",
    requirements="SRP-RX-03 SRP-RUN-01 SRP-RUN-02",
    stimulus="records of two neighbours; after their entries were removed a record of each, seqno {variant}",
    expect="entries with the new records, which are removed in time, too",
    window=90,
    needs=_TABLE,
    variants={"lower": 3},
    alone="it shortens the timeout of neighbours",
)
def entered_again(bench: Bench, seqno: int) -> None:
    with brief_timeout(bench) as length:
        peers = [bench.peer() for _ in range(2)]
        begun = bench.now()
        _report(bench, peers, 50)
        for peer in peers:
            until_neighbour(bench, peer.node_id)
        lifetime(bench, peers, begun, length * MS)
        begun = bench.now()
        _report(bench, peers, seqno)
        entries = [until_neighbour(bench, peer.node_id) or {} for peer in peers]
        for entry in entries:
            bench.equal(entry.get("seqno"), seqno, "seqno of the entry", "SRP-RX-03 SRP-RUN-02")
        # With slow calls the entries may have been removed before they are watched.
        if all(entries) and bench.now() - begun < length * MS // 2:
            lifetime(bench, peers, begun, length * MS)


@case(
    "TC_SRP_RX_BV_08",
    "Neighbours whose identifiers differ in one octet have their own entries (octet {variant})",
    requirements="SRP-RX-05 SRP-NT-01 DATA-04",
    stimulus="records of two nodes whose identifiers differ in octet {variant} only, and of one as close to the node",
    expect="an entry of each with its own record",
    window=8,
    needs=Needs(ut=("SRP-NeighbourTable",), entities=("srp",), when=binary_identifiers),
    variants={f"{place}": place for place in range(6)},
)
def alike(bench: Bench, place: int) -> None:
    if bench.session.sut_id is None:
        bench.probes.probe()
    peer, own = bench.peer(), bench.identifiers.sut_id
    if place >= len(own):
        bench.verdicts.not_applicable(f"node identifiers have {len(own)} octets")
    names = [peer.node_id, _other(peer.node_id, place), _other(own, place)]
    for number, name in enumerate(names):
        peer.send(bench.records.report(name, 7 + number))
    for number, name in enumerate(names):
        entry = until_neighbour(bench, name) or {}
        bench.equal(entry.get("seqno"), 7 + number, f"seqno in the entry of {name.hex(':')}")


def _other(name: bytes, place: int) -> bytes:
    """Return an identifier that differs in one octet."""
    return name[:place] + bytes([name[place] ^ 0x5A]) + name[place + 1 :]


@case(
    "TC_SRP_RX_BV_09",
    "A record replaces the stored one however far its sequence number is ahead",
    requirements="SRP-RX-03",
    stimulus="records of a neighbour with seqno 5, 20,005, 70,000 and 2,000,000,000",
    expect="an entry with each of them in turn",
    window=10,
    needs=_TABLE,
)
def far_ahead(bench: Bench) -> None:
    peer, octets = bench.peer(), bench.profile.types.srp_seqno.width
    former = None
    for seqno in (5, 20_005, 70_000, 2_000_000_000):
        if seqno < 1 << (8 * octets):
            _report(bench, [peer], seqno)
            until_neighbour(bench, peer.node_id, seqno)
            shown = (neighbour(bench, peer.node_id) or {}).get("seqno")
            if shown == former:
                # The new record may be lost.
                bench.some(False, f"an entry with seqno {seqno}", seen=shown)
            else:
                bench.equal(shown, seqno, "seqno of the entry")
            former = seqno


@case(
    "TC_SRP_RX_BO_01",
    f"A record is stored after {_DAMAGED} payloads of wrong length from the same node",
    requirements="SRP-RX-03 SRP-RX-01",
    stimulus=f"{_DAMAGED} truncated records of a neighbour; then a valid one",
    expect="an entry with the valid record",
    window=8,
    needs=_TABLE,
)
def after_damage(bench: Bench) -> None:
    peer = bench.peer()
    octets = bench.builder.srp(bench.records.report(peer.node_id, 1)).octets
    for _ in paced(bench, range(_DAMAGED)):
        peer.send(Block(BP_PROTID_SRP, octets[:-1]))
    _report(bench, [peer], 2)
    entry = until_neighbour(bench, peer.node_id) or {}
    bench.equal(entry.get("seqno"), 2, "seqno of the entry")


@case(
    "TC_SRP_RX_BO_03",
    "Records are stored while an own report waits for a beacon",
    requirements="SRP-RX-03",
    stimulus="three times: SRP-UpdateSafetyData, and at once a record of a new neighbour",
    expect="an entry of each neighbour",
    window=10,
    needs=Needs(ut=("SRP-NeighbourTable", _UPDATE), entities=("srp",)),
)
def while_waiting(bench: Bench) -> None:
    reporter = Reporter(bench)
    for _ in range(3):
        peer = bench.peer()
        reporter.submit()
        _report(bench, [peer], 1)
        bench.some(until_neighbour(bench, peer.node_id), "an entry of the neighbour")


# -- own reports -------------------------------------------------------------------------------------------------------


@case(
    "TC_SRP_REC_TI_02",
    "A report has the tStamp of its own submission ({variant})",
    requirements="SRP-TYP-05",
    stimulus="safety data are submitted; five periods later others, or the same again ({variant})",
    expect="a report whose tStamp is later by the time between the submissions",
    window=30,
    variants={
        "replaces-a-waiting-one": Variant(
            True, needs=Needs(SpecVersion.V1_2, ut=(_UPDATE, *_SWITCHES), entities=("srp",))
        ),
        "the-same-data": Variant(False, needs=Needs(ut=(_UPDATE,), entities=("srp",))),
    },
)
def own_stamp(bench: Bench, waits: bool) -> None:
    reporter = Reporter(bench)

    def measure() -> Stamps:
        first = reporter.sent("SRP-SRV-03")
        if waits:
            with bench.services.deactivated("BP"):
                reporter.submit()
                bench.wait(5)
                values = reporter.submit()
            second = reporter.awaited(values, "SRP-SRV-03")
            later, moment = second.report, second.moment
        else:
            bench.wait(5)
            found, left = None, _BURST
            # An application may replace the data before a beacon is sent.
            while found is None and left:
                moment, left = timed(bench, _UPDATE, sData=first.values), left - 1
                reporter.noted(first.values, moment)
                # In mode REPEAT the report before is sent again until then.
                found = bench.until(lambda heard: heard.report if _is_later(bench, heard, first) else None, 1 / 16)
            if found is None:
                reporter.lost("a report with the next sequence number", "SRP-SRV-03")
            later = found
        stamps = [nanoseconds(bench, each.t_stamp) for each in (first.report, later)]
        return Stamps(stamps[0], stamps[1], (first.moment, moment))

    check_apart(bench, "tStamp", measure)


def _is_later(bench: Bench, heard: ReceivedBeacon, first: Sent) -> bool:
    """Return whether a beacon has a report with the same data and another sequence number."""
    report = heard.report
    same = report is not None and reported_safety_data(bench, report) == first.values
    return report is not None and same and report.seqno != first.report.seqno


@case(
    "TC_SRP_SEQ_TI_01",
    "Reports are counted with 32 bits",
    requirements="SRP-SEQ-01 SRP-TYP-01",
    stimulus="65,537 submissions of safety data between two reports",
    expect="a sequence number larger by the number of submissions",
    window=600,
    needs=Needs(ut=(_UPDATE,), entities=("srp",)),
    long=True,
)
def counts_far(bench: Bench) -> None:
    if bench.profile.types.srp_seqno.width < 4:
        bench.verdicts.not_applicable(f"in the profile {bench.profile.name} the sequence number has fewer octets")
    reporter = Reporter(bench)
    first = reporter.sent("SRP-SRV-03")
    reporter.fill(_SIXTEEN_BITS)
    reporter.check_grown(first, reporter.sent("SRP-SRV-03"), "SRP-SEQ-01", "SRP-TYP-01")
