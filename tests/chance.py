"""How many examples Hypothesis draws: few and the same in `make test`, more and new ones in `make test-fresh`."""

from __future__ import annotations

import os

#: Whether this run draws new examples.
FRESH = os.environ.get("HYPOTHESIS_PROFILE") == "fresh"
#: How many times as many examples are drawn then.
FACTOR = int(os.environ.get("DCP_EXAMPLES", "5")) if FRESH else 1


def examples(number: int) -> int:
    """``number`` of examples, multiplied in a run with fresh seeds."""
    return number * FACTOR
