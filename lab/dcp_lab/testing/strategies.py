"""Hypothesis strategies for messages of a profile, and for damaged messages.

Everything is generated from the plan of the profile, so a user-defined profile works as well::

    @given(strategies.beacons(codec))
    def test_round_trip(beacon):
        assert codec.decode(codec.encode(beacon)) == beacon

Values are valid: the layout can express their counts, lengths and sizes, strings that end with NUL contain no other
NUL, and extra fields are always present. Boundary values of a width (0, 1, highest - 1, highest; signed also the
lowest) are far more frequent than by chance, and some lists and strings have their maximum length. Descriptions and
node identifiers need not be UTF-8, floats need not be finite.

This module alone imports hypothesis, which is not needed to use the rest of the package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from hypothesis import reject
from hypothesis import strategies as st

from dcp_codec.codec import Codec
from dcp_codec.plan.layout import ValueTypes
from dcp_codec.plan.measures import largest
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text
from dcp_codec.values import Beacon, Container, ExtendedSafetyData, Payload, VardisRecord
from dcp_codec.views.encode_diagnosis import bounds
from dcp_codec.views.fields import Dissection, Field

#: Maximum length of strings and payloads of unknown protocols: longer ones only cost time.
LONGEST_TEXT = 300
#: Maximum length of an uncounted list (elements) and of a whole message (octets).
LONGEST_LIST = 4
LARGEST_MESSAGE = 1 << 14


def beacons(codec: Codec) -> st.SearchStrategy[Beacon]:
    """Beacons that ``codec.encode`` accepts, of state reports, instruction containers and unknown protocols."""
    return _drawn(_shape(codec.beacon_plan, codec.types))


def envelopes(codec: Codec) -> st.SearchStrategy[Beacon]:
    """Beacons whose client payloads are all octets, as ``codec.encode_envelope`` accepts them."""
    return _drawn(_shape(codec.envelope_plan, codec.types))


def payloads(codec: Codec) -> st.SearchStrategy[Payload]:
    """Payload blocks, each of which fits into a beacon on its own."""
    return beacons(codec).filter(lambda beacon: beacon.payloads).map(lambda beacon: beacon.payloads[-1])


def containers(codec: Codec) -> st.SearchStrategy[tuple[Container, ...]]:
    """VarDis payloads: tuples of zero or more instruction containers, as ``codec.encode_containers`` accepts them."""
    return _drawn(_shape(codec.containers_plan, codec.types))


def reports(codec: Codec) -> st.SearchStrategy[ExtendedSafetyData]:
    """State reports. Raises ValueError for a profile that cannot encode them."""
    if codec.report_plan is None:
        raise ValueError(f"profile {codec.profile.name} cannot encode state reports (srp.record is empty)")
    return _drawn(_shape(codec.report_plan, codec.types))


def records(codec: Codec, container_name: str) -> st.SearchStrategy[VardisRecord]:
    """Records of the container type of that name, for example ``"CREATE-VARIABLES"``.

    Raises KeyError for a name that the specification does not have.
    """
    number = codec.profile.vardis.container_types.by_name()[container_name]
    plan = codec.containers_plan
    assert isinstance(plan, Many)
    content = plan.element.members[-1]
    select = content.content if isinstance(content, Region) else content
    assert isinstance(select, Select)
    many = select.cases[number]
    assert isinstance(many, Many)
    return _drawn(_shape(many.element, codec.types))


# -- valid values -----------------------------------------------------------------------------------------------


class _Shape(Protocol):
    """A node of the plan, prepared for drawing. ``least`` is its minimum number of octets."""

    @property
    def least(self) -> int: ...

    def draw(self, draw: st.DrawFn, room: int) -> Any:
        """Draw a value of at most ``room`` octets; ``room`` is never less than ``least``."""

    def size(self, value: Any) -> int:
        """Return the number of octets of ``value``."""


def _drawn(shape: _Shape) -> st.SearchStrategy[Any]:
    @st.composite
    def value(draw: st.DrawFn) -> Any:
        return shape.draw(draw, LARGEST_MESSAGE)

    return value()


def _shape(node: Node, types: ValueTypes, counts: tuple[int, int] = (0, LONGEST_LIST)) -> _Shape:
    """Return the shape of a node outside a record, or inside one if it refers to no other member."""
    match node:
        case Scalar():
            return _ScalarShape(node)
        case Text():
            return _TextShape(node)
        case Rest():
            return _RestShape()
        case Group():
            return _GroupShape(node, types)
        case Exact():
            return _GroupShape(node.content, types)
        case Many():
            fewest, most = counts
            return _ManyShape(_GroupShape(node.element, types), max(fewest, int(node.nonempty)), most)
        case Region():
            return _shape(node.content, types, counts)
        case _:
            raise TypeError(f"{type(node).__name__} is drawn with the record around it")


_BINARY = {size: st.binary(min_size=size, max_size=size) for size in range(17)}


def _octets(size: int) -> st.SearchStrategy[bytes]:
    """Exactly ``size`` octets; many repeat a pattern, because drawing each octet costs more than it finds."""
    if size in _BINARY:
        return _BINARY[size]
    return _BINARY[16].map(lambda pattern: (pattern * (size // 16 + 1))[:size])


def _numbers(scalar: Scalar) -> st.SearchStrategy[Any]:
    if scalar.kind == "bytes":
        size = scalar.size
        return st.one_of(_octets(size), st.sampled_from((bytes(size), b"\xff" * size, bytes(size - 1) + b"\1")))
    if scalar.kind == "float":
        usual = st.sampled_from((0.0, -0.0, 1.0, -1.5, float("inf"), float("-inf"), float("nan")))
        return st.one_of(usual, st.floats(width=32 if scalar.size == 4 else 64))
    low, high = bounds(scalar)
    edges = [0, 1, high - 1, high, *([low, low + 1, -1] if scalar.signed else [])]
    return st.one_of(st.sampled_from(edges), st.integers(low, high))


class _ScalarShape:
    def __init__(self, scalar: Scalar) -> None:
        self.least = scalar.size
        self.values = _numbers(scalar)

    def draw(self, draw: st.DrawFn, room: int) -> Any:  # noqa: ARG002 - it always takes the same
        return draw(self.values)

    def size(self, value: Any) -> int:  # noqa: ARG002
        return self.least


_ANY_OCTETS = st.binary(max_size=12)
_NO_NUL = st.lists(st.integers(1, 255), max_size=12).map(bytes)
_UTF8 = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=6).map(str.encode)
#: Decides whether something gets its maximum length.
_ONE_IN_16 = st.integers(0, 15)


def _stretched(draw: st.DrawFn, octets: bytes, room: int) -> bytes:
    """Return ``octets`` cut to ``room``; sometimes repeated up to it, or to one octet less."""
    stretch = draw(_ONE_IN_16)
    if octets and stretch >= 14:
        size = max(room - (stretch == 14), 0)
        return (octets * (size // len(octets) + 1))[:size]
    return octets[:room]


class _TextShape:
    def __init__(self, text: Text) -> None:
        self.least = sum(prefix.size for prefix in text.prefixes) + text.terminated
        self.longest = min([LONGEST_TEXT, *(largest(prefix) - text.terminated for prefix in text.prefixes)])
        octets = _NO_NUL if text.terminated else _ANY_OCTETS
        self.values = st.one_of(_UTF8, _UTF8, octets) if text.human else octets

    def draw(self, draw: st.DrawFn, room: int) -> bytes:
        return _stretched(draw, draw(self.values), min(self.longest, room - self.least))

    def size(self, value: bytes) -> int:
        return self.least + len(value)


class _RestShape:
    least = 0

    def draw(self, draw: st.DrawFn, room: int) -> bytes:
        return _stretched(draw, draw(_ANY_OCTETS), min(room, LONGEST_TEXT))

    def size(self, value: bytes) -> int:
        return len(value)


class _ManyShape:
    def __init__(self, element: _GroupShape, fewest: int, most: int) -> None:
        self.element = element
        self.fewest = fewest
        self.most = most
        self.least = fewest * element.least
        self.wanted = st.integers(fewest, min(most, LONGEST_LIST))

    def draw(self, draw: st.DrawFn, room: int) -> tuple[Any, ...]:
        items: list[Any] = []
        for _ in range(draw(self.wanted)):
            if room < self.element.least:
                break
            items.append(self.element.draw(draw, room))
            room -= self.element.size(items[-1])
        if items and self.most > LONGEST_LIST and draw(_ONE_IN_16) == 15:
            # As many elements as the count can express, by repetition of the drawn ones.
            drawn = len(items)
            while len(items) < self.most and (size := self.element.size(items[-drawn])) <= room:
                items.append(items[-drawn])
                room -= size
        return tuple(items)

    def size(self, value: tuple[Any, ...]) -> int:
        return sum(map(self.element.size, value))


@dataclass(frozen=True)
class _Part:
    """A stored member of a record. ``cap``: the limit by its length field and its area. ``key``: the field that selects
    it.

    ``attribute`` is the attribute of the record that holds it, None for the next entry of ``extra``.
    """

    name: str
    attribute: str | None
    shape: _Shape | None
    cap: int = LARGEST_MESSAGE
    key: str | None = None
    cases: Mapping[int, _Shape] | None = None
    default: _Shape | None = None

    @property
    def least(self) -> int:
        if self.shape is not None:
            return self.shape.least
        shapes = [*(self.cases or {}).values(), *([self.default] if self.default is not None else [])]
        return min(shape.least for shape in shapes)

    def shape_for(self, number: int) -> _Shape:
        """Return the shape of the content for a value of the key."""
        shape = (self.cases or {}).get(number, self.default)
        assert shape is not None
        return shape

    def numbers(self, draw: st.DrawFn, key: _Shape, room: int) -> int:
        """Draw a value of the key whose content fits."""
        cases = self.cases or {}
        fitting = [number for number, shape in cases.items() if shape.least <= room]
        if self.default is not None and (not fitting or draw(st.integers(0, 4)) == 0):
            number: int = key.draw(draw, key.least)
            return number if number not in cases else reject()
        return draw(st.sampled_from(fitting)) if fitting else reject()


class _GroupShape:
    def __init__(self, group: Group, types: ValueTypes) -> None:
        self.cls = types[group.type_name]
        self.foreign = [member.name for member in types.slots(group)[1]]
        self.parts: list[_Part] = []
        self.choices: dict[str, _Part] = {}
        # The member before an unused rest and the rest together take all octets of the area.
        self.areas = {member.used: member for member in group.members if isinstance(member, Fill)}
        self.area_of: dict[str, Fill] = {}
        self.fixed = sum(member.total for member in self.areas.values())
        for member in group.members:
            if isinstance(member, Fill):
                continue
            if isinstance(member, Scalar) and not member.stored:
                self.fixed += member.size
                continue
            self._add(member, group, types)
        self.least = self.fixed + sum(part.least for part in self.parts if part.name not in self.area_of)

    def _add(self, member: Node, group: Group, types: ValueTypes) -> None:
        cap, counts = LARGEST_MESSAGE, (0, LONGEST_LIST)
        for scalar in _scalars(group):
            if scalar.derived is not None and scalar.derived.of.rsplit(".", 1)[-1] == member.name:
                highest = largest(scalar)
                if scalar.derived.kind == "count":
                    counts = (1, highest)
                else:
                    cap = highest
        if isinstance(member, Region) and member.length in self.areas:
            self.area_of[member.name] = self.areas[member.length]
            cap = min(cap, self.areas[member.length].total)
        content = member.content if isinstance(member, Region) else member
        attribute = types.attribute(group, member)
        if isinstance(content, Select):
            cases = {number: _shape(case, types, counts) for number, case in content.cases.items()}
            default = _shape(content.default, types, counts) if content.default is not None else None
            part = _Part(member.name, attribute, None, cap, content.key, cases, default)
            self.choices[content.key] = part
        else:
            part = _Part(member.name, attribute, _shape(content, types, counts), cap)
        self.parts.append(part)

    def draw(self, draw: st.DrawFn, room: int) -> Any:
        spare = room - self.least
        found: dict[str, Any] = {}
        for part in self.parts:
            if part.name in self.choices:
                assert part.shape is not None
                content = self.choices[part.name]
                most = min(content.cap, content.least + self._spare(content, spare))
                found[part.name] = content.numbers(draw, part.shape, most)
                continue
            shape = part.shape or part.shape_for(found[part.key or ""])
            most = min(part.cap, part.least + self._spare(part, spare))
            if most < shape.least:
                reject()
            found[part.name] = shape.draw(draw, most)
            size = shape.size(found[part.name])
            if part.name in self.area_of:
                area = self.area_of[part.name]
                found[area.name] = draw(_octets(area.total - size))
            else:
                spare -= size - part.least
        values = {part.attribute: found[part.name] for part in self.parts if part.attribute is not None}
        if self.foreign:
            values["extra"] = tuple(found[name] for name in self.foreign)
        if "bp" in self.cls.__struct_fields__:
            values.setdefault("bp", None)
        return self.cls(**values)

    def _spare(self, part: _Part, spare: int) -> int:
        """Return the octets beyond its minimum that a member may take; those inside an area are already counted."""
        return LARGEST_MESSAGE if part.name in self.area_of else spare

    def size(self, value: Any) -> int:
        size = self.fixed
        attributes = {part.name: part.attribute for part in self.parts}
        for part in self.parts:
            if part.name in self.area_of:
                continue
            if part.attribute is None:
                # A choice never gets here.
                assert part.shape is not None
                size += part.shape.size(value.extra[self.foreign.index(part.name)])
                continue
            shape = part.shape or part.shape_for(getattr(value, attributes[part.key or ""] or ""))
            size += shape.size(getattr(value, part.attribute))
        return size


def _scalars(group: Group) -> list[Scalar]:
    """Return the scalars of a record and of its inner records, which may depend on its members."""
    found: list[Scalar] = []
    for member in group.members:
        if isinstance(member, Scalar):
            found.append(member)
        elif isinstance(member, Group):
            found.extend(_scalars(member))
    return found


# -- octets that are almost a message ---------------------------------------------------------------------------

Dissect = Callable[[bytes], Dissection]


def mutations(octets: st.SearchStrategy[bytes], dissect: Dissect | None = None) -> st.SearchStrategy[bytes]:
    """Octets as drawn from ``octets``, damaged in one to three places.

    With ``dissect`` (``codec.dissect``, or that of a part) half of the damage hits exactly one field: it becomes zero,
    one, the highest value or the one below, one more, one less, a value without a name, or its octets are reversed, so
    that lengths, counts, types and identifiers are wrong. The other damage is to structure: a cut at any octet,
    appended octets, a duplicated or removed region, a flipped bit; with ``dissect`` also two exchanged list elements,
    an element replaced by one of another message, and all counts and lengths at their maximum. The result may by chance
    be a message again.
    """

    @st.composite
    def mutated(draw: st.DrawFn) -> bytes:
        found = draw(octets)
        for _ in range(draw(st.sampled_from((1, 1, 2, 3)))):
            if dissect is not None and draw(st.booleans()):
                found = _with_field_changed(draw, found, dissect)
            elif dissect is not None and draw(st.booleans()):
                found = _with_elements_changed(draw, found, dissect, octets)
            else:
                found = _with_structure_changed(draw, found)
        return found

    return mutated()


def _with_field_changed(draw: st.DrawFn, octets: bytes, dissect: Dissect) -> bytes:
    dissection = dissect(octets)
    shift = dissection.root.offset
    fields = [field for field in dissection.root.walk() if _is_leaf(field)]
    if not fields:
        return octets
    field = draw(st.sampled_from(fields))
    start = field.offset - shift
    raw = octets[start : start + field.length]
    wrong = _wrong(raw)
    if isinstance(field.layout, Scalar) and field.layout.names is not None:
        known = field.layout.names
        unnamed = next((number for number in range(1 << 8 * len(raw)) if number not in known), None)
        wrong += [] if unnamed is None else [unnamed.to_bytes(len(raw), field.layout.order)]
    return octets[:start] + draw(st.sampled_from(wrong)) + octets[start + field.length :]


def _is_leaf(field: Field) -> bool:
    return not field.children and field.length > 0


def _wrong(raw: bytes) -> list[bytes]:
    """Return other octets of the same length: the boundaries, the neighbours, the other byte order."""
    size = len(raw)
    modulus = 1 << (8 * size)
    found: list[bytes] = []
    for order in ("big", "little"):
        value = int.from_bytes(raw, order)
        for other in (0, 1, modulus - 2, modulus - 1, value + 1, value - 1):
            found.append((other % modulus).to_bytes(size, order))
    return [*dict.fromkeys([*found, raw[::-1]])]


def _with_elements_changed(draw: st.DrawFn, octets: bytes, dissect: Dissect, others: st.SearchStrategy[bytes]) -> bytes:
    """Exchange list elements, within a message or with another one; or set every count and length wrong at once."""
    kind = draw(st.sampled_from(("reorder", "splice", "bomb")))
    dissection = dissect(octets)
    if kind == "bomb":
        shift = dissection.root.offset
        for field in dissection.root.walk():
            if isinstance(field.layout, Scalar) and field.layout.derived is not None:
                start = field.offset - shift
                octets = octets[:start] + b"\xff" * field.length + octets[start + field.length :]
        return octets
    mine = _elements(dissection)
    if not mine:
        return octets
    name, start, stop = draw(st.sampled_from(mine))
    if kind == "splice":
        other = draw(others)
        theirs = [element for element in _elements(dissect(other)) if element[0] == name]
        _, begin, end = draw(st.sampled_from(theirs)) if theirs else (name, 0, 0)
        return octets[:start] + other[begin:end] + octets[stop:]
    behind = [element for element in mine if element[1] >= stop]
    if not behind:
        return octets
    _, begin, end = draw(st.sampled_from(behind))
    return octets[:start] + octets[begin:end] + octets[stop:begin] + octets[start:stop] + octets[end:]


def _elements(dissection: Dissection) -> list[tuple[str, int, int]]:
    """Return the elements of all lists: name of the list, start and end."""
    shift = dissection.root.offset
    return [
        (field.name, element.offset - shift, element.offset - shift + element.length)
        for field in dissection.root.walk()
        if isinstance(field.layout, Many)
        for element in field.children
        if element.length
    ]


def _with_structure_changed(draw: st.DrawFn, octets: bytes) -> bytes:
    kind = draw(st.sampled_from(("cut", "trail", "twice", "drop", "flip")))
    if kind == "trail":
        return octets + draw(st.binary(min_size=1, max_size=8))
    if not octets:
        return octets
    first = draw(st.integers(0, len(octets) - 1))
    if kind == "cut":
        return octets[:first]
    if kind == "flip":
        return octets[:first] + bytes([octets[first] ^ 1 << draw(st.integers(0, 7))]) + octets[first + 1 :]
    behind = draw(st.integers(first, min(first + 24, len(octets))))
    return octets[: behind if kind == "twice" else first] + octets[first if kind == "twice" else behind :]
