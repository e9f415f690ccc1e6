"""Wire vectors of a profile: octets with the values or the problem that a decoder must find in them.

Valid messages cover each record, boundary values of each field, counts and lengths. Damaged ones are made from them
systematically: fields that lie, ends at each octet, elements too many or too few. Nothing is drawn. An identifier names
the message and its change, so that it keeps its meaning when others are added.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import msgspec
from dcp_spec.catalogue.readings import readings
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import BP_PROTID_VARDIS, ICType

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError, EncodeError, Problem
from dcp_codec.export.example import example_beacon
from dcp_codec.jsonform import beacon_from_json, beacon_json
from dcp_codec.plan.tree import Fill, Many, Rest, Scalar, Text
from dcp_codec.records import RecordFactory
from dcp_codec.values import Beacon, Container, Payload
from dcp_codec.views.fields import Field

#: A protocol that is neither SRP nor VarDis.
_OTHER: Final = 3
#: A message up to this size is cut off at each octet.
_SHORT: Final = 200
#: Lengths of texts at which counters and signs are likely to fail.
_LENGTHS: Final = (0, 1, 2, 31, 32, 33, 127, 128, 254, 255)
#: Readings of disputed text on which a vector depends, by what shows that it does.
_BY_WARNING: Final = {"id-mismatch": "X14", "empty-description": "X21"}
_BY_REASON: Final = {"bad-version": "X09", "beacon-overrun": "X02"}


class Expected(msgspec.Struct, frozen=True):
    """The first problem of damaged octets."""

    reason: str
    """A reason of ``dcp_spec.reasons``."""
    field: str
    """Path of the field, with indices; empty for the beacon itself."""
    offset: int
    """Octet at which the field begins, from the first octet of the beacon."""
    requirement: str | None
    needed: int | None
    available: int | None
    """Numbers of octets, or for reasons that compare numbers, the number that should be there and the one found."""


def expected_of(problem: Problem) -> Expected:
    """Return a problem as vectors have it."""
    where = problem.reason, problem.path, problem.offset, problem.requirement
    return Expected(*where, problem.needed, problem.available)


class Vector(msgspec.Struct, frozen=True, omit_defaults=True, rename="camel"):
    """One wire vector. Either ``values`` or ``problem`` is set."""

    tc_id: str
    comment: str
    flags: tuple[str, ...]
    """Warnings about well-formed octets, and readings (``X02``) on which the expectation depends."""
    requirements: tuple[str, ...]
    octets: str
    """Hex."""
    result: str
    """``valid`` or ``invalid``."""
    direction: str = "both"
    """``decode``: the values have other octets when they are encoded, for example because padding follows."""
    used: int | None = None
    """Octets of the beacon; others follow it."""
    values: Mapping[str, Any] | None = None
    """The beacon as ``dcp-codec decode`` prints it."""
    problem: Expected | None = None


class _Message(NamedTuple):
    """A valid message, and which changes are made of it."""

    name: str
    octets: bytes
    changes: str = ""
    """Letters: ``f`` of fields, ``c`` cuts, ``e`` of elements of lists."""


def vectors(codec: Codec) -> list[Vector]:
    """Return all wire vectors of a profile, in a fixed order. No two have equal octets."""
    maker, found, seen = _Maker(codec), [], set()
    for message in maker.messages():
        for name, octets, field in maker.changed(message):
            if octets not in seen:
                seen.add(octets)
                found.append(maker.vector(name, octets, field))
    return found


class _Maker:
    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._profile = codec.profile
        self._made = RecordFactory(codec)
        self._example = example_beacon(codec)
        self._numbers = codec.profile.vardis.container_types.by_name()
        present = {each.ic_type: each for each in self._example.payloads[-1].vardis or ()}
        self._create = present[self._numbers[ICType.CREATE_VARIABLES.label]].records[0]
        version = codec.profile.spec_version
        self._readings = {each.id for each in readings().values() if version.is_within(each.since, each.until)}

    # -- valid messages ----------------------------------------------------------------------------------------

    def messages(self) -> Iterator[_Message]:
        """Yield the valid messages."""
        for name, payloads, changes in self._payloads():
            header = self._example.bp
            if len(payloads) > 255:
                continue
            try:
                octets = self._codec.encode(Beacon(header, tuple(payloads)))
            except EncodeError:
                # The profile has no such type, or a length cannot express it.
                continue
            if len(octets) <= max(self._profile.limits.max_beacon_size, 1500):
                yield _Message(name, octets, changes)

    def _payloads(self) -> Iterator[tuple[str, list[Payload], str]]:
        """Yield names, payloads, and the changes of a message."""
        yield "example", list(self._example.payloads), "fce"
        for kind in ICType:
            yield f"one {kind.label}", [self._block(self._container(kind, 1))], "fc"
        for kind in ICType:
            yield f"two {kind.label}", [self._block(self._container(kind, 2))], "e"
        for kind in ICType:
            for count in (127, 128, 254, 255):
                yield f"{count} {kind.label}", [self._block(self._container(kind, count))], ""
        every = [self._container(kind, 1) for kind in ICType]
        yield "all types", [self._block(*every)], "e"
        yield "all types, reverse", [self._block(*reversed(every))], ""
        yield "one type twice", [self._block(every[0], every[0])], ""
        opaque = [Payload(_OTHER, bytes(range(1, size + 1))) for size in (0, 1, 2, 40)]
        yield "opaque 0", [opaque[0]], ""
        yield "opaque 1", [opaque[1]], "fc"
        yield "opaque 255", [Payload(_OTHER, bytes(255))], ""
        yield "opaque 256", [Payload(_OTHER, bytes(256))], ""
        yield "three payloads", [opaque[2], self._block(every[0]), opaque[3]], "fce"
        yield "two of a protocol", [self._block(every[0]), self._block(every[1])], ""
        for number in (127, 128, 255):
            yield f"{number} payloads", [opaque[1]] * number, ""
        for size in _LENGTHS:
            yield f"value of {size}", [self._block(self._update(bytes(k % 255 + 1 for k in range(size))))], ""
            yield f"descr of {size}", [self._block(self._described(b"d" * size))], ""
        yield "value of NULs", [self._block(self._update(bytes(3)))], ""
        yield "descr in UTF-8", [self._block(self._described("é – 位置 🛸".encode()))], ""
        yield "descr not in UTF-8", [self._block(self._described(b"\xff\xfe"))], ""

    def _block(self, *containers: Container) -> Payload:
        return Payload(BP_PROTID_VARDIS, containers)

    def _container(self, kind: ICType, count: int) -> Container:
        return Container(self._numbers[kind.label], tuple(self._record(kind, number) for number in range(count)))

    def _record(self, kind: ICType, number: int) -> Any:
        var_id = (number + 5) % 256
        if kind is not ICType.CREATE_VARIABLES:
            return self._made.record(kind, var_id, (number + 0x41) % 128, b"\x11\x22")
        replace = msgspec.structs.replace
        spec = replace(self._create.spec, var_id=var_id)
        return replace(self._create, spec=spec, upd=replace(self._create.upd, var_id=var_id))

    def _update(self, value: bytes) -> Container:
        record = msgspec.structs.replace(self._record(ICType.UPDATES, 0), value=value)
        return Container(self._numbers[ICType.UPDATES.label], (record,))

    def _described(self, descr: bytes) -> Container:
        spec = msgspec.structs.replace(self._create.spec, descr=descr)
        record = msgspec.structs.replace(self._create, spec=spec)
        return Container(self._numbers[ICType.CREATE_VARIABLES.label], (record,))

    # -- changes -------------------------------------------------------------------------------------------------

    def changed(self, message: _Message) -> Iterator[tuple[str, bytes, Field | None]]:
        """Yield a message and its changes: name, octets, and the changed field."""
        name, octets = message.name, message.octets
        yield name, octets, None
        root = self._codec.dissect(octets).root
        if "f" in message.changes:
            yield from self._fields(name, octets, root)
        if "c" in message.changes:
            for end in _ends(octets, root):
                yield f"{name}: ends after {end}", octets[:end], None
            for behind in (bytes(1), bytes(20), b"\xff" * 5):
                yield f"{name}: followed by {behind[:1].hex()} {len(behind)} times", octets + behind, None
        if "e" in message.changes:
            for field in root.walk():
                if isinstance(field.layout, Many):
                    for each in field.children:
                        start, stop = each.offset, each.offset + each.length
                        yield f"{name}: {each.path} twice", octets[:stop] + octets[start:], None
                        yield f"{name}: without {each.path}", octets[:start] + octets[stop:], None

    def _fields(self, name: str, octets: bytes, root: Field) -> Iterator[tuple[str, bytes, Field | None]]:
        for field in root.walk():
            layout = field.layout
            if field.children or not field.length or not isinstance(layout, Scalar):
                # A text with prefixes has them as children; texts have messages of their own.
                continue
            for new, raw in _octets_of(field.raw, layout):
                changed = octets[: field.offset] + raw + octets[field.offset + field.length :]
                yield f"{name}: {field.path} {new}", changed, field

    # -- expectations ----------------------------------------------------------------------------------------------

    def vector(self, name: str, octets: bytes, field: Field | None) -> Vector:
        """Return the vector of octets. ``field``: what was changed."""
        codec = self._codec
        dissection = codec.dissect(octets)
        flags = list(dict.fromkeys(each.reason for each in dissection.warnings))
        disputed = [_BY_WARNING[each] for each in flags if each in _BY_WARNING]
        tc_id = f"{self._profile.name}/wire/{name}"
        try:
            _, used = codec.decode_from(octets)
        except DecodeError as error:
            problem = error.problem
            expected = expected_of(problem)
            comment = f"{name}: {problem.reason}" + (f" of {problem.path}" if problem.path else "")
            disputed += [_BY_REASON[problem.reason]] if problem.reason in _BY_REASON else []
            disputed += ["X34"] if "vardis" in problem.path else []
            return Vector(
                tc_id, comment, self._flags(disputed), self._holding((problem.requirement,)),
                octets.hex(), "invalid", problem=expected,
            )  # fmt: skip
        disputed += ["X02"] if used != len(octets) else []
        values = beacon_json(codec, dissection.root)
        # JSON has no octets of a NaN.
        same = codec.encode(beacon_from_json(codec, values)) == octets
        leaf = getattr(field.layout, "requirement", None) if field is not None else None
        every = (getattr(each.layout, "requirement", None) for each in dissection.root.walk())
        named = self._holding((leaf,) if leaf else every)
        direction = "both" if same else "decode"
        all_flags = (*flags, *self._flags(disputed))
        return Vector(tc_id, name, all_flags, named, octets.hex(), "valid", direction, used, values)

    def _holding(self, named: Iterable[str | None]) -> tuple[str, ...]:
        """Return the requirements that this version has; without any, that of the format of a beacon."""
        version = self._profile.spec_version
        found = [each for each in dict.fromkeys(named) if each and requirement(each).holds_in(version)]
        return tuple(found) or ("BP-FMT-01",)

    def _flags(self, disputed: Iterable[str]) -> tuple[str, ...]:
        return tuple(each for each in dict.fromkeys(disputed) if each in self._readings)


def _ends(octets: bytes, root: Field) -> Iterable[int]:
    """Return the numbers of octets after which a message is cut off: all, or those around fields of a long one."""
    if len(octets) <= _SHORT:
        return range(len(octets))
    starts = {each.offset for each in root.walk()}
    near = {start + by for start in starts for by in (-1, 0, 1)} | {len(octets) - 1}
    return sorted(each for each in near if 0 <= each < len(octets))


def _octets_of(raw: bytes, layout: Scalar) -> Iterator[tuple[str, bytes]]:
    """Yield other contents of a field: boundary values, neighbours, the other byte order."""
    size, order = len(raw), layout.order
    top = (1 << 8 * size) - 1
    value = int.from_bytes(raw, order)
    numbers = {
        "0": 0, "1": 1, "max": top, "max-1": top - 1, "half": (top >> 1) + 1, "half-1": top >> 1,
        "+1": (value + 1) & top, "-1": (value - 1) & top,
        "counting": int.from_bytes(bytes(range(0x81, 0x81 + size)), "big"),
    }  # fmt: skip
    for name, number in numbers.items():
        yield name, number.to_bytes(size, order)
    for bit in range(8):
        yield f"bit {bit} of the first octet", bytes((raw[0] ^ 1 << bit, *raw[1:]))
    if size > 1:
        yield "swapped", raw[::-1]


# -- the form for languages without JSON -----------------------------------------------------------------------------


def tokens(root: Field) -> Iterator[str]:
    """Yield the values of a dissected beacon in wire order: numbers in decimal, octets as ``x`` and hex.

    A real number is ``f`` and the octets of an IEEE 754 double in hex, big-endian, or ``nan``. Constants, lengths and
    counts that follow from other values are left out.
    """
    layout = root.layout
    if isinstance(layout, Text | Rest | Fill):
        yield f"x{root.value.hex() if isinstance(root.value, bytes) else root.raw.hex()}"
    elif isinstance(layout, Scalar):
        if layout.stored:
            yield _token(root.value)
    else:
        for each in root.children:
            yield from tokens(each)


def _token(value: Any) -> str:
    if isinstance(value, bytes):
        return f"x{value.hex()}"
    if isinstance(value, float):
        return "nan" if value != value else f"f{struct.pack('>d', value).hex()}"
    return str(value)


def lines(codec: Codec, found: Iterable[Vector]) -> Iterator[str]:
    """Yield the vectors as lines: identifier, octets, and what a decoder finds; fields end with a tab.

    ``V`` id octets used direction values, or ``R`` id octets reason offset requirement field needed available. The
    field is without the lists around it, as ``dcp_problem_t`` has it.
    """
    yield f"# wire vectors of profile {codec.profile.name}, form 1"
    for each in found:
        octets = each.octets or "-"
        if each.problem is None:
            values = " ".join(tokens(codec.dissect(bytes.fromhex(each.octets)).root))
            yield "\t".join(("V", each.tc_id, octets, str(each.used), each.direction, values))
        else:
            problem = each.problem
            name = problem.field.rpartition("]")[2].removeprefix(".")
            numbers = str(problem.needed or 0), str(problem.available or 0)
            why = (problem.reason, str(problem.offset), problem.requirement or "-", name or "-", *numbers)
            yield "\t".join(("R", each.tc_id, octets, *why))
