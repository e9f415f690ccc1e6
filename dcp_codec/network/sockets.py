"""What Linux says about sockets, and what it takes to open them: for live capture, the node's links and the tester.

Ethernet goes through a socket that scapy opens. Octets are read from it and written to it directly: scapy's own way of
receiving builds a packet of each frame and turns the kernel's nanoseconds into a float, its way of sending expects one.

Can be imported anywhere; UDP works on other systems as well, without stamps and counts of losses.
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

#: The longest datagram or frame that is read, in octets: an IP packet and what may stand in front of it. Only loopback
#: interfaces with a larger MTU carry more than that; it comes with the flag ``CUT_OFF``.
LONGEST = 65_600
#: A plain number: what the enumeration of the socket module takes for one "and" is half of what receiving takes.
CUT_OFF = int(socket.MSG_TRUNC)
#: Room for the ancillary data of one datagram: a time stamp and a VLAN tag, with something to spare.
ANCILLARY = 128
#: Octets that may wait in the kernel, where the system allows it: some ten thousand beacons.
RECEIVE_BUFFER = 16 * 1024 * 1024
#: Octets in front of the payload of an Ethernet frame.
ETHERNET_HEADER = 14
#: For a socket that is to see all that comes in, whatever its type, and also what goes out.
EVERY_ETHER_TYPE = 0x0003
#: What the third item of a frame's address says: it is for another station, or it goes out.
OTHERHOST, OUTGOING = 3, 4

# Of <linux/if_packet.h>, <linux/if_ether.h>, <linux/if_arp.h>, <linux/socket.h>, <linux/in.h> and
# <asm-generic/socket.h>; the socket module has none of them in Python 3.11.
_SOL_PACKET = 263
_PACKET_ADD_MEMBERSHIP, _PACKET_STATISTICS, _PACKET_AUXDATA, _PACKET_MR_PROMISC = 1, 6, 8, 1
_TP_STATUS_VLAN_VALID, _TP_STATUS_VLAN_TPID_VALID, _ETH_P_8021Q = 1 << 4, 1 << 6, 0x8100
_ARPHRD_ETHER, _ARPHRD_LOOPBACK = 1, 772
_SO_TIMESTAMPNS, _SO_TIMESTAMPNS_NEW, _SO_RCVBUFFORCE, _SO_MEMINFO, _MEMINFO_DROPS = 35, 64, 33, 55, 8
_IP_MTU, _IP_MULTICAST_ALL = 14, 49

_SOL_SOCKET = socket.SOL_SOCKET
_AUXDATA = struct.Struct("IIIHHHH")
#: The former is as wide as the system's ``long``: two times 32 bits on a 32-bit system.
_STAMPS = {_SO_TIMESTAMPNS: struct.Struct("@ll"), _SO_TIMESTAMPNS_NEW: struct.Struct("qq")}
_IP_AND_UDP_HEADERS, _LONGEST_UDP_PAYLOAD, _USUAL_MTU = 28, 65_507, 1500


class OpeningError(Exception):
    """A socket cannot be opened. The message says why and what to do; in front of it belongs what was to be opened."""


class NoSuchInterfaceError(OpeningError):
    """There is no interface of that name."""


# -- any socket ---------------------------------------------------------------------------------------------------


def enlarge_receive_buffer(receiver: socket.socket) -> None:
    """Let ``RECEIVE_BUFFER`` octets wait in the kernel, or as many as the system allows (net.core.rmem_max)."""
    # Only root may have more than the system's limit.
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):
        with contextlib.suppress(OSError):
            receiver.setsockopt(_SOL_SOCKET, option, RECEIVE_BUFFER)
            return


def stamp_of(ancillary: Ancillary) -> int:
    """When the kernel received a datagram, in ns since 1970; 0 if it does not say."""
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
    """Raises :class:`NoSuchInterfaceError` if there is none of that name."""
    there_are = interfaces.names()
    if interface not in there_are:
        raise NoSuchInterfaceError(f"there is no such interface; there are {', '.join(there_are)}")


def open_ethernet(interface: str, ether_type: int, *, promiscuous: bool = False, instead: str = "") -> EthernetSocket:
    """A socket for frames with ``ether_type`` on ``interface``; with ``EVERY_ETHER_TYPE`` for all that pass there.

    ``promiscuous``: also for frames to other stations. ``instead`` is what users may turn to who lack the privilege.

    The kernel takes VLAN tags out of frames. For every EtherType they come as ancillary data (:func:`tag_of`), for a
    single one not: frames of a VLAN are shown as ``OTHERHOST``, those whose tag gives a priority only as any others.

    Raises :class:`OpeningError`: no such interface, one that is down or not Ethernet, no privilege, no scapy, not
    Linux; and ``OSError`` with whatever else the system says.
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
            # Scapy would take the number that the interface had when scapy was imported.
            index = socket.if_nametoindex(interface)
            raw.setsockopt(_SOL_PACKET, _PACKET_ADD_MEMBERSHIP, struct.pack("iHH8x", index, _PACKET_MR_PROMISC, 0))
        if ether_type != EVERY_ETHER_TYPE:
            raw.setsockopt(_SOL_PACKET, _PACKET_AUXDATA, 0)
        enlarge_receive_buffer(raw)
        made = EthernetSocket(opened, address, loops=hardware == _ARPHRD_LOOPBACK)
        # While scapy opens a socket it lets next to nothing wait; what was lost then is nobody's loss.
        made.lost()
    except OSError:
        opened.close()
        raise
    return made


