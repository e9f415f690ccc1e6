"""Upper testers: ways to the services of an implementation (the contract is conformance/UPPER-TESTER.md)."""

from .base import Answer, Notification, UpperTester
from .opening import open_upper

__all__ = ["Answer", "Notification", "UpperTester", "open_upper"]
