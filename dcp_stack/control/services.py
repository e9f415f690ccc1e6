"""The methods of the control interface, carried out on a node."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple, TypeVar

import msgspec
from dcp_spec.parameters import UnknownParameterError
from dcp_spec.status import BPStatus, SRPStatus, VardisStatus
from dcp_spec.version import __version__
from msgspec import UNSET, UnsetType

from dcp_codec.values import Extra, VarSpec
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.services import UnknownServiceError
from dcp_stack.config import MS
from dcp_stack.node import Node
from dcp_stack.own_fields import NO_VALUES
from dcp_stack.positions.geometry import Motion
from dcp_stack.srp.entity import NotInitializedError, StateReporting
from dcp_stack.srp.neighbour_table import NeighbourTable, NeighbourTableEntry
from dcp_stack.vardis.confirms import NoResponseError
from dcp_stack.vardis.entity import Vardis

from . import messages as m
from .jsonrpc import ErrorCode, RpcError
from .methods import METHODS

T = TypeVar("T")


class Times(NamedTuple):
    """The time of a request in ns: ``now`` monotonic, ``wall`` since 1970."""

    now: int
    wall: int


def parameters_of(method: str, given: Any) -> m.Params:
    """Return the parameters ``given`` in a request, checked. Raises RpcError for unknown methods and wrong values."""
    known = METHODS.get(method)
    if known is None:
        raise RpcError(ErrorCode.METHOD_NOT_FOUND, f"no method {method[:80]!r}; UT-Hello lists the methods")
    if isinstance(given, list):
        raise RpcError(ErrorCode.INVALID_PARAMS, "parameters must be given by name, in an object")
    try:
        return msgspec.convert(given, known.params)
    except msgspec.ValidationError as error:
        raise RpcError(ErrorCode.INVALID_PARAMS, f"{method}: {error}") from None


def perform(node: Node, method: str, params: Any, times: Times) -> m.Result:
    """Carry out ``method``; ``params`` must have its type. Raises only RpcError, also for values that are refused."""
    try:
        answer = _HANDLERS[method](node, params, times)
        return answer if isinstance(answer, m.Result) else METHODS[method].result(status=answer)
    except NoResponseError as error:
        raise RpcError(ErrorCode.NO_ANSWER, str(error)) from None
    except UnknownServiceError as error:
        raise RpcError(ErrorCode.METHOD_NOT_FOUND, str(error)) from None
    except (UnknownParameterError, ValueError) as error:
        # ValueError: values that the types of a message cannot exclude. The protocols raise before they change
        # anything. A TypeError would be an internal error: the types of parameters were checked with the message.
        raise RpcError(ErrorCode.INVALID_PARAMS, str(error)) from None


def supported(node: Node) -> tuple[str, ...]:
    """Return the methods of the node: its version has the service, and it runs the protocol."""
    features = node.config.features
    missing: set[str] = set()
    if not features.clear_buffer:
        missing.add("BP-ClearBuffer")
    if not features.bp_activation:
        missing |= {"BP-MGMT-Activate", "BP-MGMT-Deactivate"}
    # Activation of VarDis is internal in 1.1 and does not exist in 1.0.
    if features.vardis_activation != "service":
        missing |= {"VD-MGMT-Activate", "VD-MGMT-Deactivate"}
    entities = (("SRP-", node.srp), ("RTDB-", node.vardis), ("VD-", node.vardis))
    absent = tuple(prefix for prefix, entity in entities if entity is None)
    return tuple(name for name in METHODS if name not in missing and not name.startswith(absent))


def octets_of(text: str) -> bytes:
    """Return the octets of hex digits with or without colons."""
    return bytes.fromhex(text.replace(":", ""))


def plain_number(value: Any) -> Any:
    """Convert a value for JSON: octets to hex, non-finite floats to text."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def _member(value: T | None) -> T | UnsetType:
    """Return the value of a member of a result, UNSET for None: a member without a value is omitted."""
    return UNSET if value is None else value


# -- BP ---------------------------------------------------------------------------------------------------------------


