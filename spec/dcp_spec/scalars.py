"""Construct fields for the scalar types of a profile."""

from __future__ import annotations

from typing import Any

import construct as cs

from .combinators import Field, VarBytes
from .profile import Extra, IntType, NodeIdType, Opaque, TextType

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
    """The construct field for a node identifier; its value is the octets as they are on the wire."""
    if of.length is not None:
        return VarBytes(integer(of.length), text=True)
    return cs.Bytes(of.width)


def octets(of: TextType, *, text: bool) -> Any:
    """The construct field for a string (``text``) or a variable value."""
    return VarBytes(*(integer(length) for length in of.lengths), terminated=of.terminated, text=text)


def foreign(member: Opaque | Extra) -> Field:
    """A field that the specification does not have: octets without meaning, or a number."""
    if isinstance(member, Opaque):
        return Field(member.name, cs.Bytes(member.opaque), role="opaque", doc=member.note)
    return Field(member.name, integer(member.extra), role="extra", doc=member.note)
