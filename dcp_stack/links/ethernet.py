"""Ethernet frames of one EtherType on an interface, through a socket that scapy opens. Linux only."""

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
#: More frames than fit into the receive buffer.
_MOST_WAITING = 100_000


def open_ethernet(
    interface: str, ether_type: int, *, source: bytes | None = None, max_packet_size: int | None = None
) -> EthernetLink:
    """Open a link for frames with ``ether_type`` on ``interface``.

    The kernel passes only these; among them those for other stations, those of a VLAN, those from our own address and
    those that are longer than any beacon are ignored (counted). ``source`` is the address frames are sent from
    (6 octets), by default that of the interface, or on one that has none (``lo``) a random one. ``max_packet_size`` is
    the longest bearer payload in octets, by default the interface's MTU.

    Raises :class:`LinkError`: no such interface, one that is down or not Ethernet, no privilege, no scapy, not Linux.
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
    """See :func:`open_ethernet`, which makes them. ``Reception.source`` is the source address of the frame."""

    def __init__(self, interface: str, ether_type: int, source: bytes | None, max_packet_size: int | None) -> None:
        """Raises :class:`LinkError` or ``OSError``."""
        self._interface = interface
        self._ether_type = ether_type
        self._given_source = source
        self._source = b""
        self._header = b""
        self._max_packet_size = max_packet_size
        self._mtu = 0
        self._foreign = b""
        self._ethernet: sockets.EthernetSocket | None = None
        super().__init__(f"eth:{interface}")

    @property
    def source(self) -> bytes:
        """The address that frames are sent from."""
        return self._source

    @property
    def max_packet_size(self) -> int:
        """The longest bearer payload in octets."""
        return self._max_packet_size or self._mtu

    def _open(self) -> socket.socket:
        try:
            opened = sockets.open_ethernet(self._interface, self._ether_type, instead="udp")
        except sockets.OpeningError as error:
            raise LinkError(f"{self._name}: {error}") from None
        try:
            self._mtu = interfaces.mtu(self._interface)
            self._find_address()
        except OSError:
            opened.close()
            raise
        self._ethernet = opened
        return opened.raw

    def _find_address(self) -> None:
        """The source of frames; an interface may come back with another address than before. Raises ``OSError``."""
        _, address = interfaces.hardware_address(self._interface)
        self._source = self._given_source or _usable(address) or self._source or _random_address()
        # What comes for it the kernel takes for that of another station.
        self._foreign = b"" if self._source == address else self._source
        ##= UWB-01
        ##= UWB-02
        self._header = BROADCAST + self._source + struct.pack(">H", self._ether_type)

    def _release(self, old: socket.socket) -> None:
        old.close()
        ethernet, self._ethernet = self._ethernet, None
        if ethernet is not None:
            ethernet.close()

    def _drain(self, source: socket.socket, receptions: list[Reception]) -> None:
        receive, own = source.recvmsg, self._source
        for _ in range(PORTION):
            frame, ancillary, flags, (_, _, kind, _, sender) = receive(LONGEST, ANCILLARY)
            # Frames that go out on this interface are not shown to sockets of one EtherType, but they come in again
            # on loopback interfaces and in networks that reflect. The kernel takes what has a VLAN tag for that of
            # another station, unless the tag has a priority only.
            if (
                kind == OUTGOING
                or sender == own
                or len(frame) < ETHERNET_HEADER
                or flags & CUT_OFF
                or (kind == OTHERHOST and frame[:6] != self._foreign)
            ):
                self._counters.ignored += 1
                self._counters.own_address += sender == own and kind != OUTGOING
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
        # What it has to say of the time it was down is known, and frames that wait there since before are no news.
        source.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        with contextlib.suppress(BlockingIOError):
            for _ in range(_MOST_WAITING):
                source.recv(1)
                self._counters.ignored += 1
        return True


def _usable(address: bytes) -> bytes | None:
    return address if any(address) else None


def _random_address() -> bytes:
    """A locally administered unicast address."""
    return b"\x02" + os.urandom(5)
