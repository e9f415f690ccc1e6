"""Common faults of implementations that shift all later fields, so that a frame cannot be judged field by field.

Each fault is a changed profile, or a function that repairs the octets. A frame shows a fault if its whole block list is
consistent with the fault, and no other fault explains more of the frame.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final, NamedTuple

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.profile.definition import ByteOrder, IntType, Profile, standard_fields

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.plan.tree import Group, Scalar

__all__ = ["REQUIREMENT_OF", "Fault", "explanation", "layout_of"]

#: Minimum payload of an Ethernet frame in octets: shorter bearer payloads are received with padding.
_LEAST_FRAME = 46
#: Widths of node identifiers that are tried, in octets: usual and unusual ones.
_USUAL, _UNUSUAL = (6, 8, 4, 2, 16), (1, 3, 5, 7, 10, 12)
#: The header fields of all versions, in the order of each.
_LAYOUTS = {
    "1.0": ("magicNo", "senderId", "version", "numPayloads", "seqno"),
    "1.1": ("version", "magicNo", "senderId", "numPayloads", "seqno"),
    "1.2": ("version", "magicNo", "senderId", "length", "numPayloads", "seqno"),
    "2.0": ("version", "magicNo", "senderId", "networkId", "length", "numPayloads", "seqno"),
}
REQUIREMENT_OF: Final[Mapping[str, str]] = {
    "version": "BP-HDR-01",
    "magicNo": "BP-HDR-02",
    "senderId": "BP-HDR-03",
    "networkId": "BP-HDR-04",
    "length": "BP-HDR-06",
    "numPayloads": "BP-HDR-07",
    "seqno": "BP-HDR-08",
}
"""The requirement about the content of each field of the header."""


class Fault(NamedTuple):
    """A fault of an implementation, with the layout of such frames, or a function that repairs their octets."""

    requirements: str
    """One or more, separated by spaces."""
    expected: str
    observed: str
    field: str
    profile: Profile | None = None
    mended: Callable[[bytes], bytes] | None = None
    missing: bool = False
    """Whether the field is missing."""


def explanation(octets: bytes, codec: Codec, network_id: int | None, source: bytes | None) -> Fault | None:
    """Return the fault that explains most of a frame; None if no fault explains it.

    ``network_id`` is that of the network, ``source`` the address of the station that sent the frame, if known.
    """
    header = codec.dissect(octets).root.child("bp")
    places = () if header is None else header.children
    right = {
        each.name
        for each in places
        if isinstance(each.layout, Scalar) and each.layout.rule is not None and each.value == each.layout.rule.value
    }
    best: Fault | None = None
    most = 0
    for fault in _faults(codec):
        if fault.missing and fault.field in right:
            continue
        reader = codec if fault.profile is None else layout_of(fault.profile)
        points = _explains(fault.mended(octets) if fault.mended else octets, reader, network_id, source)
        if points > most:
            best, most = fault, points
    return best


def _explains(octets: bytes, codec: Codec, network_id: int | None, source: bytes | None) -> int:
    """Return how well a layout explains a frame: 0 if it does not, otherwise points for each consistent part."""
    try:
        envelope, end = codec.decode_envelope(octets)
    except DecodeError:
        return 0
    padding = octets[end:]
    if any(padding) or (padding and len(octets) > _LEAST_FRAME):
        return 0
    points = 1
    if envelope.bp is not None:
        points += 2 * (network_id is not None and envelope.bp.network_id == network_id)
        points += 3 * (source is not None and envelope.bp.sender_id == source)
    for payload in envelope.payloads:
        content = payload.content
        assert isinstance(content, bytes)
        try:
            if payload.protocol_id == BP_PROTID_VARDIS:
                codec.decode_containers(content)
                points += 2
            elif payload.protocol_id == BP_PROTID_SRP and codec.report_plan is not None:
                codec.decode_report(content)
                points += 2
        except DecodeError:
            points += 1
    return points


def layout_of(profile: Profile) -> Codec:
    """Return the codec of the profile of a fault."""
    return _reader(msgspec.json.encode(profile), profile)


@functools.lru_cache(maxsize=256)
def _reader(_key: bytes, profile: Profile) -> Codec:
    return Codec(profile)


@functools.lru_cache(maxsize=64)
def _faults(codec: Codec) -> tuple[Fault, ...]:
    return tuple(_all_faults(codec))


def _all_faults(codec: Codec) -> Iterator[Fault]:
    """Yield the faults that are tried, the most frequent first."""
    profile = codec.profile
    header = tuple(standard_fields(profile.bp.header))
    if not header:
        return
    replace = msgspec.structs.replace

    def with_header(names: tuple[str, ...]) -> Profile:
        return replace(profile, bp=replace(profile.bp, header=names))

    if "length" not in header:
        yield from _counts(codec)
    yield from _orders(codec)
    # Fields that only some versions have come first: a wrong profile looks the same.
    for name in sorted(
        header, key=lambda each: ("networkId", "length").index(each) if each in ("networkId", "length") else 2
    ):
        if name == "numPayloads" or (name == "length" and profile.bp.length_means != "blocks"):
            continue
        left = tuple(each for each in header if each != name)
        expected = f"a {name} in the header"
        yield Fault(REQUIREMENT_OF[name], expected, "the field is missing", name, with_header(left), missing=True)
    yield from _node_ids(profile, _USUAL)
    if "networkId" in header:
        for width in (1, 4, 8):
            yield from _width(profile, "network_id", width, "networkId", "BP-HDR-05" if width < 2 else "DATA-03")
    for width in (1, 2, 8):
        yield from _width(profile, "bp_seqno", width, "seqno", "BP-HDR-08")
    for kind, name in (("bp_length", "length"), ("protocol_id", "protocolId")):
        for width in (1, 4):
            yield from _width(profile, kind, width, name, "BP-HDR-11")
    yield from _node_ids(profile, _UNUSUAL)
    for version, layout in _LAYOUTS.items():
        if layout != header:
            text = f"that of version {version}: {', '.join(layout)}"
            yield Fault("BP-HDR-10", f"the header {', '.join(header)}", text, header[0], with_header(layout))
    for index in range(len(header) - 1):
        names = [*header]
        names[index : index + 2] = reversed(names[index : index + 2])
        text = f"{names[index]} precedes {names[index + 1]}"
        yield Fault("BP-HDR-10", f"the header {', '.join(header)}", text, header[index], with_header(tuple(names)))


def _counts(codec: Codec) -> Iterator[Fault]:
    """Yield the fault of a numPayloads that is too large by one, for versions in which only it defines the end."""
    group = next((each for each in getattr(codec.envelope_plan, "members", ()) if each.name == "bp"), None)
    if not isinstance(group, Group):
        return
    place = 0
    for member in group.members:
        if not isinstance(member, Scalar):
            return
        if member.name == "numPayloads":
            break
        place += member.size

    def mended(octets: bytes) -> bytes:
        return (
            octets
            if place >= len(octets)
            else octets[:place] + bytes([max(0, octets[place] - 1)]) + octets[place + 1 :]
        )

    yield Fault(
        "BP-HDR-07", "numPayloads is the number of payload blocks", "it is larger by one", "numPayloads", mended=mended
    )


def _orders(codec: Codec) -> Iterator[Fault]:
    """Yield faults of byte order, and of headers copied from structures in memory."""
    profile, replace = codec.profile, msgspec.structs.replace
    types, stamp = profile.types, profile.types.timestamp
    names = ("magic_no", "protocol_id", "bp_length", "network_id", "bp_seqno", "srp_seqno", "var_timeout")
    wide = [name for name in names if getattr(types, name).width > 1]
    ends = ("most", "least") if types.bp_length.byte_order == "big" else ("least", "most")
    expected, found = (f"integers with their {each} significant octet first" for each in ends)
    mended = _unpadded(codec)
    packed = "headers without octets between their fields"
    gaps = "octets between the fields, where a compiler aligns those of a structure"
    if mended is not None:
        yield Fault("DATA-02", packed, gaps, "magicNo", mended=mended)
    for left_out, stamps in itertools.product((None, "magic_no"), (False, True)):
        changed: dict[str, object] = {
            name: replace(getattr(types, name), byte_order=_other(getattr(types, name).byte_order))
            for name in wide
            if name != left_out
        }
        if stamps:
            changed["timestamp"] = replace(stamp, byte_order=_other(stamp.byte_order))
        turned = replace(profile, types=replace(types, **changed))
        yield Fault("DATA-01", expected, found, "magicNo" if left_out is None else "length", turned)
        if mended is not None:
            yield Fault(
                "DATA-02 DATA-01", f"{packed}, and {expected}", f"{gaps}, and {found}", "magicNo", turned, mended
            )


def _other(order: ByteOrder) -> ByteOrder:
    return "little" if order == "big" else "big"


def _node_ids(profile: Profile, widths: Iterable[int]) -> Iterator[Fault]:
    node = profile.types.node_id
    for width in widths:
        if node.length is None and width != node.width:
            kind = msgspec.structs.replace(node, width=width, representation="hex")
            types = msgspec.structs.replace(profile.types, node_id=kind)
            expected = f"a senderId of {node.width} octets, as in the profile {profile.name}"
            changed = msgspec.structs.replace(profile, types=types)
            yield Fault("DATA-04", expected, f"one of {width}", "senderId", changed)


def _width(profile: Profile, kind: str, width: int, name: str, requirement: str) -> Iterator[Fault]:
    known: IntType = getattr(profile.types, kind)
    if known.width == width:
        return
    types = msgspec.structs.replace(profile.types, **{kind: msgspec.structs.replace(known, width=width)})
    expected = f"a {name} of {known.width} octets"
    yield Fault(requirement, expected, f"one of {width}", name, profile=msgspec.structs.replace(profile, types=types))


def _unpadded(codec: Codec) -> Callable[[bytes], bytes] | None:
    """Return a function that removes the padding of a compiler between header fields; None if there is no padding."""
    header = next((each for each in getattr(codec.envelope_plan, "members", ()) if each.name == "bp"), None)
    if not isinstance(header, Group):
        return None
    holes: list[tuple[int, int]] = []
    position, largest = 0, 1
    for member in header.members:
        if not isinstance(member, Scalar):
            return None
        alignment = member.size if member.kind == "int" and member.code else 1
        largest = max(largest, alignment)
        if hole := -position % alignment:
            holes.append((position, hole))
        position += hole + member.size
    if hole := -position % largest:
        holes.append((position, hole))
    if not holes:
        return None

    def mended(octets: bytes) -> bytes:
        for start, size in reversed(holes):
            octets = octets[:start] + octets[start + size :]
        return octets

    return mended
