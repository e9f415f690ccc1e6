"""Ethernet frames of one EtherType on an interface, through a socket opened by scapy. Linux only."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
import time

from dcp_codec.network import interfaces, sockets
from dcp_codec.network.sockets import ANCILLARY, CUT_OFF, ETHERNET_HEADER, LONGEST, OTHERHOST, OUTGOING, stamp_of

from .base import LinkError, Reception
from .sockets import PORTION, SocketLink

BROADCAST = b"\xff" * 6
#: An upper bound of the number of frames in a receive buffer.
_MOST_WAITING = 100_000


def open_ethernet(
    interface: str, ether_type: int, *, source: bytes | None = None, max_packet_size: int | None = None
) -> EthernetLink:
    """Open a link for frames with ``ether_type`` on ``interface``.

    The kernel passes only frames of this type. Of these the link ignores and counts: frames to other stations, frames
    with a VLAN identifier, frames that are too long for a beacon, and, on loopback interfaces, frames from our own
    address. Other interfaces deliver frames from our own address, counted: BP recognises its own beacons by their
    senderId (BP-RX-06), and another node may use the same address. ``source`` is the source address of sent frames (6
    octets), by default that of the interface, or a random one if it has none (``lo``).
    ``max_packet_size`` is the longest bearer payload in octets, by default the MTU of the interface.

    Raises :class:`LinkError` if the interface does not exist, is down or is not Ethernet, if the privilege or scapy is
    missing, or if the system is not Linux; ``ValueError`` for a malformed ``source`` or ``ether_type``.
    """
    if source is not None and len(source) != 6:
        raise ValueError(f"source address {source.hex(':')} has {len(source)} octets, not 6")
    if not 0x0600 <= ether_type <= 0xFFFF:
        raise ValueError(f"EtherType {ether_type:#06x} is not within 0x0600..0xffff")
    name = f"eth:{interface}"
    try:
        return EthernetLink(interface, ether_type, source, max_packet_size)
    except OSError as error:
        raise LinkError(f"{name}: cannot be opened: {error.strerror or error}") from error


class EthernetLink(SocketLink):
    """A link made by :func:`open_ethernet`. ``Reception.source`` is the source address of the frame."""

    def __init__(self, interface: str, ether_type: int, source: bytes | None, max_packet_size: int | None) -> None:
        """Raises :class:`LinkError` or ``OSError`` if the socket cannot be opened."""
        self._interface = interface
        self._ether_type = ether_type
        self._given_source = source
        self._header = b""
        self._given_size = max_packet_size
        self._foreign = b""
        self._ethernet: sockets.EthernetSocket | None = None
        super().__init__(f"eth:{interface}")

    @property
    def up(self) -> bool:
        """Whether the link can carry frames: the socket does not learn of the loss of a carrier."""
        return super().up and interfaces.has_carrier(self._interface)

    def _open(self) -> socket.socket:
        try:
            opened = sockets.open_ethernet(self._interface, self._ether_type, instead="udp")
        except sockets.OpeningError as error:
            raise LinkError(f"{self.name}: {error}") from None
        try:
            self.max_packet_size = self._given_size or interfaces.mtu(self._interface)
            self._find_address()
        except OSError:
            opened.close()
            raise
        self._ethernet = opened
        return opened.raw

    def _find_address(self) -> None:
        """Set the source address of frames, which can differ after an outage of the interface. Raises ``OSError``."""
        _, address = interfaces.hardware_address(self._interface)
        self.source = self._given_source or _usable(address) or self.source or _random_address()
        # The kernel reports frames to this address as frames to another station (PACKET_OTHERHOST).
        self._foreign = b"" if self.source == address else self.source
        ##= UWB-01 UWB-02
        self._header = BROADCAST + self.source + struct.pack(">H", self._ether_type)

    def _release(self, old: socket.socket) -> None:
        old.close()
        ethernet, self._ethernet = self._ethernet, None
        if ethernet is not None:
            ethernet.close()

    def _drain(self, source: socket.socket, receptions: list[Reception]) -> None:
        receive, own = source.recvmsg, self.source
        loops = self._ethernet is not None and self._ethernet.loops
        for _ in range(PORTION):
            frame, ancillary, flags, (_, _, kind, _, sender) = receive(LONGEST, ANCILLARY)
            # Sockets of one EtherType do not receive frames that leave on this interface; only loopback interfaces
            # deliver all of them again. The kernel reports frames with a VLAN tag as frames to another station, unless
            # the tag has only a priority.
            if sender == own and kind != OUTGOING:
                self._counters.own_address += 1
            if (
                kind == OUTGOING
                or (loops and sender == own)
                or len(frame) < ETHERNET_HEADER
                or flags & CUT_OFF
                or (kind == OTHERHOST and frame[:6] != self._foreign)
            ):
                self._counters.ignored += 1
                continue
            receptions.append(Reception(frame[ETHERNET_HEADER:], stamp_of(ancillary) or time.time_ns(), sender))

    def _transmit(self, octets: bytes) -> None:
        if self._ethernet is None:
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        self._ethernet.send(self._header + octets)

    def _lost_by_kernel(self) -> int:
        return 0 if self._ethernet is None else self._ethernet.lost()

    def _attached(self, source: socket.socket) -> bool:  # noqa: ARG002
        return self._ethernet is not None and self._ethernet.interface == self._interface

    def _resume(self, source: socket.socket) -> bool:
        if not self._attached(source):
            return False
        if not interfaces.is_up(self._interface):
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        self._find_address()
        # The error of the outage is known already, and frames received before the outage are outdated.
        source.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        with contextlib.suppress(BlockingIOError):
            for _ in range(_MOST_WAITING):
                source.recv(1)
                self._counters.ignored += 1
        return True


def _usable(address: bytes) -> bytes | None:
    """Return the address, or None if it is all zeros, as on ``lo``."""
    return address if any(address) else None


def _random_address() -> bytes:
    """Return a random, locally administered unicast address."""
    return b"\x02" + os.urandom(5)
