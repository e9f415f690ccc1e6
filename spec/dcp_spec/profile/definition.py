"""Wire profiles: everything about the octets that the specification leaves open or changed between versions.

The version octet of a beacon is 0x01 in every version, so it cannot tell the layout; a profile states it. A
profile is a TOML file: the built-in ones lie in ``dcp_spec/profiles``, users can write their own, and
``extends = "NAME"`` takes over what is not stated again. :func:`load_profile` validates the file completely; the
structs below are immutable and are what the schemas (:mod:`dcp_spec.wire.schema`) are built from.

The description of each key is part of its type: :mod:`dcp_spec.profile.reference` writes the reference of the file
format (``docs/profile-reference.md``) from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from dcp_spec.constants import SpecVersion

from .types import BYTE_ORDER, U8, NotNegative, Part, Positive, Size
from .types import TICKS_PER_SECOND as TICKS_PER_SECOND
from .types import ByteOrder as ByteOrder
from .types import IntType as IntType
from .types import Members as Members
from .types import NodeIdType as NodeIdType
from .types import OwnField as OwnField
from .types import RealType as RealType
from .types import TextType as TextType
from .types import TimestampType as TimestampType
from .types import Types as Types
from .types import own_fields as own_fields
from .types import standard_fields as standard_fields


class Link(Part, frozen=True):
    """How beacons are told from other traffic: by an EtherType or by a UDP port (UWB-02)."""

    transport: Annotated[Literal["ethernet", "udp"], Meta(description="Link layer of the beacons.")] = "ethernet"
    ether_type: Annotated[
        Annotated[int, Meta(ge=0x0600, le=0xFFFF)] | None, Meta(description="EtherType; required for `ethernet`.")
    ] = None
    udp_port: Annotated[
        Annotated[int, Meta(ge=1, le=0xFFFF)] | None, Meta(description="Destination port; required for `udp`.")
    ] = None


class BPLayout(Part, frozen=True):
    """The beacon: its header and the blocks after it."""

    header: Annotated[
        Members,
        Meta(
            description="Fields of the beacon header in order: `version`, `magicNo`, `senderId`, `networkId`, "
            "`length`, `numPayloads`, `seqno`, and fields of your own. Empty: the implementation sends no header."
        ),
    ]
    payload_header: Annotated[
        Members,
        Meta(description="Fields before each payload in order: `protocolId`, `length`, and fields of your own."),
    ] = ("protocolId", "length")
    length_means: Annotated[
        Literal["blocks", "header-size"],
        Meta(
            description="The octets that `length` of the header counts: all payload blocks, as specified, or "
            "(nonconforming) always the size of the header."
        ),
    ] = "blocks"
    payload_area: Annotated[
        Size, Meta(description="Octets of a fixed area in which each payload lies; 0 for none.")
    ] = 0
    network_id: Annotated[NotNegative | None, Meta(description="The network identifier that own beacons carry.")] = None


class SafetyField(Part, frozen=True):
    """One field of ``SafetyDataT``."""

    name: Annotated[str, Meta(description="Name in all tools.")]
    type: Annotated[
        Literal["f64", "f32", "i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64", "opaque"],
        Meta(description="Floating-point number, signed or unsigned integer of so many bits, or `opaque` octets."),
    ]
    byte_order: Annotated[ByteOrder, BYTE_ORDER] = "big"
    unit: Annotated[str, Meta(description="Unit of the value.")] = ""
    role: Annotated[
        Literal["", "position.x", "position.y", "position.z", "velocity.x", "velocity.y", "velocity.z"],
        Meta(description="Tells tools which field is a component of the position or velocity."),
    ] = ""
    octets: Annotated[Size, Meta(description="Number of octets; for the type `opaque` only.")] = 0

    @property
    def width(self) -> int:
        """Octets on the wire."""
        return self.octets if self.type == "opaque" else int(self.type[1:]) // 8


class SRPLayout(Part, frozen=True):
    """The payload of SRP: a state report, or what the implementation sends in its place."""

    record: Annotated[
        Members,
        Meta(
            description="Fields of `ExtendedSafetyDataT` in order: `sData`, `nodeId`, `tStamp`, `seqno`, and fields of "
            'your own. Only fields of your own, for example `[{ name = "pattern", opaque = 40 }]`: payloads have this '
            "layout and are not state reports. Empty: payloads are octets of any number, shown as `data`."
        ),
    ] = ("sData", "nodeId", "tStamp", "seqno")
    safety_data: Annotated[
        tuple[SafetyField, ...], Meta(description="Fields of `SafetyDataT` in order; required if `record` has `sData`.")
    ] = ()
    record_size: Annotated[
        NotNegative | None, Meta(description="If given, what the fields must add up to, in octets.")
    ] = None

    @property
    def is_report(self) -> bool:
        """Whether payloads are state reports: without, the node and the suite run without SRP."""
        return any(isinstance(member, str) for member in self.record)


class ContainerTypes(Part, frozen=True, rename=lambda name: name.upper().replace("_", "-")):
    """The number of each container type of the specification (VD-IC-02)."""

    summaries: Annotated[U8, Meta(description="Records `VarSumm`.")]
    updates: Annotated[U8, Meta(description="Records `VarUpdate`.")]
    request_varupdates: Annotated[U8, Meta(description="Records `VarReqUpdate`.")]
    request_varcreates: Annotated[U8, Meta(description="Records `VarReqCreate`.")]
    create_variables: Annotated[U8, Meta(description="Records `VarCreate`.")]
    delete_variables: Annotated[U8, Meta(description="Records `VarDelete`.")]

    def by_name(self) -> dict[str, int]:
        """The numbers under the specification's names, in the order of the specification."""
        numbers: dict[str, int] = msgspec.to_builtins(self)
        return numbers


