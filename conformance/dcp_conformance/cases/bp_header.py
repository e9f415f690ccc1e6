"""dcp-bp.md: Data Types; Packet Format; Transmit Path.

What stands in the headers of the implementation's beacons. The octets are read here, not by what decodes them
elsewhere, so that a field is judged although another one is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from dcp_spec.constants import BP_MAGIC_NO, BP_PROTID_SRP, BP_PROTID_VARDIS, BP_VERSION, ICType, SpecVersion

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.clients import (
    CLIENT,
    LIST,
    ONCE,
    QUERY,
    BPClient,
    block_header_octets,
    header_octets,
    largest_payload,
    registered,
    some_beacons,
    talking,
)
from dcp_conformance.header_rules import judge
from dcp_conformance.heard import Heard
from dcp_conformance.services import rows

V1_1, V1_2, V2_0 = SpecVersion.V1_1, SpecVersion.V1_2, SpecVersion.V2_0
#: What an Ethernet frame holds at least: shorter bearer payloads may have been padded on their way.
_MAY_BE_PADDED = 46


class Wire(NamedTuple):
    """A beacon as its octets say."""

    heard: Heard
    fields: dict[str, object]
    """The header's fields by their names in the specification."""
    counted: Sequence[tuple[int, bytes]]
    """The blocks, as far as they are there: protocol identifiers and payloads."""
    end: int
    """Where they end."""
    whole: bool
    """Whether all of them are there."""


