"""Verdicts, and how several of them become one.

The worst of what a case found is its verdict, as in TTCN-3; nothing takes a verdict back afterwards. ``error`` is the
tester's own fault and therefore the worst: nothing else that the case says can be trusted then.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum


class Verdict(StrEnum):
    """The verdict of a case or requirement, from best to worst."""

    NOT_APPLICABLE = "not-applicable"
    """The case does not concern this implementation; the reason is given."""
    TOO_LITTLE = "too-little"
    """A recording gave too few occasions to say anything; the number is given."""
    INFO = "info"
    """The specification leaves it open; what the implementation does is reported."""
    PASS = "pass"  # noqa: S105 - no password
    INCONCLUSIVE = "inconclusive"
    """Neither shown nor refuted: the stimulus could not be given, or the tester has missed something."""
    FAIL = "fail"
    ERROR = "error"

    @property
    def rank(self) -> int:
        """0 for the best; of two verdicts the one with the higher rank counts."""
        return _RANKS[self]


_RANKS = {verdict: rank for rank, verdict in enumerate(Verdict)}


def worst(verdicts: Iterable[Verdict]) -> Verdict | None:
    """The verdict that counts; None if there are none."""
    return max(verdicts, key=lambda verdict: verdict.rank, default=None)
