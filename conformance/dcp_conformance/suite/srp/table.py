"""dcp-srp.md: Receive Path and The Neighbour Table.

To prove that a record was ignored, it must not enter the table, and a record of another node sent after it must.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from dcp_spec.constants import BP_PROTID_SRP

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.test_steps.services import neighbour, neighbours, numeric_data, rows, safety_data, until_neighbour
from dcp_conformance.test_steps.time_stamps import check_later
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

_TABLE = Needs(ut=("SRP-NeighbourTable",), entities=("srp",))


def _require_reception(bench: Bench) -> None:
    """Stop as inconclusive unless valid records enter the table: otherwise a missing entry proves nothing."""
    control = bench.peer()
    control.send(bench.records.report(control.node_id, 1))
    if until_neighbour(bench, control.node_id) is None:
        bench.inconclusive("an entry for a valid record, which this case needs", "no entry in time")


def _require_working(bench: Bench, after: str) -> None:
    """Fail and stop the case unless the record of another neighbour still enters the table."""
    probe = bench.peer()
    probe.send(bench.records.report(probe.node_id, 1))
    bench.required(until_neighbour(bench, probe.node_id), f"an entry of another neighbour after {after}")


@case(
    "TC_SRP_RX_BV_01",
    "A received record is stored unchanged, with the time of its reception",
    requirements="SRP-RX-03 SRP-NT-01",
    stimulus="a record with a different value in every field and seqno 77",
    expect="one entry of its node with the same sData, tStamp and seqno, and the current time as receptionTime",
    needs=_TABLE,
)
def stored(bench: Bench) -> None:
    peer, values = bench.peer(), numeric_data(bench, 1)
    report = bench.records.report(peer.node_id, 77, **values)
    sent = bench.lower.wall()
    peer.send(report)
    entry = bench.required(until_neighbour(bench, peer.node_id), "an entry of the record's node")
    came = bench.lower.wall()
    bench.answered({name: entry.get("sData", {}).get(name) for name in values}, values, "sData", "SRP-RX-03")
    bench.fields(entry, "SRP-RX-03", seqno=77, tStamp=report.t_stamp)
    time, slack = entry.get("receptionTime"), bench.sut.pixit.clock_tolerance_ms * MS
    near = isinstance(time, int) and sent - slack <= time <= came + slack
    bench.proved(near, f"receptionTime within {slack / 1e6:.0f} ms of the tester's clock", time, "SRP-RX-03")
    bench.answered(len(neighbours(bench)[peer.node_id]), 1, "entries of the node", "SRP-NT-01")


@case(
    "TC_SRP_RX_BV_02",
    "A newer record of a neighbour replaces the stored one",
    requirements="SRP-RX-03 SRP-NT-01",
    stimulus="records of a neighbour with different values, seqno 5, 6 and again 6",
    expect="one entry, with the second record and a later receptionTime; so for the third, unless it is filtered",
    needs=_TABLE,
)
def replaced(bench: Bench) -> None:
    peer = bench.peer()
    peer.send(bench.records.report(peer.node_id, 5, **numeric_data(bench, 1)))
    first = bench.required(until_neighbour(bench, peer.node_id), "an entry with the first record", "SRP-RX-03")
    entries = [first]

    def measure() -> int:
        bench.wait(2)
        number = 5 + len(entries)
        values = numeric_data(bench, number - 4)
        peer.send(bench.records.report(peer.node_id, number, **values))
        second = bench.required(
            until_neighbour(bench, peer.node_id, number), "an entry with the newer record", "SRP-RX-03"
        )
        bench.answered({name: second.get("sData", {}).get(name) for name in values}, values, "sData", "SRP-RX-03")
        entries.append(second)
        return int(second.get("receptionTime", 0) - entries[-2].get("receptionTime", 0))

    check_later(bench, "a later receptionTime", bench.period, measure, "SRP-RX-03")

    def measure_equal() -> int:
        bench.wait(2)
        before = entries[-1]
        values = numeric_data(bench, len(entries) + 10)
        peer.send(bench.records.report(peer.node_id, before["seqno"], **values))
        _require_working(bench, "a record with the same number")
        entry = bench.required(neighbour(bench, peer.node_id), "an entry of the neighbour", "SRP-RX-03")
        if {name: entry.get("sData", {}).get(name) for name in values} != values:
            # Filtered (SRP-RX-04), or lost.
            return bench.period
        entries.append(entry)
        return int(entry.get("receptionTime", 0) - before.get("receptionTime", 0))

    check_later(bench, "a later receptionTime with equal numbers", bench.period, measure_equal, "SRP-RX-03")
    same = neighbours(bench).get(peer.node_id, [])
    bench.answered(len(same), 1, "entries of the node", "SRP-NT-01")


def _extremes(kind: str) -> tuple[float, float]:
    """Return a low and a high value of a field that its type can hold exactly."""
    if kind.startswith("f"):
        return -(2.0**100), 2.0**100
    bits = int(kind[1:])
    return (0, (1 << bits) - 1) if kind.startswith("u") else (-1 << (bits - 1), (1 << (bits - 1)) - 1)


def _unusual(bench: Bench) -> Iterator[tuple[str, dict[str, Any], int | None]]:
    """Yield safety data in the order of the records, with a name, and the tStamp of the record unless it is usual."""
    usual, stamp = numeric_data(bench, 1), bench.profile.types.timestamp
    kinds = {each.name: each.type for each in bench.profile.srp.safety_data}

    def each(change: Callable[[Any, str], Any]) -> dict[str, Any]:
        return {name: change(value, kinds[name]) for name, value in usual.items()}

    yield "usual data", usual, None
    yield "slightly different data", each(lambda value, kind: value + (2**-10 if kind.startswith("f") else 1)), None
    yield "the same data", each(lambda value, kind: value + (2**-10 if kind.startswith("f") else 1)), None
    yield "data of a far position", each(lambda value, kind: value + 2**17 if kind[0] == "f" else value), None
    yield "data of zeros", each(lambda _value, _kind: 0), None
    yield "negative data", each(lambda value, kind: value if kind.startswith("u") else -value), None
    yield "very low values", each(lambda _value, kind: _extremes(kind)[0]), None
    yield "very high values", each(lambda _value, kind: _extremes(kind)[1]), None
    yield "usual data with tStamp 0", usual, 0
    yield (
        "data of zeros with the greatest tStamp",
        each(lambda _value, _kind: 0),
        (1 << (8 * stamp.width - stamp.signed)) - 1,
    )
    yield "usual data", usual, None


@case(
    "TC_SRP_RX_BV_13",
    "A record replaces the stored one, whatever its values and however they differ from the stored ones",
    requirements="SRP-RX-03",
    stimulus=(
        "records of a neighbour in succession: usual data, slightly different ones, the same, those of a far position, "
        "zeros, negative, very low and very high values, tStamp 0, the greatest tStamp, usual data"
    ),
    expect="after each record an entry with its values",
    window=8,
    needs=_TABLE,
)
def any_values(bench: Bench) -> None:
    peer = bench.peer()
    for number, (what, values, stamp) in enumerate(_unusual(bench)):
        for _ in range(2):
            # A beacon may be lost.
            peer.send(bench.records.report(peer.node_id, number, t_stamp=stamp, **values))
            entry = until_neighbour(bench, peer.node_id, number)
            if entry is not None:
                break
        stored = bench.required(entry, f"an entry with {what}").get("sData", {})
        wrong = {name: stored.get(name) for name, value in values.items() if not _near(stored.get(name), value)}
        bench.none(wrong, f"an entry with {what}: {values}", seen=f"{wrong}")


def _near(shown: object, value: float) -> bool:
    """Return whether a value is shown that differs at most in its sixth digit, which an upper tester may round."""
    return isinstance(shown, int | float) and math.isclose(shown, value, rel_tol=1e-5)


@case(
    "TC_SRP_RX_BV_03",
    "A record with a sequence number that is not newer should replace the stored one ({variant})",
    requirements="SRP-RX-04",
    stimulus="a record with seqno 100, then another one of the same node with a sequence number that is {variant}",
    expect="the second record is stored; a filter on sequence numbers is allowed and reported",
    needs=_TABLE,
    variants={"lower": 5, "equal": 100},
)
def not_newer(bench: Bench, seqno: int) -> None:
    _require_reception(bench)
    peer = bench.peer()
    peer.send(bench.records.report(peer.node_id, 100, **numeric_data(bench, 1)))
    bench.needed(until_neighbour(bench, peer.node_id, 100), "an entry with the first record", "no such entry")
    values = numeric_data(bench, 2)
    peer.send(bench.records.report(peer.node_id, seqno, **values))
    _require_working(bench, "a record with an older sequence number")
    entry = neighbour(bench, peer.node_id) or {}
    data = entry.get("sData", {})
    taken = entry.get("seqno") == seqno and all(data.get(name) == value for name, value in values.items())
    bench.info(
        "Is a record stored if its sequence number is not newer?",
        "yes" if taken else "no: sequence numbers are a filter",
    )
    claimed = bench.sut.pics.srp_seqno_filter
    # For an equal sequence number a filter may accept the record (it is not older) or drop it as a repetition.
    if claimed is not None and seqno < 100:
        bench.none(claimed and taken, "srp_seqno_filter = true, as the PICS claims", seen="the record is stored")
        bench.some(claimed or taken, "srp_seqno_filter = false, as the PICS claims", seen="the record is not stored")


@case(
    "TC_SRP_RX_BV_04",
    "The key of an entry is the nodeId of the record, not the senderId of the beacon",
    requirements="SRP-RX-05 SRP-NT-01",
    stimulus="a record of node X in a beacon of node Y; then another one of X in a beacon of node Z",
    expect="an entry of X and none of Y; with the second record still one of X",
    needs=Needs(ut=("SRP-NeighbourTable",), entities=("srp",), header=("senderId",)),
)
def key(bench: Bench) -> None:
    peer, other = bench.peer(), bench.identifiers.node_id()
    peer.send(bench.records.report(other, 1))
    bench.some(until_neighbour(bench, other), "an entry of the record's node")
    bench.none(neighbour(bench, peer.node_id), "no entry of the beacon's sender")
    bench.peer().send(bench.records.report(other, 2))
    # Whether the second record is stored is up to other cases: it may be lost.
    until_neighbour(bench, other, 2)
    found = neighbours(bench).get(other, [])
    bench.proved(len(found) <= 1, "one entry of the record's node", f"{len(found)} entries", "SRP-NT-01 SRP-RX-05")


@case(
    "TC_SRP_RX_BV_05",
    "The sequence number is stored in 32 bits and may have any value",
    requirements="SRP-TYP-01 SRP-RX-03",
    stimulus="a record with seqno 2^32-1, then one of another node with seqno 0x01020304",
    expect="entries with these sequence numbers",
    needs=_TABLE,
)
def wide_numbers(bench: Bench) -> None:
    for number in (0xFFFF_FFFF, 0x0102_0304):
        peer = bench.peer()
        peer.send(bench.records.report(peer.node_id, number))
        entry = until_neighbour(bench, peer.node_id)
        bench.equal(entry and entry.get("seqno"), number, "seqno of the entry")


def _block(bench: Bench, peer: Peer, name: str) -> Block:
    """Return a block with the record of the peer, made invalid as ``name`` says."""
    octets = bench.builder.srp(bench.records.report(peer.node_id, 1)).octets
    damaged = {
        "one-short": octets[:-1],
        "one-long": octets + b"\0",
        "one-octet": octets[:1],
        "twice": octets * 2,
        "without-seqno": octets[: -bench.profile.types.srp_seqno.width],
    }
    return Block(BP_PROTID_SRP, damaged[name])


@case(
    "TC_SRP_RX_BI_01",
    "An SRP payload that does not have the length of a record is ignored ({variant})",
    requirements="SRP-RX-01",
    stimulus="an SRP block of a wrong length ({variant}); then a record of another neighbour",
    expect="no entry of the first node, an entry of the second",
    needs=_TABLE,
    variants={name: name for name in ("one-short", "one-long", "one-octet", "twice", "without-seqno")},
)
def wrong_length(bench: Bench, name: str) -> None:
    _require_reception(bench)
    before = set(neighbours(bench))
    peer = bench.peer()
    peer.send(_block(bench, peer, name))
    _require_working(bench, "a payload of a wrong length")
    table = set(neighbours(bench))
    bench.proved(peer.node_id not in table, "no entry of the payload's node", "an entry")
    # No other node sent anything, so any other entry was made from octets of the payload.
    others = table - before - {each.node_id for each in bench.peers.made}
    if not any(event.direction == "other" for event in bench.traffic.events):
        bench.none(
            others, "no entry of a node that does not exist", seen=f"entries of {[each.hex(':') for each in others]}"
        )


@case(
    "TC_SRP_RX_BI_02",
    "A record in a block of another protocol is ignored",
    requirements="SRP-RX-01",
    stimulus="a valid record as payload of protocol 3; then one of another neighbour as SRP payload",
    expect="no entry of the first node, an entry of the second",
    needs=_TABLE,
)
def wrong_protocol(bench: Bench) -> None:
    _require_reception(bench)
    peer = bench.peer()
    peer.send(Block(3, bench.builder.srp(bench.records.report(peer.node_id, 1)).octets))
    _require_working(bench, "a record in a block of another protocol")
    bench.none(neighbour(bench, peer.node_id), "no entry of the payload's node")


@case(
    "TC_SRP_RX_BI_03",
    "A record with the implementation's own identifier is ignored",
    requirements="SRP-RX-02 SRP-NT-03",
    stimulus="a record with the nodeId of the implementation in a beacon of a peer; then one of a neighbour",
    expect="no entry of the implementation's own node, an entry of the neighbour",
    needs=_TABLE,
)
def own_identifier(bench: Bench) -> None:
    _require_reception(bench)
    peer = bench.peer()
    peer.send(bench.records.report(bench.identifiers.sut_id, 1))
    _require_working(bench, "a record with its own identifier")
    bench.none(neighbour(bench, bench.identifiers.sut_id), "no entry of the implementation's own node")


@case(
    "TC_SRP_NT_BV_01",
    "The table lists all neighbours and returns single entries by nodeId",
    requirements="SRP-NT-01 SRP-NT-02",
    stimulus="records of three neighbours; look-ups of one of them and of an unknown node",
    expect="all three in the list; exactly the requested entry; none for the unknown node",
    needs=_TABLE,
)
def list_and_look_up(bench: Bench) -> None:
    peers = [bench.peer() for _ in range(3)]
    for number, peer in enumerate(peers):
        peer.send(bench.records.report(peer.node_id, number))
    for peer in peers:
        bench.some(until_neighbour(bench, peer.node_id), f"{peer.node_id.hex(':')} in the list", "SRP-NT-02")
    for node_id, expected in ((peers[1].node_id, [1]), (bench.identifiers.node_id(), [])):
        found = rows(bench.must("SRP-NeighbourTable", nodeId=node_id.hex(":")), "neighbours")
        numbers = [row.get("seqno") for row in found]
        bench.in_order(numbers, expected, f"{len(expected)} entries for {node_id.hex(':')}", "SRP-NT-01")


@case(
    "TC_SRP_NT_BV_02",
    "A submission of safety data creates no entry of the node itself",
    requirements="SRP-NT-03",
    stimulus="SRP-UpdateSafetyData; then a record of a neighbour",
    expect="an entry of the neighbour, none of the implementation's own node",
    needs=Needs(ut=("SRP-NeighbourTable", "SRP-UpdateSafetyData"), entities=("srp",)),
)
def own_data(bench: Bench) -> None:
    _require_reception(bench)
    bench.must("SRP-UpdateSafetyData", sData=safety_data(bench, 1))
    _require_working(bench, "a submission of safety data")
    bench.none(neighbour(bench, bench.identifiers.sut_id), "no entry of the implementation's own node")


@case(
    "TC_SRP_NT_BV_03",
    "Reports additional fields in the entries of the table",
    requirements="SRP-NT-04",
    stimulus="a record of a neighbour; SRP-NeighbourTable",
    expect="any result: it is reported; claims of the PICS must be true",
    needs=_TABLE,
)
def extra_fields(bench: Bench) -> None:
    peer = bench.peer()
    peer.send(bench.records.report(peer.node_id, 1))
    entry = bench.needed(until_neighbour(bench, peer.node_id), "an entry of the neighbour", "no entry")
    extra = sorted(set(entry) - {"nodeId", "sData", "tStamp", "seqno", "receptionTime"})
    bench.info("Which additional fields does the neighbour table have?", ", ".join(extra) or "none")
    claimed = bench.sut.pics.neighbour_statistics
    if claimed is not None:
        bench.answered(bool(extra), claimed, "fields of statistics, as [pics] neighbour_statistics claims")
