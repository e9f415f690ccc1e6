"""Packet sockets at the relay's ends of the cables: what each station sends, with the kernel's time stamps."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

from dcp_conformance.errors import LowerTesterError

from dcp_codec.network.namespaces import entered
from dcp_codec.network.sockets import EVERY_ETHER_TYPE, OUTGOING, stamp_of

_SO_TIMESTAMPNS: Final = 35
_SOL_PACKET, _PACKET_STATISTICS = 263, 6


class Tapped(NamedTuple):
    """A frame of a station. ``wall``: ns since 1970, by the kernel."""

    wall: int
    place: int
    frame: bytes


class Taps:
    """One socket for each station, in the namespace of the relay."""

    def __init__(self, namespace: str, interfaces: Sequence[str]) -> None:
        """Raises ``LowerTesterError`` if packet sockets cannot be opened."""
        self._sockets: list[socket.socket] = []
        try:
            with entered(namespace):
                for name in interfaces:
                    made = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(EVERY_ETHER_TYPE))
                    self._sockets.append(made)
                    made.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
                    made.bind((name, EVERY_ETHER_TYPE))
                    made.setblocking(False)
        except OSError as error:
            self.close()
            raise LowerTesterError(f"no packet socket can be opened in {namespace}: {error}") from None

    def read(self, patience_s: float) -> list[Tapped]:
        """Return what has arrived, by time; waits for the first frame at most ``patience_s``."""
        ready, _, _ = select.select(self._sockets, [], [], max(patience_s, 0))
        found: list[Tapped] = []
        for each in ready:
            place = self._sockets.index(each)
            with contextlib.suppress(BlockingIOError):
                while True:
                    frame, extra, _, address = each.recvmsg(65_536, 256)
                    if address[2] == OUTGOING:
                        continue
                    found.append(Tapped(stamp_of(extra), place, frame))
        return sorted(found)

    def lost(self) -> int:
        """Return the number of frames that the kernel has dropped since the last call."""
        counters = (each.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8) for each in self._sockets)
        return sum(struct.unpack("II", each)[1] for each in counters)

    def close(self) -> None:
        """Close the sockets."""
        for each in self._sockets:
            each.close()
