"""Sockets of Linux for live capture, the node's links and the tester.

Ethernet goes through a socket that scapy opens. Octets are read from it and written to it directly: scapy's receive
function builds a packet from each frame and converts the kernel's nanoseconds to a float, and its send function expects
a packet.

The module can be imported on every system; UDP works on other systems too, without time stamps and counts of losses.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcp_codec.common.extras import advice

from . import interfaces

if TYPE_CHECKING:
    from ipaddress import IPv4Address

Ancillary = list[tuple[int, int, bytes]]

#: The longest datagram or frame that is read, in octets: an IP packet and the headers before it. Only loopback
#: interfaces with a larger MTU carry longer ones; those have the flag ``CUT_OFF``.
LONGEST = 65_600
#: A plain int: an "and" with the enumeration of the socket module takes half the time of a receive call.
CUT_OFF = int(socket.MSG_TRUNC)
#: Octets for the ancillary data of one datagram: a time stamp and a VLAN tag, with a margin.
ANCILLARY = 128
#: Octets that may wait in the kernel, if the system allows it: about ten thousand beacons.
RECEIVE_BUFFER = 16 * 1024 * 1024
#: Octets before the payload of an Ethernet frame.
ETHERNET_HEADER = 14
#: For a socket that receives all incoming frames, whatever their type, and also outgoing ones.
EVERY_ETHER_TYPE = 0x0003
#: Packet types in a frame's address: addressed to another station, or outgoing.
OTHERHOST, OUTGOING = 3, 4

# From <linux/if_packet.h>, <linux/if_ether.h>, <linux/if_arp.h>, <linux/socket.h>, <linux/in.h> and
# <asm-generic/socket.h>; the socket module has none of them in Python 3.11.
_SOL_PACKET = 263
_PACKET_ADD_MEMBERSHIP, _PACKET_STATISTICS, _PACKET_AUXDATA, _PACKET_MR_PROMISC = 1, 6, 8, 1
_TP_STATUS_VLAN_VALID, _TP_STATUS_VLAN_TPID_VALID, _ETH_P_8021Q = 1 << 4, 1 << 6, 0x8100
_ARPHRD_ETHER, _ARPHRD_LOOPBACK = 1, 772
_SO_TIMESTAMPNS, _SO_TIMESTAMPNS_NEW, _SO_RCVBUFFORCE, _SO_MEMINFO, _MEMINFO_DROPS = 35, 64, 33, 55, 8
_IP_MTU, _IP_MULTICAST_ALL = 14, 49

_SOL_SOCKET = socket.SOL_SOCKET
_AUXDATA = struct.Struct("IIIHHHH")
#: The former is as wide as the system's ``long``: two 32-bit numbers on a 32-bit system.
_STAMPS = {_SO_TIMESTAMPNS: struct.Struct("@ll"), _SO_TIMESTAMPNS_NEW: struct.Struct("qq")}
_IP_AND_UDP_HEADERS, _LONGEST_UDP_PAYLOAD, _USUAL_MTU = 28, 65_507, 1500


class OpeningError(Exception):
    """A socket cannot be opened. The message gives the reason and the remedy; the caller prepends the name of the
    link.
    """


class NoSuchInterfaceError(OpeningError):
    """There is no interface with that name."""


# -- any socket ---------------------------------------------------------------------------------------------------


def enlarge_receive_buffer(receiver: socket.socket) -> None:
    """Enlarge the kernel's buffer to ``RECEIVE_BUFFER`` octets, or to the limit of the system (net.core.rmem_max)."""
    # Only root may exceed the system's limit.
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):
        with contextlib.suppress(OSError):
            receiver.setsockopt(_SOL_SOCKET, option, RECEIVE_BUFFER)
            return


def stamp_of(ancillary: Ancillary) -> int:
    """Return the time at which the kernel received a datagram, in ns since 1970; 0 if the kernel did not report it."""
    for level, kind, data in ancillary:
        form = _STAMPS.get(kind)
        if form is not None and level == _SOL_SOCKET and len(data) == form.size:
            seconds: int
            nanoseconds: int
            seconds, nanoseconds = form.unpack(data)
            return seconds * 1_000_000_000 + nanoseconds
    return 0


# -- Ethernet -----------------------------------------------------------------------------------------------------


def require_interface(interface: str) -> None:
    """Raise :class:`NoSuchInterfaceError` if there is no interface with that name."""
    there_are = interfaces.names()
    if interface not in there_are:
        raise NoSuchInterfaceError(f"there is no such interface; there are {', '.join(there_are)}")


