"""Draw the sequences of ``data/model-sequences.json`` on the reference node in virtual time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from dcp_conformance.stateful.corpus import Corpus, Sequence
from dcp_conformance.stateful.driver import Driver
from dcp_conformance.stateful.executor import Executor
from dcp_conformance.stateful.machine import NodeMachine
from dcp_conformance.stateful.search import search
from dcp_conformance.stateful.steps import Call, Records, Report, Step, Wait

#: Longest sequence that a run executes, in beacon periods and in steps.
_LONGEST = 60.0
_STEPS = 10
#: A parameter on which the times of the tester depend.
_PERIOD = "BPPAR_BEACON_PERIOD"
#: Most variables or neighbours at once: an implementation may have room for few.
_TOGETHER = 6


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
            if steps and _usable(steps):
                decided = tuple(self.driver.decided) or ("BP-RX-16",)
                found[repr(steps)] = Sequence(self.title, steps, decided), frozenset(self.driver.pairs)

    result = search(make, sequences=sequences, steps=_STEPS, seed=seed, shrink=False, machine=Drawing)
    if result.counterexample is not None:
        raise result.counterexample
    added = _selected(list(found.values()), most, frozenset(reached))
    every = sorted((*before.sequences, *added), key=lambda each: each.theme)
    return Corpus((*before.seeds, seed), tuple(every))


def _usable(steps: tuple[Step, ...]) -> bool:
    """Return whether a sequence suits any implementation: short, and without an effect on the tester's own times."""
    return (
        sum(each.periods for each in steps if isinstance(each, Wait)) <= _LONGEST
        and all(not isinstance(each, Call) or each.params.get("name") != _PERIOD for each in steps)
        and sum(each.times for each in steps if isinstance(each, Call)) <= 400
        and not any(
            isinstance(block, Records | Report) and block.count > _TOGETHER
            for each in steps
            for block in getattr(each, "blocks", ())
        )
    )


def _selected(
    drawn: list[tuple[Sequence, frozenset[tuple[str, str]]]],
    most: int,
    reached: frozenset[tuple[str, str]],
) -> list[Sequence]:
    """Return up to ``most`` sequences that together reach the most pairs of state and event beside ``reached``."""
    rarity: Counter[tuple[str, str]] = Counter()
    for _, pairs in drawn:
        rarity.update(pairs)
    left = list(drawn)
    chosen: list[Sequence] = []
    seen = set(reached)
    while left and len(chosen) < most:
        best = max(left, key=lambda each: sum(1 / rarity[pair] for pair in sorted(each[1] - seen)))
        if not best[1] - seen:
            break
        left.remove(best)
        seen |= best[1]
        chosen.append(best[0])
    return chosen
