"""dcp-datatypes.md: Basic Data Types and Conventions; dcp-architecture.md: the wireless bearer (UWB).

Encoding of numbers, text and identifiers in the beacons of the implementation, and their decoding in received beacons.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from dcp_spec.constants import (
    BP_MAGIC_NO,
    BP_SEQNO_MODULUS,
    ETHERTYPE_MIN,
    UWB_MIN_MTU,
    ICType,
    SpecVersion,
)
from dcp_spec.profile.definition import own_fields

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.frames.header_rules import judge
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.bp_clients import CLIENT, header_octets, some_beacons, talking, unused_protocol_id
from dcp_conformance.test_steps.services import (
    Moment,
    binary_identifiers,
    create_request,
    longest_description,
    safety_data,
    timed,
    until_report,
)
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

from .bp.beacons.receive import check_dropped, check_processed

V1_1, V2_0 = SpecVersion.V1_1, SpecVersion.V2_0
CREATE = "RTDB-Create"
DESCRIPTION_TOO_LONG = "VARDIS-STATUS-VARIABLE-DESCRIPTION-TOO-LONG"
_HEADER = Needs(entities=(), header=("magicNo",))


def swapped(value: int, width: int) -> int:
    """Return the number with its octets in reverse order."""
    return int.from_bytes(value.to_bytes(width, "big"), "little")


# -- integers ----------------------------------------------------------------------------------------------------------


@case(
    "TC_DCP_DATA_BV_01",
    "Integers in beacon headers are big-endian",
    requirements="DATA-01",
    stimulus="payloads to send in every period",
    expect=(
        "plausible values of magicNo, length, protocolId and seqno, and none that is plausible only with swapped octets"
    ),
    window=8,
    needs=_HEADER,
)
def byte_order(bench: Bench) -> None:
    with talking(bench, clients=2):
        frames = some_beacons(bench, 6)
    types, start = bench.profile.types, header_octets(bench)
    for heard in frames:
        root = bench.codec.dissect(heard.octets).root
        says = {field.path: field.value for field in root.walk() if isinstance(field.value, int)}
        checks: list[tuple[str, int, int]] = [("bp.magicNo", types.magic_no.width, BP_MAGIC_NO)]
        if len(heard.octets) > 46 and bench.profile.bp.length_means == "blocks":
            checks.append(("bp.length", types.bp_length.width, len(heard.octets) - start))
        for path, width, right in checks:
            value = says.get(path)
            if value is not None and value != right and swapped(value, width) == right:
                bench.wrong(f"{path} {right:#x}", f"{value:#x}: the octets are swapped", frames=[heard])
        ids = [value for path, value in says.items() if path.endswith(".protocolId")]
        odd = [value for value in ids if value > 0xFF and swapped(value, 2) in (1, 2)]
        bench.none(odd, "protocolId 1 or 2", frames=[heard], stop=True)
    numbers = [heard.seqno for heard in frames if heard.seqno is not None]
    steps = {(after - before) % BP_SEQNO_MODULUS for before, after in itertools.pairwise(numbers)}
    bench.proved(
        1 << 24 not in steps, "seqno increases in its last octet", "it increases in its first octet", frames=frames[:2]
    )
    fields = [name for name, field in _integers(bench) if field != "big"]
    fields += [
        f"sData.{each.name}" for each in bench.profile.srp.safety_data if each.byte_order == "little" and each.width > 1
    ]
    if fields:
        bench.info("Which numbers are little-endian according to the profile?", ", ".join(fields))


def _integers(bench: Bench) -> list[tuple[str, str]]:
    """Return the integers of the profile of more than one octet, with their byte order."""
    types = bench.profile.types
    names = ("timestamp", "magic_no", "protocol_id", "bp_length", "network_id", "bp_seqno", "srp_seqno", "var_timeout")
    return [(name, str(getattr(types, name).byte_order)) for name in names if getattr(types, name).width > 1]


@case(
    "TC_DCP_DATA_BV_02",
    "Received lengths above 255 are decoded as big-endian",
    requirements="DATA-01",
    stimulus=(
        "a beacon with a block of 258 octets of an unregistered protocol, and a VarDis block with a summary of an "
        "unknown variable"
    ),
    expect="a request for the variable",
)
def long_block(bench: Bench) -> None:
    peer, var_id, start = bench.peer(), bench.unknown_id(), bench.mark()
    # A receiver with a wrong block length continues parsing within these octets.
    peer.send(Block(unused_protocol_id(bench), b"\xff" * 258), peer.summary(var_id, 1))
    check_processed(bench, [var_id], start, "the block after one of 258 octets")


@case(
    "TC_DCP_DATA_BV_03",
    "Received creationTimes are compared as unsigned big-endian numbers",
    requirements="DATA-01",
    stimulus="two VarCreates; the second creationTime is larger, but smaller with swapped octets, signed or not",
    expect="the second VarCreate replaces the first and is forwarded",
    window=10,
    needs=Needs(
        since=V2_0,
        when=lambda bench: (
            None if "creationTime" in bench.profile.vardis.var_spec else "the profile has no creationTime"
        ),
    ),
)
def order_of_creation_times(bench: Bench) -> None:
    first = (bench.records.creation_time() >> 16 << 16) + 0x17F
    second = first + 0x82
    bench.session.creation_time = second
    peer, var_id = bench.peer(), bench.var_id()
    bench.learn(peer, peer.create(var_id, creation_time=first, value=b"first"))
    start = peer.stimulate(peer.create(var_id, creation_time=second, value=b"second"))
    passed = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    found = bench.instructions(ICType.CREATE_VARIABLES, var_id, since=start)
    expected = f"the variable created at {second:#x} replaces the one created at {first:#x}"
    bench.equal(passed and passed.upd.value, bench.records.value(b"second"), expected, frames=found)


@case(
    "TC_DCP_DATA_BV_04",
    "creationTime and timeout of the node's own variables are numbers in the byte order of the profile",
    requirements="DATA-01 DATA-05",
    stimulus="RTDB-Create with timeout 22136 ms (0x5678)",
    expect=(
        "a VarCreate with timeout 22136 and the current time as creationTime, if the profile's clock has a known epoch"
    ),
    needs=Needs(since=V2_0, ut=(CREATE,)),
)
def own_creation_time(bench: Bench) -> None:
    var_id = bench.identifiers.own_var_id()
    request = timed(bench, CREATE, **create_request(bench, var_id, timeout=0x5678))
    record = bench.required(
        bench.until_instruction(ICType.CREATE_VARIABLES, var_id), "a VarCreate of the variable", "VD-CRE-12"
    )
    bench.answered(record.spec.timeout, 0x5678, "timeout", "DATA-01")
    check_time(bench, record.spec.creation_time, request, "creationTime")


@case(
    "TC_DCP_DATA_BV_05",
    "tStamp of state reports is the current time, in the byte order of the profile",
    requirements="DATA-01 DATA-05",
    stimulus="SRP-UpdateSafetyData",
    expect="a state report with the current time as tStamp, if the profile's clock has a known epoch",
    needs=Needs(entities=("srp",), ut=("SRP-UpdateSafetyData",)),
)
def own_time_stamp(bench: Bench) -> None:
    request = timed(bench, "SRP-UpdateSafetyData", sData=safety_data(bench, 3))
    heard = until_report(bench)
    report = bench.required(None if heard is None else heard.report, "a state report", "SRP-SRV-03")
    check_time(bench, report.t_stamp, request, "tStamp")


def check_time(bench: Bench, stamp: int, request: Moment, name: str) -> None:
    """Check a time stamp taken at a known wall clock time (ns); without a known epoch it is only reported."""
    layout = bench.profile.types.timestamp
    if layout.epoch_ns is None:
        bench.info(f"What is the epoch of the clock of {name}?", f"{layout.epoch}: the value is {stamp}", "DATA-05")
        return
    told = layout.epoch_ns + layout.nanoseconds(stamp)
    turned = layout.epoch_ns + layout.nanoseconds(swapped(stamp % (1 << (8 * layout.width)), layout.width))
    day, wall = 86_400 * 10**9, request.before
    if abs(told - wall) > day:
        what = (
            "a time within a day of now only with swapped octets"
            if abs(turned - wall) <= day
            else "not within a day of now"
        )
        bench.proved(False, f"{name} within a day of now", f"{stamp:#x}, {what}", "DATA-01 DATA-05")
        return
    bench.passed(f"{name} within a day of now", "DATA-01")
    off, limit = (told - wall) / MS, bench.sut.pixit.clock_tolerance_ms
    # The time stamp may have been taken at any time between request and answer.
    near = -limit <= off <= limit + (request.after - request.before) / MS
    bench.proved(near, f"{name} within {limit:g} ms of the tester's clock", f"{off:.1f} ms off", "DATA-05")


# -- records -----------------------------------------------------------------------------------------------------------


def _sends_something(bench: Bench) -> str | None:
    """Return why the tester cannot make the implementation send beacons, or None; for ``Needs.when``."""
    if bench.sut.pics.vardis is False and not bench.services.offers(*CLIENT):
        return "without VarDis and without an upper tester the tester has no way to cause beacons"
    return None


@case(
    "TC_DCP_DATA_BV_06",
    "Every beacon can be decoded with the profile, without remaining octets",
    requirements="DATA-02 DATA-03 UWB-04",
    stimulus="payloads of clients, variables, and state reports if the upper tester can submit safety data",
    expect="ten beacons without a fault; no octets after the last block of those that are not padded",
    window=14,
    needs=Needs(entities=(), when=_sends_something),
)
def packed(bench: Bench) -> None:
    with talking(bench, clients=2):
        reports = bench.profile.srp.safety_data and bench.sut.pics.srp is not False
        if bench.services.offers("SRP-UpdateSafetyData") and reports:
            bench.must("SRP-UpdateSafetyData", sData=safety_data(bench, 5))
        if bench.services.offers(CREATE) and bench.sut.pics.vardis is not False:
            # Its VarCreate has all fields of the implementation's own making.
            bench.call(CREATE, **create_request(bench, bench.identifiers.own_var_id(), timeout=60_000))
        peer = bench.peer()
        for length in (1, 3) if bench.sut.pics.vardis is not False else ():
            var_id = bench.var_id()
            peer.send(peer.create(var_id, value=bytes(length), descr=b"d" * length))
            peer.send(peer.update(var_id, 1, bytes(length + 1)), peer.summary(bench.unknown_id(), 1))
        frames = some_beacons(bench, 10)
    bench.excuses.about_layout = True
    broken = [heard for heard in frames if heard.problems]
    if not broken:
        bench.passed("beacons that can be decoded with the profile", "DATA-02 DATA-03")
    judged: set[str] = set()
    for frame, each in ((heard, each) for heard in broken for each in judge(heard.octets, bench.codec)):
        if each.requirement not in judged:
            # If a beacon has one bad block, only the rules of that block are broken.
            judged.add(each.requirement)
            observed = f"{each} ({len(broken)} of {len(frames)} beacons cannot be decoded completely)"
            bench.proved(
                False, "beacons that can be decoded with the profile", observed, *each.requirements, frames=[frame]
            )
    behind = [heard for heard in frames if not heard.problems and _trailing(bench, heard)]
    octets = _trailing(bench, behind[0]).hex() if behind else ""
    bench.none(behind, "no octets after the last block", "UWB-04 DATA-02", seen=octets)
    if any(each.opaque is not None for each in own_fields(bench.profile.srp.record)):
        what = "its state reports are memory images of a structure, with unused octets between the fields"
        bench.info("Which records of the profile itself are not packed?", what, "DATA-02")


def _trailing(bench: Bench, heard: ReceivedBeacon) -> bytes:
    """Return the octets after a beacon in a frame that is too long to have been padded; empty otherwise."""
    return bench.codec.dissect(heard.octets).padding if len(heard.octets) > 46 else b""


@case(
    "TC_DCP_DATA_BV_07",
    "Any other node identifier is accepted as a sender ({variant})",
    requirements="DATA-04",
    stimulus="a beacon with the summary of an unknown variable and a special senderId: {variant}",
    expect="a request for the variable",
    needs=Needs(header=("senderId",), when=binary_identifiers),
    variants={
        "zeros": lambda own: bytes(len(own)),
        "ones": lambda own: b"\xff" * len(own),
        "group-address": lambda own: b"\x01" + own[1:],
        "own-but-for-the-first-bit": lambda own: bytes([own[0] ^ 0x80]) + own[1:],
        "own-but-for-the-last-bit": lambda own: own[:-1] + bytes([own[-1] ^ 1]),
        "own-backwards": lambda own: own[::-1] if own[::-1] != own else own[:-1] + bytes([own[-1] ^ 2]),
    },
)
def any_identifier(bench: Bench, made: Callable[[bytes], bytes]) -> None:
    if bench.session.sut_id is None:
        bench.probes.probe()
    peer, var_id, start = bench.peer(), bench.unknown_id(), bench.mark()
    peer.send(peer.summary(var_id, 1), sender=made(bench.identifiers.sut_id))
    check_processed(bench, [var_id], start, "a beacon with this senderId")


# -- octets and text ---------------------------------------------------------------------------------------------------


def check_forwarded(bench: Bench, value: bytes, descr: bytes, *requirements: str) -> None:
    """Check that a variable with this value and description is accepted and forwarded unchanged."""
    peer, var_id = bench.peer(), bench.var_id()
    peer.send(peer.create(var_id, value=value, descr=descr, exact=True))
    record = bench.required(
        bench.until_instruction(ICType.CREATE_VARIABLES, var_id), "a VarCreate of the variable", *requirements
    )
    same = record.upd.value == value and record.spec.descr == descr
    observed = f"value {record.upd.value.hex()}, description {record.spec.descr.hex()}"
    bench.proved(same, f"value {value.hex()} and description {descr.hex()}, as received", observed, *requirements)


@case(
    "TC_DCP_DATA_BV_08",
    "Values of any length and content are forwarded unchanged (length: {variant})",
    requirements="DATA-06",
    stimulus="a VarCreate with a value of octets that have a meaning elsewhere in a beacon; length: {variant}",
    expect="the same VarCreate in a beacon of the implementation",
    needs=Needs(since=V1_1),
    variants={
        "least": 1,
        "medium": 7,
        "greatest": None,
        "greatest-1.0": Variant(None, requirements="VD-PC-07 VD-PC-10", needs=Needs(until=SpecVersion.V1_0)),
    },
)
def memory_blocks(bench: Bench, length: int | None) -> None:
    # Every maximum allows a value of one octet.
    if length != 1:
        length = max(1, min(bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH"), length or 255))
    octets = bytes([0, 0xFF, 0x0A, 0x05, 0x49, 0x7E, 0x0D]) * 40
    check_forwarded(bench, octets[:length], bench.records.descr(b"octets"))


@case(
    "TC_DCP_DATA_BV_09",
    "Descriptions of any content are forwarded unchanged ({variant})",
    requirements="DATA-07",
    stimulus="a VarCreate with a special description: {variant}",
    expect="the same VarCreate in a beacon of the implementation",
    needs=Needs(
        since=V1_1,
        when=lambda bench: (
            "strings of the profile are NUL-terminated" if bench.profile.types.string.terminated else None
        ),
    ),
    variants={
        "one-octet": b"d",
        "a-NUL-in-the-middle": b"a\0b",
        "a-NUL-at-the-end": b"ab\0",
        "no-UTF-8": b"\xff\xfe\x80",
        "UTF-8": Variant("h\u00f6he \u2264 \U0001f681".encode(), requirements="DATA-07 DATA-08"),
    },
)
def descriptions(bench: Bench, descr: bytes) -> None:
    if len(descr) > bench.sut.longest_description:
        bench.verdicts.not_applicable(
            f"descriptions have at most {bench.sut.longest_description} octets, and this one has {len(descr)}"
        )
    check_forwarded(bench, bench.records.value(b"value"), descr)


@case(
    "TC_DCP_DATA_BV_10",
    "The length of a description counts octets, not characters",
    requirements="DATA-08 DATA-07",
    stimulus="RTDB-Create with a description of two-octet characters: as many as fit, and one more",
    expect=(
        "the description with its length in octets and no NUL after it; VARIABLE-DESCRIPTION-TOO-LONG for the "
        "longer one"
    ),
    needs=Needs(since=V1_1, ut=(CREATE,)),
)
def length_of_text(bench: Bench) -> None:
    longest = min(longest_description(bench), 254)
    text = "\u00e9" * (longest // 2)
    var_id, other = bench.identifiers.own_var_id(), bench.unknown_id()
    bench.expect_status("VARDIS-STATUS-OK", CREATE, "DATA-08", **create_request(bench, var_id, descr=text))
    record: Any = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    bench.required(record, "a VarCreate of the variable", "DATA-08")
    bench.answered(record.spec.descr, text.encode(), "the description in UTF-8", "DATA-07 DATA-08")
    # Fewer characters than the maximum, but more octets.
    longer = "\u00e9" * (longest // 2 + 1)
    bench.expect_status(
        DESCRIPTION_TOO_LONG, CREATE, "DATA-08", **create_request(bench, other, descr=longer, value=b"v", exact=True)
    )


# -- the bearer --------------------------------------------------------------------------------------------------------


def ethernet_frames(bench: Bench) -> list[tuple[int, bytes]]:
    """Return numbers and octets of the implementation's frames that were received with an Ethernet header."""
    return [
        (each.number, each.frame) for each in bench.traffic.events if each.direction == "heard" and each.start == 14
    ]


