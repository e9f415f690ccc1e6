"""The VarDis records of a received beacon, as parts and statements of the ledger."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import ICType

from dcp_codec.analysis.ledger import (
    ASK_CREATE,
    ASK_UPDATE,
    CREATE,
    DELETE,
    SUMMARY,
    UPDATE,
    Part,
    Statement,
    latest,
    part_of,
    statement,
)
from dcp_conformance.frames.received import ReceivedBeacon

__all__ = [
    "ASK_CREATE",
    "ASK_UPDATE",
    "CREATE",
    "DELETE",
    "SUMMARY",
    "UPDATE",
    "Part",
    "Statement",
    "latest",
    "statement",
]


def speaker(heard: ReceivedBeacon) -> bytes:
    """Return senderId of a beacon; the source address of the frame if it has none."""
    return heard.sender or heard.source


def parts_of(heard: ReceivedBeacon) -> list[Part]:
    """Return the VarDis records of a frame by container; empty containers are left out."""
    # Container types that a profile adds are left out, too: no rule is about their records.
    return [part for each in heard.containers if (part := part_of(each.records)) is not None]


def statement_of(kind: ICType, record: Any, heard: ReceivedBeacon, sender: bytes) -> Statement:
    """Return a record of the beacon ``heard`` as a statement of ``sender``."""
    return statement(kind, record, heard.number, heard.wall, sender)


def statements_in(heard: ReceivedBeacon, sender: bytes) -> tuple[Statement, ...]:
    """Return all VarDis records of a beacon as statements of ``sender``."""
    return tuple(
        [statement_of(kind, record, heard, sender) for kind, records, _, _, _ in parts_of(heard) for record in records]
    )
