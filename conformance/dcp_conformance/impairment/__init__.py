"""A bad link between tester and implementation (``run --impair``): a lower tester around a lower tester.

The link is bad while the body of a case is executed. It only delays while the tester finds out what it tests, in the
sanity case, while it asks whether the implementation lives, and while it undoes changes: what every verdict rests on
is not left to chance.

The tester knows which frames the link took, so a failed check that they can explain is inconclusive, and the case is
executed again (:mod:`dcp_conformance.test_system.judgement.losses`, :mod:`dcp_conformance.execution.runner`).
"""

from __future__ import annotations

import contextlib
from contextlib import AbstractContextManager
from typing import Final

from dcp_conformance.lower_tester import Impairs, LowerTester

from .directions import Directions, parse_directions
from .incidents import told
from .lower_tester import ImpairedLowerTester, impaired

#: The most executions of a case on an impaired link.
MOST_EXECUTIONS: Final = 25


def engaged(lower: LowerTester) -> AbstractContextManager[None]:
    """A context in which the link of this lower tester is as bad as the user wants it."""
    return lower.engaged() if isinstance(lower, Impairs) else contextlib.nullcontext()


__all__ = [
    "MOST_EXECUTIONS",
    "Directions",
    "ImpairedLowerTester",
    "engaged",
    "impaired",
    "parse_directions",
    "told",
]
