"""The headers around a bearer payload in a recording: the other way round than :mod:`dcp_codec.framing.locate`."""

from __future__ import annotations

import struct

from dcp_spec.profile.definition import Link

_BROADCAST = b"\xff" * 6
_IPV4, _UDP = 0x0800, 17
_HEADERS = 28
#: For profiles that name no EtherType; of the range that is for local experiments (IEEE 802).
_EXPERIMENTAL = 0x88B5


class Envelope:
    """Puts bearer payloads into frames that the profile itself finds them in again.

    Where DCP is told by an EtherType that is an Ethernet header, whatever the link really was; where it is told by a
    UDP port, a datagram in an IPv4 packet in an Ethernet frame.
    """

    def __init__(self, link: Link) -> None:
        """``link`` is how beacons are told from other traffic."""
        self._port = link.udp_port or 0 if link.transport == "udp" else None
        ether_type = _IPV4 if link.transport == "udp" else link.ether_type or _EXPERIMENTAL
        self._ether_type = struct.pack(">H", ether_type)

    def frame(self, octets: bytes, source: bytes) -> bytes:
        """The frame. ``source`` is who sent it: a MAC address, IPv4 address and port, or anything shorter."""
        source = source[:6].rjust(6, b"\0")
        header = _BROADCAST + unicast(source) + self._ether_type
        if self._port is None:
            return header + octets
        return header + _udp(octets, source[:4], int.from_bytes(source[4:], "big"), self._port)


def unicast(address: bytes) -> bytes:
    """``address``, or where it would be that of a group (as 127.0.0.1 and a port) a locally administered one."""
    return bytes([address[0] & ~1 | 2]) + address[1:] if address[0] & 1 else address


def _udp(octets: bytes, host: bytes, source_port: int, port: int) -> bytes:
    # What is longer than a datagram can be still has to be recorded.
    length = min(_HEADERS + len(octets), 0xFFFF)
    header = struct.pack(">BBHHHBBH4s4s", 0x45, 0, length, 0, 0, 1, _UDP, 0, host, b"\xff" * 4)
    checksum: int = sum(struct.unpack(">10H", header))
    checksum = (checksum & 0xFFFF) + (checksum >> 16)
    checksum = ~(checksum + (checksum >> 16)) & 0xFFFF
    header = header[:10] + checksum.to_bytes(2, "big") + header[12:]
    # The checksum of UDP over IPv4 is optional.
    return header + struct.pack(">HHHH", source_port, port, length - 20, 0) + octets
