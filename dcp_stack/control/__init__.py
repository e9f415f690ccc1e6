"""Control interface and upper tester interface of a node: JSON-RPC 2.0, one message per line, without sockets.

``conformance/UPPER-TESTER.md`` specifies the interface.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcp_spec.exports import exported

if TYPE_CHECKING:
    from .client import ControlClient, ControlError, ServiceError
    from .methods import METHODS, NOTIFICATIONS
    from .server import ControlServer, ControlSession

__all__ = [
    "METHODS",
    "NOTIFICATIONS",
    "ControlClient",
    "ControlError",
    "ControlServer",
    "ControlSession",
    "ServiceError",
]

# Imported on demand: a client does not need the modules of the server.
__getattr__ = exported(
    __name__,
    {
        "client": ("ControlClient", "ControlError", "ServiceError"),
        "methods": ("METHODS", "NOTIFICATIONS"),
        "server": ("ControlServer", "ControlSession"),
    },
)
