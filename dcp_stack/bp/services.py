"""Confirms of the services of BP (dcp-bp.md, "Service Interface"); those for SRP and VarDis are in ``bp_port``."""

from __future__ import annotations

import msgspec
from dcp_spec.constants import QueueingMode, SpecVersion
from dcp_spec.status import BPStatus

from dcp_stack.bp_port import NumberConfirm, RegisterConfirm, StatusConfirm

__all__ = ["ListConfirm", "NumberConfirm", "RegisterConfirm", "Registration", "StatusConfirm", "UnknownServiceError"]


class UnknownServiceError(ValueError):
    """The service does not exist in the profile's version of the specification."""

    def __init__(self, service: str, since: SpecVersion, version: SpecVersion) -> None:
        super().__init__(f"{service} exists since {since} of the specification; the profile follows {version}")


class Registration(msgspec.Struct, frozen=True, rename="camel"):
    """One entry of ``BP-ListRegisteredProtocols.confirm`` (BP-LST-01).

    ``msgspec.to_builtins`` gives it under the specification's field names. Sizes in octets,
    ``time_stamp_registration`` in ns since 1970. ``queue_mode`` is a ``QueueingMode``, except for an unknown mode
    that was registered under reading X06 ``refuse-at-clear``.
    """

    protocol_id: int
    protocol_name: str
    max_payload_size: int
    queue_mode: QueueingMode | str | int
    time_stamp_registration: int
    ##= DATA-09
    # Counts are Python integers: no overflow.
    max_entries: int
    allow_multiple_payloads: bool


class ListConfirm(msgspec.Struct, frozen=True):
    """``BP-ListRegisteredProtocols.confirm``, in the order of registration; always OK (X08)."""

    status: BPStatus
    protocols: tuple[Registration, ...]
