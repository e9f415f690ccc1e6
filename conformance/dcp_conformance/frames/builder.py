"""Frames that may lie: anything can be put on the air with any field wrong.

An honest beacon is encoded by the codec, from the same schema as everything else; then the octets of single fields are
replaced, found by their path in the dissection. Lengths and counts that nobody lies about are therefore right for any
profile. What no field can express (cut off, added, reordered) is done with the octets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType

from dcp_codec.codec import Codec
from dcp_codec.plan.tree import Node, Scalar
from dcp_codec.values import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    Payload,
    VarDelete,
    VardisRecord,
)
from dcp_codec.views.dissect import Field, dissect

from .received import KIND_OF

Lies = Mapping[str, int | bytes]


class Block(NamedTuple):
    """A payload block: the protocol and the client payload, which may be any octets."""

    protocol_id: int
    octets: bytes


class FrameBuilderError(ValueError):
    """A lie about a field that is not there, or a value that no octets of that field can hold."""


class FrameBuilder:
    """Builds bearer payloads of a profile."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self._numbers = codec.profile.vardis.container_types.by_name()

    # -- VarDis ------------------------------------------------------------------------------------------------

    def ic_type(self, kind: ICType) -> int:
        """The number of a container type in this profile."""
        return self._numbers[kind.label]

    def container(
        self,
        *records: VardisRecord,
        count: int | None = None,
        ic_type: int | None = None,
        lies: Lies | None = None,
    ) -> bytes:
        """One container of records of one kind; ``count`` is what icNumRecords says if not the truth.

        ``lies`` are paths below the container: ``{"records[0].upd.value.length": 200}``.
        """
        honest = self.codec.encode_containers((Container(self.ic_type(KIND_OF[type(records[0])]), tuple(records)),))
        wrong = {f"[0].{path}": value for path, value in (lies or {}).items()}
        if count is not None:
            wrong["[0].icNumRecords"] = count
        if ic_type is not None:
            wrong["[0].icType"] = ic_type
        return self.patched(self.codec.containers_plan, honest, wrong)

    def empty_container(self, ic_type: int, count: int = 0, rest: bytes = b"") -> bytes:
        """The header of a container with no honest record behind it, and then ``rest``."""
        probe = self.container(VarDelete(0), count=count, ic_type=ic_type)
        return probe[: len(probe) - self.codec.profile.types.var_id.width] + rest

    @property
    def container_header_size(self) -> int:
        """Octets of an ``ICHeaderT``."""
        return len(self.empty_container(1))

    def record_size(self, record: VardisRecord) -> int:
        """Octets of a record in its container."""
        return len(self.container(record)) - self.container_header_size

    def vardis(self, *containers: bytes | VardisRecord) -> Block:
        """A VarDis payload. Records become containers: neighbours of one kind share one."""
        octets = bytearray()
        run: list[VardisRecord] = []
        for each in containers:
            if run and (isinstance(each, bytes) or type(each) is not type(run[0])):
                octets += self.container(*run)
                run = []
            if isinstance(each, bytes):
                octets += each
            else:
                run.append(each)
        if run:
            octets += self.container(*run)
        return Block(BP_PROTID_VARDIS, bytes(octets))

    # -- SRP ---------------------------------------------------------------------------------------------------

    def srp(self, report: ExtendedSafetyData) -> Block:
        """A state report."""
        return Block(BP_PROTID_SRP, self.codec.encode_report(report))

    # -- beacons -----------------------------------------------------------------------------------------------

    def beacon(
        self,
        sender: bytes,
        seqno: int,
        blocks: Sequence[Block],
        *,
        network_id: int | None = None,
        lies: Lies | None = None,
    ) -> bytes:
        """The bearer payload of a beacon. ``lies`` are paths as the dissector has them: ``{"bp.length": 0}``.

        Raises :class:`ForgeError`, or ``EncodeError`` for what has no octets at all.
        """
        profile = self.codec.profile
        header = None
        if profile.bp.header:
            identifier = profile.bp.network_id if network_id is None else network_id
            header = BPHeader(sender, seqno, identifier if profile.has_header_field("networkId") else None)
        honest = self.codec.encode_envelope(Beacon(header, tuple(Payload(*block) for block in blocks)))
        return self.patched(self.codec.envelope_plan, honest, lies or {})

    def patched(self, plan: Node, octets: bytes, lies: Lies) -> bytes:
        """``octets`` with the fields at these paths replaced; a value may be octets of any number."""
        if not lies:
            return octets
        fields = {field.path: field for field in dissect(plan, octets).root.walk()}
        # From the end, so that octets of another number do not move what is still to be replaced.
        for path, value in sorted(lies.items(), key=lambda lie: -_found(fields, lie[0]).offset):
            field = _found(fields, path)
            new = value if isinstance(value, bytes) else _number(field, value)
            octets = octets[: field.offset] + new + octets[field.offset + field.length :]
        return octets


def _found(fields: Mapping[str, Field], path: str) -> Field:
    try:
        return fields[path]
    except KeyError:
        raise FrameBuilderError(f"there is no field {path}; there are {', '.join(filter(None, fields))}") from None


def _number(field: Field, value: int) -> bytes:
    layout = field.layout
    if not isinstance(layout, Scalar) or layout.kind != "int":
        raise FrameBuilderError(f"{field.path} is no number; give its octets")
    try:
        return value.to_bytes(layout.size, layout.order, signed=layout.signed and value < 0)
    except OverflowError:
        raise FrameBuilderError(f"{field.path} has {layout.size} octets, which cannot hold {value}") from None
