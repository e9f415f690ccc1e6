"""Notification of changes to the network interfaces of the system."""

from __future__ import annotations

import contextlib
import socket

# From <linux/rtnetlink.h>; the socket module does not define them.
_AF_NETLINK, _NETLINK_ROUTE = 16, 0
_RTMGRP_LINK, _RTMGRP_IPV4_IFADDR = 0x1, 0x10


class InterfaceWatch:
    """A descriptor that is readable after an interface or IPv4 address changed (rtnetlink; no privilege needed)."""

    def __init__(self) -> None:
        """Raises ``OSError`` if the system has no rtnetlink."""
        self._socket = socket.socket(_AF_NETLINK, socket.SOCK_RAW, _NETLINK_ROUTE)
        try:
            self._socket.setblocking(False)
            self._socket.bind((0, _RTMGRP_LINK | _RTMGRP_IPV4_IFADDR))
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        """Return the descriptor to wait for."""
        return self._socket.fileno()

    def changed(self) -> bool:
        """Whether an interface or address changed since the last call; the caller determines the change."""
        seen = False
        # Bounded: the caller also has frames to read.
        for _ in range(64):
            try:
                self._socket.recv(1)
            except BlockingIOError:
                break
            except OSError:
                # ENOBUFS: there were so many notifications that the kernel dropped some.
                return True
            seen = True
        return seen

    def close(self) -> None:
        """Close the descriptor."""
        with contextlib.suppress(OSError):
            self._socket.close()