def no_ethernet(bench: Bench) -> str | None:
    """Return why frames cannot be inspected, or None; for ``Needs.when``."""
    if bench.profile.link.transport != "ethernet" or bench.lower.name.startswith("udp"):
        return f"the link is not Ethernet: {bench.lower.name}"
    return None


@case(
    "TC_DCP_UWB_BV_01",
    "Every beacon is a local broadcast with the EtherType of the profile",
    requirements="UWB-01 UWB-02 BP-PAR-10",
    stimulus="payloads to send in every period",
    expect="frames to the broadcast address, all with the same EtherType, not below the smallest valid EtherType",
    window=6,
    needs=Needs(entities=(), when=no_ethernet),
)
def broadcast(bench: Bench) -> None:
    with talking(bench):
        some_beacons(bench, 4)
    frames = ethernet_frames(bench)
    if not frames:
        bench.inconclusive("Ethernet frames of the implementation", "the link does not provide them")
    other = [frame[:6].hex(":") for _, frame in frames if frame[:6] != b"\xff" * 6]
    bench.none(other, "frames to ff:ff:ff:ff:ff:ff", "UWB-01", seen=f"frames to {', '.join(sorted(set(other)))}")
    types = {int.from_bytes(frame[12:14], "big") for _, frame in frames}
    observed = ", ".join(f"{each:#06x}" for each in sorted(types))
    bench.answered(len(types), 1, "EtherTypes of all beacons", "UWB-02")
    bench.proved(min(types) >= ETHERTYPE_MIN, f"an EtherType of at least {ETHERTYPE_MIN:#06x}", observed, "BP-PAR-10")


