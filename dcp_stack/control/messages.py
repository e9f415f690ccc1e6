"""The messages of the control interface: parameters and results of every method, and the notifications.

These structs define the interface. Messages are checked against them, and the JSON Schema in
``spec/dcp_spec/data/upper-tester.schema.json`` is generated from them (:mod:`dcp_stack.control.schema`).
Members have the names of the specification. Octets are hex, node identifiers hex with or without colons, times of day
ns since 1970, and durations ms unless the name has another unit.
"""

from __future__ import annotations

from typing import Annotated, Any, Final

import msgspec
from dcp_spec.status import BPStatus, SRPStatus, VardisStatus
from msgspec import UNSET, Meta, UnsetType

UT_OK: Final = "UT-STATUS-OK"

Octets = Annotated[str, Meta(pattern="^([0-9A-Fa-f]{2})*$", description="Octets in hex, two digits each.")]
NodeId = Annotated[
    str,
    Meta(
        pattern="^([0-9A-Fa-f]{2}(:?[0-9A-Fa-f]{2})*)?$", description="A node identifier: hex, with or without colons."
    ),
]
ProtId = Annotated[int, Meta(description="Identifier of a client protocol of BP.")]
VarId = Annotated[int, Meta(description="Identifier of a variable.")]
WallNs = Annotated[int, Meta(description="ns since 1970-01-01T00:00:00Z.")]
Millis = Annotated[int, Meta(description="Milliseconds.")]
OwnFields = Annotated[
    dict[str, int | float | str],
    Meta(description="Fields that the profile adds to records, by name; octets in hex."),
]
UTStatus = Annotated[str, Meta(pattern="^UT-STATUS-OK$")]


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename="camel"):
    """Base of the parameters of a method; an unknown member is an error."""


class Result(msgspec.Struct, frozen=True, kw_only=True, rename="camel"):
    """Base of results; members without a value are omitted."""


class Nothing(Params, frozen=True):
    """No parameters."""


class ForProtocol(Params, frozen=True):
    """A request about one client protocol."""

    prot_id: ProtId


class ForVariable(Params, frozen=True):
    """A request about one variable."""

    var_id: VarId


# -- BP ---------------------------------------------------------------------------------------------------------------


class BPConfirm(Result, frozen=True):
    """A confirm of BP that contains only the status."""

    status: BPStatus


class RegisterProtocol(Params, frozen=True):
    """Parameters of BP-RegisterProtocol."""

    prot_id: ProtId
    name: str
    max_payload_size: int
    queueing_mode: Annotated[str, Meta(description="BP_QMODE_ONCE, BP_QMODE_REPEAT, BP_QMODE_QUEUE_DROPTAIL, ...")]
    max_entries: int = 0
    allow_multiple_payloads: bool = False


class RegisterProtocolConfirm(Result, frozen=True):
    """BP-RegisterProtocol.confirm."""

    status: BPStatus
    own_node_identifier: NodeId | UnsetType = UNSET


class RegisteredProtocol(Result, frozen=True):
    """One entry of BP-ListRegisteredProtocols.confirm; ``buffered`` is the number of waiting payloads."""

    protocol_id: int
    protocol_name: str
    max_payload_size: int
    queue_mode: str
    time_stamp_registration: WallNs
    max_entries: int
    allow_multiple_payloads: bool
    buffered: int | UnsetType = UNSET


class ListRegisteredProtocolsConfirm(Result, frozen=True):
    """BP-ListRegisteredProtocols.confirm."""

    status: BPStatus
    protocols: tuple[RegisteredProtocol, ...]


class TransmitPayload(Params, frozen=True):
    """Parameters of BP-TransmitPayload; the service parameter length is the length of ``payload``."""

    prot_id: ProtId
    payload: Octets


class QueryNumberBufferedPayloadsConfirm(Result, frozen=True):
    """BP-QueryNumberBufferedPayloads.confirm; contains the number if the status is OK."""

    status: BPStatus
    number: int | UnsetType = UNSET


class SetParameter(Params, frozen=True):
    """Parameters of BP-, SRP- and VD-SetParameter."""

    name: Annotated[str, Meta(description="As in the specification, for example BPPAR_BEACON_PERIOD.")]
    value: int | float


