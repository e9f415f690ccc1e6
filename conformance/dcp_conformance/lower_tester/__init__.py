"""Lower testers: send frames to the SUT and receive its frames."""

from .base import Arrival, Impairs, Incident, LinkHealth, ListensToAllTypes, LowerTester, OnThisMachine
from .ethernet import open_ethernet
from .udp import open_udp

__all__ = [
    "Arrival",
    "Impairs",
    "Incident",
    "LinkHealth",
    "ListensToAllTypes",
    "LowerTester",
    "OnThisMachine",
    "open_ethernet",
    "open_udp",
]
