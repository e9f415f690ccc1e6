"""A small example beacon of a profile, and octets annotated with the names of their fields."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType

from dcp_codec.codec import Codec
from dcp_codec.jsonform import scalar_json
from dcp_codec.plan.tree import Fill, Group, Rest, Scalar
from dcp_codec.records import RecordFactory
from dcp_codec.values import Beacon, Container, ExtendedSafetyData, Payload
from dcp_codec.views.encode_diagnosis import zero
from dcp_codec.views.fields import Field

from .jsonschema import record_group

#: 2023-11-14T22:13:20Z
_NOW_S = 1_700_000_000
_OCTETS_A_LINE = 8


def example_beacon(codec: Codec) -> Beacon:
    """Return a beacon with a state report, if the profile has one, and the creation and summary of a variable."""
    node_id = codec.profile.types.node_id.of(b"\x02\x00\x00\x00\x00\x01")
    payloads = []
    if codec.report_plan is not None:
        payloads.append(Payload(BP_PROTID_SRP, _report(codec, node_id)))
    elif codec.srp_plan is not None:
        payloads.append(Payload(BP_PROTID_SRP, _blank(record_group(codec.srp_plan), codec)))
    payloads.append(Payload(BP_PROTID_VARDIS, _containers(codec, node_id)))
    return Beacon(RecordFactory(codec).header(node_id, 41), tuple(payloads))


def _blank(group: Group, codec: Codec) -> Any:
    """Return a record of zeros."""
    return codec.types[group.type_name](*(zero(member) for member in group.members))


def _now(codec: Codec) -> int:
    stamp = codec.profile.types.timestamp
    since = _NOW_S if stamp.epoch_ns is not None else 12
    bits = 8 * stamp.width - stamp.signed
    return since * stamp.per_second % (1 << bits)


def _report(codec: Codec, node_id: bytes) -> ExtendedSafetyData:
    values = {
        member.name: number * 1.5 if member.type.startswith("f") else number
        for number, member in enumerate(codec.profile.srp.safety_data, start=1)
        if member.type != "opaque"
    }
    return RecordFactory(codec).report(node_id, _now(codec), 7, values)


def _containers(codec: Codec, node_id: bytes) -> tuple[Container, ...]:
    made = RecordFactory(codec)
    numbers = codec.profile.vardis.container_types.by_name()
    timeout = 5000 % (1 << 8 * codec.profile.types.var_timeout.width)
    create = made.create(made.spec(7, node_id, 2, b"pos", _now(codec), timeout), 3, b"ABCD")
    summaries = made.record(ICType.SUMMARIES, 7, 3), made.record(ICType.SUMMARIES, 9)
    return (
        Container(numbers["CREATE-VARIABLES"], (create,)),
        Container(numbers["SUMMARIES"], summaries),
    )


def annotated(codec: Codec, octets: bytes) -> Iterator[str]:
    """Yield one line for each field of a beacon: offset, octets in hex, path, value. Never raises."""
    dissection = codec.dissect(octets)
    leaves = [field for field in dissection.root.walk() if not field.children and field.length]
    names, width = max((len(field.path) for field in leaves), default=0), 3 * _OCTETS_A_LINE - 1
    yield f"{'offset':6}  {'octets':{width}}  {'field':{names}}  value"
    for field in leaves:
        yield f"{field.offset:#06x}  {_hex(field):{width}}  {field.path:{names}}  {_value(field, codec)}".rstrip()


def _hex(field: Field) -> str:
    raw = field.raw
    if len(raw) <= _OCTETS_A_LINE:
        return raw.hex(" ")
    return f"{raw[:3].hex(' ')} .. {raw[-2:].hex(' ')}"


def _value(field: Field, codec: Codec) -> str:
    if isinstance(field.layout, Rest | Fill) or (isinstance(field.layout, Scalar) and field.layout.role == "opaque"):
        return f"({field.length} octet{'' if field.length == 1 else 's'})"
    value = scalar_json(field.layout, field.value, codec.profile.types.node_id.representation)
    return f"{value} {field.label}" if field.label else f"{value}"
