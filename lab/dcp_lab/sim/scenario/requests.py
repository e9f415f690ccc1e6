"""Events of a scenario as requests to the control interface, common to simulations and testbeds."""

from __future__ import annotations

from typing import Any

import msgspec

from dcp_stack.control.client import ServiceError
from dcp_stack.control.jsonrpc import RpcError
from dcp_stack.control.services import Times, parameters_of, perform
from dcp_stack.node import Node

from .definition import Activate, Create, Deactivate, Delete, Submission, Update

ServiceEvent = Create | Update | Delete | Activate | Deactivate | Submission
"""Events that are a service request at one node."""

_LAYERS = {"vardis": "VD", "bp": "BP"}


def request(event: ServiceEvent, n: int) -> tuple[str, dict[str, Any]]:
    """Return method and parameters for the ``n``-th repetition of an event."""
    own_fields = event.own_fields if isinstance(event, Create | Update) else {}
    given = {"ownFields": own_fields} if own_fields else {}
    match event:
        case Create():
            return "RTDB-Create", {
                "varId": event.variable,
                "repCnt": event.repetitions,
                "descr": event.description,
                "value": event.octets(n).hex(),
                "timeout": event.timeout_ms,
                **given,
            }
        case Update():
            return "RTDB-Update", {"varId": event.variable, "value": event.octets(n).hex(), **given}
        case Delete():
            return "RTDB-Delete", {"varId": event.variable}
        case Activate():
            return f"{_LAYERS[event.layer]}-MGMT-Activate", {}
        case Deactivate():
            return f"{_LAYERS[event.layer]}-MGMT-Deactivate", {}
        case Submission():
            return "SRP-UpdateSafetyData", {"sData": event.data}


def answer(node: Node, method: str, params: dict[str, Any], now: int, wall: int) -> dict[str, Any]:
    """Return the answer of a node to a request at its control interface. Raises ServiceError for an error answer."""
    try:
        found = perform(node, method, parameters_of(method, params), Times(now, wall))
    except RpcError as error:
        raise ServiceError(error.code, str(error)) from None
    plain: dict[str, Any] = msgspec.to_builtins(found)
    return plain


def trouble(result: dict[str, Any]) -> str:
    """Return the status of a confirm if it is not OK, otherwise an empty text."""
    status = str(result["status"])
    return "" if status.endswith("-STATUS-OK") else status