def _register(node: Node, params: m.RegisterProtocol, times: Times) -> m.Result:
    confirm = node.bp.register(
        params.prot_id,
        params.name,
        params.max_payload_size,
        params.queueing_mode,
        params.max_entries,
        params.allow_multiple_payloads,
        now=times.now,
        wall=times.wall,
    )
    own = confirm.own_node_identifier
    return m.RegisterProtocolConfirm(status=confirm.status, own_node_identifier=UNSET if own is None else own.hex(":"))


def _list_registered(node: Node, _params: m.Nothing, _times: Times) -> m.Result:
    confirm = node.bp.list_registered()
    protocols = tuple(
        m.RegisteredProtocol(
            **{**msgspec.structs.asdict(each), "queue_mode": str(each.queue_mode)},
            buffered=node.bp.query_number_buffered(each.protocol_id).number or 0,
        )
        for each in confirm.protocols
    )
    return m.ListRegisteredProtocolsConfirm(status=confirm.status, protocols=protocols)


def _query(node: Node, params: m.ForProtocol, _times: Times) -> m.Result:
    confirm = node.bp.query_number_buffered(params.prot_id)
    return m.QueryNumberBufferedPayloadsConfirm(status=confirm.status, number=_member(confirm.number))


def _transmit(node: Node, params: m.TransmitPayload, times: Times) -> BPStatus:
    return node.bp.transmit_payload(params.prot_id, octets_of(params.payload), now=times.now).status


def _bp_parameters(node: Node, _params: m.Nothing, _times: Times) -> m.Result:
    shown = {name: v.hex(":") if isinstance(v, bytes) else v for name, v in node.bp.parameters().items()}
    return m.BPParametersConfirm(status=BPStatus.OK, parameters=shown)


def _set_parameter(entity: BeaconingProtocol | StateReporting | Vardis, params: m.SetParameter, ok: T) -> T:
    """Set a parameter; return the status ``ok``.

    Raises RpcError for a refused value: the specification defines no status for it (BP-PAR-07).
    """
    violation = entity.set_parameter(params.name, params.value)
    if violation is not None:
        raise RpcError(ErrorCode.REFUSED, str(violation), msgspec.structs.asdict(violation))
    return ok


# -- SRP --------------------------------------------------------------------------------------------------------------


def _srp(node: Node) -> StateReporting:
    """Return the SRP of the node. Raises RpcError if it runs without."""
    if node.srp is None:
        raise RpcError(ErrorCode.METHOD_NOT_FOUND, "this node runs without SRP")
    return node.srp


def _update_safety_data(node: Node, params: m.UpdateSafetyData, times: Times) -> SRPStatus:
    srp = _srp(node)
    values = {name: _field_value(node, name, value) for name, value in params.s_data.items()}
    confirm = srp.update_safety_data(values, now=times.now, wall=times.wall)
    if confirm is None:
        raise RpcError(ErrorCode.NO_ANSWER, "SRP does not answer before it is initialized (reading X10)")
    return confirm.status


def _field_value(node: Node, name: str, value: m.Number) -> Any:
    """Convert a value for SRP: text stands for octets of opaque fields, or for non-finite floats."""
    if not isinstance(value, str):
        return value
    kinds = {field.name: field.type for field in node.config.profile.srp.safety_data}
    if kinds.get(name) == "opaque":
        return bytes.fromhex(value)
    if value in ("NaN", "Infinity", "-Infinity"):
        return float(value)
    raise RpcError(ErrorCode.INVALID_PARAMS, f"{name} takes a number, not {value[:40]!r}")


def _neighbour_table(node: Node, params: m.NeighbourTableRequest, times: Times) -> m.Result:
    try:
        table = _srp(node).neighbours
    except NotInitializedError:
        return m.NeighbourTableConfirm(status=SRPStatus.INACTIVE)
    if params.node_id is not UNSET:
        entry = table.lookup(octets_of(params.node_id))
        entries = [] if entry is None else [entry]
    else:
        entries = sorted(table, key=lambda each: each.node_id)
    loss = {each.node_id: each.loss for each in node.bp.losses()}
    own = _srp(node).own_motion()
    shown = tuple(_neighbour(table, entry, own, loss.get(entry.node_id), times) for entry in entries)
    return m.NeighbourTableConfirm(status=SRPStatus.OK, neighbours=shown)