class BPParametersConfirm(Result, frozen=True):
    """BP-GetParameters: values by name; identifiers of nodes as hex."""

    status: BPStatus
    parameters: dict[str, int | float | str]


# -- SRP --------------------------------------------------------------------------------------------------------------


class SRPConfirm(Result, frozen=True):
    """A confirm of SRP that contains only the status."""

    status: SRPStatus


class SRPParametersConfirm(Result, frozen=True):
    """SRP-GetParameters: values by name."""

    status: SRPStatus
    parameters: dict[str, int | float]


Number = int | float | str
"""A number, or one of the texts NaN, Infinity and -Infinity, which JSON has no numbers for."""


class UpdateSafetyData(Params, frozen=True):
    """Parameters of SRP-UpdateSafetyData: all fields of the profile's SafetyDataT, in its units; opaque ones as hex."""

    s_data: dict[str, Number]


class NeighbourTableRequest(Params, frozen=True):
    """Parameters of SRP-NeighbourTable; with ``nodeId`` only the entry of this node is returned."""

    node_id: NodeId | UnsetType = UNSET


class Neighbour(Result, frozen=True):
    """An entry of the neighbour table. An implementation may omit the members after ``receptionTime``."""

    node_id: NodeId
    s_data: dict[str, Number]
    t_stamp: Annotated[int, Meta(description="As in the record, in the units of the profile.")]
    seqno: int
    reception_time: WallNs
    age: Annotated[float, Meta(description="ms since the last record was received.")] | UnsetType = UNSET
    sender_id: NodeId | UnsetType = UNSET
    received: int | UnsetType = UNSET
    repeated: int | UnsetType = UNSET
    lost: Annotated[int, Meta(description="Records missing by their sequence numbers.")] | UnsetType = UNSET
    restarts: int | UnsetType = UNSET
    mean_interval: Annotated[float, Meta(description="ms between records.")] | UnsetType = UNSET
    beacon_loss: Annotated[float, Meta(description="Share of beacons lost recently, 0..1.")] | UnsetType = UNSET
    position: tuple[float, float, float] | UnsetType = UNSET
    velocity: tuple[float, float, float] | UnsetType = UNSET
    distance: Annotated[float, Meta(description="m between us and the neighbour.")] | UnsetType = UNSET


class NeighbourTableConfirm(Result, frozen=True):
    """SRP-NeighbourTable.confirm; without entries if the status is INACTIVE."""

    status: SRPStatus
    neighbours: tuple[Neighbour, ...] = ()


# -- VarDis -----------------------------------------------------------------------------------------------------------


class VardisConfirm(Result, frozen=True):
    """A confirm of VarDis that contains only the status."""

    status: VardisStatus


class VardisParametersConfirm(Result, frozen=True):
    """VD-GetParameters: values by name."""

    status: VardisStatus
    parameters: dict[str, int]


class Create(Params, frozen=True):
    """Parameters of RTDB-Create. ``prodId`` is used up to version 1.1, ``timeout`` since 2.0."""

    var_id: VarId
    rep_cnt: int
    descr: Annotated[str, Meta(description="Sent as UTF-8.")]
    value: Octets
    timeout: Millis = 0
    prod_id: NodeId | UnsetType = UNSET
    own_fields: OwnFields | UnsetType = UNSET


class Update(Params, frozen=True):
    """Parameters of RTDB-Update."""

    var_id: VarId
    value: Octets
    own_fields: OwnFields | UnsetType = UNSET


class ReadConfirm(Result, frozen=True):
    """RTDB-Read.confirm; contains value and time if the status is OK."""

    status: VardisStatus
    value: Octets | UnsetType = UNSET
    t_stamp: WallNs | UnsetType = UNSET


