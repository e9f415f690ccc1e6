"""Lower the construct schema of a profile to a plan: a small tree from which every view of the codec is made.

Construct trees are executable; a plan is data for other code. The compiled decoder and encoder, the dissector, the
exports (Wireshark, Kaitai, JSON Schema, tables) and the scapy layers all walk the plan, so the layout is defined once,
in ``dcp_spec``. Node types:

``Scalar``   fixed number of octets: integer, float or octets
``Text``     octets of varying number after lengths and/or before a NUL
``Rest``     all octets to the end of the region
``Fill``     the unused rest of a fixed area
``Group``    a record: named members in order
``Many``     a list of groups, counted by a field or up to the end of the region
``Region``   a content that must fill the number of octets in a field
``Exact``    a group of fixed size that must fill its region
``Select``   one of several contents, chosen by a field

``requirement`` is the requirement that octets break if they do not fit the node. ``field_requirement`` is the
requirement for a member of that form, if it is another one: a record has it at each of its positions. A node is equal
only to itself.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import construct as cs
from dcp_spec.wire import combinators as dc


@dataclass(frozen=True, slots=True)
class Rule:
    """Condition on the value of a scalar; ``value`` None means "not zero"."""

    value: int | None
    reason: str
    requirement: str | None


@dataclass(frozen=True, slots=True)
class Derived:
    """A scalar that follows from another member: its size in octets or its number of elements."""

    kind: Literal["size", "count"]
    of: str


@dataclass(frozen=True, slots=True, eq=False)
class Scalar:
    """``size`` octets. ``code`` is the struct code without byte order ("" if there is none for this width)."""

    name: str
    kind: Literal["int", "float", "bytes"]
    size: int
    code: str
    order: Literal["big", "little"]
    signed: bool = False
    rule: Rule | None = None
    derived: Derived | None = None
    names: Mapping[int, str] | None = None
    name_field: str | None = None
    requirement: str | None = None
    role: str | None = None
    unit: str | None = None
    doc: str = ""

    @property
    def stored(self) -> bool:
        """Return whether message values carry it (all scalars except constants and derived fields)."""
        return self.derived is None and (self.rule is None or self.rule.value is None)


@dataclass(frozen=True, slots=True, eq=False)
class Text:
    """Octets of varying number; ``human`` if they are text."""

    name: str
    prefixes: tuple[Scalar, ...]
    terminated: bool
    human: bool
    requirement: str | None = None
    role: str | None = None
    unit: str | None = None
    doc: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """All remaining octets of the region."""

    name: str
    field_requirement: str | None = None
    doc: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Fill:
    """``total`` octets minus the number in the field ``used``."""

    name: str
    total: int
    used: str
    reason: str = "area-overrun"
    requirement: str = "BP-RX-09"
    field_requirement: str | None = None
    doc: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """A record. ``type_name`` is the name of its value class, ``size`` its number of octets if that is fixed."""

    name: str
    type_name: str
    members: tuple[Node, ...]
    size: int | None
    requirement: str | None = None
    field_requirement: str | None = None
    doc: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Many:
    """A list of ``element``. ``count`` names the counting field (None: up to the end of the region); ``agrees`` names a
    field that must equal the number of elements. ``nonempty``: up to the end of the region, with at least one element.
    """

    name: str
    element: Group
    count: str | None
    agrees: str | None = None
    reason: str = "count-mismatch"
    requirement: str | None = None
    nonempty: bool = False
    field_requirement: str | None = None
    doc: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """``content`` in exactly as many octets as the field ``length`` states."""

    name: str
    length: str
    content: Node
    reason: str
    requirement: str
    field_requirement: str | None = None
    doc: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Exact:
    """``content`` must be as long as the region around it."""

    name: str
    content: Group
    size: int
    reason: str
    requirement: str
    field_requirement: str | None = None
    doc: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Select:
    """The content for the value of the field ``key``; the name of a case is its label."""

    name: str
    key: str
    cases: Mapping[int, Node]
    default: Node | None
    reason: str
    requirement: str | None
    field_requirement: str | None = None
    doc: str = ""


Node = Scalar | Text | Rest | Fill | Group | Many | Region | Exact | Select


@functools.lru_cache(maxsize=1024)
def snake(name: str) -> str:
    """Convert ``"numPayloads"`` to ``"num_payloads"``: field names of the specification to Python attributes."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def lower(subcon: Any, name: str = "") -> Node:
    """Return the plan of a construct schema made of the classes of ``dcp_spec.wire.combinators``.

    Raises ``TypeError`` for a construct class that the views do not support.
    """
    match subcon:
        case dc.Field():
            return _lower_field(subcon)
        case dc.Record():
            members = tuple(lower(member) for member in subcon.subcons)
            return Group(name, subcon.type_name, members, _total(members), subcon.requirement)
        case dc.WholeRegion():
            content = lower(subcon.subcon, name)
            assert isinstance(content, Group)
            assert content.size is not None
            return Exact(name, content, content.size, subcon.reason, subcon.requirement)
        case dc.Counted():
            return Many(name, _element(subcon), subcon.count)
        case dc.UntilEnd():
            return Many(name, _element(subcon), None, subcon.count, subcon.reason, subcon.requirement, subcon.nonempty)
        case dc.Sized():
            return Region(name, subcon.size, lower(subcon.subcon, name), subcon.reason, subcon.requirement)
        case dc.Choice():
            cases = {int(key): lower(layout, label) for key, (label, layout) in subcon.cases.items()}
            default = lower(subcon.default[1], subcon.default[0]) if subcon.default else None
            return Select(name, subcon.key, cases, default, subcon.reason, subcon.requirement)
        case dc.VarBytes():
            prefixes = tuple(
                replace(_scalar(prefix), name=f"length{number}" if number > 1 else "length")
                for number, prefix in enumerate(subcon.prefixes, start=1)
            )
            return Text(name, prefixes, subcon.terminated, subcon.text)
        case dc.Filler():
            return Fill(name, subcon.total, subcon.used)
        case _ if subcon is cs.GreedyBytes:
            return Rest(name)
        case _:
            return replace(_scalar(subcon), name=name)


