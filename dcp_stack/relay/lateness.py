"""Statistics of the delay between deadline and transmission of frames, in bounded memory."""

from __future__ import annotations

from typing import Final

#: Width of a class in ns, and number of classes: together 40 ms.
_WIDTH: Final = 20_000
_CLASSES: Final = 2000


class Lateness:
    """A histogram of the times between deadline and transmission."""

    def __init__(self) -> None:
        self._counts = [0] * (_CLASSES + 1)
        self._most = 0

    def add(self, late: int) -> None:
        """Count a frame that was sent ``late`` ns after its deadline."""
        self._counts[min(max(late, 0) // _WIDTH, _CLASSES)] += 1
        self._most = max(self._most, late)

    def quantile(self, share: float) -> int:
        """Return the time in ns that at least this share of frames did not exceed; 0 without frames.

        The resolution is 20 us; above 40 ms the result is the largest time.
        """
        total = sum(self._counts)
        seen = 0
        for place, count in enumerate(self._counts):
            seen += count
            if total and seen >= share * total:
                return self._most if place == _CLASSES else min((place + 1) * _WIDTH, self._most)
        return 0

    def summary(self) -> dict[str, int]:
        """Return the median, the 99th percentile and the maximum in ns."""
        return {"p50": self.quantile(0.5), "p99": self.quantile(0.99), "max": self._most}
