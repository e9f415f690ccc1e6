"""Helpers for the generators and interpreters of a plan: runs of scalars, struct formats, value classes."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

import msgspec
from dcp_spec.profile.definition import OwnField, Profile

from dcp_codec.values import VALUE_CLASSES, AnyRecord, Extra, OwnRecord, SafetyData

from .source import Source
from .tree import Fill, Group, Many, Node, Region, Scalar, Select, Text, snake


class Packing(NamedTuple):
    """The ``struct`` format of one run of scalars, and the scalars that need a second step.

    ``swapped[i]`` is true if scalar ``i`` is packed as octets because ``struct`` cannot express it (an odd width, or an
    integer in the other byte order than the rest of the run).
    """

    struct: struct.Struct
    swapped: tuple[bool, ...]


def order_of(scalars: Sequence[Scalar]) -> str | None:
    """Return the byte order of a run: that of its first number of more than one octet."""
    for scalar in scalars:
        if scalar.size > 1 and scalar.code and scalar.kind != "bytes":
            return scalar.order
    return None


def joins(run: Sequence[Scalar], scalar: Scalar) -> bool:
    """Return whether ``scalar`` and ``run`` can share one ``struct`` format.

    A float must have the byte order of the run: unlike the octets of an integer, it cannot be swapped afterwards.
    """
    order = order_of(run)
    if scalar.kind == "float":
        return order is None or order == scalar.order
    return True


def packing(run: Sequence[Scalar]) -> Packing:
    """Return the struct format of a run of scalars."""
    order = order_of(run) or "big"
    codes, swapped = [], []
    for scalar in run:
        direct = scalar.kind == "bytes" or (scalar.code != "" and (scalar.size == 1 or scalar.order == order))
        codes.append(scalar.code if direct else f"{scalar.size}s")
        swapped.append(not direct)
    return Packing(struct.Struct((">" if order == "big" else "<") + "".join(codes)), tuple(swapped))


def read_scalar(scalar: Scalar, octets: bytes) -> Any:
    """Return the value of exactly ``scalar.size`` octets."""
    if scalar.kind == "bytes":
        return octets
    if scalar.kind == "float":
        return struct.unpack((">" if scalar.order == "big" else "<") + scalar.code, octets)[0]
    return int.from_bytes(octets, scalar.order, signed=scalar.signed)


def broken(scalar: Scalar, value: Any) -> bool:
    """Return whether the value of a scalar breaks its rule."""
    rule = scalar.rule
    return rule is not None and (value == 0 if rule.value is None else value != rule.value)


def read_run(source: Source, run: Sequence[Scalar], variables: Sequence[str]) -> None:
    """Emit the reading of neighbouring scalars, which are complete, from ``b[o:]`` into their variables."""
    if len(run) <= 3 and all(each.size == 1 and each.kind == "int" and not each.signed for each in run):
        for index, variable in enumerate(variables):
            source.add(f"{variable} = b[o + {index}]" if index else f"{variable} = b[o]")
        return
    packed = packing(run)
    unpack = source.constant("unpack", packed.struct.unpack_from, packed.struct.format)
    source.namespace["from_bytes"] = int.from_bytes
    source.add(f"{', '.join(variables)}, = {unpack}(b, o)")
    for scalar, variable, swapped in zip(run, variables, packed.swapped, strict=True):
        if swapped:
            signed = ", signed=True" if scalar.signed else ""
            source.add(f"{variable} = from_bytes({variable}, {scalar.order!r}{signed})")


def scalars_of(group: Group) -> list[Scalar] | None:
    """Return the scalars of a group in wire order, with those of nested groups; None if it has other members."""
    found: list[Scalar] = []
    for member in group.members:
        if isinstance(member, Scalar):
            found.append(member)
        elif isinstance(member, Group) and (inner := scalars_of(member)) is not None:
            found.extend(inner)
        else:
            return None
    return found


def walk(node: Node) -> Iterator[Node]:
    """Yield every node of a plan, parents first."""
    yield node
    match node:
        case Group():
            for member in node.members:
                yield from walk(member)
        case Many():
            yield from walk(node.element)
        case Region():
            yield from walk(node.content)
        case Select():
            for case in node.cases.values():
                yield from walk(case)
            if node.default is not None:
                yield from walk(node.default)
        case Text():
            yield from node.prefixes
        case _:
            content = getattr(node, "content", None)
            if content is not None:
                yield from walk(content)


def references(node: Node) -> frozenset[str]:
    """Return the last names of all fields that other members of a plan refer to."""
    found: set[str] = set()
    for each in walk(node):
        match each:
            case Many():
                found |= {each.count or "", each.agrees or ""}
            case Region():
                found.add(each.length)
            case Select():
                found.add(each.key)
            case Fill():
                found.add(each.used)
            case Text() if len(each.prefixes) > 1:
                found |= {prefix.name for prefix in each.prefixes}
            case _:
                pass
    return frozenset(name.rsplit(".", 1)[-1] for name in found)


class ValueTypes:
    """The value class of every record of a profile.

    Classes are created for its SafetyData, for records that the specification does not have, and for records of the
    specification to which the profile adds fields. Only the latter have ``extra``, so that the usual values stay small.
    """

    def __init__(self, profile: Profile) -> None:
        self.safety_data = cast(
            type[SafetyData], _made("SafetyData", [member.name for member in profile.srp.safety_data], SafetyData)
        )
        classes = {**VALUE_CLASSES, "SafetyData": self.safety_data}
        vardis = profile.vardis
        for name, own in profile.own_fields().items():
            if name != "ExtendedSafetyData":
                classes[name] = _extended(name, own)
        records = {container.type_name: container.record for container in vardis.own_containers}
        if profile.srp.record and not profile.srp.is_report:
            records["OwnReport"] = profile.srp.record
        for name, members in records.items():
            names = [snake(member if isinstance(member, str) else member.name) for member in members]
            classes[name] = _made(name, names, OwnRecord)
        self._classes: Mapping[str, type[msgspec.Struct]] = classes

    def __getitem__(self, type_name: str) -> type[msgspec.Struct]:
        return self._classes[type_name]

    def accepted(self, type_name: str) -> tuple[type[msgspec.Struct], ...]:
        """Return the classes whose values can be encoded: that of the profile, and the plain one it is derived from."""
        made = self[type_name]
        plain = VALUE_CLASSES.get(type_name, made)
        return (made,) if plain is made else (made, plain)

    def extended(self, record: AnyRecord, extra: Extra) -> AnyRecord:
        """Return a record of a class of ``dcp_codec.values`` in that of the profile, with the values of its fields."""
        made: Any = self._classes[type(record).__name__]
        return cast(AnyRecord, made(**{**msgspec.structs.asdict(record), "extra": extra}))

    def slots(self, group: Group) -> tuple[list[str], list[Node]]:
        """Return the attribute names of the value class of ``group``, and the stored members that go to ``extra``."""
        names = list(self[group.type_name].__struct_fields__)
        foreign = [
            member
            for member in group.members
            if self.attribute(group, member) is None and (not isinstance(member, Scalar) or member.stored)
        ]
        return names, foreign

    def attributes_without_field(self, group: Group) -> list[str]:
        """Return the attributes of the value class that this layout lacks: they must be None (``extra``: empty)."""
        names, foreign = self.slots(group)
        placed = {self.attribute(group, member) for member in group.members} | ({"extra"} if foreign else set())
        return [name for name in names if name not in placed]

    def attribute(self, group: Group, member: Node) -> str | None:
        """Return the attribute of the value class that holds ``member``; None if it is derived or goes to ``extra``."""
        if isinstance(member, Scalar) and not member.stored:
            return None
        # Fields of SafetyData keep the profile's names.
        name = member.name if group.type_name == "SafetyData" else snake(member.name)
        return name if name in self[group.type_name].__struct_fields__ and name != "extra" else None


def _extended(name: str, own: Sequence[OwnField]) -> type[msgspec.Struct]:
    """Create the class of a specified record with fields of the profile, kept in ``extra`` and readable by name."""
    readers = {snake(member.name): property(_Entry(place)) for place, member in enumerate(own)}
    names: dict[str, Any] = {"ADDED": tuple(readers)}
    return msgspec.defstruct(
        name,
        [("extra", Extra, tuple(neutral(member) for member in own))],
        bases=(VALUE_CLASSES[name],),
        namespace=names | readers,
        frozen=True,
        gc=False,
        module=__name__,
    )


class _Entry:
    """Descriptor that reads one entry of ``extra``."""

    def __init__(self, place: int) -> None:
        self._place = place

    def __call__(self, record: Any) -> Any:
        return record.extra[self._place]


def neutral(member: OwnField) -> int | float | bytes:
    """Return the default value of a field that the profile adds: zero, zero octets, or no octets."""
    if member.opaque is not None:
        return bytes(member.opaque)
    if member.real is not None:
        return 0.0
    return b"" if member.block is not None else 0


def _made(name: str, fields: Sequence[str], base: type[msgspec.Struct]) -> type[msgspec.Struct]:
    typed = [(field, Any) for field in fields]
    return msgspec.defstruct(name, typed, bases=(base,), frozen=True, gc=False, module=__name__)
