"""UDP as a lower tester: multicast as ``dcp-node run --link udp`` has it, and broadcast or unicast with a fixed port.

All virtual peers share one socket; an implementation tells them apart by the identifier in their beacons. To a group
the tester sends from a port of its own, by which it knows its own datagrams. Where beacons are told by a UDP port
(student-2024) they also have to come *from* that port; there it knows its own datagrams by their octets.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import re
import socket
import struct
import sys

from dcp_spec.profile import Link

from dcp_codec import interfaces
from dcp_codec.envelope import Envelope
from dcp_codec.framing import Framing, locate
from dcp_conformance.errors import LowerTesterError, UsageError

from .sockets import ANCILLARY, LONGEST, Echoes, SocketLowerTester, prepare, stamp_of

#: Group and port of ``dcp-node run --link udp``.
DEFAULT_GROUP = "239.73.126.1"
DEFAULT_PORT = 0x4953

# Of <linux/in.h>, <asm-generic/socket.h> and <linux/sockios.h>.
_IP_MULTICAST_ALL, _SO_MEMINFO, _MEMINFO_DROPS, _SIOCGIFADDR = 49, 55, 8, 0x8915


def open_udp(
    group: str = "", port: int | None = None, interface: str | None = None, link: Link | None = None, *, ttl: int = 1
) -> UDPLowerTester:
    """A lower tester on ``group``: an IPv4 multicast group, a broadcast address, or the address of one station.

    Left out, it is the group of ``dcp-node``; ``port`` that of ``link``, or the one of ``dcp-node``. ``interface`` is a
    name or an IPv4 address, by default the loopback interface. ``link`` is that of the profile: how recorded frames are
    to look, and whether datagrams must come from ``port``.

    Raises ``UsageError`` for what is no address or interface, ``LowerTesterError`` if the port cannot be had.
    """
    link = link or Link()
    number = port if port is not None else link.udp_port or DEFAULT_PORT
    name = f"udp:{group or DEFAULT_GROUP}:{number}"
    try:
        to = ipaddress.IPv4Address(group or DEFAULT_GROUP)
    except ValueError as error:
        raise UsageError(f"{name}: not an IPv4 address: {error}") from None
    if not 1 <= number <= 0xFFFF:
        raise UsageError(f"{name}: the port is not within 1..65535")
    return UDPLowerTester(to, number, _address_of(name, interface), link, ttl)


def parse_udp(text: str, link: Link) -> tuple[str, int | None, str | None, Link]:
    """The arguments of :func:`open_udp` out of what users write: ``udp[:GROUP[:PORT]][,interface=NAME|ADDRESS]``.

    Raises ``UsageError``.
    """
    match = re.fullmatch(r"udp(?::([^:,]*)(?::(\d{1,5}))?)?(?:,interface=([^,]+))?", text)
    if match is None:
        raise UsageError(f"{text!r} is no link; it is udp[:GROUP[:PORT]][,interface=NAME|ADDRESS]")
    return match[1] or "", int(match[2]) if match[2] else None, match[3], link


class UDPLowerTester(SocketLowerTester):
    """See :func:`open_udp`, which makes them. Sources of arrivals are address and port, 6 octets."""

    def __init__(
        self, group: ipaddress.IPv4Address, port: int, interface: ipaddress.IPv4Address, link: Link, ttl: int
    ) -> None:
        """Raises ``LowerTesterError``."""
        self._group, self._port, self._interface, self._ttl = group, port, interface, ttl
        self._link = link
        self._envelope = Envelope(link)
        # A datagram for one station needs a port at which its answers arrive.
        self._fixed = link.transport == "udp" or not group.is_multicast
        self._sender: socket.socket | None = None
        self._own: tuple[str, int] = ("", 0)
        self._echoes = Echoes()
        self._drops = 0
        super().__init__(f"udp:{group}:{port}")

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Send a bearer payload; ``source`` shows in the frame of the recording only."""
        frame = self._envelope.frame(octets, source)
        self._transmit(octets)
        return frame

    def send_frame(self, frame: bytes) -> None:
        """Send what is in the frame. One that is no beacon to this link (another EtherType) cannot be sent at all."""
        place = locate(frame, self._link)
        if isinstance(place, Framing) and frame[:6] == b"\xff" * 6:
            self._transmit(frame[place.start : place.end])

    def _transmit(self, octets: bytes) -> None:
        self._ready()
        assert self._sender is not None
        if self._fixed:
            self._echoes.sent(octets, self.now())
        try:
            self._push(self._sender, octets, (str(self._group), self._port))
        except OSError as error:
            if error.errno == errno.EMSGSIZE:
                raise LowerTesterError(f"{self.name}: {len(octets)} octets do not fit into a datagram") from None
            if error.errno == errno.ECONNREFUSED:
                # What a station said of an earlier datagram: nobody listens there. That shows as silence.
                return
            self._discard()
            raise self._gone(error) from None

    def _open(self) -> socket.socket:
        with contextlib.ExitStack() as failed:
            try:
                receiver = failed.enter_context(self._open_receiver())
                sender = receiver
                if self._group.is_multicast or self._is_broadcast():
                    sender = failed.enter_context(self._open_sender())
            except OSError as error:
                raise self._gone(error) from None
            failed.pop_all()
        self._sender, self._own, self._drops = sender, sender.getsockname(), 0
        return receiver

    def _is_broadcast(self) -> bool:
        """Whether the group is no address of one station, as far as the system tells."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
            try:
                # Without SO_BROADCAST the system refuses broadcast addresses.
                asking.connect((str(self._group), self._port))
            except PermissionError:
                return True
            except OSError:
                return self._group == ipaddress.IPv4Address("255.255.255.255")
        return False

    def _open_sender(self) -> socket.socket:
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sender.setblocking(False)
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, self._ttl)
            # For implementations on this host.
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
            sender.bind((str(self._interface), self._port if self._fixed else 0))
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, self._interface.packed)
        except OSError:
            sender.close()
            raise
        return sender

    def _open_receiver(self) -> socket.socket:
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            prepare(receiver)
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if self._group.is_multicast:
                if sys.platform == "linux":
                    # Only on the interface that was asked for, whatever else on this host joined the group elsewhere.
                    receiver.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
                # Bound to the group, so that nothing else to this port comes in.
                receiver.bind((str(self._group), self._port))
                membership = self._group.packed + self._interface.packed
                receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
            elif self._is_broadcast():
                receiver.bind((str(self._group), self._port))
            else:
                receiver.bind((str(self._interface), self._port))
        except OSError:
            receiver.close()
            raise
        return receiver

    def _read(self, source: socket.socket) -> tuple[bytes, bytes, bytes, int] | None:
        try:
            octets, ancillary, _, sender = source.recvmsg(LONGEST, ANCILLARY)
        except ConnectionRefusedError:
            return None
        # From a port that others on this host may have as well, only the octets tell.
        if sender == self._own and (not self._fixed or self._echoes.is_one(octets, self.now())):
            return None
        address = socket.inet_aton(sender[0]) + sender[1].to_bytes(2, "big")
        return octets, self._envelope.frame(octets, address), address, stamp_of(ancillary)

    def _kernel_drops(self, source: socket.socket) -> int:
        if sys.platform != "linux":
            return 0
        # A total since the socket was opened.
        octets = source.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * (_MEMINFO_DROPS + 1))
        total: int = struct.unpack_from("I", octets, 4 * _MEMINFO_DROPS)[0]
        new, self._drops = (total - self._drops) & 0xFFFF_FFFF, total
        return new

    def _gone(self, error: OSError) -> LowerTesterError:
        what = error.strerror or str(error)
        if error.errno in (errno.EADDRNOTAVAIL, errno.ENODEV):
            what = f"no interface has the address {self._interface}; see: ip -brief address"
        elif error.errno in (errno.ENETUNREACH, errno.ENETDOWN, errno.EHOSTUNREACH):
            what = f"the interface with the address {self._interface} does not reach {self._group} ({what})"
        elif error.errno == errno.EADDRINUSE:
            what = "another program has this port for itself; choose another one"
        elif error.errno in (errno.EACCES, errno.EPERM):
            what = f"the system does not permit it ({what}); ports below 1024 are for root"
        return LowerTesterError(f"{self.name}: {what}")

    def _release(self, old: socket.socket) -> None:
        old.close()
        sender, self._sender = self._sender, None
        if sender is not None:
            sender.close()


def _address_of(name: str, interface: str | None) -> ipaddress.IPv4Address:
    """The IPv4 address of an interface that is given by name or address."""
    if interface is None:
        return ipaddress.IPv4Address("127.0.0.1")
    with contextlib.suppress(ValueError):
        return ipaddress.IPv4Address(interface)
    names = interfaces.names()
    if interface not in names:
        raise UsageError(f"{name}: there is no interface {interface}; there are {', '.join(names)}")
    import fcntl  # not on every system

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            answer = fcntl.ioctl(asking, _SIOCGIFADDR, struct.pack("16s24x", interface.encode()))
        except OSError:
            raise UsageError(
                f"{name}: the interface {interface} has no IPv4 address; see: ip -brief address show {interface}"
            ) from None
    return ipaddress.IPv4Address(answer[20:24])