def _neighbour(
    table: NeighbourTable, entry: NeighbourTableEntry, own: Motion | None, loss: float | None, times: Times
) -> m.Neighbour:
    motion = table.motion(entry)
    apart = None if own is None or motion is None else math.dist(own.position, motion.position)
    return m.Neighbour(
        node_id=entry.node_id.hex(":"),
        s_data={name: plain_number(value) for name, value in entry.ext_sd.s_data.as_dict().items()},
        t_stamp=entry.ext_sd.t_stamp,
        seqno=entry.ext_sd.seqno,
        reception_time=entry.reception_time,
        age=entry.age(times.now) / MS,
        sender_id=entry.sender_id.hex(":"),
        received=entry.received,
        repeated=entry.repeated,
        lost=entry.lost,
        restarts=entry.restarts,
        mean_interval=UNSET if entry.mean_interval is None else entry.mean_interval / MS,
        beacon_loss=_member(loss),
        position=UNSET if motion is None else motion.position,
        velocity=UNSET if motion is None else _member(motion.velocity),
        # The distance of two positions near the limits of a float can exceed these limits.
        distance=_member(apart if apart is not None and math.isfinite(apart) else None),
    )


# -- VarDis -----------------------------------------------------------------------------------------------------------


def _vardis(node: Node) -> Vardis:
    """Return the VarDis of the node. Raises RpcError if it runs without."""
    if node.vardis is None:
        raise RpcError(ErrorCode.METHOD_NOT_FOUND, "this node runs without VarDis")
    return node.vardis


def _create(node: Node, params: m.Create, times: Times) -> VardisStatus:
    producer = None if params.prod_id is UNSET else octets_of(params.prod_id)
    confirm = _vardis(node).create(
        params.var_id,
        producer,
        params.rep_cnt,
        params.descr.encode(),
        octets_of(params.value),
        params.timeout,
        own_fields=_own_fields(node, params),
        now=times.now,
        wall=times.wall,
    )
    return confirm.status


def _update(node: Node, params: m.Update, times: Times) -> VardisStatus:
    vardis, value, fields = _vardis(node), octets_of(params.value), _own_fields(node, params)
    if fields:
        return vardis.update_with_fields(params.var_id, value, fields, now=times.now, wall=times.wall).status
    return vardis.update(params.var_id, value, now=times.now, wall=times.wall).status


def _own_fields(node: Node, params: m.Create | m.Update) -> dict[str, Any]:
    """Return the given values of fields that the profile adds. Raises ValueError for invalid octets."""
    return {} if params.own_fields is UNSET else node.config.own_fields.parsed(params.own_fields)


def _delete(node: Node, params: m.ForVariable, times: Times) -> VardisStatus:
    return _vardis(node).delete(params.var_id, now=times.now, wall=times.wall).status


def _read(node: Node, params: m.ForVariable, _times: Times) -> m.Result:
    confirm = _vardis(node).read(params.var_id)
    value = None if confirm.value is None else confirm.value.hex()
    return m.ReadConfirm(status=confirm.status, value=_member(value), t_stamp=_member(confirm.t_stamp))


def _describe_database(node: Node, _params: m.Nothing, _times: Times) -> m.Result:
    confirm = _vardis(node).describe_database()
    listed = tuple(
        m.Variable(**_spec(node, each.spec), is_deleted=each.is_deleted, t_stamp=each.t_stamp)
        for each in confirm.variables
    )
    return m.DescribeDatabaseConfirm(status=confirm.status, variables=listed)


def _describe_variable(node: Node, params: m.ForVariable, _times: Times) -> m.Result:
    confirm = _vardis(node).describe_variable(params.var_id)
    entry = confirm.entry
    if entry is None:
        return m.DescribeVariableConfirm(status=confirm.status)
    variable = m.Variable(
        **_spec(node, entry.spec, entry.own),
        is_deleted=entry.is_deleted,
        t_stamp=entry.t_stamp,
        value=entry.value.hex(),
        seqno=entry.seqno,
        count_update=entry.count_update,
        count_create=entry.count_create,
        count_delete=entry.count_delete,
    )
    return m.DescribeVariableConfirm(status=confirm.status, variable=variable)


