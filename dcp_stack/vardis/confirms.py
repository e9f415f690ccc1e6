"""Confirms of the services of VarDis (dcp-vardis.md#vardis-application-service-interface)."""

from __future__ import annotations

import msgspec
from dcp_spec.status import VardisStatus

from dcp_codec.values import VarSpec

from .database import DBEntry


class NoResponseError(RuntimeError):
    """The request gets no confirm in the current state (reading X30 ``no-response``)."""


class Confirm(msgspec.Struct, frozen=True):
    """Confirm with a status only: RTDB-Create, RTDB-Update, RTDB-Delete and the management services."""

    status: VardisStatus


class ReadConfirm(msgspec.Struct, frozen=True):
    """``RTDB-Read.confirm``. ``value`` and ``t_stamp`` are None unless the status is OK.

    ``t_stamp``: local wall time (ns since 1970) of the last creation or update.
    """

    status: VardisStatus
    value: bytes | None = None
    t_stamp: int | None = None


class DescribedVariable(msgspec.Struct, frozen=True):
    """One variable in ``RTDB-DescribeDatabase.confirm``; the specification requires only ``spec`` (VD-DDB-03).

    ``t_stamp``: local wall time (ns since 1970) of the last creation or update.
    """

    spec: VarSpec
    is_deleted: bool
    t_stamp: int


class DescribeDatabaseConfirm(msgspec.Struct, frozen=True):
    """``RTDB-DescribeDatabase.confirm``; ``variables`` is empty unless the status is OK."""

    status: VardisStatus
    variables: tuple[DescribedVariable, ...] = ()


class DescribeVariableConfirm(msgspec.Struct, frozen=True):
    """``RTDB-DescribeVariable.confirm``; ``entry`` is a copy, None unless the status is OK."""

    status: VardisStatus
    entry: DBEntry | None = None
