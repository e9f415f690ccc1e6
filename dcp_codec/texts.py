"""Text form of dissected values, for a terminal or a report."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.profile.definition import Profile

from dcp_codec.common.printable import plain
from dcp_codec.jsonform import node_id_text
from dcp_codec.plan.tree import Fill, Group, Many, Rest, Scalar, Text

from .views.fields import Field

PROTOCOLS = {int(BP_PROTID_SRP): "SRP", int(BP_PROTID_VARDIS): "VarDis"}
# Tuples, because a union would be built again for each field that is tested.
_LISTS, _ANNOUNCED, _ROLES, _REMAINING = (Group, Many), (Scalar, Text, Fill), (Scalar, Text), (Rest, Fill)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def utc(time_ns: int) -> str:
    """Format a time as ``2026-11-21 07:25:51.682044000`` (UTC), or as the number of ns if the calendar has no such
    date.
    """
    seconds, ns = divmod(time_ns, 10**9)
    try:
        return f"{_EPOCH + timedelta(seconds=seconds):%Y-%m-%d %H:%M:%S}.{ns:09d}"
    except OverflowError:
        return f"{time_ns} ns"


def stamp_text(profile: Profile, stamp: int) -> str:
    """Format a time stamp of the protocol, with its calendar time if its epoch has one."""
    layout = profile.types.timestamp
    if layout.epoch_ns is None or layout.unit == "ps":
        return f"{stamp} {layout.unit}"
    return f"{stamp} {layout.unit} ({utc(layout.epoch_ns + layout.nanoseconds(stamp))})"


def octets_text(octets: bytes, limit: int = 32) -> str:
    """Format octets as hex, shortened to ``limit`` octets."""
    if len(octets) <= limit:
        return octets.hex()
    return f"{octets[:limit].hex()}… ({len(octets)} octets)"


def quoted(octets: bytes) -> str:
    """Return text octets in quotes; characters that could move the cursor or change colours are escaped."""
    text = octets.decode(errors="backslashreplace")
    return f'"{plain(text)}"'


def value_text(profile: Profile, field: Field) -> str:
    """Return the value of a field as text; empty for a field that only has parts."""
    layout, value = field.layout, field.value
    if isinstance(layout, _LISTS):
        return "(none)" if isinstance(layout, Many) and not field.children else ""
    if value is None:
        return "(cut off)" if isinstance(layout, _ANNOUNCED) else ""
    if isinstance(layout, Text) and layout.human and layout.role != "node-id":
        return quoted(value)
    if isinstance(layout, _ROLES) and layout.role == "node-id":
        return node_id_text(value, profile.types.node_id.representation)
    if isinstance(value, bytes):
        return octets_text(value) if value or isinstance(layout, _REMAINING) else "(no octets)"
    if not isinstance(layout, Scalar):
        return str(value)
    if layout.role == "timestamp":
        return stamp_text(profile, value)
    if field.label is not None:
        return f"{value} {field.label}"
    if layout.name == "protocolId" and value in PROTOCOLS:
        return f"{value} {PROTOCOLS[value]}"
    if layout.name in ("magicNo", "networkId"):
        return f"0x{value:0{2 * layout.size}x}"
    text = f"{value:.15g}" if isinstance(value, float) else str(value)
    return f"{text} {layout.unit}" if layout.unit and layout.unit != "octets" else text


def payload_name(payload: Field) -> str:
    """Return a short name of a payload: ``SRP``, ``VarDis [SUMMARIES 2]``, ``protocol 0x7777 [12]``."""
    protocol = payload.child("protocolId")
    if protocol is None or protocol.value is None:
        return "cut off"
    containers = payload.child("vardis")
    if containers is not None:
        parts = []
        for container in containers.children:
            kind, count = container.child("icType"), container.child("icNumRecords")
            name = (kind.label or f"type {kind.value}") if kind is not None else "?"
            parts.append(f"{name} {count.value if count is not None else '?'}")
        return f"VarDis [{', '.join(parts)}]"
    if payload.child("srp") is not None:
        return "SRP"
    data = payload.child("data")
    name = PROTOCOLS.get(protocol.value, f"protocol 0x{protocol.value:04x}")
    return f"{name} [{data.length if data is not None else 0} octets]"


def payload_line(payload: Field) -> str:
    """Describe a payload block in one line."""
    containers = payload.child("vardis")
    if containers is None:
        report = payload.child("srp")
        number = report.child("seqno") if report is not None else None
        return f"SRP #{number.value}" if number is not None else payload_name(payload)
    return " ".join(_container_line(container) for container in containers.children) or "VarDis (empty)"


def _container_line(container: Field) -> str:
    kind, records = container.child("icType"), container.child("records")
    name = (kind.label or f"type {kind.value}") if kind is not None else "?"
    shown = [_record_text(record) for record in (records.children if records is not None else [])]
    return f"{name}({' '.join(shown)})"


def _record_text(record: Field) -> str:
    """Format ``7:3`` (variable and sequence number), ``7"pos":3=41424344`` for a create, ``7:3=4142`` for an update."""
    spec, update = record.child("spec"), record.child("upd") or record
    var_id = (spec or record).child("varId")
    text = str(var_id.value) if var_id is not None and var_id.value is not None else "?"
    descr = spec.child("descr") if spec is not None else None
    if descr is not None and descr.value is not None:
        text += quoted(descr.value)
    seqno, value = update.child("seqno"), update.child("value")
    if seqno is not None and seqno.value is not None:
        text += f":{seqno.value}"
    if value is not None and value.value is not None:
        text += f"={value.value.hex()}"
    return text
