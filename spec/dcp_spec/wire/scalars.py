"""Construct fields for the scalar types of a profile."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import construct as cs

from dcp_spec.profile.types import IntType, Members, NodeIdType, OwnField, TextType

from .combinators import Field, VarBytes

# struct codes for the widths that have one; the others become construct's BytesInteger.
_CODES = {1: "b", 2: "h", 4: "l", 8: "q"}
_ORDER = {"big": ">", "little": "<"}


def integer(of: IntType) -> Any:
    """The construct field for an integer of ``of.width`` octets."""
    ##= DATA-03
    code = _CODES.get(of.width)
    if code is None:
        return cs.BytesInteger(of.width, signed=of.signed, swapped=of.byte_order == "little")
    ##= DATA-01
    return cs.FormatField(_ORDER[of.byte_order], code if of.signed else code.upper())


def real(width: int, byte_order: str) -> Any:
    """The construct field for an IEEE 754 number of 4 or 8 octets."""
    return cs.FormatField(_ORDER[byte_order], {4: "f", 8: "d"}[width])


def node_id(of: NodeIdType) -> Any:
    """The construct field for a node identifier; its value is the octets on the wire."""
    if of.length is not None:
        return VarBytes(integer(of.length), text=True)
    return cs.Bytes(of.width)


def octets(of: TextType, *, text: bool) -> Any:
    """The construct field for a string (``text``) or a variable value."""
    return VarBytes(*(integer(length) for length in of.lengths), terminated=of.terminated, text=text)


def foreign(member: OwnField) -> Field:
    """A field that the specification does not have."""
    doc, unit = member.note, member.unit or None
    if member.opaque is not None:
        return Field(member.name, cs.Bytes(member.opaque), role="opaque", unit=unit, doc=doc)
    if member.block is not None:
        return Field(member.name, octets(member.block, text=member.text), role="extra", unit=unit, doc=doc)
    if member.real is not None:
        return Field(member.name, real(member.real.width, member.real.byte_order), role="extra", unit=unit, doc=doc)
    if member.extra is None:
        raise ValueError(f"field {member.name!r} has no layout")
    return Field(member.name, integer(member.extra), role="extra", unit=unit, doc=doc)


def members(listed: Members, fields: Iterable[Field]) -> list[Field]:
    """The members of a record: the standard ones out of ``fields``, and those of the implementation's own."""
    standard = {field.name: field for field in fields}
    return [standard[member] if isinstance(member, str) else foreign(member) for member in listed]
