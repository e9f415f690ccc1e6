"""Number of examples that Hypothesis draws: few and fixed in `make test`, more and new ones in `make test-fresh`."""

from __future__ import annotations

import os

#: Whether this run draws new examples.
FRESH = os.environ.get("HYPOTHESIS_PROFILE") == "fresh"
#: Factor for the number of examples that tests name, with the profile "fresh".
FACTOR = int(os.environ.get("DCP_EXAMPLES", "5"))


def examples(number: int) -> int:
    """``number`` of examples for a run that draws new ones, times ``FACTOR``.

    A run that draws the same ones each time finds nothing new by drawing many: it takes a quarter of the number.
    """
    return number * FACTOR if FRESH else (number + 3) // 4
