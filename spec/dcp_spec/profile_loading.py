"""Find, read and validate profile files. Every complaint names the file, the key and what to do."""

from __future__ import annotations

import difflib
import functools
import importlib.resources
import keyword
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from .constants import BP_MAGIC_NO, SpecVersion
from .profile import IntType, NodeIdType, Opaque, Profile

BUILTIN_PROFILES: tuple[str, ...] = (
    "dcp-1.0",
    "dcp-1.1",
    "dcp-1.2",
    "dcp-1.3",
    "dcp-2.0",
    "cpp-1.2",
    "cpp-1.3",
    "cpp-2.0",
    "sim-1.0",
    "sim-2.0",
    "student-2024",
)

_HEADER_FIELDS = ("version", "magicNo", "senderId", "networkId", "length", "numPayloads", "seqno")
_RECORD_FIELDS = ("sData", "nodeId", "tStamp", "seqno")
_SPEC_FIELDS = ("varId", "prodId", "repCnt", "creationTime", "timeout", "descr")
# What fields of the implementation's own may not be called: what else the record around them has under a name.
_TAKEN = {
    "bp.payload_header": ("protocolId", "length", "content", "area", "srp", "vardis", "data", "extra"),
    "srp.record": (*_RECORD_FIELDS, "extra"),
    "srp.safety_data": ("as_dict", "extra"),
    "vardis.container_extra": ("icType", "icName", "icNumRecords", "listLength", "records", "extra"),
}
_MAX_DEPTH = 8


class ProfileError(ValueError):
    """A profile cannot be used. The message names the profile or file, the key, and what to change."""


def profile_names() -> tuple[str, ...]:
    """The names of the built-in profiles, oldest specification first."""
    return BUILTIN_PROFILES


def load_profile(name_or_path: str | Path) -> Profile:
    """Return the built-in profile of that name, or the one in that TOML file.

    Raises :class:`ProfileError` when there is no such profile, the file cannot be read or what it says
    contradicts itself.
    """
    text = str(name_or_path)
    if text in BUILTIN_PROFILES:
        return _load_builtin(text)
    path = Path(text)
    if path.suffix != ".toml" and not _exists(path):
        near = difflib.get_close_matches(text, BUILTIN_PROFILES, n=3, cutoff=0.4)
        hint = f"did you mean {' or '.join(near)}?" if near else "the built-in ones are: " + ", ".join(BUILTIN_PROFILES)
        raise ProfileError(
            f"unknown profile {text!r}: {hint} (a profile of your own is given as a path to a .toml file)"
        )
    return _build(_resolve(_read(path), str(path), path.parent), str(path))


@functools.cache
def _load_builtin(name: str) -> Profile:
    return _build(_resolve(_read_builtin(name), name, None), name)


def _read_builtin(name: str) -> dict[str, Any]:
    resource = importlib.resources.files("dcp_spec").joinpath("profiles", f"{name}.toml")
    return tomllib.loads(resource.read_text(encoding="utf-8"))


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name too long for the file system
        return False


def _read(path: Path) -> dict[str, Any]:
    try:
        octets = path.read_bytes()
    except FileNotFoundError:
        raise ProfileError(f"{path}: there is no such profile file") from None
    except OSError as error:
        raise ProfileError(f"{path}: cannot read this profile file ({error.strerror})") from None
    except ValueError as error:  # a name that no file can have
        raise ProfileError(f"{str(path)!r}: cannot read this profile file ({error})") from None
    try:
        return tomllib.loads(octets.decode())
    except (ValueError, RecursionError) as error:
        raise ProfileError(f"{path}: this is not a TOML file: {error}") from None


def _resolve(raw: dict[str, Any], where: str, folder: Path | None, depth: int = 0) -> dict[str, Any]:
    """Merge ``raw`` over the profile that it extends; tables merge key by key, all else is replaced."""
    base_name = raw.pop("extends", None)
    if base_name is None:
        return raw
    if not isinstance(base_name, str):
        raise ProfileError(f"{where}: extends must be the name of a profile or the path of a file, not {base_name!r}")
    if depth >= _MAX_DEPTH:
        raise ProfileError(f"{where}: extends goes round in a circle or deeper than {_MAX_DEPTH} files")
    if base_name in BUILTIN_PROFILES:
        base = _resolve(_read_builtin(base_name), base_name, None, depth + 1)
    elif folder is not None and base_name.endswith(".toml"):
        path = folder / base_name
        base = _resolve(_read(path), str(path), path.parent, depth + 1)
    else:
        known = ", ".join(BUILTIN_PROFILES)
        raise ProfileError(f"{where}: extends = {base_name!r} is no built-in profile ({known}) and no .toml file")
    return _merge(base, raw)


