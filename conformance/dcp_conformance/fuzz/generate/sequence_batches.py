"""Join several sequences into one test, because preparing and checking a node takes longer than a sequence."""

from __future__ import annotations

from typing import Final

from dcp_conformance.fuzz.execute.model_monitor import WINDOW
from dcp_conformance.fuzz.steps import Generator, Step, Wait

#: Sequences for one node in this process. Making a node and checking that it is alive take half of the time of a
#: sequence; seeded faults are found fastest with three to eight sequences (docs/fuzzing.md).
IN_PROCESS: Final = 4
#: Every n-th test waits: between its frames on a link, at its end in process.
_UNHURRIED: Final = 8


class Joined:
    """Generator of tests of ``size`` sequences. The first starts in the initial state, the others in a later state."""

    def __init__(self, sequences: Generator, size: int) -> None:
        self._sequences = sequences
        self._size = size
        self._drawn = 0
        self.kinds: tuple[str, ...] = ()

    def draw(self) -> list[Step]:
        """Return the next ``size`` sequences as one test."""
        self._drawn += 1
        steps: list[Step] = []
        kinds: list[str] = []
        for _ in range(self._size):
            steps += self._sequences.draw()
            kinds += self._sequences.kinds
        self.kinds = tuple(kinds)
        return steps

    def keep(self, steps: list[Step]) -> None:
        """See :meth:`~dcp_conformance.fuzz.generate.sequences.Sequences.keep`."""
        self._sequences.keep(steps)


class Lifetimes(Joined):
    """Generator for a stack in this process: some tests end with a wait, so that the node can send all its records."""

    def __init__(self, sequences: Generator, size: int = IN_PROCESS) -> None:
        super().__init__(sequences, size)

    def draw(self) -> list[Step]:
        """Return the next test, for one new node."""
        steps = super().draw()
        return [*steps, Wait(WINDOW + 1)] if self._drawn % _UNHURRIED == 0 else steps


class Batches(Joined):
    """Generator for implementations on a link: most tests have no waits, which take most of the time of a sequence."""

    def draw(self) -> list[Step]:
        """Return the next test."""
        steps = super().draw()
        if self._drawn % _UNHURRIED == 0:
            return steps
        return [step for step in steps if not isinstance(step, Wait)]
