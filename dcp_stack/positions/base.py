"""The contract of a position source, and what the sources share."""

from __future__ import annotations

from collections import Counter
from typing import Any, Protocol

Sample = dict[str, Any]
"""Values for all fields of the profile's SafetyDataT by name, as ``StateReporting.update_safety_data`` takes them."""


class SourceError(ValueError):
    """A source cannot be opened; the message says which one, why, and what to do."""


class PositionSource(Protocol):
    """Where a node learns its own position from.

    A source has no clock and never waits: the first :meth:`poll` starts it, later ones return what has become due or
    has arrived. A driver calls :meth:`poll` when ``fileno()`` is readable or ``poll_timeout()`` is reached, both asked
    anew after each poll. Once open, nothing that comes in raises: it is counted and complained about.
    """

    name: str
    """The source as its opener called it."""

    @property
    def finished(self) -> bool:
        """Whether nothing will come any more."""
        ...

    @property
    def counts(self) -> Counter[str]:
        """How often each kind of complaint had a reason."""
        ...

    def poll(self, now: int, wall: int) -> list[Sample]:
        """New samples, the oldest first (``now`` monotonic ns, ``wall`` ns since 1970)."""
        ...

    def poll_timeout(self) -> int | None:
        """When to poll next (monotonic ns); None if only ``fileno()`` tells, or nothing ever will."""
        ...

    def fileno(self) -> int:
        """A descriptor that is readable when there is something to poll; -1 if there is none."""
        ...

    def take_complaints(self) -> list[str]:
        """Sentences for people about what went wrong since the last call; each kind is told once."""
        ...

    def close(self) -> None:
        """Give everything back; may be called twice."""
        ...


class Source:
    """What sources without a descriptor do by default, and the counting of complaints."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.counts: Counter[str] = Counter()
        self._untold: list[str] = []

    @property
    def finished(self) -> bool:
        """Whether nothing will come any more."""
        return False

    def fileno(self) -> int:
        """No descriptor: time alone moves this source."""
        return -1

    def complain(self, kind: str, sentence: str) -> None:
        """Count something of ``kind``; the first of it is told."""
        if not self.counts[kind]:
            self._untold.append(f"{self.name}: {sentence}")
        self.counts[kind] += 1

    def take_complaints(self) -> list[str]:
        """Sentences about what went wrong since the last call; each kind is told once."""
        untold, self._untold = self._untold, []
        return untold

    def close(self) -> None:
        """Nothing to give back."""
