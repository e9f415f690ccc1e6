"""Wire profiles: everything about the octets that the specification leaves open or changed between versions.

The version octet of a beacon is 0x01 in every version, so it cannot tell the layout; a profile states it. A
profile is a TOML file: the built-in ones lie in ``dcp_spec/profiles``, anyone can add one, and ``extends = "NAME"``
takes over what is not stated again. :func:`load_profile` validates the file completely; the structs below are
immutable and are what the schemas (:mod:`dcp_spec.schema`) are built from.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Literal

import msgspec

from .constants import SpecVersion

ByteOrder = Literal["big", "little"]
Width = Annotated[int, msgspec.Meta(ge=1, le=8)]
U8 = Annotated[int, msgspec.Meta(ge=0, le=0xFF)]
Positive = Annotated[int, msgspec.Meta(ge=1)]
#: Units of time stamps in a second.
TICKS_PER_SECOND: Mapping[str, int] = MappingProxyType({"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9, "ps": 10**12})
#: Epochs that are calendar dates (1980-01-06 for GPS), in ns since 1970.
_EPOCHS_NS: Mapping[str, int] = MappingProxyType({"unix": 0, "gps": 315_964_800 * 10**9})
#: Octets of a part: nothing in a beacon is larger than a datagram.
Size = Annotated[int, msgspec.Meta(ge=0, le=0xFFFF)]


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the parts of a profile: immutable, and a key that is not known is an error."""


class IntType(_Part, frozen=True):
    """An integer on the wire: ``width`` octets (1..8), ``byte_order``, two's complement when ``signed``."""

    width: Width
    byte_order: ByteOrder = "big"
    signed: bool = False


class NodeIdType(_Part, frozen=True):
    """``NodeIdentifierT`` (DATA-04): ``width`` octets, or text behind a length (``length``)."""

    width: Annotated[int, msgspec.Meta(ge=0, le=255)] = 6
    representation: Literal["mac", "hex", "text"] = "mac"
    length: IntType | None = None


class TimestampType(_Part, frozen=True):
    """``TimeStampT`` (DATA-05): an integer counting ``unit`` since ``epoch``.

    ``simulation`` and ``boot`` epochs have no known relation to the time of a recording.
    """

    width: Width = 8
    byte_order: ByteOrder = "big"
    signed: bool = False
    unit: Literal["s", "ms", "us", "ns", "ps"] = "ns"
    epoch: Literal["unix", "gps", "simulation", "boot"] = "unix"

    @property
    def per_second(self) -> int:
        """How many units make a second."""
        return TICKS_PER_SECOND[self.unit]

    @property
    def epoch_ns(self) -> int | None:
        """When stamps begin, in ns since 1970; None for an epoch that is no calendar date. No leap seconds."""
        return _EPOCHS_NS.get(self.epoch)

    def nanoseconds(self, ticks: int) -> int:
        """So many units in ns, rounded down: since the epoch for a stamp, a duration for the difference of two."""
        return ticks * 10**9 // self.per_second

    def as_int(self) -> IntType:
        """The integer that carries the time stamp."""
        return IntType(width=self.width, byte_order=self.byte_order, signed=self.signed)


class TextType(_Part, frozen=True):
    """Octets of varying number: ``lengths`` (none, one, or several that must agree) and/or a final NUL."""

    lengths: tuple[IntType, ...] = (IntType(width=1),)
    terminated: bool = False


class Link(_Part, frozen=True):
    """How beacons are told from other traffic: an EtherType, or a UDP port (UWB-02)."""

    transport: Literal["ethernet", "udp"] = "ethernet"
    ether_type: Annotated[int, msgspec.Meta(ge=0x0600, le=0xFFFF)] | None = None
    udp_port: Annotated[int, msgspec.Meta(ge=1, le=0xFFFF)] | None = None


class Opaque(_Part, frozen=True):
    """Octets inside a record that carry no meaning: kept when decoding, ignored by receivers."""

    opaque: Annotated[int, msgspec.Meta(ge=1, le=0xFFFF)]
    name: str
    note: str = ""


class Extra(_Part, frozen=True):
    """A field that the specification does not have, kept as a number."""

    extra: IntType
    name: str
    note: str = ""


class Types(_Part, frozen=True):
    """Width and byte order of every transmissible type."""

    node_id: NodeIdType = NodeIdType()
    timestamp: TimestampType = TimestampType()
    magic_no: IntType = IntType(width=2)
    protocol_id: IntType = IntType(width=2)
    bp_length: IntType = IntType(width=2)
    network_id: IntType = IntType(width=2)
    bp_seqno: IntType = IntType(width=4)
    srp_seqno: IntType = IntType(width=4)
    var_id: IntType = IntType(width=1)
    var_rep_cnt: IntType = IntType(width=1)
    var_seqno: IntType = IntType(width=1)
    var_timeout: IntType = IntType(width=2)
    string: TextType = TextType()
    value: TextType = TextType()


