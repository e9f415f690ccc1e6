"""Explain a set of failed cases by the fewest faults.

The suite runs against nodes with one known fault each. The cases that fail are the signature of the fault. All
signatures together are a fault dictionary (:mod:`.dictionary`; ``selftest/diagnosis/`` makes it). :mod:`.explain` finds
the few faults whose signatures together account for the failures of a run.
"""

from .dictionary import Dictionary, Fault, load
from .explain import explain

__all__ = ["Dictionary", "Fault", "explain", "load"]
