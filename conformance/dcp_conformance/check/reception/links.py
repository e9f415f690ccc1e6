"""Who hears whom: inferred from all trials together, as a noisy OR.

A node reacts if it has heard at least one of the beacons that gave it a reason to. With p(Y, X) as the probability that
Y gets a beacon of X, a reaction has the probability 1 - (1 - p(Y, X1))^n1 (1 - p(Y, X2))^n2 ... for the speakers X1,
X2, ... of the trial and the numbers of their beacons n1, n2, ...: a summary is repeated in each beacon, and a node that
sends few beacons has heard one of many before its next one, while a create is said once. Expectation maximisation finds
the p that explain the outcomes best (Dempster, Laird and Rubin 1977; Heckerman 1990 for causal independence).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from .following import Exposure

_ROUNDS, _FLOOR = 25, 1e-9
#: Standard deviations by which a probability is taken lower than it looks: 5 % of all are lower still.
CAUTION = 1.64
#: After so many trials with a share below this a link is no more.
_TRIALS, _GONE = 10, 0.1

Outcomes = Mapping[Exposure, tuple[int, int]]
"""Speakers and the numbers of their beacons -> trials that were missed, and that were not."""


class Link(NamedTuple):
    """That one node hears another, for a while."""

    listener: bytes
    speaker: bytes
    begin: int
    end: int
    """ns since 1970, as the recorder's clock had it."""
    share: float
    """The part of the speaker's beacons that the listener reacts to, 0..1."""
    trials: int
    """How often the speaker was among those who gave the listener a reason."""
    reactions: float
    """How many reactions are due to this speaker, as far as that can be told."""
    at_least: float
    """A lower bound of the share, which holds in 95 of 100 cases."""
    alone: int
    """Reactions to this speaker alone."""


@functools.lru_cache(maxsize=1 << 16)
def bits(mask: int) -> tuple[int, ...]:
    """The bits that are set, as masks. The same few masks are asked for again and again."""
    found = []
    while mask:
        low = mask & -mask
        found.append(low)
        mask ^= low
    return tuple(found)


def infer(outcomes: Outcomes) -> dict[int, tuple[float, int, float]]:
    """For each speaker (a bit): the probability to be heard, its trials, and the reactions that are due to it."""
    trials: dict[int, int] = {}
    beacons: dict[int, int] = {}
    for exposure, (missed, hit) in outcomes.items():
        for bit, count in exposure:
            trials[bit] = trials.get(bit, 0) + missed + hit
            beacons[bit] = beacons.get(bit, 0) + (missed + hit) * count
    shares = dict.fromkeys(trials, 0.5)
    received: dict[int, float] = {}
    hits = [(exposure, hit) for exposure, (_, hit) in outcomes.items() if hit]
    for _ in range(_ROUNDS):
        received = dict.fromkeys(trials, 0.0)
        for exposure, hit in hits:
            reaction = max(reacts(exposure, shares), _FLOOR)
            for bit, count in exposure:
                received[bit] += hit * count * shares[bit] / reaction
        shares = {bit: min(received[bit] / count, 1.0) for bit, count in beacons.items()}
    due = dict.fromkeys(trials, 0.0)
    for exposure, hit in hits:
        # Of one reaction, the part of each speaker: together they are one.
        parts = [count * shares[bit] for bit, count in exposure]
        whole = max(sum(parts), _FLOOR)
        for (bit, _), part in zip(exposure, parts, strict=True):
            due[bit] += hit * part / whole
    return {bit: (shares[bit], count, due[bit]) for bit, count in trials.items()}


def reacts(exposure: Exposure, shares: Mapping[int, float]) -> float:
    """The probability of a reaction to these beacons."""
    silent = 1.0
    for bit, count in exposure:
        silent *= (1.0 - shares.get(bit, 0.0)) ** count
    return 1.0 - silent


def without(exposure: Exposure, bit: int) -> Exposure:
    """The beacons of the other speakers."""
    return tuple(each for each in exposure if each[0] != bit)


def hits_alone(bit: int, outcomes: Outcomes) -> int:
    """Reactions to a speaker alone."""
    return sum(hit for exposure, (_, hit) in outcomes.items() if len(exposure) == 1 and exposure[0][0] == bit)


def lower_bound(bit: int, outcomes: Outcomes, shares: Mapping[int, float], caution: float = CAUTION) -> float:
    """What the share of a speaker is at least; 0 where others explain all reactions as well.

    The lowest share whose likelihood, with all others as they were inferred, is not much smaller than the largest.
    ``caution``: in standard deviations of a normal distribution, 1.64 for 95 of 100 cases.
    """
    terms = [
        (1.0 - reacts(without(exposure, bit), shares), count, missed, hit)
        for exposure, (missed, hit) in outcomes.items()
        for speaker, count in exposure
        if speaker == bit
    ]

    def log_likelihood(share: float) -> float:
        total = 0.0
        for silent, count, missed, hit in terms:
            rest = (1.0 - share) ** count * silent
            if missed:
                total += missed * math.log(max(rest, _FLOOR))
            if hit:
                total += hit * math.log(max(1.0 - rest, _FLOOR))
        return total

    best = min(max(shares.get(bit, 0.0), _FLOOR), 1 - 1e-6)
    needed = log_likelihood(best) - caution * caution / 2
    low, high = 0.0, best
    if log_likelihood(_FLOOR) >= needed:
        return 0.0
    for _ in range(12):
        middle = (low + high) / 2
        if log_likelihood(middle) >= needed:
            high = middle
        else:
            low = middle
    return low


def chance(trials: int, expected: float, hits: int) -> float:
    """A bound of the probability of ``hits`` or fewer in trials that differ, where ``expected`` is the sum of theirs.

    The bound of Hoeffding and Chernoff: exp(-n D(hits/n || expected/n)).
    """
    if trials == 0 or expected <= hits:
        return 1.0
    seen, mean = hits / trials, min(expected / trials, 1 - 1e-6)
    distance = (1 - seen) * math.log((1 - seen) / (1 - mean)) if seen < 1 else 0.0
    if seen:
        distance += seen * math.log(seen / mean)
    return math.exp(-trials * distance)


class Whole(NamedTuple):
    """That one node hears another, in all of a recording."""

    share: float
    at_least: float
    alone: int
    trials: int
    reactions: float
    end: int
    """When it was last shown, ns since 1970."""
    lasts: bool
    """Whether the last that is known of it is no different from before."""


def summary(links: Iterable[Link]) -> dict[tuple[bytes, bytes], Whole]:
    """What all windows together say of each listener and speaker."""
    of: dict[tuple[bytes, bytes], list[Link]] = {}
    for link in links:
        of.setdefault((link.listener, link.speaker), []).append(link)
    return {pair: _whole(each) for pair, each in of.items()}


def _whole(links: list[Link]) -> Whole:
    trials = sum(link.trials for link in links)
    share = sum(link.share * link.trials for link in links) / trials
    shown = [link for link in links if link.at_least > 0]
    end = shown[-1].end if shown else links[-1].end
    after = links[links.index(shown[-1]) + 1 :] if shown else []
    silent = sum(link.trials for link in after if link.share < _GONE)
    return Whole(
        share,
        max((link.at_least for link in links), default=0.0),
        sum(link.alone for link in links),
        trials,
        sum(link.reactions for link in links),
        end,
        silent < _TRIALS,
    )
