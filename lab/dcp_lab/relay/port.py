"""One interface of the relay: reads and writes whole Ethernet frames, and recovers if the interface fails."""

from __future__ import annotations

import contextlib
import socket
import time
from typing import Final, NamedTuple

from dcp_codec.network import interfaces, sockets
from dcp_codec.network.sockets import ANCILLARY, CUT_OFF, ETHERNET_HEADER, EVERY_ETHER_TYPE, LONGEST, OUTGOING

#: Time in ns between two attempts to open a missing interface.
_PAUSE: Final = 200_000_000
_IPV4, _UDP = b"\x08\x00", 17


class Taken(NamedTuple):
    """A received frame; ``time`` is monotonic ns, ``wall`` ns since 1970."""

    time: int
    wall: int
    frame: bytes


class Port:
    """A socket for all frames on one interface."""

    def __init__(self, interface: str) -> None:
        """Open the interface. Raises ``dcp_codec.network.sockets.OpeningError`` and ``OSError``."""
        self.interface = interface
        self.refused = 0
        """Frames that were not forwarded: too long, or the interface was down or its queue full."""
        self.dropped = 0
        """Frames that the kernel dropped before the relay read them."""
        self.outages = 0
        """Number of times that the interface was removed or went down."""
        self._tried = 0
        self._ethernet: sockets.EthernetSocket | None = self._open()

    def _open(self) -> sockets.EthernetSocket:
        """Open a promiscuous socket for all EtherTypes."""
        self._tried = time.monotonic_ns()
        return sockets.open_ethernet(self.interface, EVERY_ETHER_TYPE, promiscuous=True)

    @property
    def socket(self) -> socket.socket | None:
        """The socket to wait for; None while the interface is missing."""
        return None if self._ethernet is None else self._ethernet.raw

    def revive(self, now: int) -> None:
        """Open a missing interface if it exists again; at most one attempt per ``_PAUSE`` (``now``: monotonic ns)."""
        if self._ethernet is None and now - self._tried >= _PAUSE:
            self._tried = now
            if self.interface in interfaces.names():
                with contextlib.suppress(sockets.OpeningError, OSError):
                    self._ethernet = self._open()

    def read(self) -> Taken | None:
        """Return the next received frame; None if there is none."""
        while self._ethernet is not None:
            try:
                frame, ancillary, flags, (_, _, kind, *_) = self._ethernet.raw.recvmsg(LONGEST, ANCILLARY)
            except BlockingIOError:
                return None
            except InterruptedError:
                continue
            except OSError:
                self._interrupted()
                return None
            if kind == OUTGOING or len(frame) < ETHERNET_HEADER:
                continue
            if flags & CUT_OFF:
                self.refused += 1
                continue
            tag, _ = sockets.tag_of(ancillary)
            whole = frame[:12] + tag + frame[12:] if tag else _without_udp_checksum(frame)
            now, wall = time.monotonic_ns(), time.time_ns()
            stamp = sockets.stamp_of(ancillary) or wall
            return Taken(min(stamp - wall + now, now), stamp, whole)
        return None

    def send(self, frame: bytes) -> bool:
        """Send a whole frame; returns False, and counts the frame, if it could not be sent."""
        if self._ethernet is not None:
            try:
                self._ethernet.send(frame)
            except OSError:
                self.refused += 1
                return False
            return True
        self.refused += 1
        return False

    def count_drops(self) -> None:
        """Add the frames that the kernel dropped since the last call to ``dropped``."""
        if self._ethernet is not None:
            with contextlib.suppress(OSError):
                self.dropped += self._ethernet.lost()

    def _interrupted(self) -> None:
        """Count an outage. Close the socket if the interface was removed; after a mere link-down it stays usable."""
        self.outages += 1
        ethernet = self._ethernet
        removed = True
        with contextlib.suppress(OSError):
            removed = ethernet is None or not ethernet.interface
        if removed:
            self.close()

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self.count_drops()
        ethernet, self._ethernet = self._ethernet, None
        if ethernet is not None:
            ethernet.close()


def _without_udp_checksum(frame: bytes) -> bytes:
    """Return the frame with the checksum of UDP over IPv4 set to 0, which means none.

    On veth pairs the kernel does not complete checksums (it leaves this to the hardware), and a receiver would discard
    the forwarded frame.
    """
    if frame[12:14] != _IPV4 or len(frame) < 42 or frame[23] != _UDP:
        return frame
    place = ETHERNET_HEADER + (frame[14] & 0x0F) * 4 + 6
    # Only the first fragment has the UDP header.
    if int.from_bytes(frame[20:22]) & 0x1FFF or len(frame) < place + 2:
        return frame
    return frame[:place] + b"\0\0" + frame[place + 2 :]
