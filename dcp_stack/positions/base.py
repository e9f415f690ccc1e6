"""The base class of position sources."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from typing import Any

Sample = dict[str, Any]
"""Values for all fields of the profile's SafetyDataT by name, for ``StateReporting.update_safety_data``."""


class SourceError(ValueError):
    """A source cannot be opened; the message has the source, the reason and a remedy."""


class PositionSource(ABC):
    """A source of a node's own position.

    A source has no clock and never waits. The first :meth:`poll` starts it, and later ones return samples that are due
    or have arrived. A driver calls :meth:`poll` when ``fileno()`` is readable or ``poll_timeout()`` is reached; both
    may change with each poll. After opening, invalid input never raises: it is counted and reported as a complaint.
    """

    def __init__(self, name: str) -> None:
        """``name`` is the text by which the source was opened."""
        self.name = name
        self.counts: Counter[str] = Counter()
        """Number of complaints of each kind."""
        self._untold: list[str] = []

    @property
    def finished(self) -> bool:
        """Whether the source will not provide any more samples."""
        return False

    @abstractmethod
    def poll(self, now: int, wall: int) -> list[Sample]:
        """Return new samples, the oldest first (``now`` monotonic ns, ``wall`` ns since 1970)."""

    @abstractmethod
    def poll_timeout(self) -> int | None:
        """Return when to poll next (monotonic ns); None if only ``fileno()`` indicates it, or after the last sample."""

    def fileno(self) -> int:
        """Return a descriptor that is readable when samples may be available; -1 if samples depend only on time."""
        return -1

    def complain(self, kind: str, sentence: str) -> None:
        """Count a problem of ``kind``; report ``sentence`` if it is the first of its kind."""
        if not self.counts[kind]:
            self._untold.append(f"{self.name}: {sentence}")
        self.counts[kind] += 1

    def take_complaints(self) -> list[str]:
        """Return sentences about problems since the last call; each kind of problem is reported once."""
        untold, self._untold = self._untold, []
        return untold

    def close(self) -> None:  # noqa: B027 - most sources have no resources
        """Release all resources; may be called twice."""
