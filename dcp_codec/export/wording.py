"""Wording of the exports about a field: one sentence of meaning, unit and requirement."""

from __future__ import annotations

import re

from dcp_spec.profile.definition import Profile

from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text

_EPOCHS = {
    "unix": "1970-01-01T00:00:00Z",
    "gps": "1980-01-06T00:00:00Z",
    "simulation": "the simulation began",
    "boot": "the sender was started",
}


def snake_name(name: str) -> str:
    """Return a name of the specification as Kaitai and C have it: ``"BPHeader"`` -> ``"bp_header"``."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    plain = re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")
    return plain if plain[:1].isalpha() else f"f_{plain}".rstrip("_")


def constant(name: str) -> str:
    """Return a name in capitals: ``"REQUEST-VARUPDATES"`` -> ``"REQUEST_VARUPDATES"``."""
    return "".join(each if each.isalnum() and each.isascii() else "_" for each in name).upper()


def bits_of(octets: int) -> int:
    """Return the width of the narrowest integer of C and Rust for a value of ``octets`` octets."""
    return next(bits for bits in (8, 16, 32, 64) if octets * 8 <= bits)


def requirement_of(node: Node) -> str | None:
    """Return the requirement for a field or record, if the schema names one."""
    if not isinstance(node, Scalar | Text) and node.field_requirement is not None:
        return node.field_requirement
    if isinstance(node, Region | Exact):
        return requirement_of(node.content) or node.requirement
    return None if isinstance(node, Rest) else node.requirement


def unit_of(node: Node, profile: Profile) -> str:
    """Return the unit of a field, for time stamps with their epoch; empty without one."""
    unit = (node.unit or "") if isinstance(node, Scalar | Text) else ""
    if isinstance(node, Scalar) and node.role == "timestamp":
        return f"{unit} since {_EPOCHS[profile.types.timestamp.epoch]}"
    return unit


def meaning(node: Node) -> str:
    """Return the meaning of a field; never empty."""
    role = node.role if isinstance(node, Scalar | Text) else None
    if role == "opaque":
        return "no meaning" + (f" ({node.doc})" if node.doc else "")
    if role == "extra":
        return "not in the specification" + (f": {node.doc}" if node.doc else "")
    if node.doc:
        return node.doc
    if role:
        return role.replace(".", " ").replace("-", " ")
    match node:
        case Rest():
            return "octets of a protocol that is not known"
        case Fill():
            return "unused rest of the fixed area"
        case Scalar(derived=derived) if derived is not None:
            what = "size" if derived.kind == "size" else "number of elements"
            return f"{what} of {derived.of.removeprefix('_.')}"
        case Many():
            return f"list of {node.element.type_name}"
        case Region() | Exact():
            return meaning(node.content)
        case Group():
            return f"record {node.type_name}"
        case Select():
            return "one of several contents"
        case _:
            return "value of the application"


def description(node: Node, profile: Profile) -> str:
    """Return meaning, unit and requirement in one line."""
    text, unit, requirement = meaning(node), unit_of(node, profile), requirement_of(node)
    if unit:
        text += f", in {unit}"
    return f"{text} [{requirement}]" if requirement else text