def read(bench: Bench, heard: Heard) -> Wire:
    """Take the headers of a beacon apart.

    The blocks are those that length, numPayloads and the lengths of blocks agree on, or would but for one of them;
    otherwise as many as numPayloads says.
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
    """Beacons of an implementation that has several blocks to send."""
    with talking(bench, clients=clients):
        return [read(bench, heard) for heard in some_beacons(bench, count)]


def check_field(bench: Bench, wires: Sequence[Wire], name: str, right: object, *requirements: str) -> None:
    """Check that a header field has a value in all beacons."""
    wrong = [each for each in wires if each.fields.get(name) != right]
    show = (lambda value: f"{value:#x}") if isinstance(right, int) else repr
    said = "" if not wrong else f"it is {show(wrong[0].fields.get(name) or 0)} in {len(wrong)} of {len(wires)} beacons"
    frames = [each.heard for each in wrong[:8]]
    bench.check(not wrong, f"{name} is {show(right)} in every beacon", said, *requirements, frames=frames, shown=True)


def _judged(bench: Bench, wires: Sequence[Wire], *requirements: str) -> None:
    """Fail for what beacons break of these requirements; inconclusive if something else hides the blocks."""
    for wire in wires:
        faults = judge(wire.heard.octets, bench.codec)
        for each in faults:
            if each.requirement in requirements:
                bench.fail(each.expected, each.observed, each.requirement, frames=[wire.heard], shown=True)
        if faults and not (wire.heard.salvaged.clear and wire.heard.seqno is not None):
            bench.inconclusive("headers that can be told from what follows", f"{faults[0]}")


def _fields(*names: str, since: SpecVersion = SpecVersion.V1_0) -> Needs:
    return Needs(since=since, entities=(), header=names)


@case(
    "TC_BP_HDR_BV_01",
    "Every beacon has version 0x01 and magicNo 0x497E",
    requirements="BP-HDR-01 BP-HDR-02",
    stimulus="something to send in every period",
    expect="both values in six beacons",
    window=8,
    needs=_fields("version", "magicNo"),
    smoke=True,
)
def constants(bench: Bench) -> None:
    wires = beacons_read(bench)
    check_field(bench, wires, "version", BP_VERSION, "BP-HDR-01")
    check_field(bench, wires, "magicNo", BP_MAGIC_NO, "BP-HDR-02")


def _registered(bench: Bench) -> set[int] | None:
    """The protocols that are registered now; None if they cannot be listed."""
    upper = bench.session.upper
    if upper is None or LIST not in upper.methods:
        return None
    return {
        each["protocolId"] for each in rows(bench.must(LIST), "protocols") if isinstance(each.get("protocolId"), int)
    }


@case(
    "TC_BP_HDR_BV_02",
    "The fields of both headers stand in the order of the specification",
    requirements="BP-HDR-10",
    stimulus="something to send in every period",
    expect="magicNo, senderId, numPayloads and the protocolIds of the blocks make sense at their places",
    window=8,
    needs=_fields("version", "magicNo", "senderId", "numPayloads", since=V1_1),
)
def order_of_fields(bench: Bench) -> None:
    with talking(bench, clients=2) as clients:
        wires = [read(bench, heard) for heard in some_beacons(bench, 6)]
    _judged(bench, wires, "BP-HDR-10")
    check_field(bench, wires, "senderId", bench.sut_id)
    known = {BP_PROTID_SRP, BP_PROTID_VARDIS, *(client.prot_id for client in clients)}
    others = _registered(bench)
    # Where nobody can say which clients of its own the node has, one known identifier in a beacon has to do.
    strange = [
        each
        for each in wires
        if not each.whole
        or (others is None and not known.intersection(prot_id for prot_id, _ in each.counted))
        or (others is not None and not {prot_id for prot_id, _ in each.counted} <= known | others)
    ]
    ids = {prot_id for each in wires for prot_id, _ in each.counted}
    frames = [each.heard for each in strange[:8]]
    expected = "blocks of protocols that are registered, as long as they say"
    bench.check(not strange, expected, f"protocols {sorted(ids)} in {len(strange)} beacons", frames=frames, shown=True)
    bare = [each.heard for each in wires if not each.counted]
    bench.check(
        not bare, "numPayloads counts at least one block", f"none in {len(bare)} beacons", frames=bare[:8], shown=True
    )


@case(
    "TC_BP_HDR_BV_03",
    "protocolId has 16 bits: 2 for VarDis, 1 for SRP",
    requirements="BP-HDR-11",
    stimulus="something to send for VarDis, and for SRP where the upper tester can hand down safety data",
    expect="blocks with these identifiers in two octets each",
    window=6,
    needs=Needs(header=("numPayloads",)),
)
def predefined_identifiers(bench: Bench) -> None:
    upper = bench.session.upper
    reports = upper is not None and "SRP-UpdateSafetyData" in upper.methods and bool(bench.profile.srp.safety_data)
    start = bench.mark()
    with talking(bench, clients=0):
        if reports:
            fields = bench.profile.srp.safety_data
            data = {each.name: "00" * each.octets if each.type == "opaque" else 0 for each in fields}
            bench.must("SRP-UpdateSafetyData", sData=data)
        some_beacons(bench, 4)
        if not any(heard.has_vardis for heard in bench.heard[start:]):
            bench.until(lambda heard: heard.has_vardis)
    # The report may have left before the hand-down was confirmed.
    wires = [read(bench, heard) for heard in bench.heard[start:]]
    ids = {prot_id for each in wires for prot_id, _ in each.counted}
    width = bench.profile.types.protocol_id.width
    bench.check(
        width == 2, "the identifier has two octets", f"it has {width} in the profile {bench.profile.name}", shown=True
    )
    bench.check(BP_PROTID_VARDIS in ids, "blocks of protocol 2 (VarDis)", f"there are {sorted(ids)}")
    if reports:
        bench.check(BP_PROTID_SRP in ids, "a block of protocol 1 (SRP)", f"there are {sorted(ids)}")


@case(
    "TC_BP_HDR_BV_04",
    "senderId is the node's own identifier in every beacon, whoever it answers",
    requirements="BP-HDR-03 BP-PAR-09",
    stimulus="beacons of three peers that bring reactions",
    expect="the same senderId always; the one that the upper tester names, if it names one",
    window=12,
    needs=_fields("senderId"),
)
def sender(bench: Bench) -> None:
    _named_by_another(bench)
    wires = beacons_read(bench, 3)
    if bench.pics.vardis is not False:
        for _ in range(3):
            bench.probe()
    ids = {each.fields.get("senderId") for each in wires} | {heard.sender for heard in bench.heard}
    bench.check(len(ids - {None}) == 1, "one senderId", f"{len(ids)} different ones", shown=len(ids - {None}) > 1)
    upper = bench.session.upper
    told = str(upper.about.get("nodeId", "")).replace(":", "").lower() if upper is not None else ""
    if told:
        heard = wires[0].fields.get("senderId")
        said = heard.hex() if isinstance(heard, bytes) else f"{heard}"
        bench.check(said == told, f"senderId {told}", said, "BP-HDR-03", frames=[wires[0].heard], shown=True)
    # A frame from the same address with another identifier: not recognised as the implementation's.
    sources = {heard.source for heard in bench.heard} - {peer.address for peer in bench.peers_made}
    other = [heard for heard in bench.others if heard.source in sources]
    expected = "no beacon of the same station under another identifier"
    bench.check(not other, expected, f"{len(other)} of them", frames=other[:8], shown=True)


def _named_by_another(bench: Bench) -> None:
    """Fail if it answers under an identifier that it says is not its own: nothing else could be heard of it then."""
    if bench.pics.vardis is False or bench.session.upper is None or "nodeId" not in bench.session.upper.about:
        return
    start, others, unknown, peer = bench.mark(), len(bench.others), bench.unknown_id(), bench.peer()
    peer.send(peer.summary(unknown, 1))
    bench.until_instruction(ICType.REQUEST_VARCREATES, unknown)
    known = {each.node_id for each in bench.peers_made}
    answers = [each for each in bench.others[others:] if each.about(ICType.REQUEST_VARCREATES, unknown)]
    if not bench.heard[start:] and answers and not known & {each.sender for each in answers}:
        said = f"the request that a summary brought came from {(answers[0].sender or b'').hex(':')}"
        bench.fail(f"senderId {bench.sut_id.hex(':')}", said, "BP-HDR-03", frames=answers[:4], shown=True)


@case(
    "TC_BP_HDR_BV_05",
    "networkId is BPPAR_NETWORK_ID, and has two octets or more",
    requirements="BP-HDR-04 BP-HDR-05",
    stimulus="something to send in every period",
    expect="the value of the parameter in six beacons",
    window=8,
    needs=_fields("networkId", since=V2_0),
)
def network(bench: Bench) -> None:
    wires = beacons_read(bench)
    check_field(bench, wires, "networkId", bench.parameter("BPPAR_NETWORK_ID"), "BP-HDR-04")
    width = bench.profile.types.network_id.width
    bench.check(width >= 2, "networkId has 16 bits or more", f"it has {8 * width}", "BP-HDR-05", shown=True)


@case(
    "TC_BP_HDR_BV_06",
    "length is the sum of all blocks with their headers",
    requirements="BP-HDR-06",
    stimulus="several clients with something to send in every period",
    expect="length is what numPayloads blocks have, or what follows the header in frames that are not padded",
    window=8,
    needs=Needs(
        since=V1_2,
        entities=(),
        header=("length", "numPayloads"),
        when=lambda bench: (
            None if bench.profile.bp.length_means == "blocks" else f"length is something else in {bench.profile.name}"
        ),
    ),
)
def length(bench: Bench) -> None:
    start, wires = header_octets(bench), beacons_read(bench)
    _judged(bench, wires, "BP-HDR-06")
    for wire in wires:
        said = wire.fields.get("length")
        size = len(wire.heard.octets)
        # With either of the two the beacon is consistent; if both disagree, the length is wrong.
        right = {wire.end - start} if wire.whole else set()
        if size > _MAY_BE_PADDED:
            right.add(size - start)
        expected = f"length {' or '.join(map(str, sorted(right)))}"
        if not bench.check(said in right, expected, f"length {said}", frames=[wire.heard], shown=True):
            return


@case(
    "TC_BP_HDR_BV_07",
    "numPayloads is the number of blocks, and they follow each other without gaps",
    requirements="BP-HDR-07 BP-FMT-01",
    stimulus="several clients with something to send in every period",
    expect="numPayloads blocks of known protocols, the last of which ends where the beacon ends",
    window=8,
    needs=_fields("numPayloads"),
)
def number_of_blocks(bench: Bench) -> None:
    wires = beacons_read(bench)
    _judged(bench, wires, "BP-HDR-07", "BP-FMT-01")
    for wire in wires:
        number, size = wire.fields.get("numPayloads"), len(wire.heard.octets)
        said = f"{len(wire.counted)} blocks that end at octet {wire.end} of {size}"
        right = wire.whole and number == len(wire.counted) and (wire.end == size or size <= _MAY_BE_PADDED)
        if not bench.check(right, f"{number} blocks that fill the beacon", said, frames=[wire.heard], shown=True):
            return


@case(
    "TC_BP_FMT_BV_01",
    "Beacons are not larger than BPPAR_MAXIMUM_PACKET_SIZE",
    requirements="BP-FMT-02",
    stimulus="three clients submit the largest payloads they may; VarDis has something to send, and later nothing",
    expect="no larger beacon; all payloads at the latest when no other block keeps them back",
    window=20,
    needs=Needs(
        entities=(), ut=CLIENT, when=lambda bench: "blocks of fixed size" if bench.profile.bp.payload_area else None
    ),
)
def largest_beacons(bench: Bench) -> None:
    limit = bench.bound("BPPAR_MAXIMUM_PACKET_SIZE")
    size = min(largest_payload(bench), limit - header_octets(bench) - block_header_octets(bench))
    with (
        BPClient(bench, ONCE, size=size) as one,
        BPClient(bench, ONCE, size=size) as two,
        BPClient(bench, ONCE, size=size) as three,
    ):
        clients = (one, two, three)
        variable = bench.peer() if bench.pics.vardis is not False else None
        var_id = bench.var_id()
        if variable is not None:
            variable.send(variable.create(var_id))
        start = bench.mark()
        for client in clients:
            client.transmit(client.payload(size))

        def all_sent(_: object = None) -> bool:
            return all(client.frames(start) for client in clients)

        bench.until(all_sent, 3 * bench.reaction)
        if variable is not None and not all_sent():
            # A block that is in every beacon may be served first every time: the order is free (BP-TX-03).
            variable.send(variable.delete(var_id))
            bench.until_quiet(lambda heard: heard.has_vardis and not all_sent())
            bench.until(all_sent, 3 * bench.reaction)
        _check_all_sent(bench, clients)
        large = [heard for heard in bench.heard[start:] if len(heard.octets) > limit]
        most = max((len(heard.octets) for heard in bench.heard[start:]), default=0)
        if large and most <= limit + header_octets(bench):
            bench.reading("X04", "blocks-only")
            large = []
        bench.check(
            not large, f"beacons of at most {limit} octets", f"one has {most}", "BP-FMT-02", frames=large, shown=True
        )


def _check_all_sent(bench: Bench, clients: Sequence[BPClient]) -> None:
    """Check that each client has sent its payload, unless every beacon to the end had a block of somebody else."""
    waiting = [client for client in clients if not client.sent()]
    ours = {client.prot_id for client in clients}
    last = bench.wait(2 * bench.reaction) if waiting else []
    waiting = [client for client in waiting if not client.sent()]
    if waiting and last and all({prot_id for prot_id, _ in each.blocks} - ours for each in last):
        bench.info("Does a block in every beacon keep back the largest payloads?", "yes", "BP-TX-03")
        return
    said = f"{len(waiting)} are missing"
    bench.check(not waiting, "each of the payloads in a beacon", said, "BP-TX-04")


@case(
    "TC_BP_FMT_BV_02",
    "Without a payload there is no beacon",
    requirements="BP-FMT-03",
    stimulus="none, for six periods",
    expect="no beacon without blocks; where all buffers can be asked and are empty, no beacon at all",
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
    bench.check(not bare, "no beacon without blocks", f"{len(bare)} of them", frames=bare, shown=True)
    upper = bench.session.upper
    if heard and upper is not None and LIST in upper.methods:
        # A payload is that of a client.
        clients = set(registered(bench))
        strange = [each for each in heard if not {prot_id for prot_id, _ in each.blocks} & clients]
        said = f"{len(strange)} have none"
        bench.check(not strange, "beacons with a block of a registered protocol", said, frames=strange[:8], shown=True)
    if heard and upper is not None and {"UT-Reset", QUERY} <= upper.methods:
        waiting = [bench.call(QUERY, protId=each).result.get("number") for each in (BP_PROTID_SRP, BP_PROTID_VARDIS)]
        what = f"{len(heard)} beacons came; SRP and VarDis have {waiting} payloads"
        bench.info("Is the implementation silent after a reset?", what, frames=heard[:8])
