"""Links between nodes, inferred from all trials together by a noisy-OR model.

A node reacts if it has heard at least one of the beacons that gave it a reason. If p(Y, X) is the probability that Y
receives a beacon of X, the probability of a reaction is 1 - (1 - p(Y, X1))^n1 (1 - p(Y, X2))^n2 ... for the senders
X1, X2, ... of the trial and the numbers n1, n2, ... of their beacons. (A summary is repeated in each beacon, and a
node that sends few beacons has heard one of many before its next beacon; a create is sent once.) Expectation
maximisation finds the values of p that explain the outcomes best (Dempster, Laird and Rubin 1977; Heckerman 1990 for
causal independence).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from .following import Exposure

#: Iterations of expectation maximisation, and the smallest probability that is computed with.
_ROUNDS, _FLOOR = 25, 1e-9
#: A probability that makes no difference beside 1.
_NOTHING = 1e-17
#: Standard deviations between an estimate and its lower bound: a one-sided confidence level of 95 %.
CAUTION = 1.64
#: A link has ended if after its last reactions there were this many trials in windows with a share below ``_GONE``.
_TRIALS, _GONE = 10, 0.1
#: Minimum number of reactions to a speaker alone that prove a link.
ALONE = 2
#: In 5 % of the windows, the lower bound is positive by chance. If it is positive in less than ``_BY_CHANCE`` of the
#: windows, these show the link only if the node has reacted at least ``ALONE`` times to the speaker alone, and in at
#: least ``_OFTEN`` of the trials with the speaker alone. Otherwise only windows with ``ALONE`` such reactions show it.
_BY_CHANCE, _OFTEN = 0.1, 0.2

Outcomes = Mapping[Exposure, tuple[int, int]]
"""Senders with the numbers of their beacons -> number of trials without a reaction, and with one."""


class Link(NamedTuple):
    """The inferred reception of one node by another in one window of time."""

    listener: bytes
    speaker: bytes
    begin: int
    """Start of the window, ns since 1970 by the recorder's clock."""
    end: int
    """End of the window, ns since 1970 by the recorder's clock."""
    share: float
    """Estimated share of the speaker's beacons that the listener receives, 0..1."""
    trials: int
    """Number of trials with the speaker among the senders."""
    reactions: float
    """Estimated number of reactions that this speaker caused."""
    at_least: float
    """Lower bound of the share, with a confidence of 95 %."""
    alone: int
    """Number of reactions in trials with this speaker as the only sender."""
    alone_of: int
    """Number of these trials."""


@functools.lru_cache(maxsize=1 << 16)
def bits(mask: int) -> tuple[int, ...]:
    """Return the bits of a mask, each as a mask with one bit. Cached: the same few masks occur often."""
    found = []
    while mask:
        low = mask & -mask
        found.append(low)
        mask ^= low
    return tuple(found)


def reacts(exposure: Exposure, shares: Mapping[int, float]) -> float:
    """Return the probability of a reaction to these beacons; ``shares`` has those of single beacons."""
    silent = 1.0
    for bit, count in exposure:
        silent *= (1.0 - shares.get(bit, 0.0)) ** count
    return 1.0 - silent


def without(exposure: Exposure, bit: int) -> Exposure:
    """Return the beacons of the other speakers."""
    return tuple(each for each in exposure if each[0] != bit)


