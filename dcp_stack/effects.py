"""Effects: the outputs of the protocol cores, as values in one ordered queue.

Times are ns: ``now`` monotonic (deadlines), ``wall`` since the Unix epoch (stamps). Octets are ``bytes``.
"""

from __future__ import annotations

import msgspec


class SendBeacon(msgspec.Struct, frozen=True, gc=False):
    """Broadcast this bearer payload (no link-layer header) now."""

    octets: bytes
    seqno: int
    num_payloads: int


class PayloadReceived(msgspec.Struct, frozen=True, gc=False):
    """``BP-ReceivePayload.indication`` for the client registered under ``protocol_id`` (BP-RXP-01)."""

    protocol_id: int
    payload: bytes
    sender_id: bytes


class PayloadTransmitted(msgspec.Struct, frozen=True, gc=False):
    """``BP-PayloadTransmitted.indication`` (BP-PTI-01); ``next_epoch`` is monotonic ns (BP-PTI-02)."""

    protocol_id: int
    next_epoch: int


class VariableChanged(msgspec.Struct, frozen=True, gc=False):
    """A variable was created, updated or deleted (``event``) by this node or another."""

    event: str
    var_id: int
    seqno: int
    value: bytes
    prod_id: bytes


class NeighbourSeen(msgspec.Struct, frozen=True, gc=False):
    """An entry of the neighbour table was inserted (``new``) or replaced (SRP-RX-03)."""

    node_id: bytes
    new: bool


class NeighbourExpired(msgspec.Struct, frozen=True, gc=False):
    """An entry of the neighbour table was dropped for its age (SRP-RUN-02)."""

    node_id: bytes


class Dropped(msgspec.Struct, frozen=True, gc=False):
    """Received octets or a record were ignored. ``layer``: bp, srp or vardis; ``reason``: one of ``dcp_stack.drops``.

    ``offset`` is the octet in the bearer payload (bp) or client payload (srp, vardis) where the reason lies, -1 if it
    has none; ``requirement`` the rule that demands it; ``var_id`` the variable for VarDis records.
    """

    layer: str
    reason: str
    requirement: str
    offset: int = -1
    var_id: int | None = None


Effect = (
    SendBeacon | PayloadReceived | PayloadTransmitted | VariableChanged | NeighbourSeen | NeighbourExpired | Dropped
)
