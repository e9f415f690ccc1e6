"""Explain a set of failed cases by the fewest faults.

The self-test runs the suite against nodes with one known fault each. The cases that fail are the signature of the
fault. All signatures together are the fault dictionary (:mod:`.dictionary`; made by ``dcp-selftest dictionary``).
:mod:`.explain` finds the smallest set of faults whose signatures together account for the failures of a run.
"""

from .dictionary import Dictionary, Fault, load
from .explain import explain

__all__ = ["Dictionary", "Fault", "explain", "load"]
