"""Join several sequences into one test, because preparing and checking a node takes longer than a sequence."""

from __future__ import annotations

from typing import Final

from dcp_lab.fuzz.steps import Generator, Step, Wait

#: Every n-th test waits: between its frames on a link, at its end in process.
UNHURRIED: Final = 8


class Joined:
    """Generator of tests of ``size`` sequences. The first starts in the initial state, the others in a later state."""

    def __init__(self, sequences: Generator, size: int) -> None:
        self._sequences = sequences
        self._size = size
        self.drawn = 0
        """Number of tests so far."""
        self.kinds: tuple[str, ...] = ()

    def draw(self) -> list[Step]:
        """Return the next ``size`` sequences as one test."""
        self.drawn += 1
        steps: list[Step] = []
        kinds: list[str] = []
        for _ in range(self._size):
            steps += self._sequences.draw()
            kinds += self._sequences.kinds
        self.kinds = tuple(kinds)
        return steps

    def keep(self, steps: list[Step]) -> None:
        """See :meth:`~dcp_lab.fuzz.generate.sequences.Sequences.keep`."""
        self._sequences.keep(steps)


class Batches(Joined):
    """Generator for implementations on a link: most tests have no waits, which take most of the time of a sequence."""

    def draw(self) -> list[Step]:
        """Return the next test."""
        steps = super().draw()
        if self.drawn % UNHURRIED == 0:
            return steps
        return [step for step in steps if not isinstance(step, Wait)]
