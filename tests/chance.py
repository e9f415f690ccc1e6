"""How many examples Hypothesis draws: some and the same in `make test`, more and new ones in `make test-fresh`."""

from __future__ import annotations

import os

#: Whether this run draws new examples.
FRESH = os.environ.get("HYPOTHESIS_PROFILE") == "fresh"
#: How many times as many examples as tests name are drawn then.
FACTOR = int(os.environ.get("DCP_EXAMPLES", "5"))


def examples(number: int) -> int:
    """``number`` of examples for a run that draws new ones, times ``FACTOR``.

    A run that draws the same ones each time finds nothing new by drawing many: it takes half of the number.
    """
    return number * FACTOR if FRESH else (number + 1) // 2
