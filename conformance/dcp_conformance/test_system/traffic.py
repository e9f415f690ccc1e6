"""The recording of a case: frames in both directions, calls, notifications and remarks in order. Bounded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Literal

import msgspec

from dcp_codec.codec import Codec
from dcp_codec.values import Payload, VardisRecord

#: Maximum number of events of one case; of a longer recording, the first and the last half of this number are kept.
MOST_EVENTS = 20_000

Direction = Literal["sent", "heard", "other", "call", "answer", "notified", "note"]


class Event(msgspec.Struct, frozen=True, omit_defaults=True):
    """An entry of the recording."""

    number: int
    """Number of the frame, counted from 1 in the order of the recording; 0 if the event is not a frame."""
    wall: int
    """Time in ns since 1970."""
    direction: Direction
    who: str = ""
    frame: bytes = b""
    """The whole link-layer frame."""
    start: int = 0
    """Offset of the bearer payload in ``frame``."""
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
        """The kept events, in order."""
        return self._events

    def frame(self, direction: Direction, wall: int, who: str, frame: bytes, start: int) -> int:
        """Record a frame and return its number."""
        self.frames += 1
        self._add(Event(self.frames, wall, direction, who, frame, start))
        return self.frames

    def note(self, direction: Direction, wall: int, text: str, data: Any = None, who: str = "") -> None:
        """Record an event that is not a frame."""
        self._add(Event(0, wall, direction, who, text=text, data=data))

    def _add(self, event: Event) -> None:
        if len(self._events) >= MOST_EVENTS:
            # Drop from the middle: the beginning and the end are of most interest to readers.
            del self._events[MOST_EVENTS // 2]
            self.left_out += 1
        self._events.append(event)


def payloads(codec: Codec, events: Iterable[Event], *more: Direction) -> Iterator[Payload]:
    """Yield the payloads of frames that the tester has sent or that have one of ``more`` directions.

    Beacons that are partly invalid are included.
    """
    for event in events:
        if event.direction == "sent" or event.direction in more:
            beacon = codec.salvage(event.frame[event.start :]).beacon
            yield from () if beacon is None else beacon.payloads


def records(payload: Payload) -> Iterator[VardisRecord]:
    """Yield the records of a VarDis payload; none of another payload."""
    return (record for container in payload.vardis or () for record in container.records)