def _merge(base: dict[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        merged[key] = _merge(below, value) if isinstance(value, dict) and isinstance(below, dict) else value
    return merged


def _build(raw: dict[str, Any], where: str) -> Profile:
    _know_version(raw.get("spec_version"), where)
    try:
        profile = msgspec.convert(raw, Profile)
    except msgspec.ValidationError as error:
        raise ProfileError(f"{where}: {_explain(str(error))}") from None
    complaints = list(contradictions(profile))
    if complaints:
        raise ProfileError(f"{where}: " + "; ".join(complaints))
    return profile


def _know_version(version: object, where: str) -> None:
    """Refuse a version of the specification that this code base knows nothing of. A missing one is another error."""
    known = [str(each) for each in SpecVersion]
    if version is None or version in known:
        return
    hint = f'write "{version}"' if str(version) in known else f"known are {', '.join(known)}"
    raise ProfileError(f"{where}: spec_version = {version!r} is no known version of the specification: {hint}")


def _explain(message: str) -> str:
    """Turn msgspec's ``... - at `$.types.var_id.width``` into ``types.var_id.width: ...``."""
    text, _, place = message.partition(" - at `$")
    key = place.rstrip("`").lstrip(".")
    if text.startswith("Object contains unknown field"):
        return f"{text}{f' in [{key}]' if key else ''}; remove it or correct its name"
    return f"{key}: {text}" if key else text


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
            yield f"{key} has {name!r}, which is none of {', '.join(known)}"
    for name in sorted({name for name in seen if seen.count(name) > 1}):
        yield f"{key} lists {name!r} twice"


def _own_names(key: str, names: list[str]) -> Iterable[str]:
    """Names of fields that the specification does not have must be usable as attributes and free."""
    taken = {_bare(name): name for name in _TAKEN[key]}
    for name in names:
        if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name) or keyword.iskeyword(name):
            yield f"{key}: field name {name!r} is no plain name (letters, digits, _; first a letter; no word of Python)"
        elif _bare(name) in taken:
            yield f"{key}: field name {name!r} is taken ({taken[_bare(name)]})"
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield f"{key}: field name {name!r} is used twice"


def _bare(name: str) -> str:
    """What names have in common that would collide as attributes: sData and s_data."""
    return name.replace("_", "").lower()


def _bp_contradictions(profile: Profile) -> Iterable[str]:
    header = profile.bp.header
    yield from _listed("bp.header", header, _HEADER_FIELDS)
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
    block = [name for name in profile.bp.payload_header if isinstance(name, str)]
    yield from _listed("bp.payload_header", block, ("protocolId", "length"))
    if sorted(block) != ["length", "protocolId"]:
        yield "bp.payload_header needs protocolId and length (BP-HDR-11)"
    own = [member.name for member in profile.bp.payload_header if isinstance(member, Opaque)]
    yield from _own_names("bp.payload_header", own)
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
    return sum(sizes.get(name, 0) for name in profile.bp.header)


def _srp_contradictions(profile: Profile) -> Iterable[str]:
    srp = profile.srp
    if not srp.record:
        if srp.record_size:
            yield f"srp.record_size = {srp.record_size} but srp.record lists no field"
        return
    names = [name for name in srp.record if isinstance(name, str)]
    yield from _listed("srp.record", names, _RECORD_FIELDS)
    for name in _RECORD_FIELDS:
        if name not in names:
            yield f"srp.record lacks {name} (SRP-TYP-03)"
    if not srp.safety_data:
        yield "srp.safety_data lists no field; a state report needs a SafetyDataT of fixed size (SRP-TYP-02)"
    own = [member.name for member in srp.record if isinstance(member, Opaque)]
    data = [member.name for member in srp.safety_data]
    yield from _own_names("srp.record", own)
    yield from _own_names("srp.safety_data", data)
    for name in sorted(set(own) & set(data)):
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
        yield "srp.record_size is set but types.node_id has no fixed width"


def srp_record_size(profile: Profile) -> int | None:
    """Octets of one state report, or None when the node identifier has no fixed width."""
    if profile.types.node_id.length is not None:
        return None
    sizes = {
        "sData": sum(member.width for member in profile.srp.safety_data),
        "nodeId": profile.types.node_id.width,
        "tStamp": profile.types.timestamp.width,
        "seqno": profile.types.srp_seqno.width,
    }
    return sum(member.opaque if isinstance(member, Opaque) else sizes.get(member, 0) for member in profile.srp.record)


def _vardis_contradictions(profile: Profile) -> Iterable[str]:
    vardis = profile.vardis
    yield from _listed("vardis.var_spec", vardis.var_spec, _SPEC_FIELDS)
    for name in ("varId", "prodId", "repCnt", "descr"):
        if name not in vardis.var_spec:
            yield f"vardis.var_spec lacks {name} (VD-TYP-05)"
    for name in ("creationTime", "timeout"):
        if name in vardis.var_spec and profile.spec_version < "2.0":
            yield f"vardis.var_spec has {name}, which came with specification 2.0, not {profile.spec_version}"
        if name not in vardis.var_spec and profile.spec_version >= "2.0":
            yield f"vardis.var_spec lacks {name}, which specification 2.0 has (VD-TYP-05)"
    yield from _own_names("vardis.container_extra", [member.name for member in vardis.container_extra])
    numbers = list(vardis.container_types.by_name().values())
    for number in sorted({number for number in numbers if numbers.count(number) > 1}):
        yield f"vardis.container_types uses the number {number} twice"


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
            yield f"types.{name}: needs a length or a terminator, or nobody can tell where it ends"
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
