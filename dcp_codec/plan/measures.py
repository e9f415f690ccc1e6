"""Sizes and positions of the parts of a plan. All sizes are octets."""

from __future__ import annotations

from typing import TypeVar

from .layout import walk
from .tree import Exact, Fill, Group, Node, Scalar, Text

N = TypeVar("N", Scalar, Text, Group)


def least_size(node: Node) -> int:
    """Return the size when all parts of varying length (contents of regions, lists, texts) are empty."""
    match node:
        case Scalar():
            return node.size
        case Text():
            return sum(prefix.size for prefix in node.prefixes) + node.terminated
        case Group():
            return sum(least_size(member) for member in node.members)
        case Exact():
            return node.size
        case Fill():
            return node.total
        case _:
            return 0


def record(plan: Node, type_name: str) -> Group | None:
    """Return the layout of the records of a type; None if the plan has no such record."""
    return next((each for each in walk(plan) if isinstance(each, Group) and each.type_name == type_name), None)


def member(group: Group, name: str) -> Node | None:
    """Return the member of a record with the specification's name; None if the layout has none."""
    return next((each for each in group.members if each.name == name), None)


def places(group: Group) -> dict[str, slice]:
    """Return the positions of the members of a record, from its start up to the first one of varying size."""
    found: dict[str, slice] = {}
    start = 0
    for each in group.members:
        size = each.size if isinstance(each, Scalar | Group | Exact) else None
        if size is None:
            break
        found[each.name] = slice(start, start + size)
        start += size
    return found


def start(group: Group, name: str) -> int | None:
    """Return the offset of a member in its record; None if the layout has none, or a part of varying size precedes
    it.
    """
    begin = 0
    for each in group.members:
        if each.name == name:
            return begin
        if not isinstance(each, Scalar | Group | Exact) or each.size is None:
            return None
        begin += each.size
    return None


def largest(scalar: Scalar) -> int:
    """Return the largest value of an integer."""
    return int((1 << (8 * scalar.size - scalar.signed)) - 1)


def longest(text: Text) -> int | None:
    """Return the longest content that the lengths before it can count; None if it has no lengths."""
    return min((largest(prefix) for prefix in text.prefixes), default=None)
