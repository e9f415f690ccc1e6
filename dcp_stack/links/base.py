"""The contract of a link."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import msgspec


class LinkError(Exception):
    """A link cannot be opened or used; the message says what, where and what to do."""


class LinkCounters(msgspec.Struct):
    """What a link knows of its traffic; ``kernel_drops`` are frames the system lost before we read them."""

    sent: int = 0
    received: int = 0
    send_errors: int = 0
    ignored: int = 0
    kernel_drops: int = 0
    outages: int = 0


class Reception(msgspec.Struct, frozen=True, gc=False):
    """A bearer payload that arrived: ``wall`` is the time in ns since 1970, ``source`` the address of the sender."""

    octets: bytes
    wall: int
    source: bytes = b""


class Link(Protocol):
    """Unacknowledged single-hop broadcast (UWB-01).

    A link never delivers what it sent itself, never raises after it was opened (a failed send is counted), and comes
    back by itself when the interface below it does.
    """

    name: str
    counters: LinkCounters
    max_packet_size: int

    def fileno(self) -> int:
        """A descriptor that is readable when :meth:`receive` has something; -1 if the link has none."""
        ...

    def receive(self) -> list[Reception]:
        """Everything that has arrived, without waiting; empty when there is nothing."""
        ...

    def send(self, octets: bytes) -> bool:
        """Broadcast one bearer payload; False if it could not be sent."""
        ...

    def close(self) -> None:
        """Give everything back; may be called twice."""
        ...


class Watcher(Protocol):
    """Sees every frame of a link in both directions (recording, counting)."""

    def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:
        """Take note of one frame."""
        ...


OpenLink = Callable[[], Link]
