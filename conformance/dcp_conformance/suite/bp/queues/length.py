"""dcp-bp.md: Receive Path, the length field of the header.

How a receiver finds the end of a beacon: bearers pad short frames, and senders may send a wrong length.
"""

from __future__ import annotations

from dcp_spec.constants import ICType

from dcp_conformance.definitions.case import case
from dcp_conformance.suite.bp.beacons.receive import check_processed, lengths, summary_block
from dcp_conformance.test_steps.bp_clients import block_header_octets
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer


def _noise(count: int) -> bytes:
    """Return octets without a pattern, the same every time."""
    return bytes((167 * index + 91) * (index + 3) // 7 % 256 for index in range(count))


@case(
    "TC_BP_RX_BV_06",
    "Padding after the end of a beacon is ignored ({variant})",
    requirements="BP-RX-14",
    stimulus="a beacon with the summary of an unknown variable, followed by octets that length does not count",
    expect="requests for this variable and for that of the next beacon",
    needs=lengths(),
    variants={f"{count}-zeros": bytes(count) for count in (1, 3, 4, 5, 18, 46, 200)}
    | {f"{count}-random": _noise(count) for count in (1, 4, 7, 46, 200)},
)
def padding(bench: Bench, octets: bytes) -> None:
    peer, (first, second), start = bench.peer(), bench.identifiers.unknown_ids(2), bench.mark()
    peer.send(peer.summary(first, 1), padding=octets)
    peer.send(peer.summary(second, 1))
    check_processed(bench, [first, second], start, "a beacon with padding and the next beacon")


@case(
    "TC_BP_RX_BV_07",
    "A block after the end given by length is padding",
    requirements="BP-RX-14",
    stimulus=(
        "beacons with a VarDis block, followed by another block that length does not count: numPayloads 1, then 2, "
        "then 255"
    ),
    expect=(
        "a request for the variable of the first block of the first beacon; whether the second block is parsed is a "
        "reading (X02), but does not depend on numPayloads"
    ),
    needs=lengths(),
)
def block_in_padding(bench: Bench) -> None:
    peer, (inside, outside), start = bench.peer(), bench.identifiers.unknown_ids(2), bench.mark()
    tail = _tail(bench, peer, inside, outside)
    peer.send(summary_block(bench, peer, inside), padding=tail)
    check_processed(bench, [inside], start, "the block before the end")
    bench.require_alive("a block after the end of its beacon")
    parsed = bench.instructions(ICType.REQUEST_VARCREATES, outside, since=start)
    if parsed or bench.instructions(ICType.REQUEST_VARCREATES, inside, since=start):
        bench.reading("X02", "frame-size" if parsed else "length-field")
    if parsed or not bench.profile.has_header_field("numPayloads"):
        return
    for count in (2, 255):
        inside, outside = bench.identifiers.unknown_ids(2)
        tail, start = _tail(bench, peer, inside, outside), bench.mark()
        peer.send(summary_block(bench, peer, inside), padding=tail, lies={"bp.numPayloads": count})
        bench.require_alive(f"a block after the end of a beacon with numPayloads {count}")
        found = bench.instructions(ICType.REQUEST_VARCREATES, outside, since=start)
        bench.none(found, f"no request for the variable after the end, also with numPayloads {count}")


def _tail(bench: Bench, peer: Peer, inside: int, outside: int) -> bytes:
    """Return the second block of a beacon with the summaries of two variables in two blocks."""
    head = peer.beacon(summary_block(bench, peer, inside))
    whole = peer.beacon(summary_block(bench, peer, inside), summary_block(bench, peer, outside))
    return whole[len(head) :]


@case(
    "TC_BP_RX_BI_13",
    "A receiver survives a length that reaches past the end of the frame ({variant})",
    requirements="BP-RX-15",
    stimulus=(
        "a beacon with the summary of an unknown variable, its length beyond the end of the frame ({variant}); "
        "then a valid beacon"
    ),
    expect="no request for the first variable, unless the end of the frame decides (X02); a request for the second",
    needs=lengths(),
    variants={"1-octet": 1, "4-octets": 4, "1000-octets": 1000, "as-far-as-possible": None},
    destructive=True,
)
def length_beyond_frame(bench: Bench, more: int | None) -> None:
    peer, var_id, start = bench.peer(), bench.unknown_id(), bench.mark()
    block = summary_block(bench, peer, var_id)
    length = 0xFFFF if more is None else block_header_octets(bench) + len(block.octets) + more
    peer.send(block, lies={"bp.length": length})
    bench.require_alive("a length past the end of the frame")
    found = bench.instructions(ICType.REQUEST_VARCREATES, var_id, since=start)
    bench.reading("X02", "frame-size" if found else "length-field")
