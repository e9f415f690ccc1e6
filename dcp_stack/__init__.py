"""The reference node: BP, SRP and VarDis without input or output, its links and ``dcp-node``.

The names below are the public interface (docs/stability.md). :class:`Node` has no sockets and no clock: the caller
passes in received frames and times, and carries out the effects that :meth:`Node.take_effects` returns::

    >>> import random
    >>> from dcp_codec import Codec
    >>> from dcp_stack import Node, NodeConfig
    >>> config = NodeConfig(node_id=bytes.fromhex("020000000001"), codec=Codec("dcp-2.0"))
    >>> node = Node(config, rng=random.Random(1), now=0, wall=0)
    >>> node.start(0, 0)
    >>> node.poll_timeout()                        # when handle_timeout() is due, in ns; None: never
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcp_spec.exports import exported

if TYPE_CHECKING:
    from .config import BPConfig, NodeConfig, SRPConfig, VardisConfig
    from .control.client import ControlClient, ControlError, ServiceError
    from .effects import (
        Dropped,
        Effect,
        NeighbourExpired,
        NeighbourSeen,
        PayloadReceived,
        PayloadTransmitted,
        SendBeacon,
        VariableChanged,
    )
    from .node import Node

__all__ = [
    "BPConfig",
    "ControlClient",
    "ControlError",
    "Dropped",
    "Effect",
    "NeighbourExpired",
    "NeighbourSeen",
    "Node",
    "NodeConfig",
    "PayloadReceived",
    "PayloadTransmitted",
    "SRPConfig",
    "SendBeacon",
    "ServiceError",
    "VardisConfig",
    "VariableChanged",
]

# Lazy imports: a client of a running node must not load the modules of a node.
__getattr__ = exported(
    __name__,
    {
        "config": ("BPConfig", "NodeConfig", "SRPConfig", "VardisConfig"),
        "control.client": ("ControlClient", "ControlError", "ServiceError"),
        "effects": (
            *("Dropped", "Effect", "NeighbourExpired", "NeighbourSeen"),
            *("PayloadReceived", "PayloadTransmitted", "SendBeacon", "VariableChanged"),
        ),
        "node": ("Node",),
    },
)
