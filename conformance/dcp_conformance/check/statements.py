"""VarDis records without their frames, in a form that rules can keep for long."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
from dcp_spec.constants import ICType

from dcp_conformance.frames.received import ReceivedBeacon


class Statement(msgspec.Struct, frozen=True, gc=False):
    """A record of a VarDis payload with its sender, frame number and time, but without the frame."""

    kind: ICType
    record: Any
    frame: int
    """Number of the frame in the recording."""
    time: int
    """ns since 1970."""
    sender: bytes
    var_id: int
    """Variable identifier; of a VarCreate the one in its VarSpec (X14)."""
    number: int
    """Sequence number of the variable in the record; -1 if it has none."""


class Part(NamedTuple):
    """The records of a container, and their variable identifiers in the same order."""

    kind: ICType
    records: tuple[Any, ...]
    ids: list[int]


def speaker(heard: ReceivedBeacon) -> bytes:
    """Return senderId of a beacon; the source address of the frame if it has none."""
    return heard.sender or heard.source


CREATE, UPDATE, SUMMARY = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES
DELETE, ASK_UPDATE, ASK_CREATE = ICType.DELETE_VARIABLES, ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES
"""Local aliases: access to enum members costs more time than most rules."""


def parts_of(heard: ReceivedBeacon) -> list[Part]:
    """Return the VarDis records of a frame by container; empty containers are left out."""
    parts: list[Part] = []
    for container in heard.containers:
        records = container.records
        # Skip container types that a profile adds: no rule is about their records.
        if records and (kind := records[0].IC_TYPE) is not None:
            ids = [each.spec.var_id for each in records] if kind is CREATE else [each.var_id for each in records]
            parts.append(Part(kind, records, ids))
    return parts


def statement_of(kind: ICType, record: Any, heard: ReceivedBeacon, sender: bytes) -> Statement:
    """Return a record of the beacon ``heard`` as a statement of ``sender``."""
    if kind is CREATE:
        return Statement(kind, record, heard.number, heard.wall, sender, record.spec.var_id, record.upd.seqno)
    number = -1 if kind is DELETE or kind is ASK_CREATE else record.seqno
    return Statement(kind, record, heard.number, heard.wall, sender, record.var_id, number)


def statements_in(heard: ReceivedBeacon, sender: bytes) -> tuple[Statement, ...]:
    """Return all VarDis records of a beacon as statements of ``sender``."""
    return tuple(
        [statement_of(kind, record, heard, sender) for kind, records, _ in parts_of(heard) for record in records]
    )
