"""Lower testers: ways to the air around an implementation."""

from .base import Arrival, LinkHealth, LowerTester

__all__ = ["Arrival", "LinkHealth", "LowerTester"]
