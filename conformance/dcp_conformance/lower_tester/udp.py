"""UDP as a lower tester: multicast as in ``dcp-node run --link udp``, and broadcast or unicast with a fixed port.

All virtual peers share one socket; their beacons have different identifiers. The tester sends to a group from a port
of its own, which identifies its own datagrams. Where a UDP port identifies beacons (student-2024), the source port must
be the same; there the tester identifies its own datagrams by their octets.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import re
import socket

from dcp_spec.profile.definition import Link

from dcp_codec.framing.envelope import Envelope
from dcp_codec.framing.locate import Framing, locate
from dcp_codec.network import interfaces, sockets
from dcp_codec.network.sockets import ANCILLARY, LONGEST, stamp_of
from dcp_conformance.errors import LowerTesterError, UsageError

from .sockets import Echoes, SocketLowerTester

#: Group and port of ``dcp-node run --link udp``.
DEFAULT_GROUP = "239.73.126.1"
DEFAULT_PORT = 0x4953


def open_udp(
    group: str = "", port: int | None = None, interface: str | None = None, link: Link | None = None, *, ttl: int = 1
) -> UDPLowerTester:
    """A lower tester on ``group``: an IPv4 multicast group, a broadcast address, or the address of one station.

    Left out, it is the group of ``dcp-node``; ``port`` that of ``link``, or the one of ``dcp-node``. ``interface`` is a
    name or an IPv4 address, by default the loopback interface. ``link`` is that of the profile: how recorded frames are
    to look, and whether datagrams must come from ``port``.

    Raises ``UsageError`` for an invalid address or interface, ``LowerTesterError`` if the port cannot be had.
    """
    link = link or Link()
    number = port if port is not None else link.udp_port or DEFAULT_PORT
    name = f"udp:{group or DEFAULT_GROUP}:{number}"
    try:
        to = ipaddress.IPv4Address(group or DEFAULT_GROUP)
    except ValueError as error:
        raise UsageError(f"udp:{group}: not an IPv4 address ({error}); the form is udp[:GROUP[:PORT]]") from None
    if not 1 <= number <= 0xFFFF:
        raise UsageError(f"{name}: the port is not within 1..65535")
    return UDPLowerTester(to, number, _address_of(name, interface), link, ttl)


def parse_udp(text: str, link: Link) -> tuple[str, int | None, str | None, Link]:
    """The arguments of :func:`open_udp` out of what users write: ``udp[:GROUP[:PORT]][,interface=NAME|ADDRESS]``.

    Raises ``UsageError``.
    """
    match = re.fullmatch(r"udp(?::([^:,]*)(?::(\d{1,5}))?)?(?:,interface=([^,]+))?", text)
    if match is None:
        raise UsageError(f"{text!r} is not a link; expected udp[:GROUP[:PORT]][,interface=NAME|ADDRESS]")
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
        self._losses: sockets.UDPLosses | None = None
        super().__init__(f"udp:{group}:{port}")

    def framed(self, octets: bytes, source: bytes) -> bytes:
        """The frame of a bearer payload in a recording, where ``source`` shows."""
        return self._envelope.frame(octets, source)

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Send a bearer payload; ``source`` shows in the frame of the recording only."""
        self._transmit(octets)
        return self.framed(octets, source)

    def send_frame(self, frame: bytes) -> None:
        """Send the payload of the frame. A frame of another EtherType cannot be sent over UDP."""
        place = locate(frame, self._link)
        if isinstance(place, Framing) and frame[:6] == b"\xff" * 6:
            self._transmit(frame[place.start : place.end])

    def _transmit(self, octets: bytes) -> None:
        self._ready()
        sender, to = self._sender, (str(self._group), self._port)
        assert sender is not None
        if self._fixed:
            self._echoes.sent(octets, self.now())
        try:
            self._push(sender, lambda: sender.sendto(octets, to))
        except OSError as error:
            if error.errno == errno.EMSGSIZE:
                raise LowerTesterError(f"{self.name}: {len(octets)} octets do not fit into a datagram") from None
            if error.errno == errno.ECONNREFUSED:
                # An ICMP error for an earlier datagram: the port is closed. The case sees silence.
                return
            self._discard()
            raise self._gone(error) from None

    def _open(self) -> socket.socket:
        multicast = self._group.is_multicast
        with contextlib.ExitStack() as failed:
            try:
                to_many = multicast or self._is_broadcast()
                own_address = self._group if to_many else self._interface
                receiver = failed.enter_context(sockets.open_udp_receiver(own_address, self._port))
                if multicast:
                    sockets.join(receiver, self._group, self._interface)
                sender = receiver
                if to_many:
                    port = self._port if self._fixed else 0
                    sender = failed.enter_context(sockets.open_udp_sender(self._interface, ttl=self._ttl, port=port))
                self._own = sender.getsockname()
            except OSError as error:
                raise self._gone(error) from None
            failed.pop_all()
        self._sender, self._losses = sender, sockets.UDPLosses(receiver)
        return receiver

    def _is_broadcast(self) -> bool:
        """Return whether the address is that of a group, as far as the system knows."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
            try:
                # Without SO_BROADCAST the system refuses broadcast addresses.
                asking.connect((str(self._group), self._port))
            except PermissionError:
                return True
            except OSError:
                return self._group == ipaddress.IPv4Address("255.255.255.255")
        return False

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

    def _kernel_drops(self) -> int:
        return 0 if self._losses is None else self._losses.new()

    def _attached(self, source: socket.socket) -> None:
        # A membership goes with its interface and does not come back with it. Joining again tells which it is.
        if self._group.is_multicast:
            try:
                sockets.join(source, self._group, self._interface)
            except OSError as error:
                if error.errno == errno.EADDRINUSE:
                    return
                raise
            raise OSError(errno.ENETDOWN, "it was away for a while")

    def _gone(self, error: OSError) -> LowerTesterError:
        station = not self._group.is_multicast and not self._is_broadcast()
        return LowerTesterError(
            f"{self.name}: {sockets.udp_problem(error, self._group, self._interface, station=station)}"
        )

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
    try:
        sockets.require_interface(interface)
        return ipaddress.IPv4Address(interfaces.ipv4_address(interface))
    except sockets.OpeningError as error:
        raise UsageError(f"{name},interface={interface}: {error}") from None
    except OSError:
        raise UsageError(
            f"{name}: the interface {interface} has no IPv4 address; see: ip -brief address show {interface}"
        ) from None