def _spec(node: Node, spec: VarSpec, own: Mapping[str, Extra] = NO_VALUES) -> dict[str, Any]:
    """Return the members of a Variable that come from its VarSpec, and ``own``, the values of added fields."""
    shown: dict[str, Any] = {"var_id": spec.var_id, "prod_id": spec.prod_id.hex(":"), "rep_cnt": spec.rep_cnt}
    try:
        shown["descr"] = spec.descr.decode()
    except UnicodeDecodeError:
        shown["descr_hex"] = spec.descr.hex()
    if spec.creation_time is not None:
        shown["creation_time"] = spec.creation_time
    if spec.timeout is not None:
        shown["timeout"] = spec.timeout
    if fields := node.config.own_fields.shown(spec, own):
        shown["own_fields"] = fields
    return shown


def _management(node: Node) -> Vardis:
    """Return the VarDis of the node. Raises RpcError if its version has no activation service."""
    vardis = _vardis(node)
    if node.config.features.vardis_activation != "service":
        version = node.config.profile.spec_version
        message = f"VD-MGMT-Activate and -Deactivate exist since 1.2; the profile follows {version}"
        raise RpcError(ErrorCode.METHOD_NOT_FOUND, message)
    return vardis


# -- the upper tester -------------------------------------------------------------------------------------------------


def _hello(node: Node, _params: m.Nothing, _times: Times) -> m.Result:
    profile = node.config.profile
    return m.HelloConfirm(
        status=m.UT_OK,
        name="dcp-node",
        version=__version__,
        spec_version=str(profile.spec_version),
        methods=supported(node),
        node_id=node.config.node_id.hex(":"),
        profile=profile.name,
    )


def _reset(node: Node, _params: m.Nothing, times: Times) -> str:
    node.reset(times.now, times.wall)
    return m.UT_OK


#: Method -> a function that returns the result, or only its status.
_HANDLERS: Final[dict[str, Callable[[Node, Any, Times], m.Result | str]]] = {
    "UT-Hello": _hello,
    "UT-Reset": _reset,
    "BP-RegisterProtocol": _register,
    "BP-DeregisterProtocol": lambda node, params, _: node.bp.deregister(params.prot_id).status,
    "BP-ListRegisteredProtocols": _list_registered,
    "BP-TransmitPayload": _transmit,
    "BP-ClearBuffer": lambda node, params, _: node.bp.clear_buffer(params.prot_id).status,
    "BP-QueryNumberBufferedPayloads": _query,
    "BP-MGMT-Activate": lambda node, _, times: node.bp.activate(times.now).status,
    "BP-MGMT-Deactivate": lambda node, _, __: node.bp.deactivate().status,
    "BP-GetParameters": _bp_parameters,
    "BP-SetParameter": lambda node, params, _: _set_parameter(node.bp, params, BPStatus.OK),
    "SRP-UpdateSafetyData": _update_safety_data,
    "SRP-NeighbourTable": _neighbour_table,
    "SRP-GetParameters": lambda node, _, __: m.SRPParametersConfirm(
        status=SRPStatus.OK, parameters=_srp(node).parameters()
    ),
    "SRP-SetParameter": lambda node, params, _: _set_parameter(_srp(node), params, SRPStatus.OK),
    "RTDB-DescribeDatabase": _describe_database,
    "RTDB-DescribeVariable": _describe_variable,
    "RTDB-Create": _create,
    "RTDB-Update": _update,
    "RTDB-Delete": _delete,
    "RTDB-Read": _read,
    "VD-MGMT-Activate": lambda node, _, __: _management(node).activate().status,
    "VD-MGMT-Deactivate": lambda node, _, __: _management(node).deactivate().status,
    "VD-GetParameters": lambda node, _, __: m.VardisParametersConfirm(
        status=VardisStatus.OK, parameters=_vardis(node).parameters()
    ),
    "VD-SetParameter": lambda node, params, _: _set_parameter(_vardis(node), params, VardisStatus.OK),
}
