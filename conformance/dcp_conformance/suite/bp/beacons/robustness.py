"""dcp-bp.md: Receive Path, octets that are not a beacon.

The implementation must survive any received octets, including beacons of other versions of the specification.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from functools import cache

import msgspec
from dcp_spec.constants import BP_MAGIC_NO, BP_VERSION, ICType
from dcp_spec.profile.definition import IntType, NodeIdType
from dcp_spec.profile.loading import load_profile

from dcp_codec import Codec
from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.builder import Block, FrameBuilder
from dcp_conformance.frames.sampling import plain
from dcp_conformance.test_steps.bp_clients import block_header_octets, header_octets, unused_protocol_id
from dcp_conformance.test_system.bench import Bench

#: The header layouts of the versions of the specification.
_LAYOUTS = {"1.0": "dcp-1.0", "1.1": "dcp-1.1", "1.2-and-1.3": "dcp-1.3", "2.0": "dcp-2.0"}

_CHECKED = {
    "bp.version": "BP-RX-01",
    "bp.magicNo": "BP-RX-02",
    "bp.length": "BP-RX-03",
    "bp.numPayloads": "BP-RX-04",
    "bp.networkId": "BP-RX-05",
}


def broken_rule(bench: Bench, octets: bytes) -> str:
    """Return the requirement for which a receiver must drop these octets because of their header; empty if there is
    none.
    """
    root = bench.codec.dissect(octets).root
    network = bench.sut.parameter("BPPAR_NETWORK_ID")
    says = {
        path: field.value for path in _CHECKED if (field := root.find(path)) is not None and field.value is not None
    }
    for path, value in says.items():
        if not {
            "bp.version": value == BP_VERSION,
            "bp.magicNo": value == BP_MAGIC_NO,
            "bp.networkId": value == network,
        }.get(path, value != 0):
            return _CHECKED[path]
    return ""


@cache
def _layout_of(name: str, node_id: NodeIdType, var_id: IntType) -> Codec:
    """Return the layout of a version, with the identifier types of the implementation: the specification leaves them
    open.
    """
    other = load_profile(name)
    types = msgspec.structs.replace(other.types, node_id=node_id, var_id=var_id)
    return Codec(msgspec.structs.replace(other, types=types))


def _other_layout(name: str) -> Needs:
    def when(bench: Bench) -> str | None:
        if not bench.profile.bp.header:
            return f"the profile {bench.profile.name} has no beacon header"
        if load_profile(name).bp.header == bench.profile.bp.header:
            return "this is the layout of the profile itself"
        return None

    return Needs(when=when)


@case(
    "TC_BP_RX_BI_20",
    "A receiver survives beacons in the layout of version 1.0, and drops them if their header breaks a rule",
    requirements="BP-RX-16",
    stimulus="two beacons in the layout of 1.0 with summaries of unknown variables; then a valid beacon",
    expect="a request for the variable of the valid beacon; none for variables of beacons with an invalid header",
    needs=_other_layout("dcp-1.0"),
    value="dcp-1.0",
)
@case(
    "TC_BP_RX_BI_21",
    "A receiver survives beacons in the layout of version 1.1, and drops them if their header breaks a rule",
    requirements="BP-RX-16",
    stimulus="two beacons in the layout of 1.1 with summaries of unknown variables; then a valid beacon",
    expect="a request for the variable of the valid beacon; none for variables of beacons with an invalid header",
    needs=_other_layout("dcp-1.1"),
    value="dcp-1.1",
)
@case(
    "TC_BP_RX_BI_22",
    "A receiver survives beacons in the layout of versions 1.2 and 1.3, and drops them if their header breaks a rule",
    requirements="BP-RX-16",
    stimulus="two beacons in the layout of 1.2 with summaries of unknown variables; then a valid beacon",
    expect="a request for the variable of the valid beacon; none for variables of beacons with an invalid header",
    needs=_other_layout("dcp-1.3"),
    value="dcp-1.3",
)
@case(
    "TC_BP_RX_BI_23",
    "A receiver survives beacons in the layout of version 2.0, and drops them if their header breaks a rule",
    requirements="BP-RX-16",
    stimulus="two beacons in the layout of 2.0 with summaries of unknown variables; then a valid beacon",
    expect="a request for the variable of the valid beacon; none for variables of beacons with an invalid header",
    needs=_other_layout("dcp-2.0"),
    value="dcp-2.0",
    # In other layouts the header has a length of 4369 octets, more than the frame (X02).
    destructive=True,
)
def foreign_layout(bench: Bench, name: str) -> None:
    """Send a short and a long beacon in another version's layout; each must be dropped if its header breaks a rule."""
    types = bench.profile.types
    codec, peer = _layout_of(name, types.node_id, types.var_id), bench.peer()
    builder = FrameBuilder(codec)
    sent = []
    for number, filler in enumerate((0, 300)):
        var_id = bench.unknown_id()
        blocks = [Block(0x7777, bytes(filler))] * (filler > 0) + [builder.vardis(plain(peer.summary(var_id, 1)))]
        network = bench.sut.parameter("BPPAR_NETWORK_ID") if codec.profile.has_header_field("networkId") else None
        octets = builder.beacon(peer.node_id, 258 + number, blocks, network_id=network)
        peer.send_octets(octets)
        sent.append((var_id, octets, f"a beacon of {len(octets)} octets in the layout of {codec.profile.spec_version}"))
    bench.require_alive("beacons in the layout of another version")
    for var_id, octets, what in sent:
        found = bench.instructions(ICType.REQUEST_VARCREATES, var_id)
        if rule := broken_rule(bench, octets):
            bench.none(found, f"{what} is dropped ({rule})", rule)
        else:
            bench.info(f"Is {what} processed?", "yes" if found else "no")


