"""dcp-bp.md: Receive Path.

To prove that a beacon was dropped, its variable must not be requested, and that of a probe sent after it must be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dcp_spec.constants import BP_PROTID_VARDIS, BP_SEQNO_MODULUS, ICType, SpecVersion

from dcp_codec.values import VarSumm
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.frames.builder import Block, Lies
from dcp_conformance.test_steps.bp_clients import block_header_octets, header_octets, unused_protocol_id
from dcp_conformance.test_steps.services import until_neighbour
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

Send = Callable[[Peer, VarSumm], object]

NOTHING_KNOWN = "no request for the first variable; a request for the second"


def check_dropped(bench: Bench, send: Send, what: str, *requirements: str) -> None:
    """Check that the beacon sent by ``send``, with the summary of an unknown variable, is not processed."""
    peer, ignored = bench.peer(), bench.unknown_id()
    send(peer, peer.summary(ignored, 1))
    bench.require_alive(what, *requirements)
    check_unknown(bench, ignored, what, *requirements)


def check_unknown(bench: Bench, var_id: int, what: str, *requirements: str) -> None:
    """Check that the implementation has not requested the variable so far."""
    bench.none(bench.instructions(ICType.REQUEST_VARCREATES, var_id), f"{what} is not processed", *requirements)


def check_processed(bench: Bench, var_ids: Sequence[int], since: int, what: str, *requirements: str) -> None:
    """Check that variables whose summaries were sent after a mark are requested."""
    bench.until(lambda _: not missing(bench, var_ids, since))
    lost = [f"request for variable {var_ids.index(each) + 1}" for each in missing(bench, var_ids, since)]
    bench.complete(lost, f"{what} is processed", *requirements, frames=bench.heard[since:][-3:])


def _processed_or_discarded(bench: Bench, var_ids: Sequence[int], since: int, what: str) -> None:
    """As :func:`check_processed`, for a beacon whose numPayloads differs from the number of extractable blocks.

    An implementation may compare the two numbers and discard the beacon (BP-RX-12). It then also discards a beacon with
    valid blocks only and a wrong numPayloads.
    """
    bench.until(lambda _: not missing(bench, var_ids, since))
    if missing(bench, var_ids, since):
        peer, others, start = bench.peer(), bench.identifiers.unknown_ids(2), bench.mark()
        blocks = [Block(unused_protocol_id(bench), bytes(40)), *(summary_block(bench, peer, each) for each in others)]
        # Without a length field, padding cannot be told from a further block.
        peer.send(*blocks, lies={"bp.numPayloads": 2 if bench.profile.has_header_field("length") else 4})
        bench.require_alive("a beacon whose numPayloads differs from its number of blocks")
        if missing(bench, others, start) == others:
            bench.info(
                "Is a beacon discarded if its numPayloads differs from the number of its blocks?", "yes", "BP-RX-12"
            )
            return
    check_processed(bench, var_ids, since, what)


def missing(bench: Bench, var_ids: Sequence[int], since: int) -> list[int]:
    """Return the variables that were not requested after a mark."""
    asked = {each.var_id for each in bench.instructions(ICType.REQUEST_VARCREATES, since=since)}
    return [each for each in var_ids if each not in asked]


def summary_block(bench: Bench, peer: Peer, var_id: int) -> Block:
    """Return a VarDis block with the summary of a variable."""
    return bench.builder.vardis(peer.summary(var_id, 1))


def length_is_of_blocks(bench: Bench) -> str | None:
    """Return why the length field does not have the meaning of the specification, or None; for ``Needs.when``."""
    if bench.profile.bp.length_means != "blocks":
        return f"in the profile {bench.profile.name} the length field of the header has another meaning"
    return None


def lengths(since: SpecVersion = SpecVersion.V1_2) -> Needs:
    """Return the needs of cases about the length field of the header."""
    return Needs(since=since, header=("length", "numPayloads"), when=length_is_of_blocks)


# -- checks of the header ----------------------------------------------------------------------------------------------


@case(
    "TC_BP_RX_BI_01",
    "A beacon with version octet {variant} is dropped",
    requirements="BP-RX-01",
    stimulus="a beacon with the summary of an unknown variable and version octet {variant}; then a valid beacon",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("version",)),
    variants={f"{each:02x}": each for each in (0, 2, 0xFF, 0x11, 0x21, 0x41, 0x81)},
)
def wrong_version(bench: Bench, version: int) -> None:
    check_dropped(bench, lambda peer, it: peer.send(it, lies={"bp.version": version}), "a beacon with another version")


@case(
    "TC_BP_RX_BI_02",
    "A beacon with magicNo {variant} is dropped",
    requirements="BP-RX-02",
    stimulus="a beacon with the summary of an unknown variable and magicNo {variant}; then a valid beacon",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("magicNo",)),
    variants={each: bytes.fromhex(each) for each in ("497f", "7e49", "487e", "0000", "ffff")},
)
def wrong_magic(bench: Bench, magic: bytes) -> None:
    def send(peer: Peer, summary: VarSumm) -> None:
        octets = magic if bench.profile.types.magic_no.byte_order == "big" else magic[::-1]
        peer.send(summary, lies={"bp.magicNo": octets})

    check_dropped(bench, send, "a beacon with another magicNo")


@case(
    "TC_BP_RX_BI_03",
    "A beacon with length 0 in its header is dropped",
    requirements="BP-RX-03",
    stimulus="a beacon with a VarDis block and length 0; then a valid beacon",
    expect=NOTHING_KNOWN,
    needs=lengths(),
    value="length",
)
@case(
    "TC_BP_RX_BI_04",
    "A beacon with numPayloads 0 is dropped",
    requirements="BP-RX-04",
    stimulus="a beacon with a VarDis block and numPayloads 0; then a valid beacon",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("numPayloads",)),
    value="numPayloads",
)
def zero_field(bench: Bench, name: str) -> None:
    check_dropped(bench, lambda peer, it: peer.send(it, lies={f"bp.{name}": 0}), f"a beacon with {name} 0")


@case(
    "TC_BP_RX_BI_05",
    "A beacon of another network is dropped ({variant})",
    requirements="BP-RX-05",
    stimulus="a beacon with the summary of an unknown variable and another networkId ({variant}); then a valid beacon",
    expect=NOTHING_KNOWN,
    needs=Needs(since=SpecVersion.V2_0, header=("networkId",)),
    variants={
        "next": lambda own, top: (own + 1) & top,
        "first-bit": lambda own, top: own ^ (top + 1) >> 1,
        "last-bit": lambda own, _: own ^ 1,
        "inverted": lambda own, top: own ^ top,
        "zero": lambda own, _: 0 if own else 1,
        "all-ones": lambda own, top: top if own != top else 1,
    },
)
def foreign_network(bench: Bench, other: Callable[[int, int], int]) -> None:
    top = (1 << (8 * bench.profile.types.network_id.width)) - 1
    identifier = other(bench.sut.parameter("BPPAR_NETWORK_ID"), top)
    check_dropped(bench, lambda peer, it: peer.send(it, network_id=identifier), f"a beacon of network {identifier:#x}")


@case(
    "TC_BP_RX_BI_06",
    "A beacon with the node's own senderId is dropped",
    requirements="BP-RX-06",
    stimulus="a beacon with the summary of an unknown variable and the node's own senderId; then a valid beacon",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("senderId",)),
)
def own_beacon(bench: Bench) -> None:
    if bench.session.sut_id is None:
        bench.probes.probe()
    own = bench.identifiers.sut_id
    check_dropped(bench, lambda peer, it: peer.send(it, sender=own), "a beacon with its own senderId")


@case(
    "TC_BP_RX_BI_07",
    "A beacon with two faults in its header is dropped ({variant})",
    requirements="BP-RX-01 BP-RX-02 BP-RX-04",
    stimulus="a beacon with the summary of an unknown variable and two wrong fields; then a valid beacon",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("version", "magicNo", "numPayloads")),
    variants={
        "version-magicNo": Variant({"bp.version": 2, "bp.magicNo": 0x497F}, requirements="BP-RX-01 BP-RX-02"),
        "version-numPayloads": Variant({"bp.version": 0, "bp.numPayloads": 0}, requirements="BP-RX-01 BP-RX-04"),
        "magicNo-numPayloads": Variant({"bp.magicNo": 0, "bp.numPayloads": 0}, requirements="BP-RX-02 BP-RX-04"),
    },
)
def two_faults(bench: Bench, lies: Lies) -> None:
    check_dropped(bench, lambda peer, it: peer.send(it, lies=lies), "a beacon with two wrong header fields")


# -- blocks ------------------------------------------------------------------------------------------------------------


@case(
    "TC_BP_RX_BV_01",
    "All VarDis blocks in a beacon are processed (blocks: {variant})",
    requirements="BP-RX-07",
    stimulus="a beacon with VarDis blocks, each with the summary of a different unknown variable (blocks: {variant})",
    expect="requests for all variables",
    variants={"1": 1, "2": 2, "3": 3, "8": 8},
)
def several_blocks(bench: Bench, count: int) -> None:
    peer, var_ids, start = bench.peer(), bench.identifiers.unknown_ids(count), bench.mark()
    peer.send(*(summary_block(bench, peer, each) for each in var_ids))
    check_processed(bench, var_ids, start, "each block")


@case(
    "TC_BP_RX_BV_02",
    "SRP and VarDis blocks in the same beacon are processed ({variant})",
    requirements="BP-RX-07",
    stimulus="a beacon with a state report and the summary of an unknown variable, in the order {variant}",
    expect="a request for the variable; an entry for the sender in the neighbour table, if it can be queried",
    needs=Needs(entities=("vardis", "srp")),
    variants={"srp-vardis": True, "vardis-srp": False},
)
def two_protocols(bench: Bench, report_first: bool) -> None:
    asks, control = bench.services.offers("SRP-NeighbourTable"), bench.peer()
    if asks:
        control.send(bench.records.report(control.node_id, 1))
    # If an SRP record alone in a beacon is not stored either, the fault is not one of BP.
    stores = asks and until_neighbour(bench, control.node_id) is not None
    peer, var_id, start = bench.peer(), bench.unknown_id(), bench.mark()
    blocks = [bench.builder.srp(bench.records.report(peer.node_id, 1)), summary_block(bench, peer, var_id)]
    peer.send(*(blocks if report_first else blocks[::-1]))
    # Query the neighbour table first: the entry may time out before the beacon with the request is sent.
    found = until_neighbour(bench, peer.node_id) if stores else None
    check_processed(bench, [var_id], start, "the VarDis block")
    if stores:
        bench.some(found, "the sender of the SRP block in the neighbour table", seen="no entry for it")
    elif asks:
        bench.inconclusive("an SRP record alone in a beacon is stored, which the rest of this case needs", "not stored")


@case(
    "TC_BP_RX_BV_03",
    "A block of an unregistered protocol is skipped ({variant})",
    requirements="BP-RX-08",
    stimulus="a beacon with VarDis blocks and blocks of unregistered protocols: {variant}",
    expect="requests for the variables of all VarDis blocks",
    variants={
        "first": ((1,), None),
        "last": (None, (1,)),
        "between": (None, (40,), None),
        "several": ((3,), (200,), None, (1,), None, (5,)),
        "long": ((300,), None),
        "many": Variant((*[(1,)] * 60, None), requirements="BP-RX-07 BP-RX-08"),
    },
)
def unregistered_blocks(bench: Bench, layout: Sequence[tuple[int] | None]) -> None:
    peer, start = bench.peer(), bench.mark()
    var_ids = bench.identifiers.unknown_ids(sum(each is None for each in layout))
    waiting = iter(var_ids)
    blocks = [
        # For VarDis these octets would be instruction containers.
        Block(unused_protocol_id(bench), bytes([6, 1, 9]) * (each[0] // 3) + bytes(each[0] % 3))
        if each is not None
        else summary_block(bench, peer, next(waiting))
        for each in layout
    ]
    peer.send(*blocks)
    check_processed(bench, var_ids, start, "each VarDis block")


@case(
    "TC_BP_RX_BI_08",
    "A VarDis payload with protocolId {variant} is not given to VarDis",
    requirements="BP-HDR-11 BP-RX-08",
    stimulus="a beacon with the summary of an unknown variable in a block of protocol {variant}; then a valid beacon",
    expect=NOTHING_KNOWN,
    variants={"0200": 0x0200, "0102": 0x0102, "0202": 0x0202, "8002": 0x8002, "0003": 3},
    needs=Needs(
        when=lambda bench: (
            None if bench.profile.types.protocol_id.width > 1 else "protocol identifiers of the profile have one octet"
        )
    ),
)
def other_protocol_ids(bench: Bench, prot_id: int) -> None:
    def send(peer: Peer, summary: VarSumm) -> None:
        peer.send(Block(prot_id, bench.builder.vardis(summary).octets))

    check_dropped(bench, send, f"a block of protocol {prot_id:#06x}", "BP-HDR-11 BP-RX-08")


@case(
    "TC_BP_RX_BI_09",
    "Parsing ends at a block that extends past the end of its beacon; the blocks before it are delivered ({variant})",
    requirements="BP-RX-09",
    stimulus="a beacon with a valid VarDis block and one with a wrong length ({variant}); then a valid beacon",
    expect=(
        "no request for the variable of the bad block, a request for that of the valid beacon; a request for that "
        "of the good block, unless the beacon is discarded because numPayloads differs from its number of blocks "
        "(BP-RX-12)"
    ),
    needs=Needs(
        since=SpecVersion.V1_1,
        header=("numPayloads",),
        when=lambda bench: length_is_of_blocks(bench) if bench.profile.has_header_field("length") else None,
    ),
    variants={
        "one-octet-too-many": lambda n: n + 1,
        "100-octets-too-many": lambda n: n + 100,
        "65535": lambda _: 0xFFFF,
    },
)
def block_past_the_end(bench: Bench, claimed: Callable[[int], int]) -> None:
    peer, (good, bad), start = bench.peer(), bench.identifiers.unknown_ids(2), bench.mark()
    last = summary_block(bench, peer, bad)
    # Bearers pad short frames, and before 1.2 padding cannot be told from the last block.
    filler = Block(unused_protocol_id(bench), bytes(40))
    lies = {"payloads[2].length": claimed(len(last.octets))}
    peer.send(filler, summary_block(bench, peer, good), last, lies=lies)
    _processed_or_discarded(bench, [good], start, "the block before the one that is too long")
    bench.require_alive("a block that extends past the end of its beacon")
    check_unknown(bench, bad, "the block that extends past the end of its beacon")


@case(
    "TC_BP_RX_BI_10",
    "A single block that extends past the end of its beacon is not delivered ({variant})",
    requirements="BP-RX-09",
    stimulus="a beacon with one VarDis block whose length is too large ({variant}); then a valid beacon",
    expect=NOTHING_KNOWN,
    needs=Needs(
        since=SpecVersion.V1_1,
        header=("numPayloads",),
        when=lambda bench: length_is_of_blocks(bench) if bench.profile.has_header_field("length") else None,
    ),
    variants={"by-1": 1, "by-4": 4, "by-1000": 1000},
)
def only_block_past_the_end(bench: Bench, more: int) -> None:
    def send(peer: Peer, summary: VarSumm) -> None:
        # Long enough not to need padding by the bearer.
        block = bench.builder.vardis(*[summary] * 25)
        peer.send(block, lies={"payloads[0].length": len(block.octets) + more})

    check_dropped(bench, send, "a block that extends past the end of its beacon")


@case(
    "TC_BP_RX_BI_11",
    "An incomplete payload header after the last block is not a block (octets: {variant})",
    requirements="BP-RX-09",
    stimulus=(
        "a beacon with a valid VarDis block and the first {variant} octets of a payload header, counted by length "
        "and numPayloads; then a valid beacon"
    ),
    expect="requests for both variables",
    needs=lengths(),
    variants={"1": 1, "2": 2, "3": 3},
)
def cut_payload_header(bench: Bench, count: int) -> None:
    peer, var_id, start = bench.peer(), bench.unknown_id(), bench.mark()
    block = summary_block(bench, peer, var_id)
    # The header of a VarDis block, encoded according to the profile.
    header = block_header_octets(bench)
    tail = bench.builder.beacon(peer.node_id, 0, [block])[header_octets(bench) :]
    size = header + len(block.octets) + count
    peer.send(block, lies={"bp.length": size, "bp.numPayloads": 2}, padding=tail[:count])
    _processed_or_discarded(bench, [var_id], start, "the block before an incomplete payload header")
    bench.require_alive("an incomplete payload header")


@case(
    "TC_BP_RX_BV_04",
    "A receiver survives a block of length 0 ({variant})",
    requirements="BP-RX-16 BP-RX-08",
    stimulus="a beacon with a block of length 0 ({variant}) and a VarDis block with the summary of an unknown variable",
    expect=(
        "a request for the variable of the next beacon; the VarDis block after an empty one of an unregistered "
        "protocol is processed, otherwise the case reports whether it is"
    ),
    variants={"vardis": BP_PROTID_VARDIS, "unregistered": None},
    robustness=True,
    destructive=True,
)
def empty_block(bench: Bench, prot_id: int | None) -> None:
    peer, var_id = bench.peer(), bench.unknown_id()
    peer.send(Block(unused_protocol_id(bench) if prot_id is None else prot_id, b""), summary_block(bench, peer, var_id))
    processed = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id) is not None
    if prot_id is None:
        # Such a block is skipped like any other block of an unregistered protocol.
        bench.some(processed, "the block after an empty one of an unregistered protocol is processed", "BP-RX-08")
    else:
        bench.info("Is the block after a VarDis block of length 0 processed?", "yes" if processed else "no")
    bench.require_alive("a block of length 0")


# -- numbers that are not checked --------------------------------------------------------------------------------------


@case(
    "TC_BP_RX_BV_05",
    "Receivers accept any beacon sequence number ({variant})",
    requirements="BP-RX-10",
    stimulus="beacons of one sender with summaries of different unknown variables; sequence numbers: {variant}",
    expect="requests for the variables of all beacons",
    needs=Needs(since=SpecVersion.V1_1, header=("seqno",)),
    variants={
        "repeated": (41, 41, 41),
        "decreasing": (1000, 999, 5, 0),
        "jumping": (7, 1_000_000, 3_000_000_000),
        "wrapping": (BP_SEQNO_MODULUS - 1, 0, 1),
    },
)
def seqno_not_checked(bench: Bench, numbers: Sequence[int]) -> None:
    peer, var_ids, start = bench.peer(), bench.identifiers.unknown_ids(len(numbers)), bench.mark()
    for number, var_id in zip(numbers, var_ids, strict=True):
        peer.seqno = number
        peer.send(peer.summary(var_id, 1))
    check_processed(bench, var_ids, start, "each beacon")


@case(
    "TC_BP_RX_BI_12",
    "A receiver survives numPayloads {variant} in a beacon of two blocks",
    requirements="BP-RX-12",
    stimulus="a beacon with two VarDis blocks and numPayloads {variant}; then a valid beacon",
    expect="a request for the variable of the valid beacon; the case reports which blocks are processed",
    needs=Needs(header=("numPayloads",)),
    variants={"1": 1, "3": 3, "255": 255},
    robustness=True,
)
def other_number_of_payloads(bench: Bench, claimed: int) -> None:
    peer, var_ids, start = bench.peer(), bench.identifiers.unknown_ids(2), bench.mark()
    peer.send(*(summary_block(bench, peer, each) for each in var_ids), lies={"bp.numPayloads": claimed})
    bench.require_alive("a wrong numPayloads")
    lost = missing(bench, var_ids, start)
    what = {0: "both", 2: "none"}.get(len(lost), "the first only" if lost == var_ids[1:] else "the second only")
    bench.info(f"Which blocks are processed if numPayloads is {claimed} and the beacon has 2 blocks?", what)
