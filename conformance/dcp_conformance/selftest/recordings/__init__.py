"""Tests of ``check`` with simulated recordings: networks with one faulty node, and networks without any fault."""

from .clean import CleanResult, Suspicion, clean, situation
from .faulty import FaultyResult, Outcome, faulty

__all__ = ["CleanResult", "FaultyResult", "Outcome", "Suspicion", "clean", "faulty", "situation"]
