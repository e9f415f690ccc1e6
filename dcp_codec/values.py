"""Messages as immutable values.

There is one class for each record type of the specification. Its attributes are the specification's field names in
snake_case, in the order of the specification. Fields that follow from others (lengths, counts, version, magic number)
are not stored, so they cannot be inconsistent. Fields that a profile adds to a record (opaque regions of an in-memory
image, an implementation's additional field) are kept in wire order in ``extra``; if ``extra`` is empty or missing, they
are encoded as zeros. Records have it only in the classes of such a profile (``codec.types``), which are derived from
those of this module. ``IC_TYPE`` is the type of the container that holds the records of a class.

Integers are ``int``, octets are ``bytes``. Node identifiers are octets as on the wire; time stamps have the unit and
epoch of the profile.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar

import msgspec
from dcp_spec.constants import ICType

Extra = tuple[Any, ...]


class BPHeader(msgspec.Struct, frozen=True, gc=False):
    """``BPHeaderT`` (dcp-bp.md, "Data Types"). ``network_id`` is None where the layout has none (before 2.0).

    ``seqno`` is 0..2^32-1; the length of ``sender_id`` is that of the profile's node identifiers.
    """

    sender_id: bytes
    seqno: int
    network_id: int | None = None
    extra: Extra = ()


class SafetyData(msgspec.Struct, frozen=True, gc=False):
    """``SafetyDataT``: base of each profile's class with its fields (``codec.safety_data_type``)."""

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, in wire order."""
        return {name: getattr(self, name) for name in self.__struct_fields__}


class OwnRecord(msgspec.Struct, frozen=True, gc=False):
    """Base of a profile's classes for records that the specification does not define.

    These are the records of additional container types (``codec.types[...]``), and ``OwnReport``, the record that an
    implementation sends instead of state reports. Attributes are the field names in snake_case.
    """

    IC_TYPE: ClassVar[None] = None

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by attribute, in wire order."""
        return {name: getattr(self, name) for name in self.__struct_fields__}


class ExtendedSafetyData(msgspec.Struct, frozen=True, gc=False):
    """``ExtendedSafetyDataT``, a state report (dcp-srp.md, "Data Types"). ``seqno`` is 0..2^32-1."""

    s_data: Any
    node_id: bytes
    t_stamp: int
    seqno: int
    extra: Extra = ()


class VarSpec(msgspec.Struct, frozen=True, gc=False):
    """``VarSpecT``. ``creation_time`` and ``timeout`` (ms) are None before 2.0; ``descr`` is UTF-8 octets."""

    var_id: int
    prod_id: bytes
    rep_cnt: int
    descr: bytes
    creation_time: int | None = None
    timeout: int | None = None


class VarUpdate(msgspec.Struct, frozen=True, gc=False):
    """``VarUpdateT``: a new value."""

    IC_TYPE: ClassVar[ICType] = ICType.UPDATES

    var_id: int
    seqno: int
    value: bytes


class VarCreate(msgspec.Struct, frozen=True, gc=False):
    """``VarCreateT``: the static attributes and the current value."""

    IC_TYPE: ClassVar[ICType] = ICType.CREATE_VARIABLES

    spec: VarSpec
    upd: VarUpdate


class VarDelete(msgspec.Struct, frozen=True, gc=False):
    """``VarDeleteT``."""

    IC_TYPE: ClassVar[ICType] = ICType.DELETE_VARIABLES

    var_id: int


class VarSumm(msgspec.Struct, frozen=True, gc=False):
    """``VarSummT``: the newest sequence number that the sender has."""

    IC_TYPE: ClassVar[ICType] = ICType.SUMMARIES

    var_id: int
    seqno: int


class VarReqUpdate(msgspec.Struct, frozen=True, gc=False):
    """``VarReqUpdateT``: ``seqno`` is the requester's own, outdated number."""

    IC_TYPE: ClassVar[ICType] = ICType.REQUEST_VARUPDATES

    var_id: int
    seqno: int


class VarReqCreate(msgspec.Struct, frozen=True, gc=False):
    """``VarReqCreateT``."""

    IC_TYPE: ClassVar[ICType] = ICType.REQUEST_VARCREATES

    var_id: int


#: The record of each type of instruction container of the specification.
RECORD_CLASSES: Mapping[ICType, type[msgspec.Struct]] = MappingProxyType(
    {each.IC_TYPE: each for each in (VarSumm, VarUpdate, VarReqUpdate, VarReqCreate, VarCreate, VarDelete)}
)

VardisRecord = VarCreate | VarDelete | VarUpdate | VarSumm | VarReqUpdate | VarReqCreate
AnyRecord = TypeVar("AnyRecord", bound=VardisRecord | VarSpec | ExtendedSafetyData | OwnRecord)


def own_values(record: msgspec.Struct) -> Extra:
    """Return the values of the fields that the profile adds to a record, in wire order."""
    found: Extra = getattr(record, "extra", ())
    return found


def attributes(record: msgspec.Struct) -> list[str]:
    """Return the names of the attributes of a record, last those of the fields that the profile adds."""
    added: tuple[str, ...] = getattr(record, "ADDED", ())
    return [*(name for name in record.__struct_fields__ if name != "extra"), *added]


class Container(msgspec.Struct, frozen=True, gc=False):
    """An instruction container: 1 to 255 records of one type, which ``ic_type`` selects in the profile."""

    ic_type: int
    records: tuple[Any, ...]
    extra: Extra = ()


class Payload(msgspec.Struct, frozen=True, gc=False):
    """A payload block. ``content`` is a state report, a tuple of containers, or the octets of another protocol.

    If the profile's SRP payloads are not state reports, ``content`` is an :class:`OwnRecord`.
    """

    protocol_id: int
    content: ExtendedSafetyData | tuple[Container, ...] | bytes | OwnRecord
    extra: Extra = ()

    @property
    def srp(self) -> ExtendedSafetyData | None:
        """Return the state report; None if the content is something else."""
        return self.content if isinstance(self.content, ExtendedSafetyData) else None

    @property
    def own_report(self) -> OwnRecord | None:
        """Return the record that the implementation sends instead of a state report; None for other content."""
        return self.content if isinstance(self.content, OwnRecord) else None

    @property
    def vardis(self) -> tuple[Container, ...] | None:
        """Return the instruction containers; None if this is not a VarDis payload."""
        return self.content if isinstance(self.content, tuple) else None

    @property
    def data(self) -> bytes | None:
        """Return the octets of an unknown protocol; None for other content."""
        return self.content if isinstance(self.content, bytes) else None


class Beacon(msgspec.Struct, frozen=True, gc=False):
    """A bearer payload: header and 1 to 255 payload blocks. ``bp`` is None for a profile that sends no header."""

    bp: BPHeader | None
    payloads: tuple[Payload, ...]


_RECORDS: tuple[type[msgspec.Struct], ...] = (Beacon, BPHeader, Payload, ExtendedSafetyData, Container, VarSpec)
#: The value class of each record type of the schema; each profile has its own class for SafetyData.
VALUE_CLASSES = {cls.__name__: cls for cls in (*_RECORDS, *RECORD_CLASSES.values())}
