"""Properties of network interfaces: names, whether they are up, and their addresses. Linux only.

The module can be imported on every system, so that ``--help`` works everywhere.
"""

from __future__ import annotations

import errno
import os
import socket
import struct

# From <linux/sockios.h> and <linux/if.h>; the socket module has none of them.
_SIOCGIFFLAGS, _SIOCGIFADDR, _SIOCGIFMTU, _SIOCGIFHWADDR = 0x8913, 0x8915, 0x8921, 0x8927
_IFF_UP, _IFF_RUNNING = 0x1, 0x40
_LONGEST_NAME = 15


def names() -> list[str]:
    """Return the names of all interfaces."""
    return [name for _, name in socket.if_nameindex()]


def is_up(interface: str) -> bool:
    """Return whether the interface exists and is switched on (it may still have no carrier)."""
    return bool(_flags(interface) & _IFF_UP)


def has_carrier(interface: str) -> bool:
    """Return whether the interface exists, is switched on, and has a carrier: its cable or radio is connected."""
    return bool(_flags(interface) & _IFF_RUNNING)


def mtu(interface: str) -> int:
    """Return the longest payload of a frame in octets. Raises ``OSError`` if there is no such interface."""
    found: int = struct.unpack("i", _ask(interface, _SIOCGIFMTU, 4))[0]
    return found


def ipv4_address(interface: str) -> bytes:
    """Return the first IPv4 address, 4 octets. Raises ``OSError`` if there is no address or no such interface."""
    return _ask(interface, _SIOCGIFADDR, 8)[4:]


def hardware_address(interface: str) -> tuple[int, bytes]:
    """Return the hardware type (``ARPHRD_*``) and the first six octets of the address, zeros if it has none.

    Raises ``OSError`` if there is no such interface.
    """
    answer = _ask(interface, _SIOCGIFHWADDR, 8)
    kind: int = struct.unpack("H", answer[:2])[0]
    return kind, answer[2:8]


def _flags(interface: str) -> int:
    """Return the flags of an interface, 0 if there is no such interface."""
    try:
        flags: int = struct.unpack("H", _ask(interface, _SIOCGIFFLAGS, 2))[0]
    except OSError:
        return 0
    return flags


def _ask(interface: str, request: int, length: int) -> bytes:
    """Return the answer to an ioctl on the interface: the octets after its name."""
    import fcntl  # not on every system

    name = os.fsencode(interface)
    if len(name) > _LONGEST_NAME or b"\0" in name:
        # The system would truncate the name, and the result may be the name of another interface.
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV), interface)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        answer = fcntl.ioctl(asking, request, struct.pack("16s24x", name))
    return answer[16 : 16 + length]
