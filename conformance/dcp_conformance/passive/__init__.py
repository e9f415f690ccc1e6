"""Passive testing: invariants over everything that the implementation sends during a run."""

from .rules import RULES
from .tester import SECTION, PassiveTester, cases, joined

__all__ = ["RULES", "SECTION", "PassiveTester", "cases", "joined"]
