"""Raw Ethernet as a lower tester: frames of one EtherType on an interface, sent as from any station.

Scapy opens the layer-2 socket; octets and the kernel's stamps go through it directly, because scapy's own way builds a
packet of each frame and turns nanoseconds into a float. Linux only.
"""

from __future__ import annotations

import errno
import os
import socket
import struct
import sys
from typing import Any

from dcp_spec.profile import Link

from dcp_codec import interfaces
from dcp_conformance.errors import LowerTesterError, UsageError

from .sockets import ANCILLARY, LONGEST, Echoes, SocketLowerTester, prepare, stamp_of

BROADCAST = b"\xff" * 6
HEADER = 14
#: Octets of the shortest frame, without the check sequence; drivers that do not pad refuse shorter ones.
_SHORTEST = 60

# Of <linux/if_packet.h>, <linux/socket.h> and <linux/if_arp.h>.
_SOL_PACKET, _PACKET_STATISTICS, _PACKET_AUXDATA = 263, 6, 8
_PACKET_OTHERHOST, _PACKET_OUTGOING = 3, 4
_ARPHRD_ETHER, _ARPHRD_LOOPBACK = 1, 772


def open_ethernet(interface: str, link: Link, *, ether_type: int | None = None) -> EthernetLowerTester:
    """A lower tester on ``interface``, for frames with the EtherType of ``link``, or another one.

    The interface is switched to promiscuous mode, so that frames that an implementation sends to a station instead of
    to all are seen, too. Frames behind a VLAN tag are ignored.

    Raises ``UsageError`` (no such interface, no EtherType) and ``LowerTesterError`` (it is down or not Ethernet, no
    privilege, no scapy).
    """
    if link.transport == "udp" and ether_type is None:
        raise UsageError(f"eth:{interface}: the profile sends beacons over UDP, not in Ethernet frames; use --link udp")
    kind = link.ether_type if ether_type is None else ether_type
    if kind is None:
        raise UsageError(f"eth:{interface}: the profile names no EtherType; say which one the implementation uses")
    if not hasattr(socket, "AF_PACKET"):
        raise LowerTesterError(f"eth:{interface}: needs the packet sockets of Linux, and this is {sys.platform}")
    names = interfaces.names()
    if interface not in names:
        raise UsageError(f"eth:{interface}: there is no such interface; there are {', '.join(names)}")
    return EthernetLowerTester(interface, kind)


class EthernetLowerTester(SocketLowerTester):
    """See :func:`open_ethernet`, which makes them. Sources are the addresses of frames, 6 octets."""

    def __init__(self, interface: str, ether_type: int) -> None:
        """Raises ``LowerTesterError``."""
        self.interface = interface
        self._type = struct.pack(">H", ether_type)
        # Any, since scapy has no types.
        self._layer2: Any = None
        self._echoes: Echoes | None = None
        super().__init__(f"eth:{interface}")

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Broadcast a bearer payload as from the station ``source`` (6 octets)."""
        frame = BROADCAST + source + self._type + octets
        self.send_frame(frame)
        return frame

    def send_frame(self, frame: bytes) -> None:
        """Send a frame as it is, from the destination address on."""
        to = self._ready()
        if self._echoes is not None:
            self._echoes.sent(frame, self.now())
        try:
            try:
                self._push(to, frame)
            except OSError as error:
                if error.errno != errno.EINVAL or len(frame) >= _SHORTEST:
                    raise
                self._push(to, frame.ljust(_SHORTEST, b"\0"))
        except OSError as error:
            if error.errno == errno.EMSGSIZE:
                raise LowerTesterError(
                    f"{self.name}: a frame of {len(frame)} octets is longer than the interface carries (its MTU and "
                    f"{HEADER}); see: ip link show {self.interface}"
                ) from None
            self._discard()
            raise self._gone(error) from None

    def _open(self) -> socket.socket:
        try:
            if self.interface in interfaces.names() and not interfaces.is_up(self.interface):
                raise LowerTesterError(
                    f"{self.name}: the interface is down; bring it up first: ip link set {self.interface} up"
                )
            self._layer2 = _layer2_socket(self.name, self.interface, int.from_bytes(self._type, "big"))
        except OSError as error:
            raise self._gone(error) from None
        opened: socket.socket = self._layer2.ins
        hardware = opened.getsockname()[3]
        if hardware not in (_ARPHRD_ETHER, _ARPHRD_LOOPBACK):
            self._release(opened)
            raise LowerTesterError(
                f"{self.name}: frames there are not Ethernet (hardware type {hardware}); choose another interface"
            )
        # Sockets of one EtherType are not shown what goes out, but on loopback interfaces it comes in again.
        self._echoes = Echoes() if hardware == _ARPHRD_LOOPBACK else None
        prepare(opened)
        opened.setsockopt(_SOL_PACKET, _PACKET_AUXDATA, 0)
        return opened

    def _read(self, source: socket.socket) -> tuple[bytes, bytes, bytes, int] | None:
        frame, ancillary, _, (_, _, kind, _, sender) = source.recvmsg(LONGEST, ANCILLARY)
        # The kernel takes a VLAN tag out of a frame, and the frame then for that of another host.
        tagged = kind == _PACKET_OTHERHOST and frame[:6] == BROADCAST
        if kind == _PACKET_OUTGOING or tagged or len(frame) < HEADER:
            return None
        if self._echoes is not None and self._echoes.is_one(frame, self.now()):
            return None
        return frame[HEADER:], frame, sender, stamp_of(ancillary)

    def _kernel_drops(self, source: socket.socket) -> int:
        # Reading it sets it back to zero.
        drops: int = struct.unpack("II", source.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))[1]
        return drops

    def _gone(self, error: OSError) -> LowerTesterError:
        if self.interface not in interfaces.names():
            return LowerTesterError(
                f"{self.name}: the interface has vanished; is the adapter plugged in, or was its driver reset?"
            )
        if error.errno == errno.ENETDOWN:
            return LowerTesterError(
                f"{self.name}: the interface went down; bring it up again: ip link set {self.interface} up"
            )
        return LowerTesterError(f"{self.name}: cannot be used: {error.strerror or error}")

    def _release(self, old: socket.socket) -> None:
        layer2, self._layer2 = self._layer2, None
        if layer2 is not None:
            layer2.close()
        else:
            old.close()


def _layer2_socket(name: str, interface: str, ether_type: int) -> Any:
    """Scapy's socket on the interface. Raises ``LowerTesterError`` or ``OSError``."""
    try:
        # For its table of hardware types, without which the socket warns that it does not know Ethernet.
        import scapy.layers.l2  # noqa: F401
        from scapy.arch.linux import L2Socket
        from scapy.config import conf
    except ImportError:
        raise LowerTesterError(f"{name}: needs scapy: pip install 'dcp-conformance-kit[scapy]'") from None
    # Scapy remembers the interfaces there were when it was imported.
    conf.ifaces.reload()
    try:
        return L2Socket(iface=interface, type=ether_type, promisc=True, nofilter=1)
    except PermissionError:
        python = os.path.realpath(sys.executable)
        raise LowerTesterError(
            f"{name}: needs the right to open raw sockets: run as root, or give it to this Python: "
            f"sudo setcap cap_net_raw+ep {python}; --link udp needs no privilege"
        ) from None
    except ValueError as error:
        # Scapy does not find the interface: it went away since we looked.
        raise OSError(errno.ENODEV, str(error)) from None
