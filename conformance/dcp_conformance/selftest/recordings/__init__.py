"""Who judges the judge of recordings: faulty nodes in simulated networks, and networks without any fault."""

from .clean import CleanResult, Suspicion, clean, situation
from .faulty import FaultyResult, Outcome, faulty

__all__ = ["CleanResult", "FaultyResult", "Outcome", "Suspicion", "clean", "faulty", "situation"]
