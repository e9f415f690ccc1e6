"""What happened in a case, in order: frames both ways, calls, notifications, remarks. Bounded."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

#: Events of one case that are kept; a case that produces more keeps the first and the last half of them.
MOST_EVENTS = 20_000

Direction = Literal["sent", "heard", "other", "call", "answer", "notified", "note"]


class Event(msgspec.Struct, frozen=True, omit_defaults=True):
    """One line of the timeline."""

    number: int
    """Frames are counted from 1 in the order of the recording; 0 for what is no frame."""
    wall: int
    """ns since 1970."""
    direction: Direction
    who: str = ""
    frame: bytes = b""
    """The whole link-layer frame."""
    start: int = 0
    """Where the bearer payload starts in it."""
    text: str = ""
    data: Any = None


class Traffic:
    """The events of one case."""

    def __init__(self) -> None:
        self._events: list[Event] = []
        self.frames = 0
        self.left_out = 0

    @property
    def events(self) -> list[Event]:
        """What is kept, in order."""
        return self._events

    def frame(self, direction: Direction, wall: int, who: str, frame: bytes, start: int) -> int:
        """Note a frame; its number."""
        self.frames += 1
        self._add(Event(self.frames, wall, direction, who, frame, start))
        return self.frames

    def note(self, direction: Direction, wall: int, text: str, data: Any = None, who: str = "") -> None:
        """Note something else."""
        self._add(Event(0, wall, direction, who, text=text, data=data))

    def _add(self, event: Event) -> None:
        if len(self._events) >= MOST_EVENTS:
            # The middle goes: how it began and how it ended is what people look for.
            del self._events[MOST_EVENTS // 2]
            self.left_out += 1
        self._events.append(event)
