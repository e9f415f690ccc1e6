"""Generate the strict encoder of a plan.

The generated function packs neighbouring scalars in one ``struct`` call and derives lengths and counts from the packed
parts. A part whose size no field states is appended to the surrounding octets directly; a measured part is assembled
first. The function does not look for the reason of a failure: if anything raises,
:mod:`dcp_codec.views.encode_diagnosis` walks plan and value again, slowly, and names the field.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from dcp_codec.errors import EncodeError
from dcp_codec.plan.layout import ValueTypes, joins, packing, walk
from dcp_codec.plan.source import Source
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text
from dcp_codec.values import VALUE_CLASSES

from .decoder import branches
from .encode_diagnosis import explain, measured, zero

Encode = Callable[[Any], bytes]

#: Exceptions that packing a wrong value can raise; any other is a fault of the encoder and must be visible.
_PACKING_ERRORS = (struct.error, TypeError, ValueError, AttributeError, OverflowError)


def _has_extra(group: Group) -> bool:
    """Return whether every value of a record has ``extra``, independently of the profile."""
    return "extra" in VALUE_CLASSES[group.type_name].__struct_fields__ if group.type_name in VALUE_CLASSES else False


class _Out:
    """Destination of octets: expressions to be joined, or a growing ``bytearray`` in the generated function."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.pieces: list[str] = []
        self.packed = False
        self.grown = ""

    def add(self, expression: str, *, packed: bool = False) -> None:
        """Append the octets of an expression; ``packed`` ones are ``bytes``, others may be a ``bytearray``."""
        if self.grown:
            self.source.add(f"{self.grown} += {expression}")
            return
        self.packed = self.packed if self.pieces else packed
        self.pieces.append(expression)

    def add_octet(self, expression: str) -> None:
        """Append one octet with this numeric value; only when open."""
        self.source.add(f"{self.grown}.append({expression})")

    def open(self) -> None:
        """Switch to a growing ``bytearray``: inside a loop or a branch no expression can be kept for later."""
        if not self.grown:
            self.grown = self.source.fresh("q")
            self.source.add(f"{self.grown} = bytearray({' + '.join(self.pieces)})")

    def expression(self) -> str:
        """Return the expression of all octets, as ``bytes`` or ``bytearray``."""
        return self.grown or " + ".join(self.pieces) or "b''"

    def octets(self) -> str:
        """Return the expression of all octets, as ``bytes``."""
        # bytes plus any buffer is bytes; packing makes bytes.
        return self.expression() if self.packed and not self.grown else f"bytes({self.expression()})"


class _Member:
    """A structural member: the variable of its value, and of its octets if they were needed early."""

    def __init__(self, value: str, octets: str = "") -> None:
        self.value = value
        self.octets = octets


