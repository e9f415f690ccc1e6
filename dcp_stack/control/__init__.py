"""Control interface and upper tester interface of a node: JSON-RPC 2.0, one message per line, without sockets.

The contract is written up in ``conformance/UPPER-TESTER.md``.
"""

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
