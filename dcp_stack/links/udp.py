"""Bearer payloads in UDP datagrams to a multicast group or a broadcast address: for laptops, without privileges.

Several nodes on one host hear each other. The socket that sends is one of its own with a port of its own, by which a
node knows what it sent itself.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import socket
import struct
import sys

from dcp_stack.links.base import LinkError, Reception
from dcp_stack.links.sockets import (
    ANCILLARY,
    LONGEST,
    PORTION,
    SO_TIMESTAMPNS,
    SocketLink,
    arrival,
    enlarge_receive_buffer,
)

#: A group of the administratively scoped range (RFC 2365), which routers keep inside of a site.
DEFAULT_GROUP = "239.73.126.1"
#: The usual EtherType of DCP, 0x4953, as a port.
DEFAULT_PORT = 0x4953

_HEADERS = 28
_LONGEST_PAYLOAD = 65_507
# Of <linux/in.h> and <asm-generic/socket.h>.
_IP_MTU, _IP_MULTICAST_ALL, _SO_MEMINFO, _MEMINFO_DROPS = 14, 49, 55, 8


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
    nodes on this host. ``ttl`` is how many networks multicast may cross, 1 for the one we are in. ``max_packet_size``
    is the longest bearer payload in octets, by default what the interface carries in one frame.

    Raises :class:`LinkError`: not such an address, no interface with it, port not to be had.
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
    """See :func:`open_udp`, which makes them. ``Reception.source`` is address and port of the sender, 6 octets."""

    def __init__(
        self,
        group: ipaddress.IPv4Address,
        port: int,
        interface: ipaddress.IPv4Address,
        ttl: int,
        max_packet_size: int | None,
    ) -> None:
        """Raises :class:`LinkError`."""
        self._group = group
        self._port = port
        self._interface = interface
        self._ttl = ttl
        self._given_size = max_packet_size
        self._max_packet_size = 0
        self._sender: socket.socket | None = None
        self._own: tuple[str, int] = ("", 0)
        self._drops = 0
        super().__init__(f"udp:{group}:{port}")

    @property
    def source(self) -> bytes:
        """Address and port that datagrams are sent from, 6 octets."""
        return _octets(self._own)

    @property
    def max_packet_size(self) -> int:
        """The longest bearer payload in octets."""
        return self._max_packet_size

    def _open(self) -> socket.socket:
        with contextlib.ExitStack() as failed:
            sender = failed.enter_context(self._open_sender())
            receiver = failed.enter_context(self._open_receiver())
            failed.pop_all()
        self._sender = sender
        self._own = sender.getsockname()
        self._max_packet_size = self._given_size or _payload_of(sender)
        self._drops = 0
        return receiver

    def _open_sender(self) -> socket.socket:
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sender.setblocking(False)
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, self._ttl)
            # For the other nodes on this host.
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
            sender.bind((str(self._interface), 0))
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, self._interface.packed)
            sender.connect((str(self._group), self._port))
        except OSError as error:
            sender.close()
            raise self._explained(error) from error
        return sender

    def _open_receiver(self) -> socket.socket:
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            receiver.setblocking(False)
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if sys.platform != "linux" and hasattr(socket, "SO_REUSEPORT"):
                # Where this is what lets several nodes have the port; on Linux it shares datagrams out instead.
                receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            if sys.platform == "linux":
                receiver.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
                # Only on the interface that was asked for, whatever else on this host joined the group elsewhere.
                receiver.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            enlarge_receive_buffer(receiver)
            # Bound to the group, so that nothing else to this port comes in.
            receiver.bind((str(self._group), self._port))
            self._join(receiver)
        except OSError as error:
            receiver.close()
            raise self._explained(error) from error
        return receiver

    def _join(self, receiver: socket.socket) -> None:
        if self._group.is_multicast:
            membership = self._group.packed + self._interface.packed
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)

    def _explained(self, error: OSError) -> LinkError:
        what = error.strerror or str(error)
        if error.errno in (errno.EADDRNOTAVAIL, errno.ENODEV, errno.EINVAL):
            what = (
                f"no interface has the address {self._interface}, or {self._group} is neither a multicast group nor "
                "a broadcast address there; see: ip -brief address"
            )
        elif error.errno in (errno.ENETUNREACH, errno.ENETDOWN):
            what = f"the interface with the address {self._interface} does not reach {self._group} ({what})"
        elif error.errno == errno.EADDRINUSE:
            what = "another program has this port for itself; choose another one"
        elif error.errno in (errno.EACCES, errno.EPERM):
            what = f"the system does not permit it ({what}); ports below 1024 are for root"
        return LinkError(f"{self._name}: {what}")

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
                # Comes with multicast on one host, and is no one's loss: not counted.
                continue
            receptions.append(Reception(octets, arrival(ancillary), _octets(sender)))

    def _transmit(self, octets: bytes) -> None:
        if self._sender is None:
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        self._sender.send(octets)

    def _lost_by_kernel(self, source: socket.socket) -> int:
        if sys.platform != "linux":
            return 0
        # A total since the socket was opened, unlike that of packet sockets.
        octets = source.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * (_MEMINFO_DROPS + 1))
        total: int = struct.unpack_from("I", octets, 4 * _MEMINFO_DROPS)[0]
        new, self._drops = (total - self._drops) & 0xFFFF_FFFF, total
        return new

    def _attached(self, source: socket.socket) -> bool:
        # A membership goes with its interface and does not come back with it. Joining again tells which it is.
        if not self._group.is_multicast:
            return True
        try:
            self._join(source)
        except OSError as error:
            return error.errno == errno.EADDRINUSE
        return False


def _octets(address: tuple[str, int]) -> bytes:
    host, port = address
    return socket.inet_aton(host) + port.to_bytes(2, "big")


def _payload_of(sender: socket.socket) -> int:
    """What fits into one frame on the way to where ``sender`` is connected; what is in use where none says."""
    try:
        mtu = sender.getsockopt(socket.IPPROTO_IP, _IP_MTU) if sys.platform == "linux" else 1500
    except OSError:
        mtu = 1500
    return min(mtu - _HEADERS, _LONGEST_PAYLOAD)
