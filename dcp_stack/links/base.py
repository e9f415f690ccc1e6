"""The interface of links: sending and receiving bearer payloads."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import msgspec


class LinkError(Exception):
    """A link cannot be opened or used. The message names the link, the cause and, if known, a remedy."""


class LinkCounters(msgspec.Struct):
    """Traffic counters of a link, in frames since it was opened; ``outages`` counts losses of the interface.

    ``kernel_drops`` are frames that the system dropped before this program read them.
    """

    sent: int = 0
    received: int = 0
    send_errors: int = 0
    ignored: int = 0
    kernel_drops: int = 0
    outages: int = 0
    own_address: int = 0
    """Frames with our own source address: of another node that uses it, reflected by a network, or on loopback."""


class Reception(msgspec.Struct, frozen=True, gc=False):
    """A received bearer payload: ``wall`` is the reception time in ns since 1970, ``source`` the sender's address."""

    octets: bytes
    wall: int
    source: bytes = b""


class Link(Protocol):
    """Unacknowledged single-hop broadcast (UWB-01).

    A link does not deliver its own transmissions, unless a network reflects them: BP drops these. After it was opened
    it raises nothing: failed transmissions are counted, and it resumes by itself when its interface returns.
    """

    @property
    def name(self) -> str:
        """A short name with the interface or group, for messages: ``eth:wlan0``, ``udp:239.73.126.1:18771``."""
        ...

    @property
    def counters(self) -> LinkCounters:
        """The current counters. Read this property again for each use: some counters are only updated by reading it."""
        ...

    @property
    def max_packet_size(self) -> int:
        """The longest bearer payload in octets that :meth:`send` accepts (UWB-03)."""
        ...

    @property
    def source(self) -> bytes:
        """Our own address, as other nodes see it in ``Reception.source``; empty if the link has none."""
        ...

    @property
    def up(self) -> bool:
        """Whether the link can carry frames, as far as it knows; False from the first sign of an outage to its end."""
        ...

    def fileno(self) -> int:
        """Return a descriptor that is readable when :meth:`receive` has frames; -1 if the link has none.

        It stays the same until :meth:`close`, also across outages.
        """
        ...

    def receive(self) -> list[Reception]:
        """Return the frames that have arrived, without waiting; empty if there are none.

        One call returns at most some hundred frames; if more have arrived, the descriptor stays readable.
        """
        ...

    def send(self, octets: bytes) -> bool:
        """Broadcast one bearer payload; return False if it could not be sent."""
        ...

    def close(self) -> None:
        """Release all resources; may be called twice. Afterwards the link neither receives nor sends."""
        ...


@runtime_checkable
class TimedLink(Link, Protocol):
    """A link that has no descriptor; its user calls :meth:`receive` at the time of :meth:`poll_timeout`."""

    def poll_timeout(self) -> int | None:
        """Return the time of the next arrival in ns of the link's clock (monotonic); None: not before a send."""
        ...


class Watcher(Protocol):
    """An object that sees every frame of a link in both directions, to record or count it."""

    def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:
        """Process one frame that the link received or sent; ``wall`` is in ns since 1970."""
        ...