class Variable(Result, frozen=True):
    """A variable: its VarSpec, and further members depending on the service and the implementation.

    ``descrHex`` replaces a description that is not UTF-8. ``creationTime`` is in the units of the profile; it and
    ``timeout`` exist since 2.0. RTDB-DescribeVariable returns all other members.
    """

    var_id: VarId
    prod_id: NodeId
    rep_cnt: int
    descr: str | UnsetType = UNSET
    descr_hex: Octets | UnsetType = UNSET
    creation_time: int | UnsetType = UNSET
    timeout: Millis | UnsetType = UNSET
    own_fields: OwnFields | UnsetType = UNSET
    is_deleted: bool | UnsetType = UNSET
    t_stamp: WallNs | UnsetType = UNSET
    value: Octets | UnsetType = UNSET
    seqno: int | UnsetType = UNSET
    count_update: int | UnsetType = UNSET
    count_create: int | UnsetType = UNSET
    count_delete: int | UnsetType = UNSET


class DescribeDatabaseConfirm(Result, frozen=True):
    """RTDB-DescribeDatabase.confirm: all variables, including deleted ones; empty unless the status is OK."""

    status: VardisStatus
    variables: tuple[Variable, ...] = ()


class DescribeVariableConfirm(Result, frozen=True):
    """RTDB-DescribeVariable.confirm; contains the variable if the status is OK."""

    status: VardisStatus
    variable: Variable | UnsetType = UNSET


# -- the upper tester -------------------------------------------------------------------------------------------------


class HelloConfirm(Result, frozen=True):
    """UT-Hello: the identity of the implementation; ``methods`` are the methods that it has."""

    status: UTStatus
    name: str
    version: str
    spec_version: str
    methods: tuple[str, ...]
    node_id: NodeId | UnsetType = UNSET
    profile: Annotated[str, Meta(description="Name of the wire profile.")] | UnsetType = UNSET


class UTConfirm(Result, frozen=True):
    """A confirm of the upper tester that contains only the status."""

    status: UTStatus


class Subscribe(Params, frozen=True):
    """Parameters of UT-Subscribe: the events that this connection is notified of from now on.

    Indications of protocols that it registered are sent without a subscription.
    """

    variables: Annotated[bool, Meta(description="UT-VariableChanged")] = False
    neighbours: Annotated[bool, Meta(description="UT-NeighbourSeen and UT-NeighbourExpired")] = False
    prot_ids: Annotated[tuple[int, ...], Meta(description="Indications of these protocols, from any client.")] = ()


class StatusConfirm(Result, frozen=True):
    """UT-Status: the state of the node in the form of this implementation, for display."""

    status: UTStatus
    node_id: NodeId
    profile: str
    spec_version: str
    now: Annotated[int, Meta(description="Monotonic ns, the clock of the times in ``node``.")]
    wall: WallNs
    node: Annotated[dict[str, Any], Meta(description="Snapshots of bp, srp and vardis.")]
    drops: Annotated[dict[str, int], Meta(description="Numbers of ignored parts of frames, by layer/reason.")]
    runtime: Annotated[dict[str, Any], Meta(description="State of link, clients, recording and positions.")]
    obstacles: Annotated[
        list[dict[str, Any]], Meta(description="Variables that do not reach a neighbour; usually none.")
    ] = []


# -- notifications ----------------------------------------------------------------------------------------------------


class ReceivePayloadIndication(Result, frozen=True):
    """BP-ReceivePayload.indication; ``senderId`` is the node that sent the beacon."""

    prot_id: ProtId
    length: int
    payload: Octets
    sender_id: NodeId | UnsetType = UNSET


class PayloadTransmittedIndication(Result, frozen=True):
    """BP-PayloadTransmitted.indication."""

    prot_id: ProtId
    next_beacon_generation_epoch: WallNs


class VariableChangedNotification(Result, frozen=True):
    """A variable was created, updated or deleted, by this node or another. A deletion has no value."""

    event: Annotated[str, Meta(pattern="^(created|updated|deleted)$")]
    var_id: VarId
    prod_id: NodeId
    seqno: int
    value: Octets | UnsetType = UNSET


class NeighbourSeenNotification(Result, frozen=True):
    """A state report was accepted; ``new`` if the table had no entry of this node."""

    node_id: NodeId
    new: bool


class NeighbourExpiredNotification(Result, frozen=True):
    """The entry of a node was removed from the neighbour table because of its age."""

    node_id: NodeId