def open_ethernet(interface: str, ether_type: int, *, promiscuous: bool = False, instead: str = "") -> EthernetSocket:
    """Open a socket for frames with ``ether_type`` on ``interface``; with ``EVERY_ETHER_TYPE`` for all frames.

    ``promiscuous``: also receive frames to other stations. ``instead`` names an alternative for users without the
    privilege.

    The kernel removes VLAN tags from frames. With ``EVERY_ETHER_TYPE`` the tags arrive as ancillary data
    (:func:`tag_of`). With a single EtherType they do not: frames of a VLAN then have the packet type ``OTHERHOST``, and
    frames whose tag only gives a priority look like untagged ones.

    Raises :class:`OpeningError` if the interface does not exist, is down or is not Ethernet, if the privilege or scapy
    is missing, or on a system other than Linux; ``OSError`` for other errors of the system.
    """
    if not hasattr(socket, "AF_PACKET"):
        other = instead and f"; use {instead} instead"
        raise OpeningError(f"this needs the packet sockets of Linux, which {sys.platform} does not have{other}")
    require_interface(interface)
    if not interfaces.is_up(interface):
        raise OpeningError(f"the interface is down; bring it up first: ip link set {interface} up")
    hardware, address = interfaces.hardware_address(interface)
    if hardware not in (_ARPHRD_ETHER, _ARPHRD_LOOPBACK):
        raise OpeningError(f"frames there are not Ethernet (hardware type {hardware}); choose another interface")
    opened = _packet_socket(interface, ether_type, instead)
    try:
        raw: socket.socket = opened.ins
        raw.setblocking(False)
        if promiscuous:
            # Scapy would use the index that the interface had when scapy was imported.
            index = socket.if_nametoindex(interface)
            raw.setsockopt(_SOL_PACKET, _PACKET_ADD_MEMBERSHIP, struct.pack("iHH8x", index, _PACKET_MR_PROMISC, 0))
        if ether_type != EVERY_ETHER_TYPE:
            raw.setsockopt(_SOL_PACKET, _PACKET_AUXDATA, 0)
        enlarge_receive_buffer(raw)
        made = EthernetSocket(opened, address, loops=hardware == _ARPHRD_LOOPBACK)
        # Scapy allows only a tiny buffer while it opens a socket; losses of that time must not be counted.
        made.lost()
    except OSError:
        opened.close()
        raise
    return made


class EthernetSocket:
    """A socket for the frames of one interface, opened by :func:`open_ethernet`."""

    def __init__(self, scapy_socket: Any, address: bytes, *, loops: bool) -> None:
        # Any, since scapy has no types.
        self._scapy = scapy_socket
        self.raw: socket.socket = scapy_socket.ins
        """For waiting and reading, as in ``recvmsg(LONGEST, ANCILLARY)``; not blocking."""
        self.address = address
        """Address of the interface, 6 octets."""
        self.loops = loops
        """Whether outgoing frames are received again, as on ``lo``."""

    @property
    def interface(self) -> str:
        """Return the name of the interface; empty after its removal, even if another interface now has the name."""
        name: str = self.raw.getsockname()[0]
        return name

    def send(self, frame: bytes) -> None:
        """Send a frame, which starts with the destination address. Raises ``OSError``."""
        try:
            self._scapy.outs.send(frame)
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            # Some drivers refuse short frames; scapy pads them to 60 octets.
            self._scapy.send(frame)

    def lost(self) -> int:
        """Return the number of frames that the kernel dropped since the last call for lack of buffer. Raises
        ``OSError``.
        """
        # Reading the counter resets it.
        drops: int = struct.unpack("II", self.raw.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))[1]
        return drops

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self._scapy.close()


def tag_of(ancillary: Ancillary) -> tuple[bytes, int]:
    """Return the VLAN tag that the kernel removed from a frame (4 octets or none) and the frame's length without it.

    The length is that of the whole frame, even if less of it was read; 0 if the kernel did not report it.
    """
    for level, kind, data in ancillary:
        if level == _SOL_PACKET and kind == _PACKET_AUXDATA and len(data) >= _AUXDATA.size:
            status, length, _, _, _, tag, tag_type = _AUXDATA.unpack_from(data)
            if not (tag or status & _TP_STATUS_VLAN_VALID):
                return b"", length
            return struct.pack(">HH", tag_type if status & _TP_STATUS_VLAN_TPID_VALID else _ETH_P_8021Q, tag), length
    return b"", 0


def _packet_socket(interface: str, ether_type: int, instead: str) -> Any:
    # Imported here, so that UDP needs no scapy.
    from dcp_codec.scapy.packet_socket import open_packet_socket

    try:
        return open_packet_socket(interface, ether_type)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "scapy":
            raise
        raise OpeningError(advice("scapy")) from None
    except PermissionError:
        other = instead and f"; {instead} needs no privilege"
        raise OpeningError(f"this needs the right to open raw sockets: {_raw_socket_advice()}{other}") from None


