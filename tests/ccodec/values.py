"""The plain form of decoded values, of which harness and Python compute a CRC."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from dcp_codec import Beacon, Codec
from dcp_codec.export.shape import Record, shape_of
from dcp_codec.plan.tree import Group, Node, Scalar, Text

_NUMBER = struct.Struct("<Q").pack
_REAL = struct.Struct("<d").pack
_ALL = (1 << 64) - 1

Dump = Callable[[Any, list[bytes]], None]


def plain_form(codec: Codec) -> Callable[[Beacon], bytes]:
    """Return the function that turns a beacon of a profile into its plain form."""
    shape = shape_of(codec)
    header = _record(codec, shape.header) if shape.header else None
    payload, container = _record(codec, shape.payload), _record(codec, shape.container)
    report = _record(codec, shape.srp) if shape.srp else None
    records = {number: _record(codec, each) for number, each in shape.records.items()}
    vardis = shape.protocols[shape.vardis.name]
    srp = shape.protocols.get("srp")
    area = None if shape.fill is None else _getter(codec, shape.payload.group, shape.fill)

    def form(beacon: Beacon) -> bytes:
        out: list[bytes] = []
        if header is not None:
            header(beacon.bp, out)
        for each in beacon.payloads:
            payload(each, out)
            if area is not None:
                out += (_NUMBER(len(area(each))), area(each))
            content: Any = each.content
            if each.protocol_id == vardis:
                for one in content:
                    container(one, out)
                    for record in one.records:
                        records[one.ic_type](record, out)
            elif each.protocol_id == srp and report is not None:
                report(content, out)
            else:
                out += (_NUMBER(len(content)), content)
        return b"".join(out)

    return form


def _record(codec: Codec, record: Record) -> Dump:
    return _members(codec, record.group, record.members)


def _getter(codec: Codec, group: Group, member: Node) -> Callable[[Any], Any]:
    attribute = codec.types.attribute(group, member)
    if attribute is not None:
        return lambda value: getattr(value, attribute)
    index = codec.types.slots(group)[1].index(member)
    return lambda value: value.extra[index]


def _members(codec: Codec, group: Group, members: tuple[Node, ...]) -> Dump:
    steps: list[Dump] = []
    for member in members:
        if isinstance(member, Scalar) and not member.stored:
            continue
        steps.append(_step(codec, _getter(codec, group, member), member))

    def dump(value: Any, out: list[bytes]) -> None:
        for step in steps:
            step(value, out)

    return dump


def _step(codec: Codec, get: Callable[[Any], Any], member: Node) -> Dump:
    if isinstance(member, Group):
        inner = _members(codec, member, member.members)
        return lambda value, out: inner(get(value), out)
    if isinstance(member, Text) or (isinstance(member, Scalar) and member.kind == "bytes"):
        return lambda value, out: out.extend((_NUMBER(len(get(value))), get(value)))
    if isinstance(member, Scalar) and member.kind == "float":

        def real(value: Any, out: list[bytes]) -> None:
            number = get(value)
            out.append(_NUMBER(_ALL) if number != number else _REAL(number))

        return real
    return lambda value, out: out.append(_NUMBER(get(value) & _ALL))
