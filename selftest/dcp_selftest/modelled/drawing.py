"""Draw the sequences of ``data/model-sequences.json`` on the reference node in virtual time."""

from __future__ import annotations

from collections.abc import Callable

from dcp_conformance.stateful.corpus import Corpus, Sequence, selected, usable
from dcp_conformance.stateful.driver import Driver
from dcp_conformance.stateful.executor import Executor
from dcp_conformance.stateful.machine import NodeMachine
from dcp_conformance.stateful.search import search

#: Longest sequence that a run executes, in beacon periods and in steps.
_LONGEST = 60.0
_STEPS = 10


def drawn(make: Callable[[], Executor], before: Corpus, *, seed: int, sequences: int, most: int) -> Corpus:
    """Draw ``sequences`` sequences, and add up to ``most`` of them. Raises the counterexample if there is one.

    Those of ``before`` remain in their places, so that the cases keep their identifiers.
    """
    reached: set[tuple[str, str]] = set()
    for each in before.sequences:
        driver = Driver(make())
        driver.run(each.steps)
        reached |= driver.pairs
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
    added = selected(list(found.values()), most, frozenset(reached))
    every = sorted((*before.sequences, *added), key=lambda each: each.theme)
    return Corpus((*before.seeds, seed), tuple(every))
