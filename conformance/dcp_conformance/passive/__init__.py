"""Passive testing: invariants over everything that the implementation sends during a run."""

from .rules import RULES
from .tester import SECTION, SIDE_BY_SIDE, PassiveTester, cases, joined

__all__ = ["RULES", "SECTION", "SIDE_BY_SIDE", "PassiveTester", "cases", "joined"]
