"""How often something was due and did not come."""

from __future__ import annotations

from .statements import Statement

#: Of so many occasions this part must be missed for a verdict; of fewer, down to the last number, every one.
_OCCASIONS, _MISSED, _FEWEST = 5, 0.8, 4


class Counter:
    """Of how many occasions how many were missed, with examples."""

    def __init__(self) -> None:
        self.occasions = self.missed = 0
        self.examples: list[Statement] = []

    def note(self, cause: Statement, *, missed: bool) -> None:
        """One more occasion."""
        self.occasions += 1
        if missed:
            self.missed += 1
            if len(self.examples) < 3:
                self.examples.append(cause)

    @property
    def convincing(self) -> bool:
        """Whether it is the rule and no exception."""
        if self.occasions < _OCCASIONS:
            return self.missed == self.occasions >= _FEWEST
        return self.missed >= _MISSED * self.occasions
