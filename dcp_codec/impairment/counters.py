"""What became of the frames of one direction, in numbers."""

from __future__ import annotations

import msgspec


class Counters(msgspec.Struct, kw_only=True):
    """Numbers of frames; times in ns. ``offered + duplicated = delivered + lost + down`` once nothing is under way."""

    offered: int = 0
    delivered: int = 0
    """Copies that were handed to the receiving side."""
    lost: int = 0
    """Frames that were lost by chance."""
    bursts: int = 0
    """Runs of frames that were lost one after the other; ``lost / bursts`` is their mean length."""
    down: int = 0
    """Frames that met a link that was down."""
    duplicated: int = 0
    reordered: int = 0
    """Frames that were held back."""
    corrupted: int = 0
    """Frames in which at least one bit was inverted."""
    flipped: int = 0
    """Inverted bits."""
    octets: int = 0
    """Octets that could have been corrupted."""
    copies: int = 0
    """Copies that were not lost, and whose delays are summed up in ``delay``."""
    delay: int = 0
    """Sum of the delays of all copies that were not held back."""
    delayed: int = 0
    """Number of these copies."""

    @property
    def loss(self) -> float:
        """The realised share of losses by chance; 0 before the first frame."""
        return self.lost / self.offered if self.offered else 0.0

    @property
    def mean_burst(self) -> float:
        """The realised mean length of bursts in frames; 0 without losses."""
        return self.lost / self.bursts if self.bursts else 0.0

    @property
    def mean_delay(self) -> float:
        """The realised mean delay in ns of copies that were not held back; 0 without any."""
        return self.delay / self.delayed if self.delayed else 0.0
