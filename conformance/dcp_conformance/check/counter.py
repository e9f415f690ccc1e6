"""Count how often a reaction was due and was missing."""

from __future__ import annotations

from .statements import Statement

#: From ``_OCCASIONS`` occasions on, at least the share ``_MISSED`` must be missed for a verdict. With fewer occasions,
#: but at least ``_FEWEST``, all of them must be missed.
_OCCASIONS, _MISSED, _FEWEST = 5, 0.8, 4


class Counter:
    """Numbers of occasions and of missed ones, with the causes of the first three that were missed."""

    def __init__(self) -> None:
        self.occasions = self.missed = 0
        self.examples: list[Statement] = []

    def note(self, cause: Statement, *, missed: bool) -> None:
        """Count an occasion; ``cause`` is the record that gave it."""
        self.occasions += 1
        if missed:
            self.missed += 1
            if len(self.examples) < 3:
                self.examples.append(cause)

    @property
    def convincing(self) -> bool:
        """Whether enough occasions were missed to rule out an exception."""
        if self.occasions < _OCCASIONS:
            return self.missed == self.occasions >= _FEWEST
        return self.missed >= _MISSED * self.occasions
