"""Draw the sequences of ``data/model-sequences.json`` on the reference node in virtual time."""

from __future__ import annotations

from collections.abc import Callable

from .corpus import Corpus, Sequence, selected, usable
from .executor import Executor
from .machine import NodeMachine
from .search import search

#: Longest sequence that a run executes, in beacon periods and in steps.
_LONGEST = 40.0
_STEPS = 9


def drawn(make: Callable[[], Executor], *, seed: int, sequences: int, most: int) -> Corpus:
    """Draw ``sequences`` sequences, and select up to ``most`` of them. Raises the counterexample if there is one."""
    found: dict[str, tuple[Sequence, frozenset[tuple[str, str]]]] = {}

    class Drawing(NodeMachine):
        def teardown(self) -> None:
            super().teardown()
            steps = tuple(self.driver.steps)
            if steps and usable(steps, _LONGEST):
                decided = tuple(self.driver.decided) or ("BP-RX-16",)
                found[repr(steps)] = Sequence(self.title, steps, decided), frozenset(self.driver.pairs)

    result = search(make, sequences=sequences, steps=_STEPS, seed=seed, shrink=False, machine=Drawing)
    if result.counterexample is not None:
        raise result.counterexample
    return Corpus(seed, tuple(selected(list(found.values()), most)))
