"""State Reporting Protocol: the schema of a state report (dcp-srp.md, "Data Types" and "Packet Format")."""

from __future__ import annotations

from typing import Any

from .combinators import Field, Record, WholeRegion
from .profile import IntType, Opaque, Profile, SafetyField
from .scalars import foreign, integer, node_id, real


def _safety_field(member: SafetyField) -> Field:
    if member.type == "opaque":
        return foreign(Opaque(name=member.name, opaque=member.octets))
    if member.type.startswith("f"):
        subcon = real(member.width, member.byte_order)
    else:
        subcon = integer(IntType(width=member.width, byte_order=member.byte_order, signed=member.type.startswith("i")))
    return Field(member.name, subcon, requirement="SRP-TYP-02", role=member.role or None, unit=member.unit or None)


def safety_data(profile: Profile) -> Record:
    """``SafetyDataT``: what the application hands down; its layout is the profile's."""
    return Record(
        "SafetyData",
        *(_safety_field(member) for member in profile.srp.safety_data),
        requirement="SRP-TYP-02",
    )


def state_report(profile: Profile) -> Any | None:
    """``ExtendedSafetyDataT``, which fills its payload exactly (SRP-RX-01); None if the profile has no record."""
    if not profile.srp.record:
        return None
    types = profile.types
    fields = {
        "sData": Field("sData", safety_data(profile), requirement="SRP-TYP-03", doc="safety data of the application"),
        "nodeId": Field(
            "nodeId",
            node_id(types.node_id),
            requirement="SRP-TYP-04",
            role="node-id",
            doc="node that the report is about",
        ),
        "tStamp": Field(
            "tStamp",
            integer(types.timestamp.as_int()),
            requirement="SRP-TYP-05",
            role="timestamp",
            unit=types.timestamp.unit,
            doc="when the application handed the data down",
        ),
        "seqno": Field(
            "seqno",
            integer(types.srp_seqno),
            requirement="SRP-TYP-01",
            role="seqno",
            doc="counts the reports of this node",
        ),
    }
    record = Record(
        "ExtendedSafetyData",
        *(fields[member] if isinstance(member, str) else foreign(member) for member in profile.srp.record),
        requirement="SRP-RX-01",
    )
    return record if types.node_id.length is not None else WholeRegion(record, requirement="SRP-RX-01")
