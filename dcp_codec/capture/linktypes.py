"""Common link types, and advice for those that are not Ethernet."""

from __future__ import annotations

#: From https://www.tcpdump.org/linktypes.html; the number is what pcap and pcapng files carry.
LINK_TYPES = {
    0: "BSD loopback",
    1: "Ethernet",
    6: "Token Ring",
    9: "PPP",
    12: "raw IP",
    14: "raw IP",
    101: "raw IP",
    105: "IEEE 802.11",
    108: "OpenBSD loopback",
    113: "Linux cooked",
    119: "IEEE 802.11 with Prism header",
    127: "IEEE 802.11 with radiotap header",
    147: "user-defined 0",
    163: "IEEE 802.11 with AVS header",
    187: "Bluetooth HCI",
    192: "per-packet information",
    195: "IEEE 802.15.4",
    220: "Linux USB",
    227: "SocketCAN",
    228: "raw IPv4",
    229: "raw IPv6",
    230: "IEEE 802.15.4 without FCS",
    249: "USBPcap",
    253: "Linux netlink",
    276: "Linux cooked v2",
}

_COOKED = "record on one named interface instead of 'any'"
_WIRELESS = "record on the interface in its ordinary (not monitor) mode, which gives Ethernet frames"
_ADVICE = {
    113: _COOKED,
    276: _COOKED,
    105: _WIRELESS,
    119: _WIRELESS,
    127: _WIRELESS,
    163: _WIRELESS,
    192: _WIRELESS,
}


def link_type_name(link_type: int) -> str:
    """Return name and number, such as ``Linux cooked (113)``."""
    return f"{LINK_TYPES.get(link_type, 'unknown link type')} ({link_type})"


def link_type_advice(link_type: int) -> str:
    """Return advice for a user with a capture of this link type."""
    return _ADVICE.get(link_type, "record on an Ethernet interface, or convert the frames to Ethernet first")


def wrong_link_type(link_type: int, accepted: frozenset[int]) -> str:
    """Return a half sentence about a link type that is not accepted, with advice."""
    wanted = " or ".join(link_type_name(each) for each in sorted(accepted)) or "none"
    return f"link type {link_type_name(link_type)}, not {wanted}: {link_type_advice(link_type)}"
