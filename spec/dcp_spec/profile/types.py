"""The types that a wire profile is written with: scalars, texts, and fields of the implementation's own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

ByteOrder = Literal["big", "little"]
Width = Annotated[int, Meta(ge=1, le=8)]
U8 = Annotated[int, Meta(ge=0, le=0xFF)]
Positive = Annotated[int, Meta(ge=1)]
NotNegative = Annotated[int, Meta(ge=0)]
#: Octets of a part: nothing in a beacon is larger than a datagram.
Size = Annotated[int, Meta(ge=0, le=0xFFFF)]
#: Units of time stamps in a second.
TICKS_PER_SECOND: Mapping[str, int] = MappingProxyType({"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9, "ps": 10**12})
#: Epochs that are calendar dates (1980-01-06 for GPS), in ns since 1970.
_EPOCHS_NS: Mapping[str, int] = MappingProxyType({"unix": 0, "gps": 315_964_800 * 10**9})

#: Described once for all numbers.
BYTE_ORDER = Meta(description="Octet order on the wire.")
_SIGNED = Meta(description="Two's complement instead of unsigned.")
_WIDTH = Meta(description="Octets on the wire.")


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the parts of a profile: immutable, and a key that is not known is an error."""


class IntType(Part, frozen=True):
    """An integer."""

    width: Annotated[Width, _WIDTH]
    byte_order: Annotated[ByteOrder, BYTE_ORDER] = "big"
    signed: Annotated[bool, _SIGNED] = False


class RealType(Part, frozen=True):
    """An IEEE 754 number."""

    width: Annotated[Literal[4, 8], _WIDTH]
    byte_order: Annotated[ByteOrder, BYTE_ORDER] = "big"


class NodeIdType(Part, frozen=True):
    """``NodeIdentifierT`` (DATA-04): octets of a fixed number, or text after a length."""

    width: Annotated[
        Annotated[int, Meta(ge=0, le=255)], Meta(description="Octets on the wire; 0 if `length` is given.")
    ] = 6
    representation: Annotated[
        Literal["mac", "hex", "text"],
        Meta(description="How tools write it: as a MAC address (6 octets), as hex, or as text (with `length`)."),
    ] = "mac"
    length: Annotated[
        IntType | None, Meta(description="The length before an identifier of varying size; not with a beacon header.")
    ] = None

    def of(self, address: bytes) -> bytes:
        """Return an identifier made of a MAC address: as text, or its last octets, after 0x02 if it is wider."""
        if self.representation == "text":
            return address.hex(":").encode()
        return address[-self.width :].rjust(self.width, b"\2") if self.width else b""


class TimestampType(Part, frozen=True):
    """``TimeStampT`` (DATA-05): an integer that counts a unit since an epoch."""

    width: Annotated[Width, _WIDTH] = 8
    byte_order: Annotated[ByteOrder, BYTE_ORDER] = "big"
    signed: Annotated[bool, _SIGNED] = False
    unit: Annotated[Literal["s", "ms", "us", "ns", "ps"], Meta(description="Unit of the count.")] = "ns"
    epoch: Annotated[
        Literal["unix", "gps", "simulation", "boot"],
        Meta(
            description="Start of the count: 1970, 1980-01-06 without leap seconds, or a point in time that has no "
            "known relation to the time of a recording (`simulation`, `boot`)."
        ),
    ] = "unix"

    @property
    def per_second(self) -> int:
        """Return the number of units in a second."""
        return TICKS_PER_SECOND[self.unit]

    @property
    def epoch_ns(self) -> int | None:
        """When stamps begin, in ns since 1970; None for an epoch that is not a calendar date. No leap seconds."""
        return _EPOCHS_NS.get(self.epoch)

    def nanoseconds(self, ticks: int) -> int:
        """So many units in ns, rounded down: since the epoch for a stamp, a duration for the difference of two."""
        return ticks * 10**9 // self.per_second

    def as_int(self) -> IntType:
        """The integer that carries the time stamp."""
        return IntType(width=self.width, byte_order=self.byte_order, signed=self.signed)


class TextType(Part, frozen=True):
    """Octets of varying number."""

    lengths: Annotated[
        tuple[IntType, ...],
        Meta(description="The lengths before the octets: none, one, or several that must agree."),
    ] = (IntType(width=1),)
    terminated: Annotated[bool, Meta(description="A NUL octet ends the octets; a length counts it.")] = False


class OwnField(Part, frozen=True):
    """A field that the specification does not have. It has exactly one of `opaque`, `extra`, `real`, `block`."""

    name: Annotated[str, Meta(description="Name in all tools: letters, digits, `_`; not that of a standard field.")]
    opaque: Annotated[
        Annotated[int, Meta(ge=1, le=0xFFFF)] | None, Meta(description="Number of octets without a known meaning.")
    ] = None
    extra: Annotated[IntType | None, Meta(description="Layout of an integer.")] = None
    real: Annotated[RealType | None, Meta(description="Layout of a floating-point number.")] = None
    block: Annotated[TextType | None, Meta(description="Layout of octets of varying number.")] = None
    text: Annotated[bool, Meta(description="The octets of `block` are UTF-8 text.")] = False
    unit: Annotated[str, Meta(description="Unit of the value, for headings.")] = ""
    note: Annotated[str, Meta(description="The meaning of the field, for exported formats.")] = ""

    @property
    def width(self) -> int | None:
        """Octets on the wire; None if the number varies."""
        if self.opaque is not None:
            return self.opaque
        number = self.extra or self.real
        return number.width if number is not None else None


#: A record: names of standard fields and fields of the implementation's own, in the order on the wire.
Members = tuple[str | OwnField, ...]


def own_fields(members: Iterable[str | OwnField]) -> list[OwnField]:
    """The fields of a record that the specification does not have."""
    return [member for member in members if isinstance(member, OwnField)]


def standard_fields(members: Iterable[str | OwnField]) -> list[str]:
    """The names of the fields of a record that the specification has."""
    return [member for member in members if isinstance(member, str)]


class Types(Part, frozen=True):
    """Width and octet order of every transmissible type."""

    node_id: Annotated[NodeIdType, Meta(description="`NodeIdentifierT`.")] = NodeIdType()
    timestamp: Annotated[TimestampType, Meta(description="`TimeStampT`.")] = TimestampType()
    magic_no: Annotated[IntType, Meta(description="`magicNo` of the beacon header.")] = IntType(width=2)
    protocol_id: Annotated[IntType, Meta(description="`protocolId` of a payload block.")] = IntType(width=2)
    bp_length: Annotated[IntType, Meta(description="`length` of header and payload block.")] = IntType(width=2)
    network_id: Annotated[IntType, Meta(description="`networkId` of the beacon header.")] = IntType(width=2)
    bp_seqno: Annotated[IntType, Meta(description="`seqno` of the beacon header.")] = IntType(width=4)
    srp_seqno: Annotated[IntType, Meta(description="`seqno` of a state report.")] = IntType(width=4)
    var_id: Annotated[IntType, Meta(description="`VarIdT`.")] = IntType(width=1)
    var_rep_cnt: Annotated[IntType, Meta(description="`VarRepCntT`.")] = IntType(width=1)
    var_seqno: Annotated[IntType, Meta(description="`VarSeqnoT`.")] = IntType(width=1)
    var_timeout: Annotated[IntType, Meta(description="`timeout` of a variable, in ms.")] = IntType(width=2)
    string: Annotated[TextType, Meta(description="`StringT`, the description of a variable.")] = TextType()
    value: Annotated[TextType, Meta(description="`MemBlockT`, the value of a variable.")] = TextType()
