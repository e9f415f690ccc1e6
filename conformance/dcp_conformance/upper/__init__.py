"""Upper testers: ways to the services of an implementation (the contract is conformance/UPPER-TESTER.md)."""

from .base import Answer, Notification, UpperTester

__all__ = ["Answer", "Notification", "UpperTester"]
