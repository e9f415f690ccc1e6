"""Bearer payloads in UDP datagrams to a multicast group or a broadcast address; needs no privilege.

Several nodes on one host receive each other. Each sends from a socket and port of its own, by which it recognises and
discards its own datagrams.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import socket
import time

from dcp_codec.network import sockets
from dcp_codec.network.sockets import ANCILLARY, LONGEST, stamp_of

from .base import LinkError, Reception
from .sockets import PORTION, SocketLink

#: A group in the administratively scoped range (RFC 2365), which routers do not forward out of a site.
DEFAULT_GROUP = "239.73.126.1"
#: The usual EtherType of DCP, 0x4953, used as the port.
DEFAULT_PORT = 0x4953


def open_udp(
    group: str = DEFAULT_GROUP,
    port: int = DEFAULT_PORT,
    interface: str = "127.0.0.1",
    *,
    ttl: int = 1,
    max_packet_size: int | None = None,
) -> UDPLink:
    """Open a link to ``group``, an IPv4 multicast group, or a broadcast address such as ``192.168.1.255``.

    ``interface`` is the IPv4 address of the interface to use, by default the loopback interface, which keeps all
    datagrams on this host. ``ttl`` is the number of networks that multicast may cross, 1 for the local one only.
    ``max_packet_size`` is the longest bearer payload in octets, by default what fits into one frame of the interface.

    Raises :class:`LinkError` if ``group`` or ``interface`` is not an IPv4 address, the port is not within 1..65535 or
    unavailable, or no interface has the address; ``ValueError`` if ``ttl`` is not within 0..255.
    """
    try:
        to, own = ipaddress.IPv4Address(group), ipaddress.IPv4Address(interface)
    except ValueError as error:
        raise LinkError(f"udp:{group}:{port}: not an IPv4 address: {error}") from None
    if not 1 <= port <= 0xFFFF:
        raise LinkError(f"udp:{group}:{port}: the port is not within 1..65535")
    if not 0 <= ttl <= 255:
        raise ValueError(f"ttl {ttl} is not within 0..255")
    return UDPLink(to, port, own, ttl, max_packet_size)


class UDPLink(SocketLink):
    """A link made by :func:`open_udp`. ``Reception.source`` is the sender's address and port, 6 octets."""

    def __init__(
        self,
        group: ipaddress.IPv4Address,
        port: int,
        interface: ipaddress.IPv4Address,
        ttl: int,
        max_packet_size: int | None,
    ) -> None:
        """Raises :class:`LinkError` if the sockets cannot be opened."""
        self._group = group
        self._port = port
        self._interface = interface
        self._ttl = ttl
        self._given_size = max_packet_size
        self._sender: socket.socket | None = None
        self._own: tuple[str, int] = ("", 0)
        self._losses: sockets.UDPLosses | None = None
        super().__init__(f"udp:{group}:{port}")

    def _open(self) -> socket.socket:
        try:
            with contextlib.ExitStack() as failed:
                sender = failed.enter_context(sockets.open_udp_sender(self._interface, ttl=self._ttl))
                sender.connect((str(self._group), self._port))
                receiver = failed.enter_context(sockets.open_udp_receiver(self._group, self._port))
                self._join(receiver)
                failed.pop_all()
        except OSError as error:
            raise LinkError(f"{self.name}: {sockets.udp_problem(error, self._group, self._interface)}") from error
        self._sender = sender
        self._own = sender.getsockname()
        self.source = _octets(self._own)
        self.max_packet_size = self._given_size or sockets.longest_udp_payload(sender)
        self._losses = sockets.UDPLosses(receiver)
        return receiver

    def _join(self, receiver: socket.socket) -> None:
        """Join the multicast group; nothing to do for a broadcast address."""
        if self._group.is_multicast:
            sockets.join(receiver, self._group, self._interface)

    def _release(self, old: socket.socket) -> None:
        old.close()
        sender, self._sender = self._sender, None
        if sender is not None:
            sender.close()

    def _drain(self, source: socket.socket, receptions: list[Reception]) -> None:
        receive, own = source.recvmsg, self._own
        for _ in range(PORTION):
            octets, ancillary, _, sender = receive(LONGEST, ANCILLARY)
            if sender == own:
                # Multicast returns our own datagrams on the same host. This is normal, so they are not counted.
                continue
            receptions.append(Reception(octets, stamp_of(ancillary) or time.time_ns(), _octets(sender)))

    def _transmit(self, octets: bytes) -> None:
        if self._sender is None:
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        self._sender.send(octets)

    def _lost_by_kernel(self) -> int:
        return 0 if self._losses is None else self._losses.new()

    def _attached(self, source: socket.socket) -> bool:
        # A membership is lost with its interface and not restored with it. Joining again shows whether it was lost.
        if not self._group.is_multicast:
            return True
        try:
            self._join(source)
        except OSError as error:
            return error.errno == errno.EADDRINUSE
        return False


def _octets(address: tuple[str, int]) -> bytes:
    """Encode an IPv4 address and port in 6 octets, big-endian."""
    host, port = address
    return socket.inet_aton(host) + port.to_bytes(2, "big")
