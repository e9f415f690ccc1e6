"""Raw Ethernet as a lower tester: frames of one EtherType on an interface, sent as from any station. Linux only."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import struct
from collections.abc import Iterable

from dcp_spec.profile.definition import Link

from dcp_codec.network import interfaces, sockets
from dcp_codec.network.sockets import ANCILLARY, CUT_OFF, ETHERNET_HEADER, LONGEST, OTHERHOST, OUTGOING, stamp_of
from dcp_conformance.errors import LowerTesterError, UsageError

from .sockets import Echoes, SocketLowerTester

BROADCAST = b"\xff" * 6
#: Frames of other types that are kept when all types are listened to.
_MOST_OVERHEARD = 1000


def open_ethernet(interface: str, link: Link, *, ether_type: int | None = None) -> EthernetLowerTester:
    """A lower tester on ``interface``, for frames with the EtherType of ``link``, or another one.

    The interface is in promiscuous mode, so that frames to single stations are received, too. Frames of a VLAN are
    ignored as far as the kernel marks them.

    Raises ``UsageError`` (no such interface, no EtherType) and ``LowerTesterError`` (it is down or not Ethernet, no
    privilege, no scapy).
    """
    if link.transport == "udp" and ether_type is None:
        raise UsageError(f"eth:{interface}: the profile sends beacons over UDP, not in Ethernet frames; use --link udp")
    kind = link.ether_type if ether_type is None else ether_type
    if kind is None:
        raise UsageError(f"eth:{interface}: the profile names no EtherType; say which one the implementation uses")
    try:
        sockets.require_interface(interface)
    except sockets.OpeningError as error:
        raise UsageError(f"eth:{interface}: {error}") from None
    return EthernetLowerTester(interface, kind)


class EthernetLowerTester(SocketLowerTester):
    """See :func:`open_ethernet`, which makes them. Sources are the addresses of frames, 6 octets."""

    def __init__(self, interface: str, ether_type: int) -> None:
        """Raises ``LowerTesterError``."""
        self.interface = interface
        self._type = struct.pack(">H", ether_type)
        self._ethernet: sockets.EthernetSocket | None = None
        self._address = b""
        self._echoes: Echoes | None = None
        super().__init__(f"eth:{interface}")

    def framed(self, octets: bytes, source: bytes) -> bytes:
        """The broadcast frame of a bearer payload from the station ``source`` (6 octets)."""
        return BROADCAST + source + self._type + octets

    def send(self, octets: bytes, source: bytes) -> bytes:
        """Broadcast a bearer payload as from the station ``source`` (6 octets)."""
        frame = self.framed(octets, source)
        self.send_frame(frame)
        return frame

    def send_frame(self, frame: bytes) -> None:
        """Send a frame unchanged; it begins with the destination address."""
        to = self._ready()
        ethernet = self._ethernet
        assert ethernet is not None
        if self._echoes is not None:
            self._echoes.sent(frame, self.now())
        try:
            self._push(to, lambda: ethernet.send(frame))
        except OSError as error:
            if error.errno == errno.EMSGSIZE:
                raise LowerTesterError(
                    f"{self.name}: a frame of {len(frame)} octets is longer than the interface carries (its MTU and "
                    f"{ETHERNET_HEADER}); see: ip link show {self.interface}"
                ) from None
            self._discard()
            raise self._gone(error) from None

    @property
    def ether_type(self) -> int:
        """The EtherType of its beacons."""
        return int.from_bytes(self._type)

    def exchange_all_types(self, asked: Iterable[bytes], duration: int) -> list[bytes]:
        """Send whole frames, and listen for ``duration`` ns; the frames of other EtherTypes that arrived, whole.

        Raises ``LowerTesterError`` if the frames cannot be sent; empty if all types cannot be listened to.
        """
        with contextlib.ExitStack() as stack:
            try:
                every = sockets.open_ethernet(self.interface, sockets.EVERY_ETHER_TYPE, promiscuous=True)
            except (sockets.OpeningError, OSError):
                return []
            stack.callback(every.close)
            own = set()
            for frame in asked:
                self.send_frame(frame)
                own.add(frame)
            found: list[bytes] = []
            deadline = self.now() + duration
            while (left := deadline - self.now()) > 0 and len(found) < _MOST_OVERHEARD:
                if not select.select([every.raw], [], [], left / 1e9)[0]:
                    break
                with contextlib.suppress(OSError):
                    frame, _, _, (_, _, kind, *_) = every.raw.recvmsg(LONGEST, ANCILLARY)
                    # On loopback interfaces what was sent comes in again.
                    if kind != OUTGOING and len(frame) > ETHERNET_HEADER and frame[12:14] != self._type:
                        found += [frame] if frame not in own else []
            return found

    def _open(self) -> socket.socket:
        try:
            opened = sockets.open_ethernet(
                self.interface, int.from_bytes(self._type), promiscuous=True, instead="--link udp"
            )
        except sockets.NoSuchInterfaceError:
            raise self._gone(OSError(errno.ENODEV, os.strerror(errno.ENODEV))) from None
        except sockets.OpeningError as error:
            raise LowerTesterError(f"{self.name}: {error}") from None
        except OSError as error:
            raise self._gone(error) from None
        # Sockets of one EtherType are not shown what goes out, but on loopback interfaces it comes in again.
        self._echoes = Echoes() if opened.loops else None
        self._ethernet, self._address = opened, opened.address
        return opened.raw

    def _read(self, source: socket.socket) -> tuple[bytes, bytes, bytes, int] | None:
        frame, ancillary, flags, (_, _, kind, _, sender) = source.recvmsg(LONGEST, ANCILLARY)
        if kind == OUTGOING or len(frame) < ETHERNET_HEADER:
            return None
        # The kernel takes the tag of a VLAN out of a frame and the frame for that of another station, which such a
        # destination is not. Of a frame to another station nothing tells.
        if kind == OTHERHOST and (frame[0] & 1 or frame[:6] == self._address):
            return None
        if flags & CUT_OFF:
            # A frame that was not read counts as dropped.
            self._dropped += 1
            return None
        if self._echoes is not None and self._echoes.is_one(frame, self.now()):
            return None
        return frame[ETHERNET_HEADER:], frame, sender, stamp_of(ancillary)

    def _kernel_drops(self) -> int:
        return 0 if self._ethernet is None else self._ethernet.lost()

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
        old.close()
        ethernet, self._ethernet = self._ethernet, None
        if ethernet is not None:
            ethernet.close()
