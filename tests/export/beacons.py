"""Beacons for the tests of exports: with everything in them, malformed ones, generated ones, recorded ones."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dcp_spec.profile.usability import unusable_keys
from hypothesis import HealthCheck, Phase, given, settings

from dcp_codec import (
    Beacon,
    BPHeader,
    Codec,
    Container,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)
from dcp_codec.plan.layout import walk
from dcp_codec.plan.tree import Group, Many, Node, Scalar, Select, Text

from ..chance import examples

RECORDINGS = sorted((Path(__file__).parent.parent.parent / "captures").glob("*.mcap"))


def everything(codec: Codec) -> Beacon:
    """A beacon with every kind of record that the profile has, and a payload of an unknown protocol."""
    profile, types = codec.profile, codec.profile.types
    if unusable_keys(profile):
        return _filled_beacon(codec)
    nodes = [bytes([2, 0, 0, 0, 0, number]) for number in (0xBB, 1)]
    if types.node_id.length is not None:
        sender, producer = (node.hex(":").encode() for node in nodes)
    else:
        sender, producer = (node.rjust(types.node_id.width, b"\7")[-types.node_id.width :] for node in nodes)
    stamp = -5 if types.timestamp.signed else (1 << 8 * types.timestamp.width) - 1
    has, numbers = profile.vardis.var_spec, profile.vardis.container_types.by_name()
    extra = tuple(range(40, 40 + len(profile.vardis.container_extra)))

    def spec(number: int, descr: str, created: int) -> VarSpec:
        timeout = 200 if "timeout" in has else None
        return VarSpec(number, producer, 2, descr.encode(), created if "creationTime" in has else None, timeout)

    now = min(1_700_000_000_123_456_789, (1 << 8 * types.timestamp.width - 1) - 1)
    records: dict[str, tuple[Any, ...]] = {
        "CREATE-VARIABLES": (
            VarCreate(spec(7, "pos", now), VarUpdate(7, 3, b"ABCD")),
            VarCreate(spec(250, "Höhe °", stamp), VarUpdate(250, 255, bytes(range(1, 32)))),
        ),
        "SUMMARIES": (VarSumm(7, 3), VarSumm(9, 0)),
        "UPDATES": (VarUpdate(7, 4, b"\x01"),),
        "REQUEST-VARUPDATES": (VarReqUpdate(9, 254),),
        "REQUEST-VARCREATES": (VarReqCreate(1), VarReqCreate(2), VarReqCreate(255)),
        "DELETE-VARIABLES": (VarDelete(4),),
    }
    containers = [Container(numbers[name], group, extra) for name, group in records.items()]
    payloads = []
    if codec.report_plan is not None:
        members = profile.srp.safety_data
        values = {
            member.name: b"\xfe" * member.octets
            if member.type == "opaque"
            else number * -1.5 + 0.125
            if member.type[0] == "f"
            else -number
            if member.type[0] == "i"
            else number
            for number, member in enumerate(members)
        }
        report = ExtendedSafetyData(codec.safety_data_type(**values), sender, now, 77)
        payloads.append(Payload(1, report))
    # Where lengths have one octet, not all containers fit into one beacon.
    roomy = types.bp_length.width > 1
    payloads += [Payload(2, tuple(containers if roomy else containers[1:])), Payload(99, b"\x00\xff?")]
    network = None if "networkId" not in profile.bp.header else profile.bp.network_id or 0
    return Beacon(BPHeader(sender, 41, network) if profile.bp.header else None, tuple(payloads))


def _filled_beacon(codec: Codec) -> Beacon:
    """The same for a profile with fields and containers of its own: every record, all fields counted up."""
    numbers = itertools.count(40)

    def value(node: Node) -> Any:
        number = next(numbers)
        match node:
            case Scalar(kind="bytes"):
                return bytes([number % 256]) * node.size
            case Scalar(kind="float"):
                return number + 0.5
            case Scalar():
                return number
            case Text():
                return f"text {number}".encode()
            case Group():
                return record(node)
            case _:
                raise TypeError(f"no value for {node}")

    def record(group: Group, **given: Any) -> Any:
        foreign = codec.types.slots(group)[1]
        found = {
            attribute: value(member)
            for member in group.members
            if (attribute := codec.types.attribute(group, member)) is not None and attribute not in given
        }
        if foreign:
            found["extra"] = tuple(value(member) for member in foreign)
        return codec.types[group.type_name](**found, **given)

    groups = {node.type_name: node for node in walk(codec.beacon_plan) if isinstance(node, Group)}
    choice = next(node for node in walk(codec.containers_plan) if isinstance(node, Select))
    containers = tuple(
        record(groups["Container"], ic_type=number, records=(record(case.element), record(case.element)))
        for number, case in choice.cases.items()
        if isinstance(case, Many)
    )
    report = record(groups["OwnReport"] if "OwnReport" in groups else groups["ExtendedSafetyData"])
    contents = {1: report, 2: containers, 99: b"\x00\xff?"}
    payloads = [record(groups["Payload"], protocol_id=key, content=content) for key, content in contents.items()]
    return Beacon(record(groups["BPHeader"]), tuple(payloads))


def malformed(codec: Codec, octets: bytes) -> Iterator[bytes]:
    """Invalid beacons: every deliberate change of a valid one."""
    found = codec.dissect(octets)
    # Of long areas and payloads, not every octet is a place of its own.
    starts = {field.offset + part for field in found.root.walk() for part in (0, 1)}
    yield from (octets[:end] for end in range(len(octets)) if len(octets) < 600 or end in starts)
    for field in found.root.walk():
        if isinstance(field.layout, Scalar) and field.layout.kind == "int":
            raw = int.from_bytes(field.raw, field.layout.order)
            for other in {0, 1, raw + 1, raw - 1, 200, (1 << 8 * field.length) - 1}:
                changed = other % (1 << 8 * field.length)
                wrong = changed.to_bytes(field.length, field.layout.order)
                yield octets[: field.offset] + wrong + octets[field.offset + field.length :]
    yield octets + bytes(12)
    yield octets + octets


def drawn(strategy: Any, count: int) -> list[bytes]:
    """As many examples of a Hypothesis strategy as :func:`examples` allows, the same in every run."""
    found: list[bytes] = []

    @settings(
        max_examples=examples(count),
        database=None,
        derandomize=True,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def draw(octets: bytes) -> None:
        found.append(octets)

    draw()
    return found
