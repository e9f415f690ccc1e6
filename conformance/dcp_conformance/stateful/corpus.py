"""The sequences that every run executes: drawn with Hypothesis once, selected, and kept as data.

So they are the same for everyone, whatever the version of Hypothesis, and drawing costs nothing.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from importlib import resources

import msgspec

from .steps import Call, Records, Report, Step, Wait

#: A parameter on which the times of the tester depend.
_PERIOD = "BPPAR_BEACON_PERIOD"
#: Most variables or neighbours at once: an implementation may have room for few.
_TOGETHER = 6


class Sequence(msgspec.Struct, frozen=True, omit_defaults=True):
    """A sequence of steps, what it is about, and the requirements that its services decide."""

    theme: str
    steps: tuple[Step, ...]
    requirements: tuple[str, ...] = ()

    @property
    def methods(self) -> tuple[str, ...]:
        """The services that it calls, and those that undo its changes."""
        called = [each.method for each in self.steps if isinstance(each, Call)]
        undoing = [each.replace("-Deactivate", "-Activate") for each in called]
        return tuple(dict.fromkeys((*called, *undoing)))

    @property
    def periods(self) -> float:
        """How long it takes at least, in beacon periods."""
        return sum(each.periods for each in self.steps if isinstance(each, Wait))


class Corpus(msgspec.Struct, frozen=True):
    """The file of sequences."""

    seeds: tuple[int, ...]
    sequences: tuple[Sequence, ...]


@cache
def corpus() -> Corpus:
    """Return the sequences of a run."""
    data = resources.files("dcp_conformance").joinpath("data", "model-sequences.json").read_bytes()
    return msgspec.json.decode(data, type=Corpus)


def usable(steps: tuple[Step, ...], longest: float) -> bool:
    """Return whether a sequence suits any implementation: short, and without an effect on the tester's own times."""
    return (
        sum(each.periods for each in steps if isinstance(each, Wait)) <= longest
        and all(not isinstance(each, Call) or each.params.get("name") != _PERIOD for each in steps)
        and sum(each.times for each in steps if isinstance(each, Call)) <= 400
        and not any(
            isinstance(block, Records | Report) and block.count > _TOGETHER
            for each in steps
            for block in getattr(each, "blocks", ())
        )
    )


def selected(
    drawn: list[tuple[Sequence, frozenset[tuple[str, str]]]],
    most: int,
    reached: frozenset[tuple[str, str]] = frozenset(),
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