def _raw_socket_advice() -> str:
    """Return how to get the right to open raw sockets without giving it to every program of the machine."""
    python = Path(sys.executable).resolve()
    if sys.prefix != sys.base_prefix and python.is_relative_to(Path(sys.prefix).resolve()):
        return f"run as root, or give it to this virtual environment's interpreter: sudo setcap cap_net_raw+ep {python}"
    return (
        "run as root, or install the kit in a virtual environment with an interpreter of its own "
        "(python3 -m venv --copies DIR) and run: sudo setcap cap_net_raw+ep DIR/bin/python3"
    )


# -- UDP ----------------------------------------------------------------------------------------------------------


def open_udp_receiver(address: IPv4Address, port: int) -> socket.socket:
    """Open a non-blocking socket for datagrams to ``address`` and ``port``; other programs may share the port.

    A multicast group must also be joined (:func:`join`). Raises ``OSError``, see :func:`udp_problem`.
    """
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        receiver.setblocking(False)
        receiver.setsockopt(_SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if sys.platform == "linux":
            receiver.setsockopt(_SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            # Only groups on the joined interface, whatever other programs of this host have joined elsewhere.
            receiver.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        elif hasattr(socket, "SO_REUSEPORT"):
            # On other systems this lets several programs share the port; on Linux it would distribute the datagrams.
            receiver.setsockopt(_SOL_SOCKET, socket.SO_REUSEPORT, 1)
        enlarge_receive_buffer(receiver)
        # Bound to the address, so that datagrams to other addresses with this port do not arrive.
        receiver.bind((str(address), port))
    except OSError:
        receiver.close()
        raise
    return receiver


def join(receiver: socket.socket, group: IPv4Address, interface: IPv4Address) -> None:
    """Join a multicast group on the interface with that address. Raises ``OSError``, EADDRINUSE if already joined."""
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group.packed + interface.packed)


def open_udp_sender(interface: IPv4Address, *, ttl: int, port: int = 0) -> socket.socket:
    """Open a non-blocking socket that sends from the interface with that address, also multicast and broadcast.

    ``ttl`` is the number of networks that multicast may cross. ``port`` is the source port; 0: an unused one. Raises
    ``OSError``, see :func:`udp_problem`.
    """
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sender.setblocking(False)
        if port:
            # Not for a port that the system chooses: two sharing sockets may get the same one.
            sender.setsockopt(_SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sender.setsockopt(_SOL_SOCKET, socket.SO_BROADCAST, 1)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, ttl)
        # For other programs on this host.
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        sender.bind((str(interface), port))
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface.packed)
    except OSError:
        sender.close()
        raise
    return sender


def longest_udp_payload(sender: socket.socket) -> int:
    """Return the octets that fit into one frame on the route to the peer of ``sender``; a default if that is
    unknown.
    """
    mtu = _USUAL_MTU
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            mtu = sender.getsockopt(socket.IPPROTO_IP, _IP_MTU)
    return min(mtu - _IP_AND_UDP_HEADERS, _LONGEST_UDP_PAYLOAD)


def udp_problem(error: OSError, to: IPv4Address, interface: IPv4Address, *, station: bool = False) -> str:
    """Explain an error of a socket to ``to`` on the interface with that address, with the remedy.

    ``station``: whether ``to`` should be the address of one station, not of a group or a broadcast address.
    """
    what = error.strerror or str(error)
    if error.errno in (errno.EADDRNOTAVAIL, errno.ENODEV) or (error.errno == errno.EINVAL and not station):
        neither = f"{to} is neither a multicast group nor a broadcast address there"
        other = "" if station or to.is_multicast else f", or {neither}"
        return f"no interface has the address {interface}{other}; see: ip -brief address"
    if error.errno in (errno.ENETUNREACH, errno.ENETDOWN, errno.EHOSTUNREACH, errno.EINVAL):
        return f"the interface with the address {interface} does not reach {to} ({what})"
    if error.errno == errno.EADDRINUSE:
        return "another program has this port for itself; choose another one"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"the system does not permit it ({what}); ports below 1024 are for root"
    return what


class UDPLosses:
    """Counts the datagrams that the kernel dropped on a socket.

    The kernel's counter has 32 bits and starts when the socket is opened.
    """

    def __init__(self, receiver: socket.socket) -> None:
        self._receiver = receiver
        self._seen = 0

    def new(self) -> int:
        """Return the number of datagrams dropped since the last call. Raises ``OSError``."""
        if sys.platform != "linux":
            return 0
        octets = self._receiver.getsockopt(_SOL_SOCKET, _SO_MEMINFO, 4 * (_MEMINFO_DROPS + 1))
        total: int = struct.unpack_from("I", octets, 4 * _MEMINFO_DROPS)[0]
        new, self._seen = (total - self._seen) & 0xFFFF_FFFF, total
        return new
