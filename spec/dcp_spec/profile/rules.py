"""Check a profile: rules beyond the types of its keys. Each complaint names the key and what to change."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable

from dcp_spec.constants import BP_MAGIC_NO

from .definition import RECORD_MEMBERS, IntType, Members, NodeIdType, OwnField, Profile, own_fields, standard_fields

_HEADER_FIELDS = ("version", "magicNo", "senderId", "networkId", "length", "numPayloads", "seqno")
_RECORD_FIELDS = ("sData", "nodeId", "tStamp", "seqno")
_SPEC_FIELDS = ("varId", "prodId", "repCnt", "creationTime", "timeout", "descr")
# Names that own fields of an implementation must not have: other members of the record have them.
_TAKEN = {
    "bp.header": (*_HEADER_FIELDS, "payloads", "extra"),
    "bp.payload_header": ("protocolId", "length", "content", "area", "srp", "vardis", "data", "extra"),
    "srp.record": (*_RECORD_FIELDS, "extra", "asDict"),
    "srp.safety_data": ("as_dict", "extra"),
    "vardis.var_spec": (*_SPEC_FIELDS, "extra"),
    "vardis.container_extra": ("icType", "icName", "icNumRecords", "listLength", "records", "extra"),
}
_OWN_RECORD_FIELDS = ("varId", "prodId", "seqno", "value", "repCnt", "creationTime", "timeout", "descr")
# Names that record types of the implementation's own may not have: those of the specification and of tables.
_TAKEN_TYPES = (
    *RECORD_MEMBERS,
    *("VarSpec", "Beacon", "BPHeader", "Payload", "Container", "SafetyData", "ExtendedSafetyData", "OwnReport"),
    *("beacons", "payloads", "srp", "containers", "creates", "updates", "deletes", "summaries", "req_updates"),
    *("req_creates", "errors", "frames", "own_report", "record", "records"),
)


def contradictions(profile: Profile) -> Iterable[str]:
    """Yield what in ``profile`` contradicts itself or the specification, one sentence each."""
    if not profile.name or not profile.name.isprintable():
        yield f"name = {profile.name!r}: needs characters, and only such as can be printed on one line"
    yield from _bp_contradictions(profile)
    yield from _srp_contradictions(profile)
    yield from _vardis_contradictions(profile)
    yield from _type_contradictions(profile)


def _listed(key: str, found: Iterable[str], known: tuple[str, ...]) -> Iterable[str]:
    seen = list(found)
    for name in seen:
        if name not in known:
            yield f"{key} has {name!r}; expected one of {', '.join(known)}"
    for name in sorted({name for name in seen if seen.count(name) > 1}):
        yield f"{key} lists {name!r} twice"


def _own_layouts(key: str, members: Iterable[OwnField], *, fixed: bool = False) -> Iterable[str]:
    """Each field that the specification does not have has one layout, of a fixed size if ``fixed``."""
    for member in members:
        given = [each for each in ("opaque", "extra", "real", "block") if getattr(member, each) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            yield f"{key}: field {member.name!r} needs exactly one of opaque, extra, real, block; it has {found}"
            continue
        if member.text and member.block is None:
            yield f"{key}: text belongs to a block, and only there (field {member.name!r})"
        if member.block is None:
            continue
        if fixed:
            yield f"{key}: field {member.name!r} must have a fixed size; block is for records"
        if not member.block.lengths and not member.block.terminated:
            yield f"{key}: block {member.name!r} needs a length or a terminator, or its end is undefined"
        if any(length.signed for length in member.block.lengths):
            yield f"{key}: the length of block {member.name!r} cannot be signed"


def _own_names(key: str, names: list[str], taken_names: Iterable[str] | None = None) -> Iterable[str]:
    """Names of fields that the specification does not have must be usable as attributes and free."""
    taken = {_bare(name): name for name in (_TAKEN[key] if taken_names is None else taken_names)}
    for name in names:
        if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name) or {name, name.lower()} & set(keyword.kwlist):
            yield (
                f"{key}: field name {name!r} is not a plain name; expected letters, digits and _, first a letter, "
                "and not a Python keyword"
            )
        elif _bare(name) in taken:
            yield f"{key}: field name {name!r} is taken ({taken[_bare(name)]})"
    bare = [_bare(name) for name in names]
    for name in sorted({name for name in names if bare.count(_bare(name)) > 1}):
        yield f"{key}: field name {name!r} is used twice"


def _members(
    key: str, members: Members, known: tuple[str, ...], taken: Iterable[str] | None = None, *, fixed: bool = False
) -> Iterable[str]:
    """Return the faults of the members of a record: unknown, listed twice, or own fields without a layout."""
    yield from _listed(key, standard_fields(members), known)
    own = own_fields(members)
    yield from _own_layouts(key, own, fixed=fixed)
    yield from _own_names(key, [member.name for member in own], taken)


def _bare(name: str) -> str:
    """Return the form of a name in which colliding attributes are equal: sData and s_data."""
    return name.replace("_", "").lower()


def _bp_contradictions(profile: Profile) -> Iterable[str]:
    header = profile.bp.header
    yield from _members("bp.header", header, _HEADER_FIELDS, fixed=True)
    if header:
        for name in ("version", "magicNo", "senderId", "numPayloads", "seqno"):
            if name not in header:
                yield f"bp.header lacks {name} (BP-HDR-10); only an empty header, for none at all, may"
        if "length" not in header and profile.spec_version >= "1.2":
            yield f"bp.header lacks length, which specification {profile.spec_version} has (BP-HDR-06)"
        if "networkId" not in header and profile.spec_version >= "2.0":
            yield "bp.header lacks networkId, which specification 2.0 has (BP-HDR-04)"
        if profile.types.node_id.length is not None:
            yield "types.node_id.length: a sender identifier in the header has a fixed width (DATA-04)"
    if "networkId" in header:
        width = profile.types.network_id.width
        if width < 2 and profile.spec_version >= "2.0":
            yield f"types.network_id.width = {width}: at least 2 octets are required (BP-HDR-05)"
        value = profile.bp.network_id
        if value is not None and value >= 1 << (8 * width):
            yield f"bp.network_id = {value:#x} does not fit types.network_id.width = {width} octets"
    yield from _members("bp.payload_header", profile.bp.payload_header, ("protocolId", "length"), fixed=True)
    if sorted(standard_fields(profile.bp.payload_header)) != ["length", "protocolId"]:
        yield "bp.payload_header needs protocolId and length (BP-HDR-11)"
    if profile.bp.length_means == "header-size":
        if "length" not in header:
            yield "bp.length_means is set but bp.header has no length"
        elif (size := header_size(profile)) >= 1 << (8 * profile.types.bp_length.width):
            yield f"types.bp_length.width = {profile.types.bp_length.width}: cannot state a header of {size} octets"
    if header and profile.types.magic_no.width < 2:
        yield f"types.magic_no.width = 1: the magic number {BP_MAGIC_NO:#x} needs 2 octets (BP-HDR-02)"


def header_size(profile: Profile) -> int:
    """Octets of the BP header of this profile (0 when it sends none)."""
    types = profile.types
    sizes = {
        "version": 1,
        "magicNo": types.magic_no.width,
        "senderId": types.node_id.width,
        "networkId": types.network_id.width,
        "length": types.bp_length.width,
        "numPayloads": 1,
        "seqno": types.bp_seqno.width,
    }
    return sum(
        (member.width or 0) if isinstance(member, OwnField) else sizes.get(member, 0) for member in profile.bp.header
    )


def _srp_contradictions(profile: Profile) -> Iterable[str]:
    srp = profile.srp
    if not srp.record:
        if srp.record_size:
            yield f"srp.record_size = {srp.record_size} but srp.record lists no field"
        return
    yield from _members("srp.record", srp.record, _RECORD_FIELDS)
    if srp.is_report:
        names = standard_fields(srp.record)
        for name in _RECORD_FIELDS:
            if name not in names:
                yield f"srp.record lacks {name} (SRP-TYP-03); only a record of fields of your own may"
        if not srp.safety_data:
            yield "srp.safety_data lists no field; a state report needs a SafetyDataT of fixed size (SRP-TYP-02)"
    own = [member.name for member in own_fields(srp.record)]
    data = [member.name for member in srp.safety_data]
    yield from _own_names("srp.safety_data", data)
    for name in sorted(set(own) & set(data) if srp.is_report else ()):
        yield f"srp: field name {name!r} is used twice"
    for field in srp.safety_data:
        if (field.type == "opaque") != (field.octets > 0):
            yield f"srp.safety_data: octets belongs to the type opaque, and only there (field {field.name!r})"
    roles = [member.role for member in srp.safety_data if member.role]
    for role in sorted({role for role in roles if roles.count(role) > 1}):
        yield f"srp.safety_data: two fields have the role {role}"
    size = srp_record_size(profile)
    if srp.record_size is not None and size is not None and size != srp.record_size:
        yield f"srp.record_size = {srp.record_size} but the listed fields add up to {size} octets"
    if srp.record_size is not None and size is None:
        yield "srp.record_size is set but a field of srp.record has no fixed size"


def srp_record_size(profile: Profile) -> int | None:
    """Octets of one SRP payload; None when a field has no fixed width."""
    node_id = profile.types.node_id
    sizes: dict[str, int | None] = {
        "sData": sum(member.width for member in profile.srp.safety_data),
        "nodeId": node_id.width if node_id.length is None else None,
        "tStamp": profile.types.timestamp.width,
        "seqno": profile.types.srp_seqno.width,
    }
    total = 0
    for member in profile.srp.record:
        size = member.width if isinstance(member, OwnField) else sizes.get(member, 0)
        if size is None:
            return None
        total += size
    return total


def _vardis_contradictions(profile: Profile) -> Iterable[str]:
    vardis = profile.vardis
    yield from _members("vardis.var_spec", vardis.var_spec, _SPEC_FIELDS)
    for name in ("varId", "prodId", "repCnt", "descr"):
        if name not in vardis.var_spec:
            yield f"vardis.var_spec lacks {name} (VD-TYP-05)"
    for name in ("creationTime", "timeout"):
        if name in vardis.var_spec and profile.spec_version < "2.0":
            yield f"vardis.var_spec has {name}, which came with specification 2.0, not {profile.spec_version}"
        if name not in vardis.var_spec and profile.spec_version >= "2.0":
            yield f"vardis.var_spec lacks {name}, which specification 2.0 has (VD-TYP-05)"
    yield from _own_layouts("vardis.container_extra", vardis.container_extra)
    yield from _own_names("vardis.container_extra", [member.name for member in vardis.container_extra])
    for name, members in vardis.records.by_name().items():
        key, wanted = f"vardis.records.{name}", RECORD_MEMBERS[name]
        yield from _members(key, members, wanted, (*wanted, "extra"))
        for member in wanted:
            if member not in members:
                yield f"{key} lacks {member} (VD-TYP-07)"
    numbers = list(vardis.container_types.by_name().values())
    for number in sorted({number for number in numbers if numbers.count(number) > 1}):
        yield f"vardis.container_types uses the number {number} twice"
    yield from _own_containers(profile)


def _own_containers(profile: Profile) -> Iterable[str]:
    known = profile.vardis.container_types.by_name()
    numbers = {number: name for name, number in known.items()}
    types = {_bare(name): name for name in _TAKEN_TYPES}
    for container in profile.vardis.own_containers:
        key = f"vardis.own_containers {container.name!r}"
        if not re.fullmatch("[A-Za-z][A-Za-z0-9]*([-_][A-Za-z0-9]+)*", container.name):
            yield f"{key}: this is not a plain name; expected letters and digits, first a letter; between them - and _"
            continue
        if container.name in known:
            yield f"{key}: this is the name of a container type of the specification; change [vardis.container_types]"
        elif (bare := _bare(container.type_name)) in types:
            yield f"{key}: its records would be called {container.type_name}, which is taken ({types[bare]})"
        else:
            types[bare] = container.name
        if container.number in numbers:
            yield f"{key}: the number {container.number} is that of {numbers[container.number]}"
        numbers.setdefault(container.number, container.name)
        if not container.record:
            yield f"{key}: record lists no field"
        yield from _members(key, container.record, _OWN_RECORD_FIELDS, (*_OWN_RECORD_FIELDS, "extra", "asDict"))


def _lengths(profile: Profile) -> Iterable[tuple[str, IntType | None]]:
    types = profile.types
    yield "types.bp_length", types.bp_length
    yield "types.node_id.length", types.node_id.length
    yield "vardis.list_length", profile.vardis.list_length
    for name, text in (("string", types.string), ("value", types.value)):
        for length in text.lengths:
            yield f"types.{name}.lengths", length


def _type_contradictions(profile: Profile) -> Iterable[str]:
    node_id: NodeIdType = profile.types.node_id
    if node_id.length is None and node_id.width == 0:
        yield "types.node_id.width = 0: give a width of at least one octet or a length (DATA-04)"
    if node_id.representation == "mac" and node_id.width != 6:
        yield f"types.node_id: representation mac has 6 octets, not {node_id.width}"
    if node_id.representation == "mac" and node_id.length is not None:
        yield "types.node_id: representation mac has 6 octets and therefore no length"
    if node_id.representation == "text" and node_id.length is None:
        yield "types.node_id: representation text needs a length"
    for name in ("string", "value"):
        text = getattr(profile.types, name)
        if not text.lengths and not text.terminated:
            yield f"types.{name}: needs a length or a terminator, or its end is undefined"
    if not profile.types.value.lengths:
        yield "types.value: a value may hold any octet and therefore needs a length, not a terminator (DATA-06)"
    for key, length in _lengths(profile):
        if length is not None and length.signed:
            yield f"{key}: a length cannot be signed"
    for key, limit, text in (
        ("max_value_length", profile.limits.max_value_length, profile.types.value),
        ("max_description_length", profile.limits.max_description_length, profile.types.string),
    ):
        widths = [length.width for length in text.lengths]
        room = (1 << (8 * min(widths))) - 1 - text.terminated if widths else None
        if room is not None and limit > room:
            yield f"limits.{key} = {limit} but the length field of that type can say {room} at most"
    if profile.link.transport == "ethernet" and profile.link.ether_type is None:
        yield "link.ether_type is missing; Ethernet needs one (UWB-02)"
    if profile.link.transport == "udp" and profile.link.udp_port is None:
        yield "link.udp_port is missing; UDP needs one (UWB-02)"
    if profile.limits.uwb_max_packet < 256 and profile.spec_version >= "1.1":
        yield f"limits.uwb_max_packet = {profile.limits.uwb_max_packet}: at least 256 octets are required (UWB-03)"
    if profile.limits.max_beacon_size > profile.limits.uwb_max_packet:
        yield "limits.max_beacon_size is larger than limits.uwb_max_packet (BP-PAR-04)"