class EthernetSocket:
    """Frames of one interface. Made by :func:`open_ethernet`."""

    def __init__(self, scapy_socket: Any, address: bytes, *, loops: bool) -> None:
        # Any, since scapy has no types.
        self._scapy = scapy_socket
        self.raw: socket.socket = scapy_socket.ins
        """To wait for and to read from, as in ``recvmsg(LONGEST, ANCILLARY)``; not blocking."""
        self.address = address
        """That of the interface, 6 octets."""
        self.loops = loops
        """Whether what goes out comes in again, as on ``lo``."""

    @property
    def interface(self) -> str:
        """Where it hears; empty once that was removed, also if there is another interface of that name."""
        name: str = self.raw.getsockname()[0]
        return name

    def send(self, frame: bytes) -> None:
        """Send a frame, from the destination address on. Raises ``OSError``."""
        try:
            self._scapy.outs.send(frame)
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            # Some drivers refuse short frames; scapy pads them to 60 octets.
            self._scapy.send(frame)

    def lost(self) -> int:
        """Frames that the kernel dropped since the last call because they were not read in time. Raises ``OSError``."""
        # Reading it sets it back to zero.
        drops: int = struct.unpack("II", self.raw.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))[1]
        return drops

    def close(self) -> None:
        """Give the socket back; may be called twice."""
        self._scapy.close()


def tag_of(ancillary: Ancillary) -> tuple[bytes, int]:
    """The VLAN tag that the kernel took out of a frame, 4 octets or none, and how long the frame is without it.

    The length is that of the frame, also where less of it was read; 0 if the kernel does not say.
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
    """How to get the right to open raw sockets, without giving it to every program of the machine."""
    python = Path(sys.executable).resolve()
    if sys.prefix != sys.base_prefix and python.is_relative_to(Path(sys.prefix).resolve()):
        return f"run as root, or give it to this virtual environment's interpreter: sudo setcap cap_net_raw+ep {python}"
    return (
        "run as root, or install the kit in a virtual environment with an interpreter of its own "
        "(python3 -m venv --copies DIR) and run: sudo setcap cap_net_raw+ep DIR/bin/python3"
    )


# -- UDP ----------------------------------------------------------------------------------------------------------


def open_udp_receiver(address: IPv4Address, port: int) -> socket.socket:
    """A socket, not blocking, for datagrams to ``address`` and ``port``, which others on this host may have as well.

    If the address is a multicast group it has to be joined (:func:`join`). Raises ``OSError``, see :func:`udp_problem`.
    """
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        receiver.setblocking(False)
        receiver.setsockopt(_SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if sys.platform == "linux":
            receiver.setsockopt(_SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            # Only on the interface that was asked for, whatever else on this host joined the group elsewhere.
            receiver.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        elif hasattr(socket, "SO_REUSEPORT"):
            # Where this is what lets several have the port; on Linux it shares datagrams out instead.
            receiver.setsockopt(_SOL_SOCKET, socket.SO_REUSEPORT, 1)
        enlarge_receive_buffer(receiver)
        # Bound to the address, so that nothing else to this port comes in.
        receiver.bind((str(address), port))
    except OSError:
        receiver.close()
        raise
    return receiver


def join(receiver: socket.socket, group: IPv4Address, interface: IPv4Address) -> None:
    """Hear a multicast group on the interface with that address. Raises ``OSError``, EADDRINUSE if it does already."""
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group.packed + interface.packed)


def open_udp_sender(interface: IPv4Address, *, ttl: int, port: int = 0) -> socket.socket:
    """A socket, not blocking, that sends out of the interface with that address, also to groups and to all.

    ``ttl`` is how many networks multicast may cross. ``port`` is where datagrams come from; by default one that nobody
    else has. Raises ``OSError``, see :func:`udp_problem`.
    """
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sender.setblocking(False)
        if port:
            # Not for a port that the system chooses: two that are willing to share may get the same.
            sender.setsockopt(_SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sender.setsockopt(_SOL_SOCKET, socket.SO_BROADCAST, 1)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, ttl)
        # For others on this host.
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        sender.bind((str(interface), port))
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface.packed)
    except OSError:
        sender.close()
        raise
    return sender


def longest_udp_payload(sender: socket.socket) -> int:
    """Octets that fit into one frame on the way to where ``sender`` is connected; the usual number where none says."""
    mtu = _USUAL_MTU
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            mtu = sender.getsockopt(socket.IPPROTO_IP, _IP_MTU)
    return min(mtu - _IP_AND_UDP_HEADERS, _LONGEST_UDP_PAYLOAD)


def udp_problem(error: OSError, to: IPv4Address, interface: IPv4Address, *, station: bool = False) -> str:
    """What it means, and what to do, that sockets to ``to`` on the interface with that address cannot be had or used.

    ``station``: that ``to`` is meant to be the address of one station, not that of a group or a broadcast address.
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
    """What the kernel dropped of a socket, whose own counter has 32 bits and goes on from when it was opened."""

    def __init__(self, receiver: socket.socket) -> None:
        self._receiver = receiver
        self._seen = 0

    def new(self) -> int:
        """Datagrams dropped since the last call. Raises ``OSError``."""
        if sys.platform != "linux":
            return 0
        octets = self._receiver.getsockopt(_SOL_SOCKET, _SO_MEMINFO, 4 * (_MEMINFO_DROPS + 1))
        total: int = struct.unpack_from("I", octets, 4 * _MEMINFO_DROPS)[0]
        new, self._seen = (total - self._seen) & 0xFFFF_FFFF, total
        return new
