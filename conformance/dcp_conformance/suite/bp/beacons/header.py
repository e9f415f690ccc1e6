"""dcp-bp.md: Data Types; Packet Format; Transmit Path.

Contents of the headers in the implementation's beacons. The octets are read here and not with the decoder, so that a
field is judged even if another field is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dcp_spec.constants import BP_MAGIC_NO, BP_PROTID_SRP, BP_PROTID_VARDIS, BP_VERSION, ICType, SpecVersion

from dcp_conformance.definitions.case import FILLS, LISTENS, Needs, case
from dcp_conformance.frames.header_rules import judge
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.bp_clients import (
    CLIENT,
    LIST,
    ONCE,
    QUERY,
    BPClient,
    block_header_octets,
    header_octets,
    largest_payload,
    registered,
    room,
    some_beacons,
    talking,
)
from dcp_conformance.test_steps.services import rows
from dcp_conformance.test_system.bench import Bench

V1_1, V1_2, V2_0 = SpecVersion.V1_1, SpecVersion.V1_2, SpecVersion.V2_0
#: Minimum payload of an Ethernet frame: shorter bearer payloads may have been padded in transit.
_MAY_BE_PADDED = 46


class Wire(NamedTuple):
    """The headers and blocks of a beacon, read from its octets."""

    heard: ReceivedBeacon
    fields: dict[str, object]
    """The fields of the header, by their names in the specification."""
    counted: Sequence[tuple[int, bytes]]
    """The blocks that are present: protocol identifiers and payloads."""
    end: int
    """Offset of the end of the last block."""
    whole: bool
    """Whether all blocks are present."""


def read(bench: Bench, heard: ReceivedBeacon) -> Wire:
    """Read the headers of a beacon.

    Where length, numPayloads and the block lengths agree, or a single one of them differs, the blocks are those that
    the majority describes; otherwise as many blocks as numPayloads gives.
    """
    octets, types = heard.octets, bench.profile.types
    header = bench.codec.dissect(octets).root.find("bp")
    fields = {field.name: field.value for field in header.children} if header is not None else {}
    if heard.salvaged.clear:
        found = heard.blocks
        size = sum(len(payload) for _, payload in found) + len(found) * block_header_octets(bench)
        return Wire(heard, fields, found, header_octets(bench) + size, True)
    number, index, blocks = fields.get("numPayloads"), header_octets(bench), []
    size, whole = block_header_octets(bench), isinstance(number, int)
    for _ in range(number if isinstance(number, int) else 0):
        if index + size > len(octets):
            whole = False
            break
        prot_id = int.from_bytes(octets[index : index + types.protocol_id.width], types.protocol_id.byte_order)
        length = int.from_bytes(octets[index + types.protocol_id.width : index + size], types.bp_length.byte_order)
        if index + size + length > len(octets):
            whole = False
            break
        blocks.append((prot_id, octets[index + size : index + size + length]))
        index += size + length
    return Wire(heard, fields, blocks, index, whole)


def beacons_read(bench: Bench, count: int = 6, clients: int = 2) -> list[Wire]:
    """Return beacons of an implementation that has several blocks to send."""
    with talking(bench, clients=clients):
        return [read(bench, heard) for heard in some_beacons(bench, count)]


def check_field(bench: Bench, wires: Sequence[Wire], name: str, right: object, *requirements: str) -> None:
    """Check that a header field has the value ``right`` in all beacons."""
    wrong = [each for each in wires if each.fields.get(name) != right]
    show = (lambda value: f"{value:#x}") if isinstance(right, int) else repr
    observed = "" if not wrong else f"{show(wrong[0].fields.get(name) or 0)} in {len(wrong)} of {len(wires)} beacons"
    frames = [each.heard for each in wrong[:8]]
    bench.none(wrong, f"{name} is {show(right)} in every beacon", *requirements, seen=observed, frames=frames)


def _judged(bench: Bench, wires: Sequence[Wire], *requirements: str) -> None:
    """Fail for beacons that break one of these requirements; inconclusive if another fault hides the blocks."""
    for wire in wires:
        faults = judge(wire.heard.octets, bench.codec)
        for each in faults:
            if each.requirement in requirements:
                bench.wrong(each.expected, each.observed, each.requirement, frames=[wire.heard])
        if faults and not (wire.heard.salvaged.clear and wire.heard.seqno is not None):
            bench.inconclusive("headers that can be separated from the blocks", f"{faults[0]}")


def _fields(*names: str, since: SpecVersion = SpecVersion.V1_0) -> Needs:
    return Needs(since=since, entities=(), header=names)


@case(
    "TC_BP_HDR_BV_01",
    "Every beacon has version 0x01 and magicNo 0x497E",
    requirements="BP-HDR-01 BP-HDR-02",
    stimulus="payloads to send in every period",
    expect="both values in six beacons",
    window=8,
    needs=_fields("version", "magicNo"),
)
def constants(bench: Bench) -> None:
    wires = beacons_read(bench)
    check_field(bench, wires, "version", BP_VERSION, "BP-HDR-01")
    check_field(bench, wires, "magicNo", BP_MAGIC_NO, "BP-HDR-02")


def _registered(bench: Bench) -> set[int] | None:
    """Return the registered protocol identifiers; None if they cannot be listed."""
    if not bench.services.offers(LIST):
        return None
    return {
        each["protocolId"] for each in rows(bench.must(LIST), "protocols") if isinstance(each.get("protocolId"), int)
    }


@case(
    "TC_BP_HDR_BV_02",
    "The fields of both headers have the order of the specification",
    requirements="BP-HDR-10",
    alone=LISTENS,
    stimulus="payloads to send in every period",
    expect="plausible magicNo, senderId, numPayloads and block protocolIds at their offsets",
    window=8,
    needs=_fields("version", "magicNo", "senderId", "numPayloads", since=V1_1),
)
def order_of_fields(bench: Bench) -> None:
    with talking(bench, clients=2) as clients:
        wires = [read(bench, heard) for heard in some_beacons(bench, 6)]
    _judged(bench, wires, "BP-HDR-10")
    check_field(bench, wires, "senderId", bench.identifiers.sut_id)
    known = {BP_PROTID_SRP, BP_PROTID_VARDIS, *(client.prot_id for client in clients)}
    others = _registered(bench)
    # If the clients of the implementation cannot be listed, one known identifier in a beacon is sufficient.
    strange = [
        each
        for each in wires
        if not each.whole
        or (others is None and not known.intersection(prot_id for prot_id, _ in each.counted))
        or (others is not None and not {prot_id for prot_id, _ in each.counted} <= known | others)
    ]
    ids = {prot_id for each in wires for prot_id, _ in each.counted}
    frames = [each.heard for each in strange[:8]]
    expected = "blocks of registered protocols, each with the announced length"
    bench.none(strange, expected, seen=f"blocks of protocols {sorted(ids)} in {len(strange)} beacons", frames=frames)
    bench.none([each.heard for each in wires if not each.counted], "numPayloads of at least 1")


@case(
    "TC_BP_HDR_BV_03",
    "protocolId has 16 bits; its value is 2 for VarDis and 1 for SRP",
    requirements="BP-HDR-11",
    stimulus="payloads of VarDis, and of SRP if the upper tester can submit safety data",
    expect="blocks with these identifiers, two octets each",
    window=6,
    needs=Needs(header=("numPayloads",)),
)
def predefined_identifiers(bench: Bench) -> None:
    reports = bench.services.offers("SRP-UpdateSafetyData") and bool(bench.profile.srp.safety_data)
    start = bench.mark()
    with talking(bench, clients=0):
        if reports:
            fields = bench.profile.srp.safety_data
            data = {each.name: "00" * each.octets if each.type == "opaque" else 0 for each in fields}
            bench.must("SRP-UpdateSafetyData", sData=data)
        some_beacons(bench, 4)
        if not any(heard.has_vardis for heard in bench.heard[start:]):
            bench.until(lambda heard: heard.has_vardis)
    # The report may have been sent before the call was confirmed.
    wires = [read(bench, heard) for heard in bench.heard[start:]]
    ids = {prot_id for each in wires for prot_id, _ in each.counted}
    bench.answered(bench.profile.types.protocol_id.width, 2, "octets of a protocolId")
    bench.some(BP_PROTID_VARDIS in ids, "blocks of protocol 2 (VarDis)", seen=f"protocols {sorted(ids)}")
    if reports:
        bench.some(BP_PROTID_SRP in ids, "a block of protocol 1 (SRP)", seen=f"protocols {sorted(ids)}")


@case(
    "TC_BP_HDR_BV_04",
    "senderId is the node's own identifier in every beacon",
    requirements="BP-HDR-03 BP-PAR-09",
    stimulus="beacons of three peers that cause reactions",
    expect="the same senderId in all beacons; that reported by the upper tester, if it reports one",
    window=12,
    needs=_fields("senderId"),
)
def sender(bench: Bench) -> None:
    _named_by_another(bench)
    wires = beacons_read(bench, 3)
    if bench.sut.pics.vardis is not False:
        for _ in range(3):
            bench.probes.probe()
    ids = {each.fields.get("senderId") for each in wires} | {heard.sender for heard in bench.heard}
    bench.some(ids - {None}, "a senderId in the beacons")
    bench.proved(len(ids - {None}) <= 1, "one senderId in all beacons", f"{len(ids)} different ones")
    upper = bench.session.upper
    told = str(upper.about.get("nodeId", "")).replace(":", "").lower() if upper is not None else ""
    if told:
        heard = wires[0].fields.get("senderId")
        observed = heard.hex() if isinstance(heard, bytes) else f"{heard}"
        bench.answered(observed, told, "senderId", "BP-HDR-03", frames=[wires[0].heard])
    # Frames from the same link address with another senderId: they are not attributed to the implementation.
    sources = {heard.source for heard in bench.heard} - {peer.address for peer in bench.peers.made}
    other = [heard for heard in bench.receiver.others if heard.source in sources]
    bench.none(other, "no beacon with another senderId from the same link address")


def _named_by_another(bench: Bench) -> None:
    """Fail if the implementation answers with a senderId other than the nodeId it reports: its beacons would not be
    recognised.
    """
    if bench.sut.pics.vardis is False or bench.session.upper is None or "nodeId" not in bench.session.upper.about:
        return
    start, others, unknown, peer = bench.mark(), len(bench.receiver.others), bench.unknown_id(), bench.peer()
    peer.send(peer.summary(unknown, 1))
    bench.until_instruction(ICType.REQUEST_VARCREATES, unknown)
    known = {each.node_id for each in bench.peers.made}
    answers = [each for each in bench.receiver.others[others:] if each.about(ICType.REQUEST_VARCREATES, unknown)]
    if not bench.heard[start:] and answers and not known & {each.sender for each in answers}:
        observed = f"senderId {(answers[0].sender or b'').hex(':')} in the answer to a summary"
        bench.wrong(f"senderId {bench.identifiers.sut_id.hex(':')}", observed, "BP-HDR-03", frames=answers[:4])


@case(
    "TC_BP_HDR_BV_05",
    "networkId equals BPPAR_NETWORK_ID and has at least two octets",
    requirements="BP-HDR-04 BP-HDR-05",
    stimulus="payloads to send in every period",
    expect="the value of the parameter in six beacons",
    window=8,
    needs=_fields("networkId", since=V2_0),
)
def network(bench: Bench) -> None:
    wires = beacons_read(bench)
    check_field(bench, wires, "networkId", bench.sut.parameter("BPPAR_NETWORK_ID"), "BP-HDR-04")
    width = bench.profile.types.network_id.width
    bench.proved(width >= 2, "a networkId of at least 16 bits", f"{8 * width} bits", "BP-HDR-05")


@case(
    "TC_BP_HDR_BV_06",
    "length is the total size of all blocks with their headers",
    requirements="BP-HDR-06",
    stimulus="several clients with payloads to send in every period",
    expect="length equals the total size of numPayloads blocks, or of all octets after the header in unpadded frames",
    window=8,
    needs=Needs(
        since=V1_2,
        entities=(),
        header=("length", "numPayloads"),
        when=lambda bench: (
            None
            if bench.profile.bp.length_means == "blocks"
            else f"the field length has another meaning in {bench.profile.name}"
        ),
    ),
)
def length(bench: Bench) -> None:
    start, wires = header_octets(bench), beacons_read(bench)
    _judged(bench, wires, "BP-HDR-06")
    for wire in wires:
        observed = wire.fields.get("length")
        size = len(wire.heard.octets)
        # The beacon is consistent with either value; length is wrong only if it matches neither.
        right = {wire.end - start} if wire.whole else set()
        if size > _MAY_BE_PADDED:
            right.add(size - start)
        expected = f"length {' or '.join(map(str, sorted(right)))}"
        if not bench.proved(observed in right, expected, f"length {observed}", frames=[wire.heard]):
            return


@case(
    "TC_BP_HDR_BV_07",
    "numPayloads is the number of blocks, which follow each other without gaps",
    requirements="BP-HDR-07 BP-FMT-01",
    stimulus="several clients with payloads to send in every period",
    expect="numPayloads blocks of known protocols, the last of which ends at the end of the beacon",
    window=8,
    needs=_fields("numPayloads"),
)
def number_of_blocks(bench: Bench) -> None:
    wires = beacons_read(bench)
    _judged(bench, wires, "BP-HDR-07", "BP-FMT-01")
    for wire in wires:
        number, size = wire.fields.get("numPayloads"), len(wire.heard.octets)
        observed = f"{len(wire.counted)} blocks, ending at octet {wire.end} of {size}"
        right = wire.whole and number == len(wire.counted) and (wire.end == size or size <= _MAY_BE_PADDED)
        if not bench.proved(right, f"{number} blocks that fill the beacon", observed, frames=[wire.heard]):
            return


@case(
    "TC_BP_FMT_BV_01",
    "No beacon is larger than BPPAR_MAXIMUM_PACKET_SIZE",
    requirements="BP-FMT-02",
    alone=FILLS,
    stimulus="three clients submit the largest allowed payloads; VarDis has payloads to send at first, and later none",
    expect="no larger beacon; all payloads are sent, at the latest when no other block competes with them",
    window=20,
    needs=Needs(
        entities=(), ut=CLIENT, when=lambda bench: "blocks of fixed size" if bench.profile.bp.payload_area else None
    ),
)
def largest_beacons(bench: Bench) -> None:
    limit = bench.sut.bound("BPPAR_MAXIMUM_PACKET_SIZE")
    size = min(largest_payload(bench), room(bench) - block_header_octets(bench))
    with (
        BPClient(bench, ONCE, size=size) as one,
        BPClient(bench, ONCE, size=size) as two,
        BPClient(bench, ONCE, size=size) as three,
    ):
        clients = (one, two, three)
        variable = bench.peer() if bench.sut.pics.vardis is not False else None
        var_id = bench.var_id()
        if variable is not None:
            variable.send(variable.create(var_id))
        start = bench.mark()
        for client in clients:
            client.transmit(client.payload(size))

        def all_sent(_: object = None) -> bool:
            return all(client.frames(start) for client in clients)

        bench.until(all_sent, 3 * bench.sut.reaction)
        if variable is not None and not all_sent():
            # A block that is in every beacon may be served first each time: the order is free (BP-TX-03).
            variable.send(variable.delete(var_id))
            bench.until_quiet(lambda heard: heard.has_vardis and not all_sent())
            bench.until(all_sent, 3 * bench.sut.reaction)
        _check_all_sent(bench, clients)
        large = [heard for heard in bench.heard[start:] if len(heard.octets) > limit]
        most = max((len(heard.octets) for heard in bench.heard[start:]), default=0)
        if large and most <= limit + header_octets(bench):
            bench.reading("X04", "blocks-only")
            large = []
        bench.none(large, f"beacons of at most {limit} octets", "BP-FMT-02", seen=f"a beacon of {most} octets")


def _check_all_sent(bench: Bench, clients: Sequence[BPClient]) -> None:
    """Check that each client has sent its payload, unless every beacon had a block of another client."""
    waiting = [client for client in clients if not client.sent()]
    ours = {client.prot_id for client in clients}
    last = bench.wait(2 * bench.sut.reaction) if waiting else []
    waiting = [client for client in waiting if not client.sent()]
    if waiting and last and all({prot_id for prot_id, _ in each.blocks} - ours for each in last):
        bench.info("Can a block in every beacon delay the largest payloads indefinitely?", "yes", "BP-TX-03")
        return
    bench.complete(
        [f"that of client {each.prot_id:#06x}" for each in waiting], "each of the payloads is sent", "BP-TX-04"
    )


@case(
    "TC_BP_FMT_BV_02",
    "No beacon is sent without a payload",
    requirements="BP-FMT-03",
    alone=LISTENS,
    stimulus="none for six periods",
    expect="no beacon without blocks; no beacon at all if all buffers are known to be empty",
    window=6,
    needs=Needs(entities=()),
)
def silence(bench: Bench) -> None:
    heard = bench.wait(6)
    bare = [
        each
        for each in heard
        if len(each.octets) <= header_octets(bench) or read(bench, each).fields.get("numPayloads") == 0
    ]
    bench.none(bare, "no beacon without blocks")
    if heard and bench.services.offers(LIST):
        # Each payload belongs to a registered client.
        clients = set(registered(bench))
        bench.every(
            heard,
            lambda each: {prot_id for prot_id, _ in each.blocks} & clients,
            "a block of a registered protocol in each beacon",
        )
    if heard and bench.services.offers("UT-Reset", QUERY):
        waiting = [bench.call(QUERY, protId=each).result.get("number") for each in (BP_PROTID_SRP, BP_PROTID_VARDIS)]
        what = f"{len(heard)} beacons; SRP and VarDis have {waiting} buffered payloads"
        bench.info("Is the implementation silent after a reset?", what, frames=heard[:8])
