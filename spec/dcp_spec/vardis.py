"""VarDis: the schema of a payload of instruction containers (dcp-vardis.md, "Key Data Types and Definitions")."""

from __future__ import annotations

from typing import Any

from .combinators import Choice, Counted, CountOf, Field, Named, Record, Sized, SizeOf, UntilEnd
from .profile import IntType, Profile
from .scalars import foreign, integer, node_id, octets


def _var_id(profile: Profile) -> Field:
    return Field("varId", integer(profile.types.var_id), requirement="VD-TYP-01", role="variable", doc="variable")


def _seqno(profile: Profile, doc: str) -> Field:
    return Field("seqno", integer(profile.types.var_seqno), requirement="VD-TYP-03", role="seqno", doc=doc)


def var_spec(profile: Profile) -> Record:
    """``VarSpecT``: the static attributes of a variable."""
    types = profile.types
    fields = {
        "varId": _var_id(profile),
        "prodId": Field("prodId", node_id(types.node_id), requirement="VD-TYP-05", role="node-id", doc="producer"),
        "repCnt": Field(
            "repCnt",
            integer(types.var_rep_cnt),
            requirement="VD-TYP-05",
            doc="beacons that repeat an instruction",
        ),
        "creationTime": Field(
            "creationTime",
            integer(types.timestamp.as_int()),
            requirement="VD-TYP-05",
            role="timestamp",
            unit=types.timestamp.unit,
            doc="when the producer created the variable",
        ),
        "timeout": Field(
            "timeout",
            integer(types.var_timeout),
            requirement="VD-TYP-04",
            unit="ms",
            doc="deleted when not updated for so long; 0 = never",
        ),
        "descr": Field("descr", octets(types.string, text=True), requirement="DATA-07", doc="description, UTF-8"),
    }
    return Record("VarSpec", *(fields[name] for name in profile.vardis.var_spec), requirement="VD-TYP-05")


def var_update(profile: Profile) -> Record:
    """``VarUpdateT``: a new value of a variable."""
    return Record(
        "VarUpdate",
        _var_id(profile),
        _seqno(profile, "sequence number of this value"),
        Field(
            "value",
            octets(profile.types.value, text=False),
            requirement="VD-TYP-02",
            doc="value of the variable",
        ),
        requirement="VD-TYP-07",
    )


def instruction_records(profile: Profile) -> dict[str, Record]:
    """The record type of each container type, by the container's name."""
    return {
        "SUMMARIES": Record(
            "VarSumm",
            _var_id(profile),
            _seqno(profile, "newest value that the sender has"),
            requirement="VD-TYP-07",
        ),
        "UPDATES": var_update(profile),
        "REQUEST-VARUPDATES": Record(
            "VarReqUpdate",
            _var_id(profile),
            _seqno(profile, "outdated value of the requester"),
            requirement="VD-TYP-07",
        ),
        "REQUEST-VARCREATES": Record("VarReqCreate", _var_id(profile), requirement="VD-TYP-07"),
        "CREATE-VARIABLES": Record(
            "VarCreate",
            Field("spec", var_spec(profile), requirement="VD-TYP-07", doc="static attributes"),
            Field("upd", var_update(profile), requirement="VD-TYP-07", doc="current value"),
            requirement="VD-TYP-07",
        ),
        "DELETE-VARIABLES": Record("VarDelete", _var_id(profile), requirement="VD-TYP-07"),
    }


def container(profile: Profile) -> Record:
    """One instruction container: ``ICHeaderT`` and a list of records of one type."""
    octet = integer(IntType(width=1))
    layout = profile.vardis
    numbers = layout.container_types.by_name()
    records: Any = Choice(
        "icType",
        {
            numbers[name]: ("records", Counted("icNumRecords", record))
            for name, record in instruction_records(profile).items()
        },
        requirement="VD-RX-05",
    )
    members = [
        Field(
            "icType",
            Named(octet, {number: name for name, number in numbers.items()}, label_field="icName"),
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
        members.append(
            Field("listLength", SizeOf(integer(layout.list_length), of="records", target=records), unit="octets")
        )
        records = Sized("listLength", records, reason="list-overrun", requirement="VD-RX-07")
    members.append(Field("records", records, requirement="VD-IC-01", doc="instruction records"))
    return Record("Container", *members, requirement="VD-RX-07")


def payload(profile: Profile) -> UntilEnd:
    """A VarDis payload: containers up to its last octet (VD-RX-04)."""
    return UntilEnd(container(profile))
