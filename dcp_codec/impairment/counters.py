"""Counters of what a channel did to the frames of one direction."""

from __future__ import annotations

import msgspec


class Counters(msgspec.Struct, kw_only=True):
    """Numbers of frames; times in ns. With no frame under way, ``offered + duplicated = delivered + lost + down``."""

    offered: int = 0
    delivered: int = 0
    """Copies that were delivered to the receiver."""
    lost: int = 0
    """Frames that were lost at random."""
    bursts: int = 0
    """Number of runs of consecutive lost frames; ``lost / bursts`` is their mean length."""
    down: int = 0
    """Frames that were sent while the link was down."""
    duplicated: int = 0
    reordered: int = 0
    """Frames that were held back."""
    corrupted: int = 0
    """Frames in which at least one bit was inverted."""
    flipped: int = 0
    """Inverted bits, in all frames together."""
    octets: int = 0
    """Octets that could have been corrupted."""
    copies: int = 0
    """Copies that were not lost."""
    delay: int = 0
    """Sum of the delays of all copies that were not held back, in ns."""
    delayed: int = 0
    """Number of copies whose delay is in ``delay``."""

    @property
    def loss(self) -> float:
        """Return the measured share of random losses; 0 before the first frame."""
        return self.lost / self.offered if self.offered else 0.0

    @property
    def mean_burst(self) -> float:
        """Return the measured mean length of bursts in frames; 0 without losses."""
        return self.lost / self.bursts if self.bursts else 0.0

    @property
    def mean_delay(self) -> float:
        """Return the measured mean delay in ns of copies that were not held back; 0 if there are none."""
        return self.delay / self.delayed if self.delayed else 0.0
