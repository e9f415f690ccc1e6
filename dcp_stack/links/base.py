"""The contract of a link."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

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
    own_address: int = 0
    """Of ``ignored``, frames that came in from our own address: another node has the same one, or it is loopback."""


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

    @property
    def name(self) -> str:
        """What the link is on, for people: ``eth:wlan0``, ``udp:239.73.126.1:18771``."""
        ...

    @property
    def counters(self) -> LinkCounters:
        """The counters as of now; take them anew for each look, some are only brought up to date here."""
        ...

    @property
    def max_packet_size(self) -> int:
        """The longest bearer payload in octets that :meth:`send` takes (UWB-03)."""
        ...

    @property
    def source(self) -> bytes:
        """Our own address, as it is in ``Reception.source`` at those who hear us; empty if the link has none."""
        ...

    @property
    def up(self) -> bool:
        """Whether it can carry frames as far as it knows; False from the first sign of an outage to its end."""
        ...

    def fileno(self) -> int:
        """A descriptor that is readable when :meth:`receive` has something; -1 if the link has none.

        It stays the same until :meth:`close`, also across outages.
        """
        ...

    def receive(self) -> list[Reception]:
        """What has arrived, without waiting; empty when there is nothing.

        Of a flood a portion is handed out (some hundred), and the descriptor stays readable.
        """
        ...

    def send(self, octets: bytes) -> bool:
        """Broadcast one bearer payload; False if it could not be sent."""
        ...

    def close(self) -> None:
        """Give everything back; may be called twice. Afterwards nothing arrives and nothing is sent."""
        ...


@runtime_checkable
class TimedLink(Link, Protocol):
    """A link without a descriptor that knows when to ask it instead."""

    def poll_timeout(self) -> int | None:
        """When :meth:`receive` has something next, in ns of the link's clock (monotonic); None: not before a send."""
        ...


class Watcher(Protocol):
    """Sees every frame of a link in both directions (recording, counting)."""

    def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:
        """Take note of one frame."""
        ...