@case(
    "TC_BP_RX_BI_24",
    "A receiver survives beacons that end within their header",
    requirements="BP-RX-16",
    stimulus=(
        "a valid beacon truncated after each octet of its header and its first payload header, from 0 octets on; "
        "then a valid beacon; all of it twice"
    ),
    expect="no truncated beacon is processed; a request for the variable of the valid beacon",
    needs=Needs(header=("senderId",)),
    destructive=True,
)
def cut_headers(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.unknown_id()

    def send() -> None:
        for octets in range(header_octets(bench) + block_header_octets(bench) + 1):
            peer.send(peer.summary(var_id, 1), cut=octets)

    _survives(bench, send, "beacons truncated within their headers")
    found = bench.instructions(ICType.REQUEST_VARCREATES, var_id)
    bench.none(found, "no request for the variable of the truncated beacons")


@case(
    "TC_BP_RX_BI_25",
    "A receiver survives beacons that end within a block",
    requirements="BP-RX-16",
    stimulus="a beacon with two VarDis blocks truncated after each octet of its blocks; then a valid beacon; twice",
    expect="a request for the variable of the valid beacon",
    destructive=True,
    robustness=True,
)
def cut_blocks(bench: Bench) -> None:
    peer, (first, second) = bench.peer(), bench.identifiers.unknown_ids(2)
    blocks = [bench.builder.vardis(peer.summary(each, 1)) for each in (first, second)]
    whole = peer.beacon(*blocks)
    begin, area = header_octets(bench), bench.profile.bp.payload_area

    def send() -> None:
        # In blocks of fixed size most octets carry no meaning.
        for octets in range(begin, len(whole), 97 if area else 1):
            peer.send_octets(whole[:octets])

    _survives(bench, send, "beacons truncated within their blocks")


def _survives(bench: Bench, send: Callable[[], None], what: str) -> None:
    """Send twice; the implementation must answer after each time.

    A frame right after a start may come before the implementation can receive it. Its answer to the first probe shows
    that it receives what comes the second time.
    """
    for _ in range(2):
        send()
        bench.require_alive(what)


def _arbitrary(seed: int) -> Iterator[bytes]:
    rng = random.Random(seed)  # noqa: S311 - the same octets every time, no secret
    for _ in range(40):
        yield rng.randbytes(rng.choice((0, 1, 2, 14, 17, 18, 19, 46, 100, 500)))


@case(
    "TC_BP_RX_BI_26",
    "A receiver survives random octets (series {variant})",
    requirements="BP-RX-16",
    stimulus="40 frames of 0 to 500 random octets; then a valid beacon; twice",
    expect="a request for the variable of the valid beacon",
    variants={"1": 1, "2": 2},
    destructive=True,
)
def arbitrary_octets(bench: Bench, seed: int) -> None:
    peer = bench.peer()

    def send() -> None:
        for octets in _arbitrary(seed):
            peer.send_octets(octets)

    _survives(bench, send, "frames of random octets")


@case(
    "TC_BP_RX_BI_27",
    "A receiver survives random octets after a valid header (series {variant})",
    requirements="BP-RX-16",
    stimulus=(
        "40 beacons with a header that is valid except for length and numPayloads, followed by random octets; then "
        "a valid beacon; all of it twice"
    ),
    expect="a request for the variable of the valid beacon",
    needs=Needs(header=("numPayloads",)),
    variants={"1": 1, "2": 2},
    destructive=True,
    robustness=True,
)
def arbitrary_blocks(bench: Bench, seed: int) -> None:
    peer = bench.peer()

    def send() -> None:
        rng = random.Random(seed)  # noqa: S311 - as above
        for octets in _arbitrary(seed):
            lies: dict[str, int | bytes] = {"bp.numPayloads": rng.randint(1, 255)}
            if bench.profile.has_header_field("length"):
                # Mostly the true length, so that the blocks are parsed.
                lies["bp.length"] = max(1, len(octets) + rng.choice((0, 0, 0, -1, 1, 5000)))
            header = peer.beacon(Block(unused_protocol_id(bench), b""), lies=lies)[: header_octets(bench)]
            peer.send_octets(header + octets)

    _survives(bench, send, "beacons of random octets")


@case(
    "TC_BP_RX_BI_28",
    "A receiver survives every wrong length of a single block up to its true length plus 8",
    requirements="BP-RX-16",
    stimulus=(
        "beacons with a VarDis block whose length field has the values 0, 1, ... up to the true length plus 8; then a "
        "valid beacon; all of it twice"
    ),
    expect="a request for the variable of a valid beacon",
    needs=Needs(header=("numPayloads",)),
    destructive=True,
    robustness=True,
)
def block_lengths(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.unknown_id()
    block = bench.builder.vardis(peer.summary(var_id, 1), peer.update(var_id, 2))

    def send() -> None:
        for length in range(len(block.octets) + 9):
            peer.send(block, lies={"payloads[0].length": length})

    _survives(bench, send, "beacons with wrong block lengths")
