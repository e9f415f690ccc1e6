"""Build frames, valid ones and frames with any field wrong.

The codec encodes a valid beacon from the schema of the profile. Then the octets of single fields are replaced, which
are located by their path in the dissection. So all other lengths and counts are correct in every profile. Faults that
are not values of fields (truncated, additional or reordered octets) are made with the octets.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType

from dcp_codec.codec import Codec
from dcp_codec.plan.measures import least_size, record
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

Lies = Mapping[str, int | bytes]


class Block(NamedTuple):
    """A payload block: the protocol and the client payload, which may be any octets."""

    protocol_id: int
    octets: bytes


class FrameBuilderError(ValueError):
    """A replacement of a field that does not exist, or by a value that the field cannot hold."""


class FrameBuilder:
    """Builds bearer payloads of a profile."""

    def __init__(self, codec: Codec, *, sized: Callable[[], object] = lambda: None) -> None:
        """``sized`` is called whenever the size of a record is asked for."""
        self.codec = codec
        self._sized = sized
        self._numbers = codec.profile.vardis.container_types.by_name()

    # -- VarDis ------------------------------------------------------------------------------------------------

    def ic_type(self, kind: ICType) -> int:
        """Return the number of a container type in this profile."""
        return self._numbers[kind.label]

    def kind(self, number: int) -> ICType | None:
        """Return the container type with a number in this profile; None for one that the profile adds."""
        return next((kind for kind in ICType if self.ic_type(kind) == number), None)

    def container(
        self,
        *records: VardisRecord,
        count: int | None = None,
        ic_type: int | None = None,
        lies: Lies | None = None,
    ) -> bytes:
        """Encode one container with records of one type; return its octets.

        ``count`` and ``ic_type`` replace the correct values of icNumRecords and icType. ``lies`` has further wrong
        values by paths below the container: ``{"records[0].upd.value.length": 200}``.
        """
        valid = self.codec.encode_containers((Container(self.ic_type(records[0].IC_TYPE), tuple(records)),))
        wrong = {f"[0].{path}": value for path, value in (lies or {}).items()}
        if count is not None:
            wrong["[0].icNumRecords"] = count
        if ic_type is not None:
            wrong["[0].icType"] = ic_type
        return self.patched(self.codec.containers_plan, valid, wrong)

    def empty_container(self, ic_type: int, count: int = 0, rest: bytes = b"") -> bytes:
        """Return the header of a container without any record, followed by the octets ``rest``."""
        probe = self.container(VarDelete(0), count=count, ic_type=ic_type)
        return probe[: self.container_header_size] + rest

    @property
    def container_header_size(self) -> int:
        """Size of an ``ICHeaderT`` in octets."""
        layout = record(self.codec.containers_plan, "Container")
        assert layout is not None
        return least_size(layout)

    def record_size(self, record: VardisRecord) -> int:
        """Return the size of a record in its container, in octets."""
        self._sized()
        return len(self.container(record)) - self.container_header_size

    def vardis(self, *containers: bytes | VardisRecord) -> Block:
        """Return a VarDis payload of containers; adjacent records of the same type share a container."""
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
        """Return an SRP payload with a state report."""
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
        """Return the bearer payload of a beacon. ``lies`` has wrong values by paths: ``{"bp.length": 0}``.

        Raise :class:`FrameBuilderError` for wrong paths or values, and ``EncodeError`` if the beacon cannot be encoded.
        """
        profile = self.codec.profile
        header = None
        if profile.bp.header:
            identifier = profile.bp.network_id if network_id is None else network_id
            header = BPHeader(sender, seqno, identifier if profile.has_header_field("networkId") else None)
        valid = self.codec.encode_envelope(Beacon(header, tuple(Payload(*block) for block in blocks)))
        return self.patched(self.codec.envelope_plan, valid, lies or {})

    def patched(self, plan: Node, octets: bytes, lies: Lies) -> bytes:
        """Return ``octets`` with the fields at these paths replaced; a value may be octets of any length."""
        if not lies:
            return octets
        fields = {field.path: field for field in dissect(plan, octets).root.walk()}
        # Replace from the end: changed lengths must not shift later offsets.
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
        raise FrameBuilderError(f"{field.path} is not a number; give its octets")
    try:
        return value.to_bytes(layout.size, layout.order, signed=layout.signed and value < 0)
    except OverflowError:
        raise FrameBuilderError(f"{field.path} has {layout.size} octets, which cannot hold {value}") from None
