"""The requirement that is violated by a service that the implementation does not survive, or whose status is unknown.

No requirement states survival of a call, but each service has a requirement about its effect and its confirm.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final, NamedTuple

from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion

from dcp_conformance.definitions.case import Case
from dcp_conformance.test_system.traffic import Event
from dcp_conformance.upper_tester.base import NOT_REACHED, Answer

#: Endings of the queueing modes with a buffer for a single payload.
_BUFFER_MODES: Final = ("ONCE", "REPEAT")


class _Rules(NamedTuple):
    """The requirements of one service."""

    family: str
    """Prefix of their identifiers."""
    usual: str = ""
    """The requirement about the effect of a successful call; empty if there is no such requirement."""
    with_queue: str = ""
    """The requirement about the effect for a client with a queue, if it is a separate one."""
    with_buffer: str = ""
    """The requirement about the effect for a client with a buffer, if it is a separate one."""


_SERVICES: Final[Mapping[str, _Rules]] = {
    "BP-RegisterProtocol": _Rules("BP-REG-", "BP-REG-06"),
    "BP-DeregisterProtocol": _Rules("BP-DRG-", "BP-DRG-02"),
    "BP-ListRegisteredProtocols": _Rules("BP-LST-", "BP-LST-01"),
    "BP-TransmitPayload": _Rules("BP-TXP-", "BP-TXP-09", with_buffer="BP-TXP-06"),
    "BP-ClearBuffer": _Rules("BP-CLR-", "BP-CLR-03", with_queue="BP-CLR-02"),
    "BP-QueryNumberBufferedPayloads": _Rules("BP-QRY-", "BP-QRY-03", with_queue="BP-QRY-02"),
    "BP-MGMT-Activate": _Rules("BP-MGT-", "BP-MGT-05"),
    "BP-MGMT-Deactivate": _Rules("BP-MGT-", "BP-MGT-01"),
    "BP-GetParameters": _Rules("BP-PAR-", "BP-PAR-01"),
    "BP-SetParameter": _Rules("BP-PAR-", "BP-PAR-01"),
    "SRP-UpdateSafetyData": _Rules("SRP-SRV-", "SRP-SRV-03"),
    "SRP-NeighbourTable": _Rules("SRP-NT-", "SRP-NT-02"),
    "SRP-GetParameters": _Rules("SRP-PAR-"),
    "SRP-SetParameter": _Rules("SRP-PAR-"),
    "RTDB-DescribeDatabase": _Rules("VD-DDB-", "VD-DDB-02"),
    "RTDB-DescribeVariable": _Rules("VD-DVA-", "VD-DVA-03"),
    "RTDB-Create": _Rules("VD-CRE-", "VD-CRE-14"),
    "RTDB-Update": _Rules("VD-UPD-", "VD-UPD-08"),
    "RTDB-Delete": _Rules("VD-DEL-", "VD-DEL-05"),
    "RTDB-Read": _Rules("VD-REA-", "VD-REA-04"),
    "VD-MGMT-Activate": _Rules("VD-MGT-", "VD-MGT-05"),
    "VD-MGMT-Deactivate": _Rules("VD-MGT-", "VD-MGT-01"),
    "VD-GetParameters": _Rules("VD-PAR-", "VD-PAR-09"),
    "VD-SetParameter": _Rules("VD-PAR-", "VD-PAR-09"),
}


def concerns(case: Case, service: str) -> bool:
    """Return whether a case decides requirements of a service; otherwise it only uses the service."""
    return bool(_own(case, service))


def violated_by_death(
    case: Case, call: Event, events: Iterable[Event], shown: Collection[str], version: SpecVersion | str
) -> tuple[str, ...]:
    """Return the requirement that is violated if the implementation is dead after a service call; empty without any.

    It is the first mandatory requirement of the case about this service that is not in ``shown``, the requirements with
    a passed check. If all of them are and the call was answered, it is the last and most specific one, because a pass
    for lack of a reaction is not evidence if the implementation was dead. Otherwise it is the requirement about the
    effect of the service. ``events`` are those of the case.
    """
    own = [each for each in _own(case, call.text) if requirement(each).level != "optional"]
    if missing := next((each for each in own if each not in shown), ""):
        return (missing,)
    return tuple(own[-1:]) if own and is_answered(call, events) else of_effect(call, events, version)


def of_effect(call: Event, events: Iterable[Event], version: SpecVersion | str) -> tuple[str, ...]:
    """Return the requirement about the effect and the confirm of a service; empty if there is none.

    ``events``: those of the case; they show the queueing mode of the client that calls.
    """
    rules = _SERVICES.get(call.text)
    if rules is None:
        return ()
    mode = _mode(call, events)
    usual = (rules.with_buffer if mode.endswith(_BUFFER_MODES) else rules.with_queue if mode else "") or rules.usual
    return (usual,) if usual and requirement(usual).holds_in(version) else ()


def family(service: str) -> str:
    """Return the prefix of the requirements about a service; empty for a service that the specification lacks."""
    rules = _SERVICES.get(service)
    return "" if rules is None else rules.family


def not_reached(answer: Event) -> bool:
    """Return whether an answer shows that the upper tester could not reach the implementation."""
    data = answer.data
    if not isinstance(data, Mapping) or "code" not in data:
        return False
    return data["code"] == NOT_REACHED or Answer(code=data["code"], message=data["message"]).unreachable


def unreached(events: Iterable[Event]) -> bool:
    """Return whether a call of the case could not reach the implementation; ``events``: those of the case."""
    return any(each.direction == "answer" and not_reached(each) for each in events)


def is_answered(call: Event, events: Iterable[Event]) -> bool:
    """Return whether the implementation has answered a call of the case; ``events``: those of the case."""
    found = False
    for event in events:
        if found and event.direction in ("call", "answer"):
            return event.direction == "answer" and not not_reached(event)
        found = found or event is call
    return False


def _own(case: Case, service: str) -> tuple[str, ...]:
    prefix = family(service)
    return tuple(each for each in case.requirements if prefix and each.startswith(prefix))


def _mode(call: Event, events: Iterable[Event]) -> str:
    """Return the queueing mode with which the client of a call was registered last; empty if it was not."""
    prot_id, asked, mode = _parameters(call).get("protId"), "", ""
    for each in events:
        if each.direction == "call" and each.text == "BP-RegisterProtocol":
            asked = str(_parameters(each).get("queueingMode", "")) if _parameters(each).get("protId") == prot_id else ""
        elif each.direction == "answer":
            mode, asked = asked if asked and _succeeded(each) else mode, ""
    return mode


def _succeeded(answer: Event) -> bool:
    status = answer.data.get("status") if isinstance(answer.data, Mapping) else None
    return isinstance(status, str) and Answer(status=status).ok


def _parameters(call: Event) -> Mapping[str, Any]:
    return call.data if isinstance(call.data, Mapping) else {}
