"""Sequence numbers of variables (protocol reference C.1), independent of any implementation."""

from __future__ import annotations


class Circle:
    """Numbers modulo ``2^(8 width)``; ``newer`` and ``older`` are both false for equal and for opposite numbers."""

    def __init__(self, width: int) -> None:
        self.modulus = 1 << (8 * width)

    def newer(self, number: int, than: int) -> bool:
        """Whether ``number`` is strictly newer: at most half the circle minus one ahead."""
        return 0 < (number - than) % self.modulus < self.modulus // 2

    def older(self, number: int, than: int) -> bool:
        """Whether ``number`` is strictly older."""
        return self.newer(than, number)
