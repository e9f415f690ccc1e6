"""An impaired link between tester and implementation (``run --impair``): a wrapper of a lower tester.

The link is impaired during the body of a case. It only delays frames in the sanity case, during probes and measurements
of the implementation, and while the tester undoes changes, because all verdicts depend on these steps.

The tester knows which frames were lost or changed. A failed check that they can explain is inconclusive, and the case
is executed again (:mod:`dcp_conformance.test_system.judgement.losses`, :mod:`dcp_conformance.execution.runner`).
"""

from __future__ import annotations

import contextlib
from contextlib import AbstractContextManager
from typing import Final

from dcp_conformance.lower_tester import Impairs, LowerTester

from .directions import Directions, parse_directions
from .incidents import incidents_text
from .lower_tester import ImpairedLowerTester, impaired

#: Maximum number of executions of a case on an impaired link.
MOST_EXECUTIONS: Final = 25


def engaged(lower: LowerTester) -> AbstractContextManager[None]:
    """Return a context in which the link of this lower tester has the impairment that the user has configured."""
    return lower.engaged() if isinstance(lower, Impairs) else contextlib.nullcontext()


__all__ = [
    "MOST_EXECUTIONS",
    "Directions",
    "ImpairedLowerTester",
    "engaged",
    "impaired",
    "incidents_text",
    "parse_directions",
]
