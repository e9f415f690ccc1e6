"""What the system says of network interfaces: which there are, whether they are up, and that something changed."""

from __future__ import annotations

import contextlib
import fcntl
import socket
import struct

# Of <linux/sockios.h>, <linux/if.h> and <linux/rtnetlink.h>; the socket module has none of them.
_SIOCGIFFLAGS, _SIOCGIFMTU, _SIOCGIFHWADDR = 0x8913, 0x8921, 0x8927
_IFF_UP = 0x1
_AF_NETLINK, _NETLINK_ROUTE = 16, 0
_RTMGRP_LINK, _RTMGRP_IPV4_IFADDR = 0x1, 0x10


def names() -> list[str]:
    """The interfaces there are."""
    return [name for _, name in socket.if_nameindex()]


def is_up(interface: str) -> bool:
    """Whether the interface is there and switched on (it may still have no carrier)."""
    try:
        flags: int = struct.unpack("H", _ask(interface, _SIOCGIFFLAGS, 2))[0]
    except OSError:
        return False
    return bool(flags & _IFF_UP)


def mtu(interface: str) -> int:
    """The longest payload of a frame in octets; raises ``OSError`` if there is no such interface."""
    found: int = struct.unpack("i", _ask(interface, _SIOCGIFMTU, 4))[0]
    return found


def hardware_address(interface: str) -> tuple[int, bytes]:
    """Hardware type (``ARPHRD_*``) and the first six octets of the address, zeros where there is none.

    Raises ``OSError`` if there is no such interface.
    """
    answer = _ask(interface, _SIOCGIFHWADDR, 8)
    kind: int = struct.unpack("H", answer[:2])[0]
    return kind, answer[2:8]


def _ask(interface: str, request: int, length: int) -> bytes:
    """The answer of the interface to an ioctl, the octets behind its name."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        answer = fcntl.ioctl(asking, request, struct.pack("16s24x", interface.encode()))
    return answer[16 : 16 + length]


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