@case(
    "TC_DCP_UWB_BI_01",
    "Frames with another EtherType are not processed by BP ({variant})",
    requirements="UWB-02",
    stimulus="a valid beacon with the summary of an unknown variable with another EtherType; then a valid frame",
    expect="no request for the first variable; a request for the second",
    needs=Needs(when=no_ethernet),
    variants={"next": 1, "IPv4": 0x0800, "experimental": 0x88B5},
)
def other_type(bench: Bench, number: int) -> None:
    own = bench.profile.link.ether_type or 0x4953

    def send(peer: Peer, summary: Any) -> None:
        head = b"\xff" * 6 + peer.address + (own + 1 if number == 1 else number).to_bytes(2, "big")
        bench.transmission.send_frame(head + peer.beacon(summary), len(head))

    check_dropped(bench, send, "a frame with another EtherType")


@case(
    "TC_DCP_UWB_BV_02",
    "The bearer carries at least 256 octets, and BP knows the maximum",
    requirements="UWB-03",
    stimulus="BP-GetParameters, if the upper tester offers it; payloads to send",
    expect=(
        "UWB-MaxPacketSize of at least 256, and no larger beacon; without BP-GetParameters the case is informational"
    ),
    window=6,
    needs=Needs(since=V1_1, entities=()),
)
def packet_size(bench: Bench) -> None:
    known = None
    if bench.services.offers("BP-GetParameters"):
        known = bench.must("BP-GetParameters").result.get("parameters")
    told = known.get("UWB-MaxPacketSize") if isinstance(known, dict) else None
    with talking(bench):
        sizes = sorted({len(heard.octets) for heard in some_beacons(bench, 4)})
    bench.info("How large are beacons?", f"{sizes[0]} to {sizes[-1]} octets", "UWB-05")
    if not isinstance(told, int):
        bench.info("Does the implementation report UWB-MaxPacketSize?", "no", "UWB-03")
        # BPPAR_MAXIMUM_PACKET_SIZE may be smaller than the maximum of the bearer.
        return
    bench.proved(told >= UWB_MIN_MTU, f"UWB-MaxPacketSize of at least {UWB_MIN_MTU} octets", told, "UWB-03")
    bench.proved(sizes[-1] <= told, f"beacons of at most {told} octets", f"a beacon of {sizes[-1]} octets", "UWB-03")