class Inference:
    """The probabilities that explain the outcomes of all trials of one node best."""

    def __init__(self, outcomes: Outcomes) -> None:
        """Infer the shares."""
        self._outcomes = [(exposure, missed, hit) for exposure, (missed, hit) in outcomes.items()]
        self.trials: dict[int, int] = {}
        """Speaker (a bit) -> number of trials with it."""
        self.alone: dict[int, int] = {}
        """Speaker -> number of reactions to it alone; none: 0."""
        self.alone_of: dict[int, int] = {}
        """Speaker -> number of trials with it alone; none: 0."""
        self._of: dict[int, list[tuple[int, int]]] = {}
        """Speaker -> places in ``_outcomes`` of the trials with it, each with the number of its beacons."""
        for place, (exposure, missed, hit) in enumerate(self._outcomes):
            for bit, count in exposure:
                self.trials[bit] = self.trials.get(bit, 0) + missed + hit
                self._of.setdefault(bit, []).append((place, count))
            if len(exposure) == 1:
                bit = exposure[0][0]
                self.alone[bit] = self.alone.get(bit, 0) + hit
                self.alone_of[bit] = self.alone_of.get(bit, 0) + missed + hit
        self.shares = dict.fromkeys(self.trials, 0.5)
        """Speaker -> probability that one of its beacons is heard."""
        self.due = dict.fromkeys(self.trials, 0.0)
        """Speaker -> number of reactions that it caused."""
        self._pairs = {
            each: place for place, each in enumerate({each: None for exposure in outcomes for each in exposure})
        }
        """(Speaker, number of its beacons) -> place in ``_silent``."""
        self._silent: list[float] = []
        """For each pair, the probability that the node hears none of these beacons."""
        self._whole: list[float] = []
        """For each outcome, the probability that the node hears none of the beacons."""
        self._infer()

    def _infer(self) -> None:
        """Find the shares by expectation maximisation."""
        # In each round, the loops over all trials are left to built-in functions.
        hits: dict[tuple[int, int], list[int]] = {}
        for place, (exposure, _, hit) in enumerate(self._outcomes):
            for each in exposure if hit else ():
                hits.setdefault(each, []).append(place)
        pairs = [[self._pairs[each] for each in exposure] for exposure, _, _ in self._outcomes]
        counts = [hit for _, _, hit in self._outcomes]
        beacons = {
            bit: sum(count * (self._outcomes[place][1] + self._outcomes[place][2]) for place, count in of)
            for bit, of in self._of.items()
        }
        for rounds in range(_ROUNDS, -1, -1):
            self._silent = [(1.0 - self.shares[bit]) ** count for bit, count in self._pairs]
            self._whole = [math.prod(map(self._silent.__getitem__, of)) for of in pairs]
            if not rounds:
                break
            weights = [hit / max(1.0 - silent, _FLOOR) for hit, silent in zip(counts, self._whole, strict=True)]
            received = dict.fromkeys(self.shares, 0.0)
            for (bit, count), places in hits.items():
                received[bit] += count * self.shares[bit] * sum(map(weights.__getitem__, places))
            shares = {bit: min(received[bit] / count, 1.0) for bit, count in beacons.items()}
            if shares == self.shares:
                # Further rounds would not change them.
                break
            self.shares = shares
        for exposure, _, hit in self._outcomes:
            # The parts of all speakers in one reaction add up to 1.
            parts = [count * self.shares[bit] for bit, count in exposure]
            whole = max(sum(parts), _FLOOR)
            for (bit, _), part in zip(exposure, parts, strict=True):
                self.due[bit] += hit * part / whole

    def lower_bound(self, bit: int, caution: float = CAUTION) -> float:
        """Return a lower bound of the share of a speaker; 0 if other speakers explain all reactions equally well.

        It is the end of a likelihood-ratio interval: the lowest share whose log-likelihood, with the inferred shares of
        the others, is at most ``caution``^2 / 2 below the maximum. ``caution``: in standard deviations of a normal
        distribution, 1.64 for a confidence of 95 %.
        """
        terms = []
        for place, count in self._of.get(bit, ()):
            exposure, missed, hit = self._outcomes[place]
            own = self._silent[self._pairs[bit, count]]
            # Without the factor of the speaker, which may be 0.
            silent = (
                self._whole[place] / own
                if own > _FLOOR
                else math.prod([self._silent[self._pairs[each]] for each in exposure if each[0] != bit])
            )
            # A reaction that the others explain with certainty tells nothing.
            if missed or silent > _NOTHING:
                terms.append((silent, count, missed, hit))

        def log_likelihood(share: float) -> float:
            """Return the log-likelihood of the outcomes if this is the share of the speaker."""
            total = 0.0
            for silent, count, missed, hit in terms:
                rest = (1.0 - share) ** count * silent
                if missed:
                    total += missed * math.log(max(rest, _FLOOR))
                if hit:
                    total += hit * math.log(max(1.0 - rest, _FLOOR))
            return total

        best = min(max(self.shares.get(bit, 0.0), _FLOOR), 1 - 1e-6)
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
    """Return an upper bound of the probability of at most ``hits`` reactions in independent trials.

    ``expected``: sum of the probabilities of all trials, which may differ. It is the Chernoff-Hoeffding bound
    exp(-n D(hits/n || expected/n)) with n = ``trials`` and D as the Kullback-Leibler divergence.
    """
    if trials == 0 or expected <= hits:
        return 1.0
    seen, mean = hits / trials, min(expected / trials, 1 - 1e-6)
    distance = (1 - seen) * math.log((1 - seen) / (1 - mean)) if seen < 1 else 0.0
    if seen:
        distance += seen * math.log(seen / mean)
    return math.exp(-trials * distance)


class Whole(NamedTuple):
    """The inferred reception of one node by another in the whole recording."""

    share: float
    """Mean share of all windows, weighted by their trials, 0..1."""
    at_least: float
    """Largest lower bound of the windows that show the link."""
    alone: int
    """Number of reactions, in these windows, in trials with this speaker as the only sender."""
    trials: int
    reactions: float
    """Estimated number of reactions that this speaker caused."""
    end: int
    """End of the last window with proof of reception, ns since 1970."""
    lasts: bool
    """False if enough trials after ``end`` show that the link has ended."""


def summary(links: Iterable[Link]) -> dict[tuple[bytes, bytes], Whole]:
    """Combine the windows of each pair (listener, speaker)."""
    of: dict[tuple[bytes, bytes], list[Link]] = {}
    for link in links:
        of.setdefault((link.listener, link.speaker), []).append(link)
    return {pair: _whole(each) for pair, each in of.items()}


def _whole(links: list[Link]) -> Whole:
    """Combine the windows of one pair, in order of time."""
    trials = sum(link.trials for link in links)
    share = sum(link.share * link.trials for link in links) / trials
    shown = [link for link in links if link.at_least > 0]
    alone = sum(link.alone for link in shown)
    often = alone >= max(ALONE, _OFTEN * sum(link.alone_of for link in links))
    if len(shown) < _BY_CHANCE * len(links) and not often:
        shown = [link for link in shown if link.alone >= ALONE]
    end = shown[-1].end if shown else links[-1].end
    after = links[links.index(shown[-1]) + 1 :] if shown else []
    silent = sum(link.trials for link in after if link.share < _GONE)
    return Whole(
        share,
        max((link.at_least for link in shown), default=0.0),
        sum(link.alone for link in shown),
        trials,
        sum(link.reactions for link in links),
        end,
        silent < _TRIALS,
    )
