"""The construct classes that the wire schemas are written with.

Plain construct describes *how* octets become values. A DCP schema also has to say *which rule* an octet breaks,
so each class here is an ordinary construct class (it parses and builds through construct alone) that carries
the reason and the requirement id with it, as data. ``dcp_codec.plan.tree`` reads the same attributes when it lowers
a schema, which is why references to other fields are names (``"bp.length"``, ``"icNumRecords"``) and not lambdas.

A field reference is a dotted name looked up in the enclosing construct context; a leading ``_.`` goes one
record up.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import construct as cs


class SchemaViolation(cs.ConstructError):
    """Octets that the schema can read but the protocol forbids.

    ``reason`` is one of :data:`dcp_spec.reasons.REASONS`; ``requirement`` an id of the catalogue.
    """

    def __init__(self, reason: str, requirement: str | None, path: str | None = None) -> None:
        super().__init__(f"{reason} ({requirement})" if requirement else reason, path)
        self.reason = reason
        self.requirement = requirement


def look_up(context: Any, reference: str) -> Any:
    """Return what ``reference`` names in a construct context (see the module docstring)."""
    value = context
    for part in reference.split("."):
        value = value[part]
    return value


def remaining(stream: Any) -> int:
    """Octets between the position of ``stream`` and its end; the position does not change."""
    here = stream.tell()
    end = stream.seek(0, io.SEEK_END)
    stream.seek(here)
    return int(end - here)


def take(stream: Any, count: int, path: str) -> bytes:
    """Read exactly ``count`` octets or raise ``construct.StreamError``."""
    return bytes(cs.stream_read(stream, count, path))


class Field(cs.Renamed):
    """A named member of a record with what people need to know about it.

    ``requirement`` is cited when the field is cut off, ``unit`` and ``doc`` go to the exported format tables,
    ``role`` tells tools what a value means (``"position.x"``, ``"opaque"``, ``"node-id"``, ``"timestamp"``).
    """

    def __init__(
        self,
        name: str,
        subcon: Any,
        *,
        requirement: str | None = None,
        role: str | None = None,
        unit: str | None = None,
        doc: str = "",
    ) -> None:
        super().__init__(subcon, newname=name, newdocs=doc)
        self.requirement = requirement
        self.role = role
        self.unit = unit


##= DATA-02
class Record(cs.Struct):
    """A packed record type of the specification; ``type_name`` is the name of its value class."""

    def __init__(self, type_name: str, *fields: Field, requirement: str | None = None) -> None:
        super().__init__(*fields)
        self.type_name = type_name
        self.requirement = requirement


class Expect(cs.Subconstruct):
    """A field that must hold one value. It is not part of the message value: building writes ``value``."""

    def __init__(self, subcon: Any, value: int, *, reason: str, requirement: str) -> None:
        super().__init__(subcon)
        self.value = value
        self.reason = reason
        self.requirement = requirement
        self.flagbuildnone = True

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        found = self.subcon._parsereport(stream, context, path)
        if found != self.value:
            raise SchemaViolation(self.reason, self.requirement, path)
        return found

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        self.subcon._build(self.value, stream, context, path)
        return self.value


class SizeOf(cs.Subconstruct):
    """A length that says how many octets ``target`` (the member named ``of``) takes; derived when building."""

    def __init__(
        self,
        subcon: Any,
        *,
        of: str,
        target: Any,
        nonzero: bool = False,
        requirement: str | None = None,
    ) -> None:
        super().__init__(subcon)
        self.of = of
        self.target = target
        self.nonzero = nonzero
        self.reason = "zero-length"
        self.requirement = requirement
        self.flagbuildnone = True

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        found = self.subcon._parsereport(stream, context, path)
        if self.nonzero and found == 0:
            raise SchemaViolation(self.reason, self.requirement, path)
        return found

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        sink = io.BytesIO()
        # The record that holds the target is the context its members refer to, as when it is built for real.
        owner = context
        for part in self.of.split(".")[:-1]:
            owner = owner[part]
        self.target._build(look_up(context, self.of), sink, owner, path)
        size = len(sink.getvalue())
        if self.nonzero and size == 0:
            raise SchemaViolation(self.reason, self.requirement, path)
        self.subcon._build(size, stream, context, path)
        return size


class CountOf(cs.Subconstruct):
    """The number of elements of the member named ``of``; at least one; derived when building."""

    def __init__(self, subcon: Any, *, of: str, requirement: str) -> None:
        super().__init__(subcon)
        self.of = of
        self.reason = "zero-count"
        self.requirement = requirement
        self.flagbuildnone = True

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        found = self.subcon._parsereport(stream, context, path)
        if found == 0:
            raise SchemaViolation(self.reason, self.requirement, path)
        return found

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        count = len(look_up(context, self.of))
        if count == 0:
            raise SchemaViolation(self.reason, self.requirement, path)
        self.subcon._build(count, stream, context, path)
        return count


class Named(cs.Subconstruct):
    """An integer whose values have names; ``label_field`` is what the name is called in JSON (``icName``)."""

    def __init__(self, subcon: Any, names: Mapping[int, str], *, label_field: str) -> None:
        super().__init__(subcon)
        self.names = dict(names)
        self.label_field = label_field


class VarBytes(cs.Construct):
    """Octets of varying number: length prefixes and/or a terminating NUL.

    With one prefix this is the specification's MemBlockT. No prefix and ``terminated`` is the string of
    specification 1.0. Both together is what the 1.0 simulator sends: the length counts the NUL. Two prefixes
    (both must agree) are what the 2024 student code sends. ``text`` marks human-readable content (UTF-8).
    """

    def __init__(self, *prefixes: Any, terminated: bool = False, text: bool = False) -> None:
        super().__init__()
        self.prefixes = prefixes
        self.terminated = terminated
        self.text = text

    def _parse(self, stream: Any, context: Any, path: str) -> bytes:
        if not self.prefixes:
            data = bytearray()
            while (octet := take(stream, 1, path)) != b"\0":
                data += octet
            return bytes(data)
        length = self.prefixes[0]._parsereport(stream, context, path)
        for prefix in self.prefixes[1:]:
            if prefix._parsereport(stream, context, path) != length:
                raise SchemaViolation("length-mismatch", "DATA-06", path)
        block = take(stream, length, path)
        if not self.terminated:
            return block
        if block[-1:] != b"\0" or b"\0" in block[:-1]:
            raise SchemaViolation("bad-terminator", "DATA-07", path)
        return block[:-1]

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        block = bytes(obj)
        if self.terminated:
            if b"\0" in block:
                raise SchemaViolation("bad-terminator", "DATA-07", path)
            block += b"\0"
        for prefix in self.prefixes:
            prefix._build(len(block), stream, context, path)
        cs.stream_write(stream, block, len(block), path)
        return obj


class Filler(cs.Construct):
    """The unused rest of a fixed area of ``total`` octets of which ``used`` (a length field) are taken."""

    def __init__(self, total: int, used: str) -> None:
        super().__init__()
        self.total = total
        self.used = used

    def _parse(self, stream: Any, context: Any, path: str) -> bytes:
        used = look_up(context, self.used)
        if used > self.total:
            raise SchemaViolation("area-overrun", "BP-RX-09", path)
        return take(stream, self.total - used, path)

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        size = self.total - look_up(context, self.used)
        rest = bytes(obj) if obj else bytes(max(size, 0))
        if size < 0 or len(rest) != size:
            raise SchemaViolation("area-overrun", "BP-RX-09", path)
        cs.stream_write(stream, rest, len(rest), path)
        return obj


class Counted(cs.Subconstruct):
    """As many elements as the field named ``count`` says."""

    def __init__(self, count: str, subcon: Any) -> None:
        super().__init__(subcon)
        self.count = count

    def _parse(self, stream: Any, context: Any, path: str) -> list[Any]:
        return [self.subcon._parsereport(stream, context, path) for _ in range(look_up(context, self.count))]

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        for element in obj:
            self.subcon._build(element, stream, context, path)
        return obj


class UntilEnd(cs.Subconstruct):
    """Elements up to the last octet of the region; a cut-off element is an error, not the end.

    ``count`` names a field that should agree with the number of elements. ``nonempty``: the first element is missing,
    where there are no octets, as any other that is cut off.
    """

    def __init__(
        self, subcon: Any, *, count: str | None = None, requirement: str | None = None, nonempty: bool = False
    ) -> None:
        super().__init__(subcon)
        self.count = count
        self.nonempty = nonempty
        self.reason = "count-mismatch"
        self.requirement = requirement

    def _parse(self, stream: Any, context: Any, path: str) -> list[Any]:
        elements: list[Any] = []
        while remaining(stream) or (self.nonempty and not elements):
            elements.append(self.subcon._parsereport(stream, context, path))
        if self.count is not None and look_up(context, self.count) != len(elements):
            raise SchemaViolation(self.reason, self.requirement, path)
        return elements

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        if self.nonempty and not obj:
            raise SchemaViolation("truncated", self.requirement, path)
        for element in obj:
            self.subcon._build(element, stream, context, path)
        return obj


class Sized(cs.Subconstruct):
    """A region of as many octets as the field named ``size`` says, which its content must fill."""

    def __init__(self, size: str, subcon: Any, *, reason: str, requirement: str) -> None:
        super().__init__(subcon)
        self.size = size
        self.reason = reason
        self.requirement = requirement

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        size = look_up(context, self.size)
        if remaining(stream) < size:
            raise SchemaViolation(self.reason, self.requirement, path)
        region = io.BytesIO(take(stream, size, path))
        value = self.subcon._parsereport(region, context, path)
        if remaining(region):
            raise SchemaViolation("leftover", self.requirement, path)
        return value


class WholeRegion(cs.Subconstruct):
    """A record of fixed size that must be exactly as long as the region that holds it."""

    def __init__(self, subcon: Any, *, requirement: str) -> None:
        super().__init__(subcon)
        self.reason = "wrong-length"
        self.requirement = requirement

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        if remaining(stream) != self.subcon.sizeof():
            raise SchemaViolation(self.reason, self.requirement, path)
        return self.subcon._parsereport(stream, context, path)


class Choice(cs.Construct):
    """One of several layouts, chosen by the field named ``key``.

    ``cases`` maps the key to (label, layout); the label is what the member is called in paths and JSON. Without
    ``default`` an unknown key is an error.
    """

    def __init__(
        self,
        key: str,
        cases: Mapping[int, tuple[str, Any]],
        *,
        default: tuple[str, Any] | None = None,
        reason: str = "unknown-type",
        requirement: str | None = None,
    ) -> None:
        super().__init__()
        self.key = key
        self.cases = dict(cases)
        self.default = default
        self.reason = reason
        self.requirement = requirement

    def _layout(self, context: Any, path: str) -> Any:
        case = self.cases.get(look_up(context, self.key), self.default)
        if case is None:
            raise SchemaViolation(self.reason, self.requirement, path)
        return case[1]

    def _parse(self, stream: Any, context: Any, path: str) -> Any:
        return self._layout(context, path)._parsereport(stream, context, path)

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any:
        return self._layout(context, path)._build(obj, stream, context, path)
