"""Upper testers: ways to the services of an implementation (the contract is conformance/UPPER-TESTER.md)."""

from .base import Answer, Notification, Reconnecting, UpperTester
from .opening import open_upper

__all__ = ["Answer", "Notification", "Reconnecting", "UpperTester", "open_upper"]
