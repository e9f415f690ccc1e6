"""The steps by which an implementation increases the sequence numbers of its beacons."""

from __future__ import annotations

from collections import Counter
from typing import Final

from dcp_spec.constants import BP_SEQNO_MODULUS

#: An implementation uses a step as its usual one if it was received this many times, and this many times as often as 1.
_STEPS: Final = 5


class Counting:
    """The differences between the sequence numbers of beacons received in succession, for a whole run."""

    def __init__(self) -> None:
        self._steps: Counter[int] = Counter()
        self._last: int | None = None

    def heard(self, seqno: int | None) -> None:
        """Take the sequence number of the next beacon into account; None if it cannot be read."""
        if seqno is not None and self._last is not None:
            self._steps[(seqno - self._last) % BP_SEQNO_MODULUS] += 1
        self._last = seqno

    def by(self, step: int) -> bool:
        """Return whether the implementation itself increases its numbers by ``step``: hardly any are consecutive."""
        return self._steps[step] >= _STEPS and self._steps[step] > _STEPS * self._steps[1]