class BPLayout(_Part, frozen=True):
    """``header`` and ``payload_header`` list the fields in the order on the wire.

    An empty ``header`` means the implementation sends none. ``length_means``: ``"blocks"`` is the specification's
    reading; ``"header-size"`` is a sender that always writes the size of its own header. ``payload_area`` > 0: every
    payload sits in an area of that many octets. ``network_id`` is the value that own beacons carry.
    """

    header: tuple[str, ...]
    payload_header: tuple[str | Opaque, ...] = ("protocolId", "length")
    length_means: Literal["blocks", "header-size"] = "blocks"
    payload_area: Size = 0
    network_id: Annotated[int, msgspec.Meta(ge=0)] | None = None


class SafetyField(_Part, frozen=True):
    """One field of ``SafetyDataT``. ``role`` tells tools which field is a position or velocity component.

    The type ``opaque`` stands for ``octets`` octets without meaning.
    """

    name: str
    type: Literal["f64", "f32", "i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64", "opaque"]
    byte_order: ByteOrder = "big"
    unit: str = ""
    role: Literal["", "position.x", "position.y", "position.z", "velocity.x", "velocity.y", "velocity.z"] = ""
    octets: Size = 0

    @property
    def width(self) -> int:
        """Octets on the wire."""
        return self.octets if self.type == "opaque" else int(self.type[1:]) // 8


class SRPLayout(_Part, frozen=True):
    """The state report: ``record`` lists the fields of ``ExtendedSafetyDataT`` in order, with opaque regions.

    An empty record means that the implementation has no octets for it; its payload is then shown as data.
    ``record_size``, when given, must be what the fields add up to.
    """

    record: tuple[str | Opaque, ...] = ("sData", "nodeId", "tStamp", "seqno")
    safety_data: tuple[SafetyField, ...] = ()
    record_size: Annotated[int, msgspec.Meta(ge=0)] | None = None


class ContainerTypes(
    _Part,
    frozen=True,
    rename={
        "summaries": "SUMMARIES",
        "updates": "UPDATES",
        "request_varupdates": "REQUEST-VARUPDATES",
        "request_varcreates": "REQUEST-VARCREATES",
        "create_variables": "CREATE-VARIABLES",
        "delete_variables": "DELETE-VARIABLES",
    },
):
    """The number of each container type (VD-IC-02)."""

    summaries: U8
    updates: U8
    request_varupdates: U8
    request_varcreates: U8
    create_variables: U8
    delete_variables: U8

    def by_name(self) -> dict[str, int]:
        """The numbers under the specification's names, in the order of the specification."""
        numbers: dict[str, int] = msgspec.to_builtins(self)
        return numbers


class VardisLayout(_Part, frozen=True):
    """Instruction containers and records. ``list_length``: a length of the record list behind the header."""

    var_spec: tuple[str, ...]
    container_types: ContainerTypes
    container_extra: tuple[Extra, ...] = ()
    list_length: IntType | None = None


class Limits(_Part, frozen=True):
    """Limits of the implementation, in octets unless the name says otherwise; they bound what it sends and takes."""

    uwb_max_packet: Positive = 1500
    max_beacon_size: Positive = 1500
    max_srp_payload: Positive | None = None
    max_vardis_payload: Positive = 1000
    max_value_length: Positive = 32
    max_description_length: Positive = 32
    max_repetitions: Positive = 15
    max_summaries: Annotated[int, msgspec.Meta(ge=0)] = 20
    max_variables: Positive | None = None
    max_neighbours: Positive | None = None


class Behaviour(_Part, frozen=True):
    """Choices that are not visible in one beacon but that a peer or a test has to know (sections A.6 and C.1)."""

    first_beacon_seqno: Annotated[int, msgspec.Meta(ge=0, le=1)] = 0
    containers_per_type: Literal["one", "several"] = "several"
    vardis_receive_error: Literal["skip-element", "keep-prefix", "drop-payload"] = "keep-prefix"
    transmit_payload_confirm: bool = True
    payload_transmitted_indication: bool = True
    seqno_half_range: Literal["neither", "newer", "older"] = "neither"


class Profile(_Part, frozen=True, kw_only=True):
    """One way to put DCP on the wire. See the module docstring; build one with :func:`load_profile`."""

    name: str
    title: str
    spec_version: SpecVersion
    notes: str = ""
    link: Link = Link()
    types: Types = Types()
    bp: BPLayout
    srp: SRPLayout = SRPLayout()
    vardis: VardisLayout
    limits: Limits = Limits()
    behaviour: Behaviour = Behaviour()

    def has_header_field(self, name: str) -> bool:
        """Whether the BP header of this profile has the field ``name`` (for example ``"networkId"``)."""
        return name in self.bp.header
