"""What nodes say of variables, in a form that can be remembered for long."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
from dcp_spec.constants import ICType

from dcp_conformance.frames.received import KIND_OF, ReceivedBeacon


class Statement(msgspec.Struct, frozen=True, gc=False):
    """A record of a VarDis payload, without the frame around it: what can be remembered for long."""

    kind: ICType
    record: Any
    frame: int
    time: int
    """ns since 1970."""
    sender: bytes
    var_id: int
    """The variable that it is about; of a VarCreate that of its VarSpec (X14)."""
    number: int
    """The sequence number that it carries, -1 for a record without."""


class Part(NamedTuple):
    """The records of a container, and the variables that they are about."""

    kind: ICType
    records: tuple[Any, ...]
    ids: list[int]


def speaker(heard: ReceivedBeacon) -> bytes:
    """The node that a frame is from; for one without sender the station."""
    return heard.sender or heard.source


CREATE, UPDATE, SUMMARY = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES
DELETE, ASK_UPDATE, ASK_CREATE = ICType.DELETE_VARIABLES, ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES
"""Members of the enumeration by names of the module: looking them up there takes longer than most rules."""


def parts_of(heard: ReceivedBeacon) -> list[Part]:
    """What a frame says of variables, by container; empty containers are left out."""
    parts: list[Part] = []
    for container in heard.containers:
        records = container.records
        # No rule speaks of the records of a container type of the profile's own.
        if records and (kind := KIND_OF.get(type(records[0]))) is not None:
            ids = [each.spec.var_id for each in records] if kind is CREATE else [each.var_id for each in records]
            parts.append(Part(kind, records, ids))
    return parts


def said_of(kind: ICType, record: Any, heard: ReceivedBeacon, sender: bytes) -> Statement:
    """A record of a frame of ``sender``."""
    if kind is CREATE:
        return Statement(kind, record, heard.number, heard.wall, sender, record.spec.var_id, record.upd.seqno)
    number = -1 if kind is DELETE or kind is ASK_CREATE else record.seqno
    return Statement(kind, record, heard.number, heard.wall, sender, record.var_id, number)


def statements_in(heard: ReceivedBeacon, sender: bytes) -> tuple[Statement, ...]:
    """What a frame of ``sender`` says of variables."""
    return tuple([said_of(kind, record, heard, sender) for kind, records, _ in parts_of(heard) for record in records])
