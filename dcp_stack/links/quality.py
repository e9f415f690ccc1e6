"""What a connection of the simulated medium does to frames."""

from __future__ import annotations

import functools
import random
from collections.abc import Callable

import msgspec

from dcp_codec.impairment import Impairment

Delay = Callable[[random.Random], int]
"""How long a frame is under way, in ns >= 0, drawn anew for each receiver."""


class Quality(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a directed connection does to frames. Probabilities are 0..1, times in ns.

    A delay is ``delay`` plus a uniform part of ``jitter``, or what ``distribution`` draws. Frames overtake one another
    as their delays have it. ``reorder`` is the probability that a frame is held up for another ``reorder_delay``.
    Each of the two frames of a duplicate has a delay of its own.

    Losses are independent, or come in bursts of ``burst`` frames on the average (0: independent). ``corrupt`` is the
    probability, for each octet, that one of its bits is inverted; ``corrupt_frames`` the share of frames in which
    ``flips`` bits are. Both are as :class:`dcp_codec.impairment.Impairment` has them.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    delay: int = 0
    jitter: int = 0
    reorder_delay: int = 50_000_000
    distribution: Delay | None = None
    burst: float = 0.0
    corrupt: float = 0.0
    corrupt_frames: float = 0.0
    flips: int = 1

    def __post_init__(self) -> None:
        """Raises ``ValueError`` for what is no probability or no time."""
        for name in ("loss", "duplicate", "reorder"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} {getattr(self, name)} is not within 0..1")
        for name in ("delay", "jitter", "reorder_delay"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} {getattr(self, name)} ns is negative")
        self.channel()

    @property
    def uniform(self) -> bool:
        """Whether all frames that are not lost take the same time, once."""
        return not (self.duplicate or self.reorder or self.jitter or self.distribution or self.has_memory)

    @property
    def has_memory(self) -> bool:
        """Whether a connection needs a state of its own: bursts of losses, and corruption."""
        return bool(self.burst or self.corrupt or self.corrupt_frames)

    def channel(self) -> Impairment:
        """Return loss and corruption as an impairment, without delays. Raises ``ImpairmentError`` (a ValueError)."""
        return _impairment(self.loss, self.burst, self.corrupt, self.corrupt_frames, self.flips)

    def draw(self, generator: random.Random) -> int:
        """The delay of one frame in ns."""
        if self.distribution is not None:
            delay = self.distribution(generator)
        else:
            delay = self.delay + (generator.randrange(self.jitter + 1) if self.jitter else 0)
        if self.reorder and generator.random() < self.reorder:
            delay += self.reorder_delay
        return delay


@functools.lru_cache(maxsize=1024)
def _impairment(loss: float, burst: float, corrupt: float, corrupt_frames: float, flips: int) -> Impairment:
    return Impairment(loss=loss, burst=burst, corrupt=corrupt, corrupt_frames=corrupt_frames, flips=flips)


PERFECT = Quality()


def exponential(minimum: int, mean: int) -> Delay:
    """A delay of ``minimum`` and an exponential part with this mean, in ns."""
    return lambda generator: minimum + round(generator.expovariate(1.0) * mean)


def normal(mean: int, deviation: int, minimum: int = 0) -> Delay:
    """A delay with this mean and standard deviation in ns, never below ``minimum``."""
    return lambda generator: max(minimum, round(generator.gauss(mean, deviation)))
