"""Word from the system that its network interfaces changed."""

from __future__ import annotations

import contextlib
import socket

# Of <linux/rtnetlink.h>; the socket module has none of them.
_AF_NETLINK, _NETLINK_ROUTE = 16, 0
_RTMGRP_LINK, _RTMGRP_IPV4_IFADDR = 0x1, 0x10


class InterfaceWatch:
    """Becomes readable when an interface or an IPv4 address comes, goes or changes (rtnetlink, no privilege needed)."""

    def __init__(self) -> None:
        """Raises ``OSError`` where the system has no such thing."""
        self._socket = socket.socket(_AF_NETLINK, socket.SOCK_RAW, _NETLINK_ROUTE)
        try:
            self._socket.setblocking(False)
            self._socket.bind((0, _RTMGRP_LINK | _RTMGRP_IPV4_IFADDR))
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        """The descriptor to wait for."""
        return self._socket.fileno()

    def changed(self) -> bool:
        """Whether something happened since the last call; what exactly is for the caller to find out."""
        seen = False
        # Not for ever: whoever asks has frames to read, too.
        for _ in range(64):
            try:
                self._socket.recv(1)
            except BlockingIOError:
                break
            except OSError:
                # ENOBUFS: so much happened that the kernel lost some of it.
                return True
            seen = True
        return seen

    def close(self) -> None:
        """Give the descriptor back."""
        with contextlib.suppress(OSError):
            self._socket.close()
