"""Names of the reasons to ignore received octets and records, with the requirement that demands it.

``dcp_spec.reasons`` has the reasons for malformed octets; the reasons below are for well-formed ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

#: reason -> (requirement, meaning)
DROPS: Final[dict[str, tuple[str, str]]] = {
    "inactive": ("BP-RX-13", "the entity is not active"),
    "foreign-network": ("BP-RX-05", "the beacon belongs to another network"),
    "own-beacon": ("BP-RX-06", "the beacon carries the own node identifier as sender"),
    "unregistered-protocol": ("BP-RX-08", "no client is registered for the protocol of the block"),
    "empty-payload": ("BP-RX-07", "the block has no octets (X46)"),
    "other-count": ("BP-RX-12", "numPayloads is not the number of blocks (X48)"),
    "larger-than-registered": ("BP-RXP-01", "the payload is larger than its client has registered (X49)"),
    "own-report": ("SRP-RX-02", "the state report is about the own node"),
    "wrong-length": ("SRP-RX-01", "the payload is not exactly one state report"),
    "table-full": ("SRP-RX-03", "the neighbour table has no room for another node, a limit of this node (X53)"),
    "vardis-inactive": ("VD-MGT-03", "VarDis is not active"),
    "unhandled-container": ("VD-RX-05", "the node has no instruction for this container type of the profile's own"),
    "not-newer-create": ("VD-PC-01", "the variable is known from the same or a later creation"),
    "creation-ahead": ("VD-PC-01", "the creation time is further in the future than max_creation_ahead_s allows"),
    "own-create": ("VD-PC-03", "the variable is produced by this node"),
    "bad-value": ("VD-PC-04", "the value is empty or longer than allowed"),
    "bad-description": ("VD-PC-05", "the description is empty or longer than allowed"),
    "bad-repcnt": ("VD-PC-06", "the repetition count is zero or larger than allowed"),
    "id-mismatch": ("VD-PC-01", "the two identifiers of a VarCreate differ (X14)"),
    "delete-unknown": ("VD-PD-01", "the variable to delete is not known"),
    "delete-deleted": ("VD-PD-02", "the variable to delete is deleted already"),
    "delete-own": ("VD-PD-03", "the variable to delete is produced by this node"),
    "update-unknown": ("VD-PU-01", "the updated variable is not known; it is requested"),
    "update-deleted": ("VD-PU-02", "the updated variable is deleted"),
    "update-own": ("VD-PU-03", "the updated variable is produced by this node"),
    "update-bad-value": ("VD-PU-04", "the value is empty or longer than allowed"),
    "update-equal": ("VD-PU-05", "the update has the stored sequence number"),
    "update-older": ("VD-PU-06", "the update is older than what is stored"),
    "summary-own": ("VD-PS-02", "the summarised variable is produced by this node"),
    "summary-deleted": ("VD-PS-02", "the summarised variable is deleted"),
    "summary-equal": ("VD-PS-02", "the summary has the stored sequence number"),
    "update-request-unknown": ("VD-RU-01", "the requested variable is not known (1.0)"),
    "update-request-deleted": ("VD-RU-02", "the requested variable is deleted"),
    "update-request-not-behind": ("VD-RU-03", "the requester has what is stored, or something newer"),
    "create-request-unknown": ("VD-RC-01", "the requested variable is not known (1.0)"),
    "create-request-deleted": ("VD-RC-02", "the requested variable is deleted"),
    "database-full": ("VD-PC-07", "the database has no room for another variable"),
}

#: Reasons that occur in every working network, because nodes repeat records and their summaries.
ROUTINE: Final = frozenset(
    f"vardis/{reason}"
    for reason in (
        *("not-newer-create", "own-create", "delete-unknown", "delete-deleted", "delete-own"),
        *("update-unknown", "update-deleted", "update-own", "update-equal", "update-older"),
        *("summary-own", "summary-deleted", "summary-equal"),
        *("update-request-deleted", "update-request-not-behind", "create-request-deleted"),
    )
)


def split(drops: Mapping[str, int]) -> tuple[dict[str, int], dict[str, int]]:
    """Return the counts, by layer/reason, of what was ignored and of what was redundant."""
    redundant = {name: drops[name] for name in drops if name in ROUTINE}
    return {name: drops[name] for name in drops if name not in ROUTINE}, redundant
