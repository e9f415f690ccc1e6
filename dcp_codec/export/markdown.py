"""Export of the wire format as a Markdown document: tables with bit offsets, limits, and an annotated beacon.

The document is also readable in a terminal: the columns are padded.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from functools import partial

import msgspec
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.constants import BP_MAGIC_NO, BP_PROTID_SRP, BP_PROTID_VARDIS, BP_VERSION
from dcp_spec.markdown import table
from dcp_spec.profile.definition import Profile

from dcp_codec.codec import Codec
from dcp_codec.plan.layout import walk
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text

from .example import annotated, example_beacon
from .wording import meaning, requirement_of, unit_of

_COLUMNS = ("Field", "Bit offset", "Bits", "Type", "Byte order", "Unit", "Meaning", "Requirement")
_WIDTH = 110


def format_tables(codec: Codec) -> str:
    """Return the document: profile at a glance, constants, one table for each record, limits, an example.

    Bit offsets count from the first bit of the record; "after F + N" is N bits after the end of a field F whose length
    varies.
    """
    profile = codec.profile
    parts = [
        f"# {profile.title}: wire format",
        _introduction(profile),
        "## At a glance",
        _table(("Item", "Value"), _glance(codec)),
        "## Constants",
        _table(("Constant", "Value", "Meaning"), _constants(profile)),
        "## Containers",
        _table(("icType", "icName", "Records"), _containers(codec)),
        "## Records",
        "Bit offsets count from the first bit of the record, which is the most significant bit of its first octet.",
    ]
    records = list(_records(codec))
    for group in records:
        parts += [f"### {group.type_name}", _about(group), _table(_COLUMNS, _rows(group, codec))]
    opaque = list(_opaque(records))
    if opaque:
        parts += [
            "## Octets without meaning",
            "Receivers ignore them. They are kept when a beacon is decoded, and are zero in beacons of our own.",
            _table(("Record", "Field", "Octets", "Meaning"), opaque),
        ]
    parts += [
        "## Limits and behaviour",
        _table(("Key", "Value"), _settings(profile)),
        "## Example",
        *_example(codec),
        "## Requirements",
        _table(("Requirement", "Section", "Statement"), _cited(records, codec)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


# -- what is not a record -----------------------------------------------------------------------------------------


def _introduction(profile: Profile) -> str:
    text = f"Profile `{profile.name}`, specification {profile.spec_version}. {profile.notes}"
    return textwrap.fill(" ".join(text.split()), _WIDTH, break_on_hyphens=False)


def _glance(codec: Codec) -> Iterator[tuple[str, ...]]:
    profile, link = codec.profile, codec.profile.link
    if link.transport == "udp":
        yield "bearer", f"UDP broadcast, port {link.udp_port}"
    else:
        yield "bearer", "Ethernet II broadcast" + (f", EtherType 0x{link.ether_type:04X}" if link.ether_type else "")
    sizes = {group.type_name: group.size for group in _records(codec)}
    yield "beacon header", _octets(sizes["BPHeader"] or 0) if "BPHeader" in sizes else "none"
    block = next(group for group in _records(codec) if group.type_name == "Payload")
    heading = sum(member.size for member in block.members if isinstance(member, Scalar))
    yield "payload header", _octets(heading)
    report = sizes.get("ExtendedSafetyData")
    if codec.srp_plan is not None and codec.report_plan is None:
        own = sizes["OwnReport"]
        yield "payload of SRP", f"no state report, {_octets(own) if own else 'of varying length'}"
    else:
        yield "state report", _octets(report) if report else "of varying length" if codec.report_plan else "no octets"
    node = profile.types.node_id
    width = "text after a length" if node.length is not None else _octets(node.width)
    yield "node identifier", f"{width}, written as {node.representation}"
    members = (member for group in _records(codec) for member in group.members)
    stamp = next((each for each in members if isinstance(each, Scalar) and each.role == "timestamp"), None)
    if stamp is not None:
        yield "time stamps", f"{_type(stamp)}, {stamp.order}-endian, {unit_of(stamp, profile)}"


def _constants(profile: Profile) -> Iterator[tuple[str, ...]]:
    if profile.bp.header:
        yield "version", f"0x{BP_VERSION:02X}", "version octet of every beacon"
        yield "magicNo", f"0x{BP_MAGIC_NO:04X}", "magic number of every beacon"
    if profile.has_header_field("networkId") and profile.bp.network_id is not None:
        yield "networkId", f"0x{profile.bp.network_id:04X}", "network that own beacons name"
    yield "protocolId", str(BP_PROTID_SRP.value), "State Reporting Protocol"
    yield "protocolId", str(BP_PROTID_VARDIS.value), "VarDis"


def _containers(codec: Codec) -> Iterator[tuple[str, ...]]:
    for node in walk(codec.containers_plan):
        if isinstance(node, Select):
            names = codec.profile.vardis.container_types.by_name()
            names |= {own.name: own.number for own in codec.profile.vardis.own_containers}
            for name, number in sorted(names.items(), key=lambda item: item[1]):
                case = node.cases[number]
                yield str(number), name, _link(case.element.type_name) if isinstance(case, Many) else case.name


def _settings(profile: Profile) -> Iterator[tuple[str, ...]]:
    for section in ("limits", "behaviour"):
        for key, value in msgspec.to_builtins(getattr(profile, section)).items():
            if value is not None:
                yield f"`{section}.{key}`", str(value).lower() if isinstance(value, bool) else str(value)


def _opaque(records: list[Group]) -> Iterator[tuple[str, ...]]:
    for group in records:
        for member in group.members:
            if isinstance(member, Scalar) and member.role == "opaque":
                yield _link(group.type_name), f"`{member.name}`", str(member.size), member.doc
            elif isinstance(member, Fill):
                yield _link(group.type_name), f"`{member.name}`", f"rest of {member.total}", member.doc


def _cited(records: list[Group], codec: Codec) -> Iterator[tuple[str, ...]]:
    ids = {row[-1] for group in records for row in _rows(group, codec)} | {group.requirement for group in records}
    for requirement in requirements().values():
        if requirement.id in ids:
            yield requirement.id, f"`{requirement.section}`", requirement.statement


def _example(codec: Codec) -> Iterator[str]:
    beacon = example_beacon(codec)
    octets = codec.encode(beacon)
    yield f"A beacon of {_octets(len(octets))}. Offsets count octets from its first one."
    yield "```text\n" + "\n".join(annotated(codec, octets)) + "\n```"


# -- records ------------------------------------------------------------------------------------------------------


def _records(codec: Codec) -> Iterator[Group]:
    """Yield each record type once, outer records before inner ones."""
    seen = set()
    for node in walk(codec.beacon_plan):
        if isinstance(node, Group) and node.type_name not in seen:
            seen.add(node.type_name)
            yield node


def _about(group: Group) -> str:
    size = _octets(group.size) if group.size is not None else "Of varying length"
    return f"{size}." + (f" Requirement {group.requirement}." if group.requirement else "")


def _octets(number: int) -> str:
    return f"{number} octet{'' if number == 1 else 's'}"


class _Position:
    """A position in a record: a number of bits after its start, or after a field whose length varies."""

    def __init__(self) -> None:
        self.behind = ""
        self.bits = 0

    def __str__(self) -> str:
        if not self.behind:
            return str(self.bits)
        return f"after {self.behind}" + (f" + {self.bits}" if self.bits else "")

    def skip(self, octets: int | None, name: str) -> None:
        """Advance by a field of ``octets``; None if its length varies."""
        if octets is None:
            self.behind, self.bits = name, 0
        else:
            self.bits += 8 * octets


def _rows(group: Group, codec: Codec) -> Iterator[tuple[str, ...]]:
    position = _Position()
    for member in group.members:
        yield from _member(member, group, position, codec.profile)


def _member(node: Node, group: Group, position: _Position, profile: Profile) -> Iterator[tuple[str, ...]]:
    tail = (unit_of(node, profile), _meaning(node), requirement_of(node) or "")
    match node:
        case Scalar():
            order = f"{node.order}-endian" if node.size > 1 and node.kind != "bytes" else ""
            yield (f"`{node.name}`", str(position), str(8 * node.size), _type(node), order, *tail)
            position.skip(node.size, node.name)
        case Text():
            yield from _text(node, position, tail)
        case Group():
            bits = str(8 * node.size) if node.size is not None else "varies"
            yield (f"`{node.name}`", str(position), bits, _link(node.type_name), "", *tail)
            position.skip(node.size, node.name)
        case _:
            content = node.content if isinstance(node, Region) else node
            names = []
            for name, kind, when, about in _contents(content, group):
                what = " ".join(filter(None, (when, node.doc or about)))
                yield (f"`{name}`", str(position), _varying_bits(node), kind, "", tail[0], what, tail[2])
                names.append(name)
            position.skip(None, "/".join(dict.fromkeys(names)))


def _varying_bits(node: Node) -> str:
    match node:
        case Region():
            return f"8 × {node.length}"
        case Fill():
            return f"8 × ({node.total} - {node.used})"
        case _:
            return "varies"


def _text(node: Text, position: _Position, tail: tuple[str, str, str]) -> Iterator[tuple[str, ...]]:
    """Yield the rows of a text of varying length: its lengths, its octets, its NUL."""
    unit, about, requirement = tail
    for prefix in node.prefixes:
        order = f"{prefix.order}-endian" if prefix.size > 1 else ""
        counts = "octets of data with their NUL" if node.terminated else "octets of data"
        row = (f"`{node.name}.{prefix.name}`", str(position), str(8 * prefix.size), _type(prefix), order, "octets")
        yield (*row, counts, requirement)
        position.skip(prefix.size, node.name)
    kind = "UTF-8" if node.human else "octets"
    if not node.prefixes:
        yield (f"`{node.name}`", str(position), "varies", f"{kind}, NUL", "", unit, about, requirement)
    else:
        bits = f"8 × {node.name}.{node.prefixes[0].name}"
        kind += ", NUL" if node.terminated else ""
        yield (f"`{node.name}.data`", str(position), bits, kind, "", unit, about, requirement)
    position.skip(None, node.name)


def _contents(node: Node, group: Group) -> Iterator[tuple[str, str, str, str]]:
    """Yield name, type, condition and meaning of all alternative contents at one position."""
    match node:
        case Select():
            key = next(member for member in group.members if member.name == node.key)
            for number, case in node.cases.items():
                label = key.names.get(number) if isinstance(key, Scalar) and key.names else None
                when = f"if {node.key} is {number}" + (f" ({label})" if label else "") + ":"
                yield from ((name, kind, when, about) for name, kind, _, about in _contents(case, group))
            if node.default is not None:
                yield from ((name, kind, "else:", about) for name, kind, _, about in _contents(node.default, group))
        case Many():
            times = f"{node.count} times" if node.count else "up to the end"
            yield node.name, f"{_link(node.element.type_name)}, {times}", "", meaning(node)
        case Exact():
            yield node.name, _link(node.content.type_name), "", meaning(node.content)
        case Group():
            yield node.name, _link(node.type_name), "", meaning(node)
        case Rest() | Fill():
            yield node.name, "octets", "", meaning(node)
        case _:
            raise TypeError(f"{type(node).__name__} is not a content")


def _type(scalar: Scalar) -> str:
    if scalar.kind == "bytes":
        return _octets(scalar.size)
    return f"{'f' if scalar.kind == 'float' else 'i' if scalar.signed else 'u'}{8 * scalar.size}"


def _meaning(node: Node) -> str:
    """Return the meaning, and the value in a well-formed beacon if it is fixed."""
    text = meaning(node)
    if isinstance(node, Scalar) and node.rule is not None:
        text += "; not 0" if node.rule.value is None else f"; always 0x{node.rule.value:0{2 * node.size}X}"
    return text


# -- Markdown -----------------------------------------------------------------------------------------------------


_table = partial(table, padded=True)


def _link(type_name: str) -> str:
    return f"[{type_name}](#{type_name.lower()})"
