"""Open the packet sockets through which Ethernet frames are received and injected (scapy's ``L2Socket``).

This module imports no protocol layers: a node and the lower tester need the socket only.
"""

from __future__ import annotations

import errno
from typing import Any


def open_packet_socket(interface: str, ether_type: int) -> Any:
    """Open scapy's packet socket for one EtherType on ``interface``; the type is ``Any``, since scapy has no types.

    Raises ``ModuleNotFoundError`` if scapy is not installed, ``PermissionError`` without the right to open raw sockets,
    and other ``OSError`` as the system reports them (``ENODEV`` if the interface was removed in the meantime).
    """
    # Imported for its table of hardware types; without it the socket warns that it does not know Ethernet.
    import scapy.layers.l2  # noqa: F401
    from scapy.arch.linux import L2Socket

    try:
        return L2Socket(iface=interface, type=ether_type, promisc=False, nofilter=1)
    except ValueError as error:
        # Scapy raises this error if it does not find the interface.
        raise OSError(errno.ENODEV, str(error)) from None
