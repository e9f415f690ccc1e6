"""Confirms of the services of VarDis (dcp-vardis.md#vardis-application-service-interface)."""

from __future__ import annotations

import msgspec
from dcp_spec.status import VardisStatus

from dcp_codec.values import VarSpec

from .database import DBEntry


class NoResponseError(RuntimeError):
    """There is no confirm: the request is not answered in this state (reading X30 ``no-response``)."""


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


class DescribeVariableConfirm(msgspec.Struct, frozen=True):
    """Of RTDB-DescribeVariable; ``entry``, a copy, is None unless the status is OK."""

    status: VardisStatus
    entry: DBEntry | None = None
