"""Several sequences as one test: what is done around a sequence takes longer than the sequence."""

from __future__ import annotations

from typing import Final

from dcp_conformance.fuzz.execute.model_monitor import WINDOW
from dcp_conformance.fuzz.steps import Generator, Step, Wait

#: Sequences in the life of a node in this process. Making one and looking whether it lives take as long as half of a
#: sequence; seeded faults are found soonest with three to eight (docs/fuzzing.md).
IN_PROCESS: Final = 4
#: One test in so many waits: between its frames on the air, in the end in process.
_UNHURRIED: Final = 8


class Joined:
    """Draws tests of ``size`` sequences: the first meets a node that knows nothing, the others one that has a past."""

    def __init__(self, sequences: Generator, size: int) -> None:
        self._sequences = sequences
        self._size = size
        self._drawn = 0
        self.kinds: tuple[str, ...] = ()

    def draw(self) -> list[Step]:
        """The next ``size`` sequences."""
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
    """The same for a stack in this process: now and then it is given the time to say all that it has to."""

    def __init__(self, sequences: Generator, size: int = IN_PROCESS) -> None:
        super().__init__(sequences, size)

    def draw(self) -> list[Step]:
        """The next test: the life of one node."""
        steps = super().draw()
        return [*steps, Wait(WINDOW + 1)] if self._drawn % _UNHURRIED == 0 else steps


class Batches(Joined):
    """The same for implementations on the air. Most is sent without pauses: they are most of the time of a sequence."""

    def draw(self) -> list[Step]:
        """The next test."""
        steps = super().draw()
        if self._drawn % _UNHURRIED == 0:
            return steps
        return [step for step in steps if not isinstance(step, Wait)]
