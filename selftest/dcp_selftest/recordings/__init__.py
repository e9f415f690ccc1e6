"""Tests of ``check`` with simulated recordings: networks with one faulty node, and networks without any fault."""

from .clean import CleanResult, FalseFinding, clean, situation
from .faulty import FaultyResult, Outcome, faulty

__all__ = ["CleanResult", "FalseFinding", "FaultyResult", "Outcome", "clean", "faulty", "situation"]
