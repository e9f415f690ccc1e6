"""Judgements of the model of a node: what was expected, what was observed, and the requirement that decides."""

from __future__ import annotations

from typing import Literal, NamedTuple

import msgspec

#: ns in a millisecond.
MS = 1_000_000


class Finding(NamedTuple):
    """An observation that the specification forbids, or that it requires and that did not come."""

    requirements: tuple[str, ...]
    expected: str
    observed: str
    about: Literal["", "creationTime", "format"] = ""
    """The comparison, if other parts of the tester judge it, too: a creationTime, or octets that cannot be read."""


class Expected(NamedTuple):
    """One status that the confirm of a service may have, and the requirement that decides it."""

    status: str
    requirement: str


class Timing(msgspec.Struct, frozen=True, kw_only=True):
    """Bounds of the times that the model cannot know. All in ns, except ``lossy``."""

    period: int
    """The initial beacon period."""
    flight: int = 0
    """Longest time from the generation of a beacon to its reception, including a service call in between."""
    late: int = 0
    """Longest time from the transmission of a frame to its processing."""
    notice: int = 0
    """Longest time from an event to its notification."""
    patience: int = 0
    """Longest time from a cause to the first beacon that shows it."""
    whole: bool = False
    """Whether a received payload is processed as a whole, and no payload is composed in between."""
    lossy: bool = False
    """Whether frames may be lost in either direction."""
    clock: int | None = None
    """Largest difference between the node's clock and the tester's; None if it is unknown."""


def either(expected: list[Expected]) -> str:
    """Return the allowed statuses as text."""
    return " or ".join(dict.fromkeys(each.status for each in expected))
