"""Failures of a case that show only that the implementation ended or stopped answering."""

from __future__ import annotations

from typing import Final

from .results import CaseResult, Check
from .verdict import Verdict

#: Beginning of the expectation that an implementation still runs and answers after a case.
SURVIVAL: Final = "the implementation survives"
BAD: Final = (Verdict.FAIL, Verdict.ERROR)


def bad_checks(case: CaseResult) -> list[Check]:
    """Return the failed checks of a case, and those in error."""
    return [check for check in case.checks if check.verdict in BAD]


def did_not_survive(case: CaseResult) -> bool:
    """Return whether the implementation ended or stopped answering in a case."""
    return any(check.expected.startswith(SURVIVAL) for check in bad_checks(case))


def only_died(case: CaseResult) -> bool:
    """Return whether nothing else failed in a case than that the implementation ended or stopped answering."""
    bad = bad_checks(case)
    return bool(bad) and all(check.expected.startswith(SURVIVAL) for check in bad)