def _lower_field(field: dc.Field) -> Node:
    node = lower(field.subcon, field.name)
    if isinstance(node, Text):
        # A value that is cut off in its length breaks the same rule as one that is cut off after it.
        node = replace(node, prefixes=tuple(replace(each, requirement=field.requirement) for each in node.prefixes))
    if isinstance(node, Scalar | Text):
        return replace(node, requirement=field.requirement, role=field.role, unit=field.unit, doc=field.docs)
    return replace(node, field_requirement=field.requirement, doc=field.docs)


def _element(subcon: Any) -> Group:
    element = lower(subcon.subcon)
    if not isinstance(element, Group):
        raise TypeError("a list in a schema must be a list of records")
    return element


def _total(members: tuple[Node, ...]) -> int | None:
    sizes = [member.size if isinstance(member, Scalar | Group) else None for member in members]
    return sum(size for size in sizes if size is not None) if None not in sizes else None


def _scalar(subcon: Any) -> Scalar:
    match subcon:
        case dc.Expect():
            rule = Rule(subcon.value, subcon.reason, subcon.requirement)
            return replace(_scalar(subcon.subcon), rule=rule)
        case dc.SizeOf():
            nonzero = Rule(None, subcon.reason, subcon.requirement) if subcon.nonzero else None
            return replace(_scalar(subcon.subcon), rule=nonzero, derived=Derived("size", subcon.of))
        case dc.CountOf():
            nonzero = Rule(None, subcon.reason, subcon.requirement)
            return replace(_scalar(subcon.subcon), rule=nonzero, derived=Derived("count", subcon.of))
        case dc.Named():
            return replace(_scalar(subcon.subcon), names=subcon.names, name_field=subcon.label_field)
        case cs.FormatField():
            order: Literal["big", "little"] = "big" if subcon.fmtstr[0] == ">" else "little"
            code = subcon.fmtstr[1:]
            kind: Literal["int", "float"] = "float" if code in "fd" else "int"
            return Scalar("", kind, subcon.length, code, order, code.islower() and kind == "int")
        case cs.BytesInteger():
            order = "little" if subcon.swapped else "big"
            return Scalar("", "int", subcon.length, "", order, subcon.signed)
        case cs.Bytes():
            return Scalar("", "bytes", subcon.length, f"{subcon.length}s", "big")
        case _:
            raise TypeError(f"no view knows the construct class {type(subcon).__name__}")
