"""Find the reason why a value does not fit a plan: which field, and what is wrong with it.

The generated encoder only notices that packing failed. Only then this module walks plan and value side by side.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

from dcp_codec.errors import EncodeError
from dcp_codec.plan.layout import ValueTypes
from dcp_codec.plan.measures import largest
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text


def measured(group: Group, length: str) -> str:
    """Return the member whose length the field ``length`` of ``group`` holds."""
    for member in group.members:
        if isinstance(member, Scalar) and member.name == length and member.derived is not None:
            return member.derived.of
    raise TypeError(f"{length} measures nothing")


def zero(node: Node) -> Any:
    """Return the default content of an extra field (None: as many zeros as the area needs)."""
    match node:
        case Scalar(kind="bytes"):
            return bytes(node.size)
        case Scalar():
            return 0
        case Text():
            return b""
        case _:
            return None


def explain(plan: Node, types: ValueTypes, value: Any) -> None:
    """Raise :class:`EncodeError` for the first part of ``value`` that does not fit; return if there is none."""
    _Explainer(types).node(plan, value, "", {})


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


class _Shape(NamedTuple):
    """The positions of a record's members in its value."""

    attributes: list[str | None]
    foreign: list[Node]
    attributes_without_field: list[str]


class _Explainer:
    """Walks plan and value side by side; every method returns the number of octets of its part."""

    def __init__(self, types: ValueTypes) -> None:
        self.types = types
        self._shapes: dict[Group, _Shape] = {}

    def shape(self, group: Group) -> _Shape:
        """Return the shape of a record, computed once for all elements of a list."""
        found = self._shapes.get(group)
        if found is None:
            attributes = [self.types.attribute(group, member) for member in group.members]
            found = _Shape(attributes, self.types.slots(group)[1], self.types.attributes_without_field(group))
            self._shapes[group] = found
        return found

    def node(self, node: Node, value: Any, path: str, siblings: dict[str, Any]) -> int:
        match node:
            case Scalar():
                return self.scalar(node, value, path)
            case Text():
                return self.text(node, value, path)
            case Rest():
                return self.octets(value, path)
            case Group():
                return self.group(node, value, path)
            case Exact():
                return self.group(node.content, value, path)
            case Many():
                return self.many(node, value, path)
            case Region():
                return self.node(node.content, value, path, siblings)
            case Select():
                case = node.cases.get(siblings[node.key], node.default)
                assert case is not None
                return self.node(case, value, path, siblings)
            case Fill():
                # Whether it fits is known only after the size of the content before it.
                return self.octets(value, path) if value else 0

    def octets(self, value: Any, path: str) -> int:
        if not isinstance(value, bytes | bytearray):
            raise EncodeError(path, f"needs bytes, not {type(value).__name__}")
        return len(value)

    def scalar(self, scalar: Scalar, value: Any, path: str) -> int:
        if scalar.kind == "bytes":
            if self.octets(value, path) != scalar.size:
                raise EncodeError(path, f"needs {scalar.size} octets, not {len(value)}")
        elif scalar.kind == "int":
            if not isinstance(value, int):
                raise EncodeError(path, f"needs an integer, not {type(value).__name__}")
            low, high = bounds(scalar)
            if not low <= value <= high:
                raise EncodeError(path, f"{value} is not in {low}..{high}")
        elif not isinstance(value, int | float):
            raise EncodeError(path, f"needs a number, not {type(value).__name__}")
        else:
            try:
                struct.pack(f">{scalar.code}", value)
            except (OverflowError, struct.error):
                raise EncodeError(path, f"{value!r} does not fit {scalar.size} octets of floating point") from None
        return scalar.size

    def text(self, text: Text, value: Any, path: str) -> int:
        size = self.octets(value, path) + text.terminated
        if text.terminated and 0 in value:
            raise EncodeError(path, "must not hold a NUL octet, which ends it")
        for prefix in text.prefixes:
            room = largest(prefix)
            if size > room:
                raise EncodeError(path, f"{len(value)} octets, at most {room - text.terminated} can be announced")
        return size + sum(prefix.size for prefix in text.prefixes)

    def group(self, group: Group, value: Any, path: str) -> int:
        if not isinstance(value, self.types.accepted(group.type_name)):
            raise EncodeError(path, f"needs a {group.type_name}, not {type(value).__name__}")
        siblings = self.members(group, value, path)
        paths: dict[str, str] = {}
        sizes: dict[str, int] = {}
        for member in group.members:
            if member.name in siblings:
                paths[member.name] = _join(path, self.label(member, siblings, path))
                sizes[member.name] = self.node(member, siblings[member.name], paths[member.name], siblings)
            elif isinstance(member, Scalar):
                sizes[member.name] = member.size
        for member in group.members:
            for scalar in member.members if isinstance(member, Group) else (member,):
                if isinstance(scalar, Scalar) and scalar.derived is not None:
                    name = scalar.derived.of.rsplit(".", 1)[-1]
                    if name in sizes:
                        self.derived(scalar, siblings[name], sizes[name], paths[name])
            if isinstance(member, Fill):
                sizes[member.name] = self.fill(member, group, siblings, sizes, paths)
        return sum(sizes.values())

    def members(self, group: Group, value: Any, path: str) -> dict[str, Any]:
        """Return the stored members of a record by name."""
        attributes, foreign, attributes_without_field = self.shape(group)
        extra: Any = getattr(value, "extra", ()) or tuple(zero(member) for member in foreign)
        if foreign:
            names = ", ".join(member.name for member in foreign)
            if not isinstance(extra, tuple | list):
                raise EncodeError(_join(path, "extra"), f"needs a tuple ({names}), not {type(extra).__name__}")
            if len(extra) != len(foreign):
                raise EncodeError(_join(path, "extra"), f"needs {len(foreign)} entries ({names}), not {len(extra)}")
        for name in attributes_without_field:
            if getattr(value, name) if name == "extra" else getattr(value, name) is not None:
                raise EncodeError(_join(path, name), "this layout has no place for it; leave it out")
        siblings: dict[str, Any] = {}
        for member, attribute in zip(group.members, attributes, strict=True):
            if attribute is not None:
                siblings[member.name] = getattr(value, attribute)
            elif member in foreign:
                siblings[member.name] = extra[foreign.index(member)]
        return siblings

    def label(self, member: Node, siblings: dict[str, Any], path: str) -> str:
        """Return the name of a member in paths; a chosen content has the label of the choice."""
        content = member.content if isinstance(member, Region) else member
        if not isinstance(content, Select):
            return member.name
        case = content.cases.get(siblings[content.key], content.default)
        if case is None:
            known = ", ".join(str(number) for number in sorted(content.cases))
            raise EncodeError(
                _join(path, content.key), f"unknown number {siblings[content.key]}; expected one of {known}"
            )
        return case.name

    def derived(self, scalar: Scalar, value: Any, size: int, path: str) -> None:
        """Check that a length or count, in this record or in one inside it, can express the actual number."""
        assert scalar.derived is not None
        found, what = (size, "octets") if scalar.derived.kind == "size" else (len(value), "elements")
        low, high = int(scalar.rule is not None), largest(scalar)
        if not low <= found <= high:
            raise EncodeError(path, f"{found} {what}, needs {low}..{high} for {scalar.name}")

    def fill(
        self, fill: Fill, group: Group, siblings: dict[str, Any], sizes: dict[str, int], paths: dict[str, str]
    ) -> int:
        """Return the size of the rest of an area; it must be the room that the content before it leaves."""
        content = measured(group, fill.used)
        rest = fill.total - sizes[content]
        if rest < 0:
            raise EncodeError(paths[content], f"{sizes[content]} octets, the area holds {fill.total}")
        given = siblings[fill.name]
        if given and len(given) != rest:
            raise EncodeError(paths[fill.name], f"{len(given)} octets, but {rest} of the area are unused")
        return rest

    def many(self, many: Many, value: Any, path: str) -> int:
        if not isinstance(value, tuple | list):
            raise EncodeError(path, f"needs a tuple of {many.element.type_name}, not {type(value).__name__}")
        if many.nonempty and not value:
            raise EncodeError(path, f"needs at least one {many.element.type_name}")
        size = 0
        for index, element in enumerate(value):
            if type(element) not in self.types.accepted(many.element.type_name):
                expected = many.element.type_name
                raise EncodeError(f"{path}[{index}]", f"needs a {expected}, not {type(element).__name__}")
            size += self.group(many.element, element, f"{path}[{index}]")
        return size


def bounds(scalar: Scalar) -> tuple[int, int]:
    """Return the lowest and the highest value of an integer."""
    high = largest(scalar)
    return (-high - 1 if scalar.signed else 0), high
