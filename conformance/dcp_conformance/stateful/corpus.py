"""The sequences that every run executes: drawn with Hypothesis once, selected, and kept as data.

So they are the same for everyone, whatever the version of Hypothesis, and drawing costs nothing.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

import msgspec

from .steps import Call, Step, Wait


class Sequence(msgspec.Struct, frozen=True, omit_defaults=True):
    """A sequence of steps, what it is about, and the requirements that its services decide."""

    theme: str
    steps: tuple[Step, ...]
    requirements: tuple[str, ...] = ()
    long: bool = False
    """Only with the long plan: other sequences find the same faults, and all together take a fifth of a run."""

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
