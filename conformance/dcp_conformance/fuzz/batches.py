"""Several sequences as one test, for implementations on the air: looking whether one lives takes longer than they."""

from __future__ import annotations

from typing import Final

from .sequences import Joined, Sequences
from .steps import Step, Wait

#: One test in so many waits between its frames.
_UNHURRIED: Final = 8


class Batches:
    """Draws tests of ``size`` sequences. Most are sent without a pause, which is most of the time of a sequence."""

    def __init__(self, sequences: Sequences, size: int) -> None:
        self._joined = Joined(sequences, size)
        self._drawn = 0
        self.last = ""

    def draw(self) -> list[Step]:
        """The next test."""
        steps = self._joined.draw()
        self._drawn += 1
        if self._drawn % _UNHURRIED == 0:
            self.last = "with pauses"
            return steps
        self.last = "without pauses"
        return [step for step in steps if not isinstance(step, Wait)]

    def keep(self, steps: list[Step]) -> None:
        """See :meth:`~.sequences.Sequences.keep`."""
        self._joined.keep(steps)
