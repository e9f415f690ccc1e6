"""The requirement that an implementation violates if it does not survive a service call.

No requirement states survival of a call, but each service has a requirement about its effect and its confirm.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final, NamedTuple

from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion

from dcp_conformance.model.case import Case
from dcp_conformance.test_system.traffic import Event

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


_SERVICES: Final[Mapping[str, _Rules]] = {
    "BP-RegisterProtocol": _Rules("BP-REG-", "BP-REG-06"),
    "BP-DeregisterProtocol": _Rules("BP-DRG-", "BP-DRG-02"),
    "BP-ListRegisteredProtocols": _Rules("BP-LST-", "BP-LST-01"),
    "BP-TransmitPayload": _Rules("BP-TXP-", "BP-TXP-09"),
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

    It is the first requirement of the case about this service that is not in ``shown``, the requirements with a passed
    check. If all of them are, it is the last and most specific one, because a pass for lack of a reaction is not
    evidence if the implementation was dead. If the case is not about the service, it is the requirement about the
    effect of the service. ``events`` are those of the case.
    """
    rules = _SERVICES.get(call.text)
    if rules is None:
        return ()
    if own := _own(case, call.text):
        return next(((each,) for each in own if each not in shown), own[-1:])
    usual = rules.with_queue if rules.with_queue and _has_queue(call, events) else rules.usual
    return (usual,) if usual and requirement(usual).holds_in(version) else ()


def _own(case: Case, service: str) -> tuple[str, ...]:
    rules = _SERVICES.get(service)
    return () if rules is None else tuple(each for each in case.requirements if each.startswith(rules.family))


def _has_queue(call: Event, events: Iterable[Event]) -> bool:
    """Return whether the client of a call was registered with a queueing mode that has a queue."""
    prot_id = _parameters(call).get("protId")
    modes = [
        str(_parameters(each).get("queueingMode", ""))
        for each in events
        if each.direction == "call"
        and each.text == "BP-RegisterProtocol"
        and _parameters(each).get("protId") == prot_id
    ]
    return bool(modes) and not modes[-1].endswith(_BUFFER_MODES)


def _parameters(call: Event) -> Mapping[str, Any]:
    return call.data if isinstance(call.data, Mapping) else {}
