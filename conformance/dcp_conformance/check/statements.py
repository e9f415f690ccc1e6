"""What nodes say of variables, in a form that can be remembered for long."""

from __future__ import annotations

from typing import Any

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


def speaker(heard: ReceivedBeacon) -> bytes:
    """The node that a frame is from; for one without sender the station."""
    return heard.sender or heard.source


CREATE, UPDATE, SUMMARY = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES
DELETE, ASK_UPDATE, ASK_CREATE = ICType.DELETE_VARIABLES, ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES
"""Members of the enumeration by names of the module: looking them up there takes longer than most rules."""


def statements_in(heard: ReceivedBeacon, sender: bytes) -> tuple[Statement, ...]:
    """What a frame of ``sender`` says of variables."""
    found: list[Statement] = []
    frame, time = heard.number, heard.wall
    for container in heard.containers:
        records = container.records
        if not records:
            continue
        kind = KIND_OF[type(records[0])]
        if kind is CREATE:
            found += [Statement(kind, each, frame, time, sender, each.spec.var_id, each.upd.seqno) for each in records]
        elif kind is DELETE or kind is ASK_CREATE:
            found += [Statement(kind, each, frame, time, sender, each.var_id, -1) for each in records]
        else:
            found += [Statement(kind, each, frame, time, sender, each.var_id, each.seqno) for each in records]
    return tuple(found)
