"""Ethernet frames of one EtherType on an interface, through scapy's layer-2 sockets.

Scapy opens the socket. Octets go through it directly: scapy's own way of receiving builds a packet from each (65 us a
frame where this takes 4) and turns the kernel's nanoseconds into a float, its way of sending expects one. Linux only.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import sys
from typing import Any

from dcp_codec import interfaces
from dcp_stack.links.base import LinkError, Reception
from dcp_stack.links.sockets import ANCILLARY, LONGEST, PORTION, SocketLink, arrival, enlarge_receive_buffer

BROADCAST = b"\xff" * 6
HEADER = 14

# Of <linux/if_packet.h>, <linux/socket.h> and <linux/if_arp.h>.
_SOL_PACKET, _PACKET_STATISTICS, _PACKET_AUXDATA = 263, 6, 8
_PACKET_OTHERHOST, _PACKET_OUTGOING = 3, 4
_ARPHRD_ETHER, _ARPHRD_LOOPBACK = 1, 772


def open_ethernet(
    interface: str, ether_type: int, *, source: bytes | None = None, max_packet_size: int | None = None
) -> EthernetLink:
    """Open a link for frames with ``ether_type`` on ``interface``.

    The kernel passes only these; among them those for other stations, those behind a VLAN tag and those from our own
    address are ignored (counted). ``source`` is the address frames are sent from (6 octets), by default that of the
    interface, or on one that has none (``lo``) a random one. ``max_packet_size`` is the longest bearer payload in
    octets, by default the interface's MTU.

    Raises :class:`LinkError`: no such interface, one that is down or not Ethernet, no privilege, no scapy, not Linux.
    """
    if source is not None and len(source) != 6:
        raise ValueError(f"source address {source.hex(':')} has {len(source)} octets, not 6")
    if not 0x0600 <= ether_type <= 0xFFFF:
        raise ValueError(f"EtherType {ether_type:#06x} is not within 0x0600..0xffff")
    name = f"eth:{interface}"
    if not hasattr(socket, "AF_PACKET"):
        raise LinkError(f"{name}: needs the packet sockets of Linux, and this is {sys.platform}; use udp instead")
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
        # Any, since scapy has no types.
        self._layer2: Any = None
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
        interface = self._interface
        there_are = interfaces.names()
        if interface not in there_are:
            raise LinkError(f"{self._name}: there is no such interface; there are {', '.join(there_are)}")
        if not interfaces.is_up(interface):
            raise LinkError(f"{self._name}: the interface is down; bring it up first: ip link set {interface} up")
        kind, address = interfaces.hardware_address(interface)
        if kind not in (_ARPHRD_ETHER, _ARPHRD_LOOPBACK):
            raise LinkError(
                f"{self._name}: frames there are not Ethernet (hardware type {kind}); choose another interface"
            )
        self._mtu = interfaces.mtu(interface)
        self._source = self._given_source or _usable(address) or self._source or _random_address()
        ##= UWB-01
        ##= UWB-02
        self._header = BROADCAST + self._source + struct.pack(">H", self._ether_type)
        self._layer2 = _layer2_socket(self._name, interface, self._ether_type)
        opened: socket.socket = self._layer2.ins
        opened.setblocking(False)
        # VLAN tags as ancillary data with each frame are of no use here: tagged frames are ignored.
        opened.setsockopt(_SOL_PACKET, _PACKET_AUXDATA, 0)
        enlarge_receive_buffer(opened)
        return opened

    def _release(self, old: socket.socket) -> None:
        self._layer2, layer2 = None, self._layer2
        if layer2 is not None:
            layer2.close()
        else:
            old.close()

    def _drain(self, source: socket.socket, receptions: list[Reception]) -> None:
        receive, own = source.recvmsg, self._source
        for _ in range(PORTION):
            frame, ancillary, _, (_, _, kind, _, sender) = receive(LONGEST, ANCILLARY)
            # Frames that go out on this interface are not shown to sockets of one EtherType, but they come in again
            # on loopback interfaces and in networks that reflect. The kernel takes what has a VLAN tag for that of
            # another host.
            if (
                kind == _PACKET_OUTGOING
                or sender == own
                or len(frame) < HEADER
                or (kind == _PACKET_OTHERHOST and frame[:6] != own)
            ):
                self._counters.ignored += 1
                continue
            receptions.append(Reception(frame[HEADER:], arrival(ancillary), sender))

    def _transmit(self, octets: bytes) -> None:
        frame = self._header + octets
        try:
            self._layer2.outs.send(frame)
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            # Some drivers refuse short frames; scapy pads them.
            self._layer2.send(frame)

    def _lost_by_kernel(self, source: socket.socket) -> int:
        # Reading it sets it back to zero.
        drops: int = struct.unpack("II", source.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))[1]
        return drops

    def _attached(self, source: socket.socket) -> bool:
        # A socket whose interface was removed is bound to none, also if there is another one of that name.
        bound: str = source.getsockname()[0]
        return bound == self._interface

    def _resume(self, source: socket.socket) -> bool:
        if not self._attached(source):
            return False
        if not interfaces.is_up(self._interface):
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        # What it has to say of the time it was down is known.
        source.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        return True


def _layer2_socket(name: str, interface: str, ether_type: int) -> Any:
    """Scapy's socket on the interface: the kernel passes what comes in with this EtherType and stamps it."""
    try:
        # For its table of hardware types, without which the socket warns that it does not know Ethernet.
        import scapy.layers.l2  # noqa: F401
        from scapy.arch.linux import L2Socket
    except ImportError:
        raise LinkError(f"{name}: needs scapy: pip install 'dcp-conformance-kit[scapy]'") from None
    try:
        return L2Socket(iface=interface, type=ether_type, promisc=False, nofilter=1)
    except PermissionError:
        python = os.path.realpath(sys.executable)
        raise LinkError(
            f"{name}: needs the right to open raw sockets: run as root, or give it to this Python: "
            f"sudo setcap cap_net_raw+ep {python}; udp needs no privilege"
        ) from None
    except ValueError as error:
        # Scapy does not find the interface: it went away since we looked.
        raise OSError(errno.ENODEV, str(error)) from None


def _usable(address: bytes) -> bytes | None:
    return address if any(address) else None


def _random_address() -> bytes:
    """A locally administered unicast address."""
    return b"\x02" + os.urandom(5)
