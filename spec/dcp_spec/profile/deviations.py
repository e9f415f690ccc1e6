"""Find the deviations from the specification that a profile declares, by requirement.

A profile describes the octets of an implementation; it excuses none of them. What the specification leaves to
implementers (the widths of identifiers and time stamps, all of the safety data) is not a deviation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from dcp_spec.catalogue.requirements import requirements

from .definition import IntType, Members, Profile, TextType, own_fields, standard_fields
from .loading import load_profile

#: The requirement that demands a field of the header.
_HEADER_FIELDS: Final = {
    "version": "BP-HDR-01",
    "magicNo": "BP-HDR-02",
    "senderId": "BP-HDR-03",
    "networkId": "BP-HDR-04",
    "length": "BP-HDR-06",
    "numPayloads": "BP-HDR-07",
    "seqno": "BP-HDR-08",
}
#: Integers whose width the specification fixes: octets, and the requirement.
_WIDTHS: Final = {
    "magic_no": (2, "BP-HDR-02"),
    "protocol_id": (2, "BP-HDR-11"),
    "bp_length": (2, "BP-HDR-11"),
    "bp_seqno": (4, "BP-HDR-08"),
    "srp_seqno": (4, "SRP-TYP-01"),
}
#: Every requirement that a profile can declare as not met.
DECLARABLE: Final = (
    *("DATA-01", "DATA-02", "DATA-04", "DATA-06", "DATA-07"),
    *(*_HEADER_FIELDS.values(), "BP-HDR-05", "BP-HDR-10", "BP-HDR-11", "BP-FMT-01"),
    *("SRP-TYP-01", "SRP-TYP-03", "SRP-FMT-01", "VD-TYP-05", "VD-TYP-07", "VD-IC-01", "VD-IC-02"),
)


def deviations(profile: Profile) -> dict[str, str]:
    """Requirement -> what the profile declares instead; empty for one that keeps to its version of the specification.

    Only requirements that this version has.
    """
    found: dict[str, list[str]] = {}
    for identifier, text in _all(profile):
        found.setdefault(identifier, []).append(text)
    known = requirements()
    return {
        identifier: "; ".join(dict.fromkeys(found[identifier]))
        for identifier in DECLARABLE
        if identifier in found and known[identifier].holds_in(profile.spec_version)
    }


def _all(profile: Profile) -> Iterator[tuple[str, str]]:
    yield from _integers(profile)
    yield from _octets(profile)
    yield from _headers(profile)
    yield from _records(profile)


def _integers(profile: Profile) -> Iterator[tuple[str, str]]:
    types = profile.types
    # A field without octets in this profile cannot have a wrong position.
    unused = {
        name
        for name, field in (("magic_no", "magicNo"), ("network_id", "networkId"), ("bp_seqno", "seqno"))
        if not profile.has_header_field(field)
    }
    if not profile.srp.is_report:
        unused |= {"srp_seqno"} if "creationTime" in profile.vardis.var_spec else {"srp_seqno", "timestamp"}
    unused |= {"var_timeout"} if "timeout" not in profile.vardis.var_spec else set()
    used = [name for name in types.__struct_fields__ if name not in unused]
    layouts = {name: getattr(types, name) for name in used}
    little = [
        name
        for name, layout in layouts.items()
        if getattr(layout, "byte_order", "big") == "little" and layout.width > 1
    ]
    if types.node_id.length is not None and _is_little(types.node_id.length):
        little.append("length of node_id")
    little += [f"length of {name}" for name in ("string", "value") if any(map(_is_little, layouts[name].lengths))]
    if little:
        yield "DATA-01", f"little-endian: {', '.join(little)}"
    for name, (width, requirement) in _WIDTHS.items():
        if name in layouts and layouts[name].width != width:
            yield requirement, f"{name} has {layouts[name].width} octets"
    if profile.has_header_field("networkId") and types.network_id.width < 2:
        yield "BP-HDR-05", f"networkId has {types.network_id.width} octet"


def _is_little(layout: IntType) -> bool:
    return layout.byte_order == "little" and layout.width > 1


def _octets(profile: Profile) -> Iterator[tuple[str, str]]:
    # A pattern that is sent instead of a state report is not a record with octets between its fields.
    report = profile.srp.record if profile.srp.is_report else ()
    listed = (*report, *profile.bp.payload_header, *profile.bp.header, *profile.vardis.var_spec)
    records = [member for members in profile.vardis.records.by_name().values() for member in members]
    opaque = [each for each in own_fields((*listed, *records)) if each.opaque is not None]
    if opaque:
        notes = dict.fromkeys(each.note or each.name for each in opaque)
        yield "DATA-02", f"octets that belong to no field: {', '.join(notes)}"
    if profile.types.node_id.length is not None:
        yield "DATA-04", "node identifiers have no fixed length"
    for name, requirement in (("string", "DATA-07"), ("value", "DATA-06")):
        layout: TextType = getattr(profile.types, name)
        if layout.terminated:
            yield requirement, f"a {name} ends with a NUL octet"
        # VarLenT may be wider than the length of a MemBlockT (X13).
        if len(layout.lengths) != 1 or (layout.lengths[0].width != 1 and name != "value"):
            widths = ", then ".join(str(each.width) for each in layout.lengths)
            yield requirement, f"the length of a {name} has {widths or 'no'} octets"


def _headers(profile: Profile) -> Iterator[tuple[str, str]]:
    bp = profile.bp
    wanted = load_profile(f"dcp-{profile.spec_version}").bp
    for name in standard_fields(wanted.header):
        if name not in bp.header:
            yield _HEADER_FIELDS[name], f"there is no {name}"
    if _reordered(standard_fields(bp.header), wanted.header) or own_fields(bp.header):
        yield "BP-HDR-10", f"the header is {_names(bp.header)}"
    block = standard_fields(bp.payload_header)
    numbers = [each for each in own_fields(bp.payload_header) if each.opaque is None]
    if numbers:
        yield "BP-HDR-11", f"the header of a payload also has {_names(tuple(numbers))}"
    if _reordered(block, wanted.payload_header):
        yield "BP-HDR-10", f"the header of a payload is {', '.join(block)}"
    if bp.length_means != "blocks" and "length" in bp.header:
        yield "BP-HDR-06", "length is the size of the header"
    if bp.payload_area:
        yield "BP-FMT-01", f"each payload lies in an area of {bp.payload_area} octets"


def _records(profile: Profile) -> Iterator[tuple[str, str]]:
    wanted = load_profile(f"dcp-{profile.spec_version}")
    record = standard_fields(profile.srp.record)
    own = [each for each in own_fields(profile.srp.record) if each.opaque is None]
    if not profile.srp.record:
        yield "SRP-FMT-01", "a state report has no octets"
    elif not record:
        yield "SRP-FMT-01", f"a payload of SRP is not a state report, but {_names(profile.srp.record)}"
    elif own:
        yield "SRP-TYP-03", f"a state report is {_names(profile.srp.record)}"
    elif record != list(wanted.srp.record):
        yield "SRP-TYP-03", f"a state report is {', '.join(record)}"
    vardis = profile.vardis
    if vardis.var_spec != wanted.vardis.var_spec:
        yield "VD-TYP-05", f"a VarSpec is {_names(vardis.var_spec)}"
    for name, members in vardis.records.by_name().items():
        if members != wanted.vardis.records.by_name()[name]:
            yield "VD-TYP-07", f"a {name} is {_names(members)}"
    for container in [each for each in vardis.own_containers if each not in wanted.vardis.own_containers]:
        yield "VD-IC-02", f"container type {container.number} is {container.name}"
    extra = [each.name for each in vardis.container_extra]
    if vardis.list_length is not None:
        extra.append("a length of the list")
    if extra:
        yield "VD-IC-01", f"container headers also have {', '.join(extra)}"
    if vardis.container_types != wanted.vardis.container_types:
        numbers = ", ".join(f"{number} {name}" for name, number in vardis.container_types.by_name().items())
        yield "VD-IC-02", f"the container types are {numbers}"


def _names(members: Members) -> str:
    return ", ".join(each if isinstance(each, str) else each.name for each in members)


def _reordered(names: Sequence[object], wanted: Sequence[object]) -> bool:
    """Return whether common names have another order, or some names are only in the first list."""
    return [each for each in names if each in wanted] != [each for each in wanted if each in names] or any(
        each not in wanted for each in names
    )