#: The standard members of each record of the specification, in its order.
RECORD_MEMBERS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "VarSumm": ("varId", "seqno"),
        "VarUpdate": ("varId", "seqno", "value"),
        "VarReqUpdate": ("varId", "seqno"),
        "VarReqCreate": ("varId",),
        "VarCreate": ("spec", "upd"),
        "VarDelete": ("varId",),
    }
)


class RecordLayouts(Part, frozen=True, rename="pascal"):
    """The members of the instruction records in order, with fields of your own (VD-TYP-07)."""

    var_summ: Annotated[Members, Meta(description="`varId`, `seqno`, and fields of your own.")] = RECORD_MEMBERS[
        "VarSumm"
    ]
    var_update: Annotated[Members, Meta(description="`varId`, `seqno`, `value`, and fields of your own.")] = (
        RECORD_MEMBERS["VarUpdate"]
    )
    var_req_update: Annotated[Members, Meta(description="`varId`, `seqno`, and fields of your own.")] = RECORD_MEMBERS[
        "VarReqUpdate"
    ]
    var_req_create: Annotated[Members, Meta(description="`varId`, and fields of your own.")] = RECORD_MEMBERS[
        "VarReqCreate"
    ]
    var_create: Annotated[Members, Meta(description="`spec`, `upd`, and fields of your own.")] = RECORD_MEMBERS[
        "VarCreate"
    ]
    var_delete: Annotated[Members, Meta(description="`varId`, and fields of your own.")] = RECORD_MEMBERS["VarDelete"]

    def by_name(self) -> dict[str, Members]:
        """The members of each record by its name in the specification."""
        return {name: getattr(self, field) for name, field in zip(RECORD_MEMBERS, self.__struct_fields__, strict=True)}


class OwnContainer(Part, frozen=True):
    """An instruction container that the specification does not have."""

    name: Annotated[str, Meta(description="Name in all tools (`icName`): letters, digits, `-`, `_`.")]
    number: Annotated[U8, Meta(description="`icType` of the container.")]
    record: Annotated[
        Members,
        Meta(
            description="Fields of each record in order: fields of your own, and of the standard ones `varId`, "
            "`prodId`, `seqno`, `value`, `repCnt`, `creationTime`, `timeout`, `descr`."
        ),
    ]

    @property
    def type_name(self) -> str:
        """The name of the record type: ``GEO-FENCE`` has records ``GeoFence``."""
        words = self.name.replace("_", "-").split("-")
        return "".join(word[:1].upper() + (word[1:].lower() if word.isupper() else word[1:]) for word in words)


class VardisLayout(Part, frozen=True):
    """Instruction containers and their records."""

    var_spec: Annotated[
        Members,
        Meta(
            description="Fields of `VarSpecT` in order: `varId`, `prodId`, `repCnt`, `creationTime`, `timeout`, "
            "`descr`, and fields of your own."
        ),
    ]
    container_types: Annotated[ContainerTypes, Meta(description="Numbers of the container types.")]
    container_extra: Annotated[
        tuple[OwnField, ...], Meta(description="Fields of your own after `icType` and `icNumRecords`.")
    ] = ()
    list_length: Annotated[
        IntType | None, Meta(description="A length of the record list, in octets, after the header of a container.")
    ] = None
    records: Annotated[RecordLayouts, Meta(description="Members of the instruction records.")] = RecordLayouts()
    own_containers: Annotated[tuple[OwnContainer, ...], Meta(description="Container types of your own.")] = ()

    def container_names(self) -> dict[int, str]:
        """Return the names of all container types by their numbers."""
        specified = {number: name for name, number in self.container_types.by_name().items()}
        return specified | {each.number: each.name for each in self.own_containers}


