"""Tests of several sequences for one new node in this process."""

from __future__ import annotations

from typing import Final

from dcp_lab.fuzz.generate.sequence_batches import UNHURRIED, Joined
from dcp_lab.fuzz.steps import Generator, Step, Wait

#: Sequences for one node in this process. Making a node and checking that it is alive take half of the time of a
#: sequence; seeded faults are found fastest with three to eight sequences (docs/fuzzing.md).
IN_PROCESS: Final = 4


class Lifetimes(Joined):
    """Generator for a stack in this process: some tests end with a wait, so that the node can send all its records."""

    def __init__(self, sequences: Generator, size: int = IN_PROCESS) -> None:
        super().__init__(sequences, size)

    def draw(self) -> list[Step]:
        """Return the next test, for one new node."""
        steps = super().draw()
        return [*steps, Wait(9.0)] if self.drawn % UNHURRIED == 0 else steps
