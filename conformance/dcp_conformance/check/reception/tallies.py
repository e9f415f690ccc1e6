"""Tallies: expected and observed reactions of one kind at one node."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from dcp_conformance.check.statements import Statement

from .links import chance

#: The probability that a link which was up before and after a time was up at that time.
UP = 0.9
#: A shortage needs at least ``_EXPECTED`` expected reactions, of which at most the share ``_SHARE`` occurred.
_EXPECTED, _SHARE = 3.0, 0.25
#: The verdict pass is withheld if at least ``_MANY`` reactions were expected and at most the share ``_FEW`` occurred.
_MANY, _FEW = 5.0, 0.1
#: Number of records that are kept as examples of a shortage.
_EXAMPLES = 3


@dataclass(slots=True)
class Gap:
    """The trials of a group between two reactions that prove reception; the link may have been down in between."""

    best: float = 0.0
    """The largest probability of a reaction to one of the trials."""
    silent: float = 1.0
    """The probability of no reaction to any of them, if the trials are independent."""
    steady: bool = True
    """Whether all links that the trials rest on have hardly ever failed."""
    hit: bool = False
    """Whether the node reacted to one of the trials."""
    speakers: int = 0
    """The senders of records without a reaction, as a mask of bits."""
    late_half: bool = True
    """Whether all records without a reaction were in the second half of their payload."""
    shortest: int = 1 << 31
    """Length of the shortest payload without a reaction, in octets."""
    cause: Statement | None = None
    """The first record without a reaction."""

    def add(self, expected: float, *, steady: bool) -> None:
        """Add a trial with this probability of a reaction; ``steady``: its link has hardly ever failed."""
        self.best = max(self.best, expected)
        self.silent *= 1.0 - expected
        self.steady = self.steady and steady

    @property
    def expected(self) -> float:
        """The probability of at least one reaction; for a steady link limited by the probability that it is up."""
        return max(self.best, min(1.0 - self.silent, UP)) if self.steady else self.best


@dataclass(slots=True)
class Tally:
    """Expected and observed reactions of a group since the last window in which the node reacted as required."""

    trials: int = 0
    """Number of gaps: all trials between two reactions that prove reception count as one."""
    hits: int = 0
    """Number of gaps with a reaction."""
    expected: float = 0.0
    """Expected number of gaps with a reaction."""
    silence: float = 1.0
    """The probability that none of these gaps has a reaction."""
    steady: bool = True
    """Whether all links that this rests on have hardly ever failed."""
    all_trials: int = 0
    """Number of single trials, including those without proof of reception."""
    all_hits: int = 0
    """Number of reactions to single trials."""
    all_expected: float = 0.0
    """Expected number of reactions to single trials."""
    examples: list[Statement] = field(default_factory=list)
    """The first records without a reaction."""
    speakers: int = 0
    """The senders of records without a reaction, as a mask of bits."""
    late_half: bool = True
    """Whether all records without a reaction were in the second half of their payload."""
    shortest: int = 1 << 31
    """Length of the shortest payload without a reaction, in octets."""

    def add(self, gaps: Iterable[Gap]) -> None:
        """Count gaps; only those without any reaction contribute examples."""
        for gap in gaps:
            self.trials += 1
            self.hits += gap.hit
            self.expected += gap.expected
            self.silence *= 1.0 - gap.expected
            self.steady = self.steady and gap.steady
            if gap.cause is not None and not gap.hit:
                self.speakers |= gap.speakers
                self.late_half = self.late_half and gap.late_half
                self.shortest = min(self.shortest, gap.shortest)
                if len(self.examples) < _EXAMPLES:
                    self.examples.append(gap.cause)

    @property
    def short(self) -> bool:
        """Whether far fewer reactions than expected occurred while reception was proved."""
        return self.expected >= _EXPECTED and self.hits <= _SHARE * self.expected

    @property
    def doubtful(self) -> bool:
        """Whether far fewer reactions than expected occurred, assuming that the links were as good as on average."""
        return self.all_expected >= _MANY and self.all_hits <= _FEW * self.all_expected

    @property
    def chance(self) -> float:
        """An upper bound of the probability of this tally for a conforming node."""
        if self.hits == 0:
            # The exact probability: the bound is wide if trials differ.
            return self.silence
        return chance(self.trials, self.expected, self.hits)
