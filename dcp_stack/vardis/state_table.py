"""The state table of a variable: events, states and actions of VarDis (dcp-vardis.md, all processing steps).

A row is an event: the result of comparing a record, a request of an application or the clock with the entry of the
variable. A column is the state of the variable at this node. A cell is the action. :func:`table` starts from the table
of 2.0 and replaces cells for other versions and other readings of disputed text.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import Final

import msgspec
from dcp_spec.status import VardisStatus

from dcp_stack.config import NodeConfig


class State(IntEnum):
    """The state of a variable at one node. The producer is the node whose identifier is in the VarSpec."""

    UNKNOWN = 0
    ALIVE_PRODUCER = 1
    ALIVE_CONSUMER = 2
    DELETED_PRODUCER = 3
    DELETED_CONSUMER = 4


class Event(Enum):
    """A request of an application (APP), or a received record and its comparison with the entry (RX)."""

    # Enum.__hash__ is written in Python, and each record needs one look-up of its row.
    __hash__ = object.__hash__

    APP_CREATE = "RTDB-Create"
    APP_UPDATE = "RTDB-Update"
    APP_DELETE = "RTDB-Delete"
    APP_READ = "RTDB-Read"
    RX_CREATE_MISMATCH = "VarCreate with two different identifiers"
    RX_CREATE_NOT_LATER = "VarCreate of the same or an earlier creation"
    RX_CREATE_OWN = "VarCreate with this node as producer"
    RX_CREATE_BAD_VALUE = "VarCreate with a value that is not allowed"
    RX_CREATE_BAD_DESCRIPTION = "VarCreate with a description that is not allowed"
    RX_CREATE_BAD_REPCNT = "VarCreate with a repetition count that is not allowed"
    RX_CREATE_LATER = "VarCreate of an unknown variable or a later creation"
    RX_DELETE = "VarDelete"
    RX_UPDATE_BAD_VALUE = "VarUpdate with a value that is not allowed"
    RX_UPDATE_EQUAL = "VarUpdate with the stored sequence number"
    RX_UPDATE_OLDER = "VarUpdate with an older sequence number"
    RX_UPDATE_NEWER = "VarUpdate with a newer sequence number"
    RX_SUMMARY_EQUAL = "VarSumm with the stored sequence number"
    RX_SUMMARY_OLDER = "VarSumm with an older sequence number"
    RX_SUMMARY_NEWER = "VarSumm with a newer sequence number"
    RX_REQUEST_UPDATE_BEHIND = "VarReqUpdate with an older sequence number"
    RX_REQUEST_UPDATE_OTHER = "VarReqUpdate with the stored or a newer sequence number"
    RX_REQUEST_CREATE = "VarReqCreate"
    TIMED_OUT = "timeout of the variable"


class Action(Enum):
    """An action on a variable or a record."""

    NONE = "nothing"
    REFUSE = "answer the application with a status"
    CREATE = "create the variable, or create it again"
    UPDATE = "store the application's value with the next sequence number"
    DELETE = "mark the variable as deleted"
    READ = "answer with the stored value"
    IGNORE = "ignore the record"
    ADOPT = "store the variable of another node"
    STORE = "store the newer value"
    TEACH = "send the stored, newer value, unless it is already queued"
    SEND_UPDATE = "send the stored value"
    SEND_CREATE = "send the VarSpec and the stored value"
    REQUEST_UPDATE = "request the newer value"
    REQUEST_CREATE = "request the variable"


class Cell(msgspec.Struct, frozen=True):
    """An action, and its explanation.

    ``reason``: why a record is ignored, a key of ``dcp_stack.drops``. ``status``: the status of a refused request.
    """

    action: Action
    reason: str | None = None
    status: VardisStatus | None = None


Row = tuple[Cell, Cell, Cell, Cell, Cell]
Table = dict[Event, Row]


def _ignore(reason: str) -> Cell:
    """Return a cell that ignores the record."""
    return Cell(Action.IGNORE, reason=reason)


def _refuse(status: VardisStatus) -> Cell:
    """Return a cell that refuses the request."""
    return Cell(Action.REFUSE, status=status)


_NONE: Final = Cell(Action.NONE)
_EXISTS: Final = _refuse(VardisStatus.VARIABLE_EXISTS)
_UNKNOWN: Final = _refuse(VardisStatus.VARIABLE_DOES_NOT_EXIST)
_FOREIGN: Final = _refuse(VardisStatus.NOT_PRODUCER)
_DELETED: Final = _refuse(VardisStatus.VARIABLE_IS_DELETED)
_CREATE: Final = Cell(Action.CREATE)
_UPDATE: Final = Cell(Action.UPDATE)
_DELETE: Final = Cell(Action.DELETE)
_READ: Final = Cell(Action.READ)
_ADOPT: Final = Cell(Action.ADOPT)
_STORE: Final = Cell(Action.STORE)
_TEACH: Final = Cell(Action.TEACH)
_SEND_UPDATE: Final = Cell(Action.SEND_UPDATE)
_SEND_CREATE: Final = Cell(Action.SEND_CREATE)
_ASK_UPDATE: Final = Cell(Action.REQUEST_UPDATE)
_ASK_CREATE: Final = Cell(Action.REQUEST_CREATE)
#: Drops the update and requests the variable.
_UPDATE_UNKNOWN: Final = Cell(Action.REQUEST_CREATE, reason="update-unknown")
_UPDATE_OLDER: Final = Cell(Action.TEACH, reason="update-older")


def _everywhere(cell: Cell) -> Row:
    """Return a row with the same cell for all states."""
    return (cell, cell, cell, cell, cell)


def _known(unknown: Cell, own: str, alive: Cell, deleted: str) -> Row:
    """Return a row for records that concern only alive variables of other nodes.

    Records about a deleted variable are ignored with the reason ``deleted``, others about an own variable with the
    reason ``own``.
    """
    ##= VD-PD-02 VD-PD-03 VD-PU-02 VD-PU-03 VD-PS-02
    return (unknown, _ignore(own), alive, _ignore(deleted), _ignore(deleted))


_TABLE: Final[Table] = {
    # event: (unknown, alive own, alive foreign, deleted own, deleted foreign)
    ##= VD-CRE-02 VD-CRE-03
    Event.APP_CREATE: (_CREATE, _CREATE, _EXISTS, _CREATE, _EXISTS),
    ##= VD-UPD-03 VD-UPD-04
    Event.APP_UPDATE: (_UNKNOWN, _UPDATE, _FOREIGN, _DELETED, _FOREIGN),
    ##= VD-DEL-03 VD-DEL-04
    Event.APP_DELETE: (_UNKNOWN, _DELETE, _FOREIGN, _DELETED, _FOREIGN),
    ##= VD-REA-03
    Event.APP_READ: (_UNKNOWN, _READ, _READ, _DELETED, _DELETED),
    Event.RX_CREATE_MISMATCH: _everywhere(_ignore("id-mismatch")),
    ##= VD-PC-01
    Event.RX_CREATE_NOT_LATER: _everywhere(_ignore("not-newer-create")),
    ##= VD-PC-03
    Event.RX_CREATE_OWN: _everywhere(_ignore("own-create")),
    ##= VD-PC-04
    Event.RX_CREATE_BAD_VALUE: _everywhere(_ignore("bad-value")),
    ##= VD-PC-05
    Event.RX_CREATE_BAD_DESCRIPTION: _everywhere(_ignore("bad-description")),
    ##= VD-PC-06
    Event.RX_CREATE_BAD_REPCNT: _everywhere(_ignore("bad-repcnt")),
    ##= VD-PC-02
    Event.RX_CREATE_LATER: _everywhere(_ADOPT),
    ##= VD-PD-01
    Event.RX_DELETE: _known(_ignore("delete-unknown"), "delete-own", _DELETE, "delete-deleted"),
    ##= VD-PU-04
    Event.RX_UPDATE_BAD_VALUE: _known(_UPDATE_UNKNOWN, "update-own", _ignore("update-bad-value"), "update-deleted"),
    ##= VD-PU-05 VD-SCP-03
    Event.RX_UPDATE_EQUAL: _known(_UPDATE_UNKNOWN, "update-own", _ignore("update-equal"), "update-deleted"),
    ##= VD-PU-06
    Event.RX_UPDATE_OLDER: _known(_UPDATE_UNKNOWN, "update-own", _UPDATE_OLDER, "update-deleted"),
    ##= VD-PU-07 VD-PU-01
    Event.RX_UPDATE_NEWER: _known(_UPDATE_UNKNOWN, "update-own", _STORE, "update-deleted"),
    ##= VD-PS-02
    Event.RX_SUMMARY_EQUAL: _known(_ASK_CREATE, "summary-own", _ignore("summary-equal"), "summary-deleted"),
    ##= VD-PS-03
    Event.RX_SUMMARY_OLDER: _known(_ASK_CREATE, "summary-own", _TEACH, "summary-deleted"),
    ##= VD-PS-04 VD-PS-01
    Event.RX_SUMMARY_NEWER: _known(_ASK_CREATE, "summary-own", _ASK_UPDATE, "summary-deleted"),
    ##= VD-RU-02 VD-RU-04
    Event.RX_REQUEST_UPDATE_BEHIND: (
        _ASK_CREATE,
        _SEND_UPDATE,
        _SEND_UPDATE,
        _ignore("update-request-deleted"),
        _ignore("update-request-deleted"),
    ),
    ##= VD-RU-03 VD-RU-01
    Event.RX_REQUEST_UPDATE_OTHER: (
        _ASK_CREATE,
        _ignore("update-request-not-behind"),
        _ignore("update-request-not-behind"),
        _ignore("update-request-deleted"),
        _ignore("update-request-deleted"),
    ),
    ##= VD-RC-01 VD-RC-02 VD-RC-03
    Event.RX_REQUEST_CREATE: (
        _ASK_CREATE,
        _SEND_CREATE,
        _SEND_CREATE,
        _ignore("create-request-deleted"),
        _ignore("create-request-deleted"),
    ),
    ##= VD-SCR-02 VD-SCR-05
    Event.TIMED_OUT: (_NONE, _DELETE, _DELETE, _NONE, _NONE),
}


def table(config: NodeConfig) -> Table:
    """Return the table for the version of a node's profile and for its readings."""
    readings = config.selected_readings
    found = dict(_TABLE)
    if not config.features.creation_time:
        # Without creation times two creations cannot be ordered: a stored variable stays unchanged.
        ##= VD-CRE-16
        found[Event.APP_CREATE] = (_CREATE, _EXISTS, _EXISTS, _EXISTS, _EXISTS)
    elif readings.repeated_create == "by-description":
        found[Event.APP_CREATE] = (_CREATE, _EXISTS, _EXISTS, _CREATE, _CREATE)
    if not config.features.rerequest_unknown:
        ##= VD-RU-05 VD-RC-04
        for event, reason in (
            (Event.RX_REQUEST_UPDATE_BEHIND, "update-request-unknown"),
            (Event.RX_REQUEST_UPDATE_OTHER, "update-request-unknown"),
            (Event.RX_REQUEST_CREATE, "create-request-unknown"),
        ):
            found[event] = (_ignore(reason), *found[event][1:])
    if readings.scrubbing == "producer-only":
        found[Event.TIMED_OUT] = (_NONE, _DELETE, _NONE, _NONE, _NONE)
    return found
