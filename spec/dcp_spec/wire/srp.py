"""State Reporting Protocol: the schema of a state report (dcp-srp.md, "Data Types" and "Packet Format")."""

from __future__ import annotations

from typing import Any

import construct as cs

from dcp_spec.profile.definition import IntType, OwnField, Profile, SafetyField

from .combinators import Field, Record, WholeRegion
from .scalars import foreign, integer, members, node_id, real


def _safety_field(member: SafetyField) -> Field:
    if member.type == "opaque":
        return foreign(OwnField(name=member.name, opaque=member.octets))
    if member.type.startswith("f"):
        subcon = real(member.width, member.byte_order)
    else:
        subcon = integer(IntType(width=member.width, byte_order=member.byte_order, signed=member.type.startswith("i")))
    return Field(member.name, subcon, requirement="SRP-TYP-02", role=member.role or None, unit=member.unit or None)


def safety_data(profile: Profile) -> Record:
    """``SafetyDataT``: the data that the application submits, in the layout of the profile."""
    return Record("SafetyData", *map(_safety_field, profile.srp.safety_data), requirement="SRP-TYP-02")


def report(profile: Profile) -> Any | None:
    """The payload of SRP, which a report fills exactly (SRP-RX-01); None if it is octets of any number.

    A record of fields of the implementation's own only has the type ``OwnReport``.
    """
    record = profile.srp.record
    if not record:
        return None
    if profile.srp.is_report:
        return _filling(state_report(profile))
    return _filling(Record("OwnReport", *members(record, ()), requirement="SRP-RX-01"))


def _filling(record: Record) -> Any:
    try:
        record.sizeof()
    except cs.SizeofError:
        return record
    return WholeRegion(record, requirement="SRP-RX-01")


def state_report(profile: Profile) -> Record:
    """``ExtendedSafetyDataT``."""
    types = profile.types
    fields = (
        Field("sData", safety_data(profile), requirement="SRP-TYP-03", doc="safety data of the application"),
        Field(
            "nodeId",
            node_id(types.node_id),
            requirement="SRP-TYP-04",
            role="node-id",
            doc="node that the report is about",
        ),
        Field(
            "tStamp",
            integer(types.timestamp.as_int()),
            requirement="SRP-TYP-05",
            role="timestamp",
            unit=types.timestamp.unit,
            doc="time at which the application submitted the data",
        ),
        Field(
            "seqno",
            integer(types.srp_seqno),
            requirement="SRP-TYP-01",
            role="seqno",
            doc="counter of the node's reports",
        ),
    )
    return Record("ExtendedSafetyData", *members(profile.srp.record, fields), requirement="SRP-RX-01")
