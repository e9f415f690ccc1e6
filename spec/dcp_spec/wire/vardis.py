"""VarDis: the schema of a payload of instruction containers (dcp-vardis.md, "Key Data Types and Definitions")."""

from __future__ import annotations

from typing import Any

from dcp_spec.profile.definition import IntType, OwnContainer, Profile

from .combinators import Choice, Counted, CountOf, Field, Named, Record, Sized, SizeOf, UntilEnd
from .scalars import foreign, integer, members, node_id, octets


def _var_id(profile: Profile) -> Field:
    return Field("varId", integer(profile.types.var_id), requirement="VD-TYP-01", role="variable", doc="variable")


def _seqno(profile: Profile, doc: str) -> Field:
    return Field("seqno", integer(profile.types.var_seqno), requirement="VD-TYP-03", role="seqno", doc=doc)


def spec_fields(profile: Profile) -> tuple[Field, ...]:
    """The fields of ``VarSpecT``."""
    types = profile.types
    return (
        _var_id(profile),
        Field("prodId", node_id(types.node_id), requirement="VD-TYP-05", role="node-id", doc="producer"),
        Field(
            "repCnt",
            integer(types.var_rep_cnt),
            requirement="VD-TYP-05",
            doc="number of beacons that contain each instruction",
        ),
        Field(
            "creationTime",
            integer(types.timestamp.as_int()),
            requirement="VD-TYP-05",
            role="timestamp",
            unit=types.timestamp.unit,
            doc="time at which the producer created the variable",
        ),
        Field(
            "timeout",
            integer(types.var_timeout),
            requirement="VD-TYP-04",
            unit="ms",
            doc="deleted after this time without an update; 0 = never",
        ),
        Field("descr", octets(types.string, text=True), requirement="DATA-07", doc="description, UTF-8"),
    )


def var_spec(profile: Profile) -> Record:
    """``VarSpecT``: the static attributes of a variable."""
    return Record("VarSpec", *members(profile.vardis.var_spec, spec_fields(profile)), requirement="VD-TYP-05")


def _value(profile: Profile) -> Field:
    value = octets(profile.types.value, text=False)
    return Field("value", value, requirement="VD-TYP-02", doc="value of the variable")


def var_update(profile: Profile) -> Record:
    """``VarUpdateT``: a new value of a variable."""
    seqno = _seqno(profile, "sequence number of this value")
    return _record(profile, "VarUpdate", _var_id(profile), seqno, _value(profile))


def _record(profile: Profile, name: str, *fields: Field) -> Record:
    """The instruction record of that name, with its members as the profile lists them."""
    listed = profile.vardis.records.by_name()[name]
    return Record(name, *members(listed, fields), requirement="VD-TYP-07")


def instruction_records(profile: Profile) -> dict[str, Record]:
    """The record type of each container type, by the container's name."""
    var_id = _var_id(profile)
    newest = _seqno(profile, "sequence number of the newest value that the sender has")
    outdated = _seqno(profile, "sequence number of the outdated value that the sender has")
    return {
        "SUMMARIES": _record(profile, "VarSumm", var_id, newest),
        "UPDATES": var_update(profile),
        "REQUEST-VARUPDATES": _record(profile, "VarReqUpdate", var_id, outdated),
        "REQUEST-VARCREATES": _record(profile, "VarReqCreate", var_id),
        "CREATE-VARIABLES": _record(
            profile,
            "VarCreate",
            Field("spec", var_spec(profile), requirement="VD-TYP-07", doc="static attributes"),
            Field("upd", var_update(profile), requirement="VD-TYP-07", doc="current value"),
        ),
        "DELETE-VARIABLES": _record(profile, "VarDelete", var_id),
    }


def own_record(profile: Profile, container: OwnContainer) -> Record:
    """The record type of a container type of the implementation's own."""
    fields = (*spec_fields(profile), _seqno(profile, "sequence number"), _value(profile))
    return Record(container.type_name, *members(container.record, fields), requirement="VD-TYP-07")


def container(profile: Profile) -> Record:
    """One instruction container: ``ICHeaderT`` and a list of records of one type."""
    octet = integer(IntType(width=1))
    layout = profile.vardis
    numbers = layout.container_types.by_name()
    layouts = {numbers[name]: record for name, record in instruction_records(profile).items()}
    layouts |= {own.number: own_record(profile, own) for own in layout.own_containers}
    records: Any = Choice(
        "icType",
        {number: ("records", Counted("icNumRecords", record)) for number, record in layouts.items()},
        requirement="VD-RX-05",
    )
    parts = [
        Field(
            "icType",
            Named(octet, layout.container_names(), label_field="icName"),
            requirement="VD-IC-01",
            doc="type of the records",
        ),
        Field(
            "icNumRecords",
            CountOf(octet, of="records", requirement="VD-RX-06"),
            requirement="VD-IC-01",
            doc="number of records",
        ),
        *(foreign(member) for member in layout.container_extra),
    ]
    if layout.list_length is not None:
        parts.append(
            Field("listLength", SizeOf(integer(layout.list_length), of="records", target=records), unit="octets")
        )
        records = Sized("listLength", records, reason="list-overrun", requirement="VD-RX-07")
    parts.append(Field("records", records, requirement="VD-IC-01", doc="instruction records"))
    return Record("Container", *parts, requirement="VD-RX-07")


def payload(profile: Profile) -> UntilEnd:
    """A VarDis payload: containers up to its last octet (VD-RX-04)."""
    return UntilEnd(container(profile))
