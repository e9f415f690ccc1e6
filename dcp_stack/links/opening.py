"""Opening a link from the text given on the command line."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from dcp_codec.framing.ethertype import parse_ether_type
from dcp_stack.config import NodeConfig
from dcp_stack.options import Options

from .base import Link, LinkError

#: The forms that :func:`open_link` accepts, for help texts.
FORMS: Mapping[str, str] = {
    "eth:IF[,source=MAC|node][,type=0xNNNN][,size=N]": "Ethernet frames on an interface; needs a privilege",
    "udp[:GROUP[:PORT]][,interface=ADDRESS][,ttl=N][,size=N]": "UDP multicast or broadcast; stays on this host",
    "replay:FILE[,speed=X][,source=MAC]": "a recording, replayed with its timing",
}


def open_link(spec: str, config: NodeConfig) -> Link:
    """Open the link that ``spec`` names (:data:`FORMS`) for a node; its profile defines the framing of beacons.

    Frames on ``eth`` are sent from the address of the interface. Profiles without a beacon header are an exception:
    there only the source address identifies the sender, so it is the node identifier if that is a unicast address.

    Raises :class:`LinkError` if ``spec`` does not name a link, or if the link cannot be opened.
    """
    kind = re.split("[:,]", spec, maxsplit=1)[0]
    if kind not in _OPENERS:
        forms = "\n".join(f"  {form}  {about}" for form, about in FORMS.items())
        raise LinkError(f"{spec!r} is not a link; known forms are\n{forms}")
    known, open_it = _OPENERS[kind]
    try:
        options = Options(spec[len(kind) :].removeprefix(":"), known, of_a_file=kind == "replay")
        return open_it(options, config)
    except ValueError as error:
        raise LinkError(f"{spec}: {error}") from error


def _open_eth(options: Options, config: NodeConfig) -> Link:
    from .ethernet import open_ethernet

    interface = options.head
    if not interface:
        raise LinkError("eth: interface missing; name it as in eth:wlan0")
    profile, node = config.profile, config.node_id
    try:
        given = options.text("type")
        ether_type = profile.link.ether_type if given is None else parse_ether_type(given)
    except ValueError as error:
        raise LinkError(f"eth:{interface}: type: {error}") from None
    if ether_type is None:
        raise LinkError(f"eth:{interface}: profile {profile.name} defines no EtherType; name it, as in ,type=0x88b5")
    source = _address(options, node)
    if source is None and not profile.bp.header and len(node) == 6 and not node[0] & 1:
        source = node
    return open_ethernet(interface, ether_type, source=source, max_packet_size=_size(options))


def _open_udp(options: Options, config: NodeConfig) -> Link:
    from .udp import DEFAULT_GROUP, DEFAULT_PORT, open_udp

    group, _, port = options.head.partition(":")
    return open_udp(
        group or DEFAULT_GROUP,
        int(port) if port else config.profile.link.udp_port or DEFAULT_PORT,
        options.text("interface") or "127.0.0.1",
        ttl=int(options.text("ttl") or "1"),
        max_packet_size=_size(options),
    )


def _open_replay(options: Options, config: NodeConfig) -> Link:
    from .replay import ReplayLink

    if not options.head:
        raise LinkError("replay: file missing; name it as in replay:flight.mcap")
    source = _address(options, config.node_id) or b""
    speed = float(options.text("speed") or "1")
    return ReplayLink(options.head, config.profile.link, speed=speed, source=source)


_OPENERS: Mapping[str, tuple[tuple[str, ...], Callable[[Options, NodeConfig], Link]]] = {
    "eth": (("source", "type", "size"), _open_eth),
    "udp": (("interface", "ttl", "size"), _open_udp),
    "replay": (("speed", "source"), _open_replay),
}


def _size(options: Options) -> int | None:
    """Return the integer in option ``size``, decimal or with a prefix such as 0x; None if absent."""
    text = options.text("size")
    return None if text is None else int(text, 0)


def _address(options: Options, node: bytes) -> bytes | None:
    """Return the address in option ``source``: a MAC address, or the node identifier for ``node``; None if absent."""
    text = options.text("source")
    if text is None:
        return None
    if text == "node":
        return node
    if not re.fullmatch(r"[0-9A-Fa-f]{2}([:-][0-9A-Fa-f]{2}){5}", text):
        raise LinkError(f"source {text!r} is neither 'node' nor an address such as 02:00:00:00:00:01")
    return bytes.fromhex(re.sub("[:-]", "", text))
