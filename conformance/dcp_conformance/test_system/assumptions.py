"""Values that a case assumes because neither the implementation nor the user has stated them."""

from __future__ import annotations


class Assumptions:
    """The assumed values that one case depends on: texts for the user who can state the values, by parameter."""

    def __init__(self) -> None:
        self.expectations: dict[str, str] = {}
        """Assumed values from which an expectation is derived: with another value, the expectation may be wrong."""
        self.stimuli: dict[str, str] = {}
        """Assumed values from which a stimulus is derived: with another value, the implementation may not accept it,
        and something may be missing. Wrong records still fail."""

    def discard(self) -> None:
        """Forget ``expectations``: the verdict of the case does not depend on assumed values."""
        self.expectations.clear()

    def text(self) -> str:
        """Return the texts about expectations; empty if there are none."""
        return "; ".join(self.expectations.values())

    def text_of_all(self) -> str:
        """Return the texts about stimuli and expectations; empty if there are none."""
        return "; ".join({**self.stimuli, **self.expectations}.values())
