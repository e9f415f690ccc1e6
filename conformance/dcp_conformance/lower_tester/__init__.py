"""Lower testers: send frames to the SUT and receive its frames."""

from .base import Arrival, HearsEveryType, Impairs, Incident, LinkHealth, LowerTester, OnThisMachine
from .ethernet import open_ethernet
from .udp import open_udp

__all__ = [
    "Arrival",
    "HearsEveryType",
    "Impairs",
    "Incident",
    "LinkHealth",
    "LowerTester",
    "OnThisMachine",
    "open_ethernet",
    "open_udp",
]
