"""Build the headers around a bearer payload in a recording: the inverse of :mod:`dcp_codec.framing.locate`."""

from __future__ import annotations

import struct

from dcp_spec.profile.definition import Link

_BROADCAST = b"\xff" * 6
_IPV4, _UDP = 0x0800, 17
_HEADERS = 28
#: EtherType for profiles that name none; reserved for local experiments (IEEE 802).
_EXPERIMENTAL = 0x88B5


class Envelope:
    """Builds frames around bearer payloads so that the profile finds the payloads in them again.

    A profile with an EtherType gets an Ethernet header, whatever the real link was. A profile with a UDP port gets a
    UDP datagram in an IPv4 packet in an Ethernet frame.
    """

    def __init__(self, link: Link) -> None:
        """``link`` says by which EtherType or UDP port beacons are recognised."""
        self._port = link.udp_port or 0 if link.transport == "udp" else None
        ether_type = _IPV4 if link.transport == "udp" else link.ether_type or _EXPERIMENTAL
        self._ether_type = struct.pack(">H", ether_type)

    def frame(self, octets: bytes, source: bytes) -> bytes:
        """Return the frame. ``source`` is the sender's address: a MAC address, an IPv4 address with port, or fewer
        octets.
        """
        source = source[:6].rjust(6, b"\0")
        header = _BROADCAST + unicast(source) + self._ether_type
        if self._port is None:
            return header + octets
        return header + _udp(octets, source[:4], int.from_bytes(source[4:], "big"), self._port)


def unicast(address: bytes) -> bytes:
    """Return ``address``, with the local bit set if it would be a group address (such as 127.0.0.1 with a port)."""
    return bytes([address[0] & ~1 | 2]) + address[1:] if address[0] & 1 else address


def _udp(octets: bytes, host: bytes, source_port: int, port: int) -> bytes:
    # A payload longer than a datagram can be is still recorded; the length field saturates.
    length = min(_HEADERS + len(octets), 0xFFFF)
    header = struct.pack(">BBHHHBBH4s4s", 0x45, 0, length, 0, 0, 1, _UDP, 0, host, b"\xff" * 4)
    checksum: int = sum(struct.unpack(">10H", header))
    checksum = (checksum & 0xFFFF) + (checksum >> 16)
    checksum = ~(checksum + (checksum >> 16)) & 0xFFFF
    header = header[:10] + checksum.to_bytes(2, "big") + header[12:]
    # 0: the checksum is optional in UDP over IPv4.
    return header + struct.pack(">HHHH", source_port, port, length - 20, 0) + octets
