"""Confirms of the services of VarDis (dcp-vardis.md#vardis-application-service-interface), and its port to BP."""

from __future__ import annotations

from typing import Protocol

import msgspec
from dcp_spec.constants import QueueingMode
from dcp_spec.status import BPStatus, VardisStatus

from dcp_codec.values import VarSpec


class Confirm(msgspec.Struct, frozen=True):
    """Of RTDB-Create, RTDB-Update, RTDB-Delete and the management services: a status and nothing else."""

    status: VardisStatus


class ReadConfirm(msgspec.Struct, frozen=True):
    """Of RTDB-Read. ``t_stamp`` is the local wall time (ns since 1970) of the last creation or update.

    Both are None unless the status is OK.
    """

    status: VardisStatus
    value: bytes | None = None
    t_stamp: int | None = None


class DescribedVariable(msgspec.Struct, frozen=True):
    """A variable in the answer of RTDB-DescribeDatabase; the specification asks for ``spec`` only (VD-DDB-03)."""

    spec: VarSpec
    is_deleted: bool
    t_stamp: int


class DescribeDatabaseConfirm(msgspec.Struct, frozen=True):
    """Of RTDB-DescribeDatabase; no variables unless the status is OK."""

    status: VardisStatus
    variables: tuple[DescribedVariable, ...] = ()


class VariableEntry(msgspec.Struct, frozen=True):
    """``DBEntry`` as it was when it was asked for; ``t_stamp`` is wall time in ns since 1970."""

    spec: VarSpec
    value: bytes
    seqno: int
    t_stamp: int
    count_update: int
    count_create: int
    count_delete: int
    is_deleted: bool


class DescribeVariableConfirm(msgspec.Struct, frozen=True):
    """Of RTDB-DescribeVariable; ``entry`` is None unless the status is OK."""

    status: VardisStatus
    entry: VariableEntry | None = None


class HasStatus(Protocol):
    """A confirm of BP."""

    @property
    def status(self) -> BPStatus: ...


class RegisterConfirm(HasStatus, Protocol):
    """Of BP-RegisterProtocol; ``own_node_identifier`` is None where the version does not tell (1.0)."""

    @property
    def own_node_identifier(self) -> bytes | None: ...


class NumberConfirm(HasStatus, Protocol):
    """Of BP-QueryNumberBufferedPayloads; ``number`` is None if the status is not OK."""

    @property
    def number(self) -> int | None: ...


class BPPort(Protocol):
    """What VarDis needs of BP; ``BeaconingProtocol`` has it. Times are ns."""

    def register(
        self,
        prot_id: int,
        name: str,
        max_payload_size: int,
        queueing_mode: QueueingMode,
        max_entries: int,
        allow_multiple_payloads: bool,
        *,
        now: int,
        wall: int,
    ) -> RegisterConfirm:
        """``BP-RegisterProtocol``."""

    def deregister(self, prot_id: int) -> HasStatus:
        """``BP-DeregisterProtocol``."""

    def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> HasStatus:
        """``BP-TransmitPayload``."""

    def query_number_buffered(self, prot_id: int) -> NumberConfirm:
        """``BP-QueryNumberBufferedPayloads``."""
