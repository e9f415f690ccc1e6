"""Explain a set of failed cases by the fewest faults.

The suite is run against a node with one known fault after the other. Which cases fail then is the signature of the
fault; all signatures together are a fault dictionary (:mod:`.dictionary`, made by :mod:`.making`). :mod:`.explain`
looks for the few faults whose signatures together account for the failures of a run.
"""

from .dictionary import Dictionary, Fault, load
from .explain import explain

__all__ = ["Dictionary", "Fault", "explain", "load"]