class _Scope:
    """The structural members and the keys of a record while it is encoded."""

    def __init__(self, parent: _Scope | None) -> None:
        self.parent = parent
        self.members: dict[str, _Member] = {}
        self.keys: dict[str, str] = {}

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
        self.source.namespace.update(octets=(bytes, bytearray))
        derived = [node.derived for node in walk(plan) if isinstance(node, Scalar) and node.derived is not None]
        self.counted = {each.of.rsplit(".", 1)[-1] for each in derived if each.kind == "count"}
        self.measured = {each.of.rsplit(".", 1)[-1] for each in derived if each.kind == "size"}

    # -- records ----------------------------------------------------------------------------------------------

    def group(self, group: Group, value: str, parent: _Scope | None, out: _Out) -> None:
        """Emit the encoding of the record in the variable ``value``."""
        scope = _Scope(parent)
        run: list[tuple[Scalar, str]] = []
        self._structure(group, value, scope)
        self._members(group, value, scope, run, out)
        self._pack(run, out)

    def _attribute(self, group: Group, member: Node, value: str) -> str:
        attribute = self.types.attribute(group, member)
        if attribute is not None:
            return f"{value}.{attribute}"
        return f"{value}_{self.types.slots(group)[1].index(member)}"

    def _structure(self, group: Group, value: str, scope: _Scope) -> None:
        """Emit the access to the structural members, and encode those whose size is stated before them."""
        source, foreign = self.source, self.types.slots(group)[1]
        if foreign:
            zeros = source.constant("zeros", tuple(zero(member) for member in foreign))
            targets = "".join(f"{value}_{index}, " for index in range(len(foreign)))
            # A plain record of the specification has no ``extra``: its additional fields were not given.
            given = f"{value}.extra" if _has_extra(group) else f"getattr({value}, 'extra', ())"
            source.add(f"{targets}= {given} or {zeros}")
        # Refuse values that the layout cannot carry; they must not be lost silently.
        lost = [
            f"{value}.extra" if name == "extra" else f"{value}.{name} is not None"
            for name in self.types.attributes_without_field(group)
        ]
        if lost:
            source.when(f"{' or '.join(lost)}", "raise ValueError")
        for member in group.members:
            if isinstance(member, Scalar | Text | Group):
                continue
            content = member.content if isinstance(member, Region) else member
            held = scope.members[member.name] = _Member(source.fresh("i"))
            source.add(f"{held.value} = {self._attribute(group, member, value)}")
            if isinstance(content, Select):
                key = next(each for each in group.members if each.name == content.key)
                scope.keys[content.key] = source.fresh("k")
                source.add(f"{scope.keys[content.key]} = {self._attribute(group, key, value)}")
            if member.name in self.measured:
                held.octets = source.fresh("o")
                self._assign(held.octets, content, held.value, scope)

    def _members(self, group: Group, value: str, scope: _Scope, run: list[tuple[Scalar, str]], out: _Out) -> None:
        for member in group.members:
            match member:
                case Scalar():
                    self._scalar(member, self._expression(group, member, value, scope), run, out)
                case Text():
                    self._text(member, self._attribute(group, member, value), run, out)
                case Group():
                    inner, nested = _Scope(scope), self.source.fresh()
                    self.source.add(f"{nested} = {self._attribute(group, member, value)}")
                    self._structure(member, nested, inner)
                    self._members(member, nested, inner, run, out)
                case Fill():
                    self._pack(run, out)
                    self._fill(member, scope.members[measured(group, member.used)], scope.members[member.name], out)
                case _:
                    self._pack(run, out)
                    held = scope.members[member.name]
                    if held.octets:
                        out.add(held.octets)
                    else:
                        content = member.content if isinstance(member, Region) else member
                        self.write(content, held.value, scope, out)

    def _expression(self, group: Group, scalar: Scalar, value: str, scope: _Scope) -> str:
        if scalar.rule is not None and scalar.rule.value is not None:
            return str(scalar.rule.value)
        if scalar.derived is not None:
            member = scope.find(scalar.derived.of)
            return f"len({member.octets if scalar.derived.kind == 'size' else member.value})"
        return scope.keys.get(scalar.name) or self._attribute(group, scalar, value)

    def _scalar(self, scalar: Scalar, expression: str, run: list[tuple[Scalar, str]], out: _Out) -> None:
        if scalar.kind == "bytes":
            # struct would silently pad or cut octets of another length.
            variable = self.source.fresh()
            self.source.add(f"{variable} = {expression}")
            self.source.when(f"len({variable}) != {scalar.size}", "raise ValueError")
            expression = variable
        if not joins([member for member, _ in run], scalar):
            self._pack(run, out)
        run.append((scalar, expression))

    def _only_octets(self, variable: str) -> None:
        """Emit the refusal of other buffers: ``len`` need not count octets in them."""
        self.source.when(f"type({variable}) is not bytes and not isinstance({variable}, octets)", "raise TypeError")

    def _text(self, text: Text, expression: str, run: list[tuple[Scalar, str]], out: _Out) -> None:
        variable = self.source.fresh()
        self.source.add(f"{variable} = {expression}")
        self._only_octets(variable)
        if text.terminated:
            self.source.when(f"0 in {variable}", "raise ValueError")
            # Not +=, which would change a bytearray of the caller.
            self.source.add(f"{variable} = {variable} + b'\\0'")
        for prefix in text.prefixes:
            self._scalar(prefix, f"len({variable})", run, out)
        self._pack(run, out)
        out.add(variable)

    def _fill(self, fill: Fill, content: _Member, given: _Member, out: _Out) -> None:
        rest = self.source.fresh("o")
        self.source.add(f"{rest} = {given.value} or bytes({fill.total} - len({content.octets}))")
        self._only_octets(rest)
        self.source.when(f"len({rest}) + len({content.octets}) != {fill.total}", "raise ValueError")
        out.add(rest)

    def _pack(self, run: list[tuple[Scalar, str]], out: _Out) -> None:
        if out.grown and all(s.size == 1 and s.kind == "int" and not s.signed for s, _ in run):
            # Faster than packing, also for several octets.
            for _, expression in run:
                out.add_octet(expression)
        elif run:
            out.add(self._packed(run), packed=True)
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

    # -- structure ----------------------------------------------------------------------------------------------

    def _assign(self, octets: str, node: Node, value: str, scope: _Scope) -> None:
        """Emit the assignment of a structural member's octets to the variable ``octets``."""
        if isinstance(node, Select):
            self._choose(node, scope, lambda case: self._assign(octets, case, value, scope))
            return
        out = _Out(self.source)
        self.write(node, value, scope, out)
        self.source.add(f"{octets} = {out.expression()}")

    def write(self, node: Node, value: str, scope: _Scope, out: _Out) -> None:
        """Emit the encoding of the structural member in the variable ``value``."""
        match node:
            case Many():
                self.many(node, value, scope, out)
            case Exact():
                self.group(node.content, value, scope, out)
            case Group():
                self.group(node, value, scope, out)
            case Select():
                out.open()
                self._choose(node, scope, lambda case: self.write(case, value, scope, out))
            case Rest():
                self._only_octets(value)
                out.add(value)
            case _:
                raise TypeError(f"{type(node).__name__} is not a structural member")

    def _choose(self, node: Select, scope: _Scope, case: Callable[[Node], None]) -> None:
        for content in branches(self.source, scope.keys[node.key], node):
            if content is None:
                self.source.add("raise ValueError")
            else:
                case(content)

    def many(self, node: Many, items: str, scope: _Scope, out: _Out) -> None:
        """Emit the encoding of a list, record by record: measured to be faster than bulk conversion for usual lists."""
        source, element = self.source, node.element
        classes = [source.constant("T", each, each) for each in self.types.accepted(element.type_name)]
        empty = f"not {items} or " if node.name in self.counted or node.nonempty else ""
        source.when(f"{empty}type({items}) is not tuple and not isinstance({items}, list)", "raise TypeError")
        out.open()
        record = source.fresh("r")
        with source.block(f"for {record} in {items}:"):
            source.when(f"{' and '.join(f'type({record}) is not {each}' for each in classes)}", "raise TypeError")
            self.group(element, record, scope, out)


def generate_encoder(plan: Node, types: ValueTypes, title: str) -> Encode:
    """Return the encoder of ``plan``: ``encode(value) -> bytes``; raises EncodeError."""

    def refused(value: Any, error: Exception) -> EncodeError:
        try:
            explain(plan, types, value)
        except EncodeError as found:
            return found
        return EncodeError("", f"cannot be put on the wire ({error})")

    generator = _Generator(plan, types)
    source, out = generator.source, _Out(generator.source)
    source.namespace.update(refused=refused, packing_errors=_PACKING_ERRORS)
    with source.block("try:"):
        generator.write(plan, "v", _Scope(None), out)
        source.add(f"return {out.octets()}")
    with source.block("except packing_errors as error:"):
        source.add("raise refused(v, error) from None")
    encode: Encode = source.compile(f"encoder {title}")
    return encode