class Limits(Part, frozen=True):
    """Limits of the implementation; they bound what it sends and takes."""

    uwb_max_packet: Annotated[Positive, Meta(description="Largest bearer payload, in octets.")] = 1500
    max_beacon_size: Annotated[Positive, Meta(description="Largest beacon, in octets.")] = 1500
    max_srp_payload: Annotated[Positive | None, Meta(description="Largest SRP payload, in octets.")] = None
    max_vardis_payload: Annotated[Positive, Meta(description="Largest VarDis payload, in octets.")] = 1000
    max_value_length: Annotated[Positive, Meta(description="Longest value, in octets.")] = 32
    max_description_length: Annotated[Positive, Meta(description="Longest description, in octets.")] = 32
    max_repetitions: Annotated[Positive, Meta(description="Highest `repCnt`.")] = 15
    max_summaries: Annotated[NotNegative, Meta(description="Most summaries in a beacon.")] = 20
    max_variables: Annotated[Positive | None, Meta(description="Most variables in the database.")] = None
    max_neighbours: Annotated[Positive | None, Meta(description="Most entries of the neighbour table.")] = None


class Behaviour(Part, frozen=True):
    """Choices that no single beacon shows but that a peer or a test has to know."""

    first_beacon_seqno: Annotated[
        Annotated[int, Meta(ge=0, le=1)], Meta(description="Sequence number of the first beacon.")
    ] = 0
    containers_per_type: Annotated[
        Literal["one", "several"], Meta(description="Number of containers of one type that a payload may have.")
    ] = "several"
    vardis_receive_error: Annotated[
        Literal["skip-element", "keep-prefix", "drop-payload"],
        Meta(description="The reaction of a receiver to a malformed VarDis payload."),
    ] = "keep-prefix"
    transmit_payload_confirm: Annotated[bool, Meta(description="`BP-TransmitPayload` is confirmed.")] = True
    payload_transmitted_indication: Annotated[bool, Meta(description="Clients learn that their payload was sent.")] = (
        True
    )
    seqno_half_range: Annotated[
        Literal["neither", "newer", "older"],
        Meta(description="The order of a number that is exactly half of the range away."),
    ] = "neither"


class Among(Part, frozen=True):
    """Initial settings of `dcp-node run` among these implementations, where their limits are not the best choice.

    Settings of the node replace it. Nodes inside the test suite and in simulations start with the limits.
    """

    max_vardis_payload: Annotated[
        Positive | None, Meta(description="VARDISPAR_MAX_PAYLOAD_SIZE, in octets; the limit without it.")
    ] = None
    max_summaries: Annotated[NotNegative | None, Meta(description="VARDISPAR_MAX_SUMMARIES; the limit without it.")] = (
        None
    )
    repetitions: Annotated[
        Positive | None, Meta(description="`repCnt` of variables that a user creates without saying it; 3 without it.")
    ] = None


class Profile(Part, frozen=True, kw_only=True):
    """One way to put DCP on the wire. See the module docstring; build one with :func:`load_profile`."""

    name: Annotated[str, Meta(description="Short name, for reports and file names.")]
    title: Annotated[str, Meta(description="One line that says whose octets these are.")]
    spec_version: Annotated[SpecVersion, Meta(description="Version of the specification that the layout follows.")]
    notes: Annotated[str, Meta(description="Anything a reader should know.")] = ""
    link: Annotated[Link, Meta(description="How beacons are found.")] = Link()
    types: Annotated[Types, Meta(description="Transmissible types.")] = Types()
    bp: Annotated[BPLayout, Meta(description="Beacon.")]
    srp: Annotated[SRPLayout, Meta(description="State reports.")] = SRPLayout()
    vardis: Annotated[VardisLayout, Meta(description="Instruction containers.")]
    limits: Annotated[Limits, Meta(description="Limits.")] = Limits()
    behaviour: Annotated[Behaviour, Meta(description="Behaviour.")] = Behaviour()
    among: Annotated[Among, Meta(description="Settings of a node among these implementations.")] = Among()

    def own_fields(self) -> dict[str, list[OwnField]]:
        """Return the fields that the profile adds to state reports, VarSpec and records, by the record; none empty."""
        report: Members = self.srp.record if self.srp.is_report else ()
        layouts = {"ExtendedSafetyData": report, "VarSpec": self.vardis.var_spec, **self.vardis.records.by_name()}
        return {name: own for name, members in layouts.items() if (own := own_fields(members))}

    def has_header_field(self, name: str) -> bool:
        """Whether the BP header of this profile has the field ``name`` (for example ``"networkId"``)."""
        return name in self.bp.header
