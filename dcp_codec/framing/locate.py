"""Find the bearer payload in a link-layer frame: Ethernet II, also tagged, and UDP over IPv4 or IPv6."""

from __future__ import annotations

import struct
from typing import Literal

import msgspec
from dcp_spec.profile.definition import Link

ETHERNET_HEADER = 14
#: Destination, source, EtherType.
_addresses = struct.Struct(">6s6sH").unpack_from
_VLAN_TAGS = (0x8100, 0x88A8)
_IPV4, _IPV6, _UDP = 0x0800, 0x86DD, 17


class Framing(msgspec.Struct, frozen=True, gc=False):
    """Location of a bearer payload, ``frame[start:end]``, and the addresses before it (octets; None: no header)."""

    start: int
    end: int
    dst: bytes | None = None
    src: bytes | None = None
    ether_type: int | None = None


class OtherTraffic(msgspec.Struct, frozen=True, gc=False):
    """A frame that is not DCP in this profile; ``ether_type`` is None when the frame is too short to have one."""

    reason: Literal["short-frame", "ether-type", "udp-port"]
    ether_type: int | None = None


def locate(frame: bytes, link: Link) -> Framing | OtherTraffic:
    """Find the bearer payload of ``frame`` by the EtherType or UDP port of ``link``. Never raises.

    Up to two VLAN tags are skipped. For UDP the destination port decides; IP fragments are other traffic.
    """
    size = len(frame)
    if size < ETHERNET_HEADER:
        return OtherTraffic("short-frame")
    start = ETHERNET_HEADER
    dst, src, ether_type = _addresses(frame)
    while ether_type in _VLAN_TAGS and start < ETHERNET_HEADER + 8 and size >= start + 4:
        ether_type = frame[start + 2] << 8 | frame[start + 3]
        start += 4
    if link.transport == "udp":
        region = _udp_payload(frame, start, ether_type, link.udp_port)
        if region is None:
            return OtherTraffic("udp-port", ether_type)
        return Framing(*region, dst, src, ether_type)
    if ether_type != link.ether_type:
        return OtherTraffic("ether-type", ether_type)
    return Framing(start, size, dst, src, ether_type)


def _udp_payload(frame: bytes, start: int, ether_type: int, port: int | None) -> tuple[int, int] | None:
    if ether_type == _IPV4 and len(frame) >= start + 20 and 0x45 <= frame[start] <= 0x4F:
        fragment = (frame[start + 6] << 8 | frame[start + 7]) & 0x3FFF
        protocol, udp = frame[start + 9], start + 4 * (frame[start] & 0x0F)
        if fragment:
            return None
    elif ether_type == _IPV6 and len(frame) >= start + 40 and frame[start] >> 4 == 6:
        protocol, udp = frame[start + 6], start + 40
    else:
        return None
    if protocol != _UDP or len(frame) < udp + 8 or (frame[udp + 2] << 8 | frame[udp + 3]) != port:
        return None
    length = frame[udp + 4] << 8 | frame[udp + 5]
    return udp + 8, max(udp + 8, min(len(frame), udp + length))


def bare(octets: bytes) -> Framing:
    """Return the framing of octets that are a bearer payload without a link-layer header."""
    return Framing(0, len(octets))


def mac(address: bytes) -> str:
    """Format a MAC address: ``b"\2\0\0\0\0\1"`` -> ``"02:00:00:00:00:01"``."""
    return address.hex(":")
