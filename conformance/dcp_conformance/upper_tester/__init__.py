"""Upper testers: ways to the services of an implementation (the contract is conformance/UPPER-TESTER.md)."""

from .base import Answer, Notification, Reconnecting, UpperTester
from .faults import Checked, Faults, Violation
from .opening import open_upper

__all__ = ["Answer", "Checked", "Faults", "Notification", "Reconnecting", "UpperTester", "Violation", "open_upper"]
