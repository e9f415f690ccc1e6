"""Generate the strict encoder of a plan.

The generated function packs neighbouring scalars in one ``struct`` call and derives lengths and counts from what it has
packed. It does not look for the reason of a failure: when anything raises, :mod:`dcp_codec.misfit` walks plan and value
once more, slowly, and names the field.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from .errors import EncodeError
from .layout import ValueTypes, joins, packing, scalars_of, walk
from .misfit import explain, measured, zero
from .plan import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text
from .source import Source

Encode = Callable[[Any], bytes]

#: What packing a wrong value can raise; anything else is a fault of ours and must show.
_PACKING_ERRORS = (struct.error, TypeError, ValueError, AttributeError, OverflowError, LookupError)


class _Member:
    """An encoded structural member: the variable of its octets, and of its elements if it is a list."""

    def __init__(self, octets: str, items: str | None) -> None:
        self.octets = octets
        self.items = items


class _Scope:
    def __init__(self, parent: _Scope | None) -> None:
        self.parent = parent
        self.members: dict[str, _Member] = {}

    def find(self, reference: str) -> _Member:
        scope: _Scope = self
        *ups, name = reference.split(".")
        for up in ups:
            assert up == "_"
            assert scope.parent is not None
            scope = scope.parent
        return scope.members[name]


class _Generator:
    def __init__(self, plan: Node, types: ValueTypes) -> None:
        self.types = types
        self.source = Source("encode(v)")
        self.source.namespace["join"] = b"".join
        self.counted = {
            node.derived.of.rsplit(".", 1)[-1]
            for node in walk(plan)
            if isinstance(node, Scalar) and node.derived is not None and node.derived.kind == "count"
        }

    def group(self, group: Group, value: str, parent: _Scope | None) -> list[str]:
        """Encode a record; returns the expressions of its octets, to be joined in order."""
        scope = _Scope(parent)
        pieces: list[str] = []
        run: list[tuple[Scalar, str]] = []
        self._structure(group, value, scope)
        self._members(group, value, scope, run, pieces)
        self._pack(run, pieces)
        return pieces

    def _attribute(self, group: Group, member: Node, value: str) -> str:
        attribute = self.types.attribute(group, member)
        if attribute is not None:
            return f"{value}.{attribute}"
        foreign = self.types.slots(group)[1]
        return f"{value}_extra[{foreign.index(member)}]"

    def _structure(self, group: Group, value: str, scope: _Scope) -> None:
        """Encode the members whose sizes or counts other members state, before those are packed."""
        foreign = self.types.slots(group)[1]
        if foreign:
            zeros = self.source.constant("zeros", tuple(zero(member) for member in foreign))
            self.source.add(f"{value}_extra = {value}.extra or {zeros}")
            with self.source.block(f"if len({value}_extra) != {len(foreign)}:"):
                self.source.add("raise ValueError")
        for member in group.members:
            if isinstance(member, Scalar | Text | Group):
                continue
            content = member.content if isinstance(member, Region) else member
            scope.members[member.name] = self.node(content, self._attribute(group, member, value), scope, value, group)

    def _members(
        self, group: Group, value: str, scope: _Scope, run: list[tuple[Scalar, str]], pieces: list[str]
    ) -> None:
        for member in group.members:
            match member:
                case Scalar():
                    self._scalar(member, self._expression(group, member, value, scope), run, pieces)
                case Text():
                    self._text(member, self._attribute(group, member, value), run, pieces)
                case Group():
                    inner, nested = _Scope(scope), self.source.fresh()
                    self.source.add(f"{nested} = {self._attribute(group, member, value)}")
                    self._structure(member, nested, inner)
                    self._members(member, nested, inner, run, pieces)
                case _:
                    self._pack(run, pieces)
                    pieces.append(scope.members[member.name].octets)

    def _expression(self, group: Group, scalar: Scalar, value: str, scope: _Scope) -> str:
        if scalar.rule is not None and scalar.rule.value is not None:
            return str(scalar.rule.value)
        if scalar.derived is not None:
            member = scope.find(scalar.derived.of)
            return f"len({member.octets if scalar.derived.kind == 'size' else member.items})"
        return self._attribute(group, scalar, value)

    def _scalar(self, scalar: Scalar, expression: str, run: list[tuple[Scalar, str]], pieces: list[str]) -> None:
        if scalar.kind == "bytes":
            # struct would pad or cut octets of another length silently.
            variable = self.source.fresh()
            self.source.add(f"{variable} = {expression}")
            with self.source.block(f"if len({variable}) != {scalar.size}:"):
                self.source.add("raise ValueError")
            expression = variable
        if not joins([member for member, _ in run], scalar):
            self._pack(run, pieces)
        run.append((scalar, expression))

    def _text(self, text: Text, expression: str, run: list[tuple[Scalar, str]], pieces: list[str]) -> None:
        variable = self.source.fresh()
        self.source.add(f"{variable} = {expression}")
        if text.terminated:
            with self.source.block(f"if 0 in {variable}:"):
                self.source.add("raise ValueError")
            # Not +=, which would change a bytearray of the caller's.
            self.source.add(f"{variable} = {variable} + b'\\0'")
        for prefix in text.prefixes:
            self._scalar(prefix, f"len({variable})", run, pieces)
        self._pack(run, pieces)
        pieces.append(variable)

    def _pack(self, run: list[tuple[Scalar, str]], pieces: list[str]) -> None:
        if run:
            pieces.append(self._packed(run))
            run.clear()

    def _packed(self, run: list[tuple[Scalar, str]]) -> str:
        packed = packing([scalar for scalar, _ in run])
        pack = self.source.constant("pack", packed.struct.pack, packed.struct.format)
        args = []
        for (scalar, expression), swapped in zip(run, packed.swapped, strict=True):
            signed = ", signed=True" if scalar.signed else ""
            swap = f".to_bytes({scalar.size}, {scalar.order!r}{signed})"
            args.append(f"({expression}){swap}" if swapped else expression)
        return f"{pack}({', '.join(args)})"

    def joined(self, pieces: list[str]) -> str:
        """One expression for the octets of ``pieces``."""
        return pieces[0] if len(pieces) == 1 else f"join(({', '.join(pieces)}, ))"

    def node(self, node: Node, value: str, scope: _Scope, owner: str, group: Group) -> _Member:
        """Encode a structural member into a variable."""
        source = self.source
        octets = source.fresh("o")
        match node:
            case Many():
                items = source.fresh("i")
                source.add(f"{items} = {value}")
                self.many(node, items, octets, scope)
                return _Member(octets, items)
            case Exact():
                record = source.fresh()
                source.add(f"{record} = {value}")
                source.add(f"{octets} = {self.joined(self.group(node.content, record, scope))}")
            case Group():
                record = source.fresh()
                source.add(f"{record} = {value}")
                source.add(f"{octets} = {self.joined(self.group(node, record, scope))}")
            case Select():
                return self.select(node, value, octets, scope, owner, group)
            case Rest():
                source.add(f"{octets} = {value}")
            case Fill():
                used = scope.members[measured(group, node.used)].octets
                source.add(f"{octets} = {value} or bytes({node.total} - len({used}))")
                with source.block(f"if len({octets}) + len({used}) != {node.total}:"):
                    source.add("raise ValueError")
            case _:
                raise TypeError(f"{type(node).__name__} is no structural member")
        return _Member(octets, None)

    def select(self, node: Select, value: str, octets: str, scope: _Scope, owner: str, group: Group) -> _Member:
        source, items = self.source, self.source.fresh("i")
        key = next(member for member in group.members if member.name == node.key)
        source.add(f"{items} = {value}")
        chosen = source.fresh("k")
        source.add(f"{chosen} = {self._attribute(group, key, owner)}")
        keyword = "if"
        for number, case in node.cases.items():
            with source.block(f"{keyword} {chosen} == {number}:"):
                source.add(f"{octets} = {self.node(case, items, scope, owner, group).octets}")
            keyword = "elif"
        with source.block("else:" if node.cases else "if True:"):
            if node.default is None:
                source.add("raise ValueError")
            else:
                source.add(f"{octets} = {self.node(node.default, items, scope, owner, group).octets}")
        return _Member(octets, items)

    def many(self, node: Many, items: str, octets: str, scope: _Scope) -> None:
        source, element = self.source, node.element
        cls = self.types[element.type_name]
        only = source.constant("only", {cls}, element.type_name)
        required = node.name in self.counted
        sequences = source.constant("sequences", (tuple, list), "sequences")
        with source.block(
            f"if not isinstance({items}, {sequences}) or "
            f"{'' if required else f'{items} and '}{{*map(type, {items})}} != {only}:"
        ):
            source.add("raise TypeError")
        scalars = scalars_of(element)
        flat = scalars is not None and len(scalars) == len(element.members) and not self.types.slots(element)[1]
        if scalars is not None and flat and all(s.stored and s.kind != "bytes" for s in scalars):
            fields = [f"r.{self.types.attribute(element, scalar)}" for scalar in scalars]
            if all(s.size == 1 and s.kind == "int" and not s.signed for s in scalars):
                octet = "f" if len(fields) > 1 else fields[0]
                inner = f" for f in ({', '.join(fields)})" if len(fields) > 1 else ""
                source.add(f"{octets} = bytes([{octet} for r in {items}{inner}])")
                return
            packed = self._packed(list(zip(scalars, fields, strict=True)))
            source.add(f"{octets} = join([{packed} for r in {items}])")
            return
        parts, append, record = source.fresh("q"), source.fresh("a"), source.fresh("r")
        source.add(f"{parts} = []")
        source.add(f"{append} = {parts}.append")
        with source.block(f"for {record} in {items}:"):
            for piece in self.group(element, record, scope):
                source.add(f"{append}({piece})")
        source.add(f"{octets} = join({parts})")


def generate_encoder(plan: Node, types: ValueTypes, title: str) -> Encode:
    """The encoder of ``plan``: ``encode(value) -> bytes``; raises EncodeError."""
    generator = _Generator(plan, types)
    match plan:
        case Group():
            result = generator.joined(generator.group(plan, "v", None))
        case Many() | Exact():
            nowhere = Group("", "", (), None)
            result = generator.node(plan, "v", _Scope(None), "v", nowhere).octets
        case _:
            raise TypeError(f"{type(plan).__name__} cannot be encoded by itself")
    generator.source.add(f"return {result}")
    generated: Encode = generator.source.compile(f"encoder {title}")

    def encode(value: Any) -> bytes:
        try:
            return generated(value)
        except _PACKING_ERRORS as error:
            explain(plan, types, value)
            raise EncodeError("", f"cannot be put on the wire ({error})") from error

    return encode
