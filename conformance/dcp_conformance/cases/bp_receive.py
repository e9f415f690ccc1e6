"""dcp-bp.md: Receive Path.

What has to be ignored is shown by a variable that must not become known, and by a probe behind it that must.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dcp_spec.constants import BP_PROTID_VARDIS, BP_SEQNO_MODULUS, ICType, SpecVersion

from dcp_codec.values import VarSumm
from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, Variant, case
from dcp_conformance.clients import block_header_octets, header_octets, unused_protocol_id
from dcp_conformance.forge import Block, Lies
from dcp_conformance.peers import Peer
from dcp_conformance.services import until_neighbour

Send = Callable[[Peer, VarSumm], object]

NOTHING_KNOWN = "no request for the first variable, a request for the second"


def check_dropped(bench: Bench, send: Send, what: str, *requirements: str) -> None:
    """Check that nothing of what ``send`` sends, which has the summary of an unknown variable, is processed."""
    peer, ignored = bench.peer(), bench.unknown_id()
    send(peer, peer.summary(ignored, 1))
    bench.require_alive(what, *requirements)
    check_unknown(bench, ignored, what, *requirements)


def check_unknown(bench: Bench, var_id: int, what: str, *requirements: str) -> None:
    """Check that nobody has asked for the variable so far."""
    found = bench.instructions(ICType.REQUEST_VARCREATES, var_id)
    bench.check(
        not found,
        f"nothing of {what} is processed",
        "its variable is requested",
        *requirements,
        frames=found,
        shown=True,
    )


def check_processed(bench: Bench, var_ids: Sequence[int], since: int, what: str, *requirements: str) -> None:
    """Check that variables whose summaries were sent after a mark are requested."""
    bench.until(lambda _: not missing(bench, var_ids, since))
    lost = missing(bench, var_ids, since)
    names = ", ".join(str(var_ids.index(each) + 1) for each in lost)
    count = len(var_ids)
    where = f"number {names} of {count} variables is not requested" if count > 1 else "its variable is not requested"
    bench.check(not lost, f"{what} is processed", where, *requirements, frames=bench.heard[since:][-3:])


def _processed_or_discarded(bench: Bench, var_ids: Sequence[int], since: int, what: str) -> None:
    """As :func:`check_processed`, for a beacon whose numPayloads is not the number of blocks that can be extracted.

    An implementation may compare the two and discard the beacon (BP-RX-12). Then it discards one with good blocks only
    and a wrong numPayloads, too.
    """
    bench.until(lambda _: not missing(bench, var_ids, since))
    if missing(bench, var_ids, since):
        peer, others, start = bench.peer(), bench.unknown_ids(2), bench.mark()
        blocks = [Block(unused_protocol_id(bench), bytes(40)), *(summary_block(bench, peer, each) for each in others)]
        # Without a length field nothing tells what follows the last block from padding.
        peer.send(*blocks, lies={"bp.numPayloads": 2 if bench.profile.has_header_field("length") else 4})
        bench.require_alive("a beacon with another number of blocks than it says")
        if missing(bench, others, start) == others:
            bench.info("Is a beacon discarded whose numPayloads is not the number of its blocks?", "yes", "BP-RX-12")
            return
    check_processed(bench, var_ids, since, what)


def missing(bench: Bench, var_ids: Sequence[int], since: int) -> list[int]:
    """Those that were not requested after a mark."""
    asked = {each.var_id for each in bench.instructions(ICType.REQUEST_VARCREATES, since=since)}
    return [each for each in var_ids if each not in asked]


def summary_block(bench: Bench, peer: Peer, var_id: int) -> Block:
    """A VarDis block with the summary of a variable."""
    return bench.forge.vardis(peer.summary(var_id, 1))


def length_is_of_blocks(bench: Bench) -> str | None:
    """For ``Needs.when``: the length field must say what the specification says."""
    if bench.profile.bp.length_means != "blocks":
        return f"in the profile {bench.profile.name} the length field of the header says something else"
    return None


def lengths(since: SpecVersion = SpecVersion.V1_2) -> Needs:
    """For cases about the length field of the header."""
    return Needs(since=since, header=("length", "numPayloads"), when=length_is_of_blocks)


# -- checks of the header ----------------------------------------------------------------------------------------------


@case(
    "TC_BP_RX_BI_01",
    "A beacon with version octet {variant} is dropped",
    requirements="BP-RX-01",
    stimulus="a beacon with the summary of an unknown variable and version octet {variant}; then an honest one",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("version",)),
    variants={"00": 0, "02": 2, "ff": 0xFF},
)
def wrong_version(bench: Bench, version: int) -> None:
    check_dropped(bench, lambda peer, it: peer.send(it, lies={"bp.version": version}), "a beacon of another version")


@case(
    "TC_BP_RX_BI_02",
    "A beacon with magic number {variant} is dropped",
    requirements="BP-RX-02",
    stimulus="a beacon with the summary of an unknown variable and magicNo {variant}; then an honest one",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("magicNo",)),
    variants={each: bytes.fromhex(each) for each in ("497f", "7e49", "487e", "0000", "ffff")},
)
def wrong_magic(bench: Bench, magic: bytes) -> None:
    def send(peer: Peer, summary: VarSumm) -> None:
        octets = magic if bench.profile.types.magic_no.byte_order == "big" else magic[::-1]
        peer.send(summary, lies={"bp.magicNo": octets})

    check_dropped(bench, send, "a beacon with another magic number")


@case(
    "TC_BP_RX_BI_03",
    "A beacon with length 0 in its header is dropped",
    requirements="BP-RX-03",
    stimulus="a beacon with a VarDis block and length 0; then an honest one",
    expect=NOTHING_KNOWN,
    needs=lengths(),
)
def zero_length(bench: Bench) -> None:
    check_dropped(bench, lambda peer, it: peer.send(it, lies={"bp.length": 0}), "a beacon of length 0")


@case(
    "TC_BP_RX_BI_04",
    "A beacon with numPayloads 0 is dropped",
    requirements="BP-RX-04",
    stimulus="a beacon with a VarDis block and numPayloads 0; then an honest one",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("numPayloads",)),
)
def zero_payloads(bench: Bench) -> None:
    check_dropped(bench, lambda peer, it: peer.send(it, lies={"bp.numPayloads": 0}), "a beacon of 0 payloads")


@case(
    "TC_BP_RX_BI_05",
    "A beacon of another network is dropped ({variant})",
    requirements="BP-RX-05",
    stimulus="a beacon with the summary of an unknown variable and a foreign networkId: {variant}; then an honest one",
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
    identifier = other(bench.parameter("BPPAR_NETWORK_ID"), top)
    check_dropped(bench, lambda peer, it: peer.send(it, network_id=identifier), f"a beacon of network {identifier:#x}")


@case(
    "TC_BP_RX_BI_06",
    "A beacon that claims to be the node's own is dropped",
    requirements="BP-RX-06",
    stimulus="a beacon with the summary of an unknown variable and the node's own senderId; then an honest one",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("senderId",)),
)
def own_beacon(bench: Bench) -> None:
    if bench.session.sut_id is None:
        bench.probe()
    own = bench.sut_id
    check_dropped(bench, lambda peer, it: peer.send(it, sender=own), "a beacon with the own identifier")


@case(
    "TC_BP_RX_BI_07",
    "A beacon with two faults in its header is dropped ({variant})",
    requirements="BP-RX-01 BP-RX-02 BP-RX-04",
    stimulus="a beacon with the summary of an unknown variable and two wrong fields; then an honest one",
    expect=NOTHING_KNOWN,
    needs=Needs(header=("version", "magicNo", "numPayloads")),
    variants={
        "version-magicNo": Variant({"bp.version": 2, "bp.magicNo": 0x497F}, requirements="BP-RX-01 BP-RX-02"),
        "version-numPayloads": Variant({"bp.version": 0, "bp.numPayloads": 0}, requirements="BP-RX-01 BP-RX-04"),
        "magicNo-numPayloads": Variant({"bp.magicNo": 0, "bp.numPayloads": 0}, requirements="BP-RX-02 BP-RX-04"),
    },
)
def two_faults(bench: Bench, lies: Lies) -> None:
    check_dropped(bench, lambda peer, it: peer.send(it, lies=lies), "a beacon with two faults")


# -- blocks ------------------------------------------------------------------------------------------------------------


@case(
    "TC_BP_RX_BV_01",
    "Each of {variant} VarDis blocks in a beacon is processed",
    requirements="BP-RX-07",
    stimulus="a beacon with {variant} VarDis blocks, each with the summary of another unknown variable",
    expect="requests for all of the variables",
    variants={"1": 1, "2": 2, "3": 3, "8": 8},
)
def several_blocks(bench: Bench, count: int) -> None:
    peer, var_ids, start = bench.peer(), bench.unknown_ids(count), bench.mark()
    peer.send(*(summary_block(bench, peer, each) for each in var_ids))
    check_processed(bench, var_ids, start, "each block")


@case(
    "TC_BP_RX_BV_02",
    "SRP and VarDis blocks share a beacon ({variant})",
    requirements="BP-RX-07",
    stimulus="a beacon with a state report and the summary of an unknown variable, in the order {variant}",
    expect="a request for the variable; the reporter is in the neighbour table, where that can be asked",
    needs=Needs(entities=("vardis", "srp")),
    variants={"srp-vardis": True, "vardis-srp": False},
)
def two_protocols(bench: Bench, report_first: bool) -> None:
    upper = bench.session.upper
    asks = upper is not None and "SRP-NeighbourTable" in upper.methods
    control = bench.peer()
    if asks:
        control.send(bench.report(control.node_id, 1))
    # Where no record at all is stored, the fault is not that of BP.
    stores = asks and until_neighbour(bench, control.node_id) is not None
    peer, var_id, start = bench.peer(), bench.unknown_id(), bench.mark()
    blocks = [bench.forge.srp(bench.report(peer.node_id, 1)), summary_block(bench, peer, var_id)]
    peer.send(*(blocks if report_first else blocks[::-1]))
    # The entry may be gone by the time of the beacon with the request: a beacon period can be longer than the timeout.
    found = until_neighbour(bench, peer.node_id) if stores else None
    check_processed(bench, [var_id], start, "the VarDis block")
    if stores:
        bench.check(found, "the SRP block is processed", "its sender is not in the neighbour table")
    elif asks:
        bench.inconclusive("a record alone in a beacon is stored, which the rest of this case needs", "it is not")


@case(
    "TC_BP_RX_BV_03",
    "A block of a protocol that is not registered is skipped ({variant})",
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
    var_ids = bench.unknown_ids(sum(each is None for each in layout))
    waiting = iter(var_ids)
    blocks = [
        # Octets that would be containers, were they VarDis'.
        Block(unused_protocol_id(bench), bytes([6, 1, 9]) * (each[0] // 3) + bytes(each[0] % 3))
        if each is not None
        else summary_block(bench, peer, next(waiting))
        for each in layout
    ]
    peer.send(*blocks)
    check_processed(bench, var_ids, start, "each VarDis block")


@case(
    "TC_BP_RX_BI_08",
    "A VarDis payload under the identifier {variant} is not given to VarDis",
    requirements="BP-HDR-11 BP-RX-08",
    stimulus="a beacon with the summary of an unknown variable in a block of protocol {variant}; then an honest one",
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
        peer.send(Block(prot_id, bench.forge.vardis(summary).octets))

    check_dropped(bench, send, f"a block of protocol {prot_id:#06x}", "BP-HDR-11", "BP-RX-08")


@case(
    "TC_BP_RX_BI_09",
    "A block that claims {variant} ends the parsing; blocks before it stay delivered",
    requirements="BP-RX-09",
    stimulus="a beacon with a good VarDis block and another one whose length field says {variant}; then an honest one",
    expect="none of the variable of the bad block, a request for the third; one for that of the good block, unless "
    "numPayloads is compared with the blocks and the beacon discarded (BP-RX-12)",
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
    peer, (good, bad), start = bench.peer(), bench.unknown_ids(2), bench.mark()
    last = summary_block(bench, peer, bad)
    # Bearers pad short frames, and before 1.2 nothing tells padding from the last block.
    filler = Block(unused_protocol_id(bench), bytes(40))
    lies = {"payloads[2].length": claimed(len(last.octets))}
    peer.send(filler, summary_block(bench, peer, good), last, lies=lies)
    _processed_or_discarded(bench, [good], start, "the block in front of the one that is too long")
    bench.require_alive("a block that is longer than its beacon")
    check_unknown(bench, bad, "the block that is longer than its beacon")


@case(
    "TC_BP_RX_BI_10",
    "A single block that is longer than its beacon is not delivered ({variant})",
    requirements="BP-RX-09",
    stimulus="a beacon with one VarDis block whose length field says too much: {variant}; then an honest one",
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
        # Long enough not to be padded by the bearer.
        block = bench.forge.vardis(*[summary] * 25)
        peer.send(block, lies={"payloads[0].length": len(block.octets) + more})

    check_dropped(bench, send, "a block that is longer than its beacon")


@case(
    "TC_BP_RX_BI_11",
    "{variant} octets behind the last block are no block",
    requirements="BP-RX-09",
    stimulus="a beacon with a good VarDis block and {variant} octets of a payload header, which length and numPayloads "
    "count; then an honest one",
    expect="requests for both variables",
    needs=lengths(),
    variants={"1": 1, "2": 2, "3": 3},
)
def cut_payload_header(bench: Bench, count: int) -> None:
    peer, var_id, start = bench.peer(), bench.unknown_id(), bench.mark()
    block = summary_block(bench, peer, var_id)
    # What every VarDis block begins with, as the profile has it.
    header = block_header_octets(bench)
    tail = bench.forge.beacon(peer.node_id, 0, [block])[header_octets(bench) :]
    size = header + len(block.octets) + count
    peer.send(block, lies={"bp.length": size, "bp.numPayloads": 2}, padding=tail[:count])
    _processed_or_discarded(bench, [var_id], start, "the block in front of a piece of a payload header")
    bench.require_alive("a piece of a payload header")


@case(
    "TC_BP_RX_BV_04",
    "A block of length 0 is survived ({variant})",
    requirements="BP-RX-16 BP-RX-08",
    stimulus="a beacon with a block of length 0 ({variant}) and a VarDis block with the summary of an unknown variable",
    expect="a request for the variable of the next beacon; behind one of no registered protocol the VarDis "
    "block is processed, else that is reported",
    variants={"vardis": BP_PROTID_VARDIS, "unregistered": None},
    robustness=True,
    destructive=True,
)
def empty_block(bench: Bench, prot_id: int | None) -> None:
    peer, var_id = bench.peer(), bench.unknown_id()
    empty = Block(unused_protocol_id(bench) if prot_id is None else prot_id, b"")
    peer.send(empty, summary_block(bench, peer, var_id))
    processed = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id) is not None
    if prot_id is None:
        # Its steps are those of any block that is skipped.
        expected = "the block behind an empty one of a protocol that is not registered is processed"
        bench.check(processed, expected, "its variable is not requested", "BP-RX-08")
    else:
        bench.info("Is a block behind one of length 0 processed?", "yes" if processed else "no")
    bench.require_alive("a block of length 0")


# -- numbers that are not checked --------------------------------------------------------------------------------------


@case(
    "TC_BP_RX_BV_05",
    "Beacon sequence numbers are not checked ({variant})",
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
    peer, var_ids, start = bench.peer(), bench.unknown_ids(len(numbers)), bench.mark()
    for number, var_id in zip(numbers, var_ids, strict=True):
        peer.seqno = number
        peer.send(peer.summary(var_id, 1))
    check_processed(bench, var_ids, start, "each beacon")


@case(
    "TC_BP_RX_BI_12",
    "numPayloads {variant} for two blocks is survived",
    requirements="BP-RX-12",
    stimulus="a beacon with two VarDis blocks and numPayloads {variant}; then an honest one",
    expect="a request for the variable of the honest beacon; what else is processed is reported",
    needs=Needs(header=("numPayloads",)),
    variants={"1": 1, "3": 3, "255": 255},
    robustness=True,
)
def other_number_of_payloads(bench: Bench, claimed: int) -> None:
    peer, var_ids, start = bench.peer(), bench.unknown_ids(2), bench.mark()
    peer.send(*(summary_block(bench, peer, each) for each in var_ids), lies={"bp.numPayloads": claimed})
    bench.require_alive("a wrong number of payloads")
    lost = missing(bench, var_ids, start)
    what = {0: "both", 2: "none"}.get(len(lost), "the first only" if lost == var_ids[1:] else "the second only")
    bench.info(f"numPayloads says {claimed} and there are 2 blocks: which are processed?", what)
