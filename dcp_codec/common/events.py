"""A queue of future events, for real and virtual time. It reads no clock."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import Generic, TypeVar

Event = TypeVar("Event")


class EventQueue(Generic[Event]):
    """Events in the order of their times (ns), then of their ranks, then of :meth:`push`."""

    __slots__ = ("_heap", "_number")

    def __init__(self) -> None:
        # The number is unique, so the heap compares no events.
        self._heap: list[tuple[int, int, int, Event]] = []
        self._number = 0

    def push(self, time: int, event: Event, rank: int = 0) -> None:
        """Add an event. Of simultaneous events, those with lower ``rank`` come first."""
        heapq.heappush(self._heap, (time, rank, self._number, event))
        self._number += 1

    def next_time(self) -> int | None:
        """Return the time of the first event; None if there is none."""
        return self._heap[0][0] if self._heap else None

    def pop(self) -> Event:
        """Remove the first event, and return it. Raises ``IndexError`` if there is none."""
        return heapq.heappop(self._heap)[3]

    def due(self, now: int) -> Iterator[Event]:
        """Remove and yield the events up to ``now``, also those that the caller adds while it iterates."""
        while self._heap and self._heap[0][0] <= now:
            yield self.pop()

    def __len__(self) -> int:
        return len(self._heap)

    def __iter__(self) -> Iterator[Event]:
        """Iterate over the events in any order."""
        return (each[3] for each in self._heap)
