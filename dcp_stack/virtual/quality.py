"""The quality of a connection of the simulated medium."""

from __future__ import annotations

import functools
import random

import msgspec

from dcp_codec.impairment import Impairment


class Quality(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The losses, duplicates, delays and bit errors of a directed connection. Probabilities are 0..1, times in ns.

    A delay is ``delay`` plus a uniform part of ``jitter``. Frames are not kept in order: a frame with a shorter delay
    can overtake another. ``reorder`` is the probability of an additional delay of ``reorder_delay``. Both frames of a
    duplicate have independent delays.

    Losses are independent (``burst`` 0), or occur in bursts with a mean of ``burst`` frames. ``corrupt`` is the
    probability, for each octet, that one of its bits is inverted; ``corrupt_frames`` is the share of frames in which
    ``flips`` bits are inverted. Bursts and corruption are those of :class:`dcp_codec.impairment.Impairment`.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    delay: int = 0
    jitter: int = 0
    reorder_delay: int = 50_000_000
    burst: float = 0.0
    corrupt: float = 0.0
    corrupt_frames: float = 0.0
    flips: int = 1

    def __post_init__(self) -> None:
        """Raises ``ValueError`` for a probability outside 0..1, a negative time, or an impossible burst."""
        for name in ("loss", "duplicate", "reorder"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} {getattr(self, name)} is not within 0..1")
        for name in ("delay", "jitter", "reorder_delay"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} {getattr(self, name)} ns is negative")
        self.channel()

    @property
    def uniform(self) -> bool:
        """Whether all frames that are not lost arrive once, unchanged and with the same delay."""
        return not (self.duplicate or self.reorder or self.jitter or self.has_memory)

    @property
    def has_memory(self) -> bool:
        """Whether each connection needs a state of its own: for bursts of losses, and for corruption."""
        return bool(self.burst or self.corrupt or self.corrupt_frames)

    def channel(self) -> Impairment:
        """Return loss and corruption as an impairment, without delays. Raises ``ImpairmentError`` (a ValueError)."""
        return _impairment(self.loss, self.burst, self.corrupt, self.corrupt_frames, self.flips)

    def draw(self, generator: random.Random) -> int:
        """Draw the delay of one frame in ns."""
        delay = self.delay + (generator.randrange(self.jitter + 1) if self.jitter else 0)
        if self.reorder and generator.random() < self.reorder:
            delay += self.reorder_delay
        return delay


@functools.lru_cache(maxsize=1024)
def _impairment(loss: float, burst: float, corrupt: float, corrupt_frames: float, flips: int) -> Impairment:
    return Impairment(loss=loss, burst=burst, corrupt=corrupt, corrupt_frames=corrupt_frames, flips=flips)


PERFECT = Quality()
