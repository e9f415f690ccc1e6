"""Opening a link from the text given on the command line."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from dcp_codec.framing.ethertype import parse_ether_type
from dcp_stack.config import NodeConfig

from .base import Link, LinkError

#: The forms that :func:`open_link` accepts, for help texts.
FORMS: Mapping[str, str] = {
    "eth:IF[,source=MAC|node][,type=0xNNNN][,size=N]": "Ethernet frames on an interface; needs a privilege",
    "udp[:GROUP[:PORT]][,interface=ADDRESS][,ttl=N][,size=N]": "UDP multicast or broadcast; stays on this host",
    "replay:FILE[,speed=X][,source=MAC]": "a recording, replayed with its timing",
}

Options = dict[str, str]


def open_link(spec: str, config: NodeConfig) -> Link:
    """Open the link that ``spec`` names (:data:`FORMS`) for a node; its profile defines the framing of beacons.

    Frames on ``eth`` are sent from the address of the interface. Profiles without a beacon header are an exception:
    there only the source address identifies the sender, so it is the node identifier if that is a unicast address.

    Raises :class:`LinkError` if ``spec`` does not name a link, or if the link cannot be opened.
    """
    body, options = _split(spec)
    kind, _, rest = body.partition(":")
    if kind == "replay":
        # File names may contain text that looks like an option.
        body, options = _split(spec, _OPENERS[kind][0])
        rest = body.partition(":")[2]
    opener = _OPENERS.get(kind)
    if opener is None:
        forms = "\n".join(f"  {form}  {about}" for form, about in FORMS.items())
        raise LinkError(f"{spec!r} is not a link; known forms are\n{forms}")
    known, open_it = opener
    for name in options:
        if name not in known:
            raise LinkError(f"{spec}: {kind} has no option {name!r}; known options are {', '.join(known)}")
    try:
        return open_it(rest, options, config)
    except ValueError as error:
        raise LinkError(f"{spec}: {error}") from error


def _split(spec: str, known: tuple[str, ...] = ()) -> tuple[str, Options]:
    """Return the text without its options, and the options; with ``known``, stop at the first unknown option."""
    options: Options = {}
    while found := re.fullmatch(r"(.*),([a-z]+)=([^,]*)", spec, re.DOTALL):
        rest, name, value = found.groups()
        if known and name not in known:
            break
        spec = rest
        options.setdefault(name, value)
    return spec, options


def _open_eth(interface: str, options: Options, config: NodeConfig) -> Link:
    from .ethernet import open_ethernet

    if not interface:
        raise LinkError("eth: interface missing; name it as in eth:wlan0")
    profile, node = config.profile, config.node_id
    try:
        ether_type = parse_ether_type(options["type"]) if "type" in options else profile.link.ether_type
    except ValueError as error:
        raise LinkError(f"eth:{interface}: type: {error}") from None
    if ether_type is None:
        raise LinkError(f"eth:{interface}: profile {profile.name} defines no EtherType; name it, as in ,type=0x88b5")
    source = _address(options, node)
    if "source" not in options and not profile.bp.header and len(node) == 6 and not node[0] & 1:
        source = node
    return open_ethernet(interface, ether_type, source=source, max_packet_size=_number(options, "size", None))


def _open_udp(rest: str, options: Options, config: NodeConfig) -> Link:
    from .udp import DEFAULT_GROUP, DEFAULT_PORT, open_udp

    group, _, port = rest.partition(":")
    return open_udp(
        group or DEFAULT_GROUP,
        int(port) if port else config.profile.link.udp_port or DEFAULT_PORT,
        options.get("interface", "127.0.0.1"),
        ttl=int(options.get("ttl", "1")),
        max_packet_size=_number(options, "size", None),
    )


def _open_replay(path: str, options: Options, config: NodeConfig) -> Link:
    from .replay import ReplayLink

    if not path:
        raise LinkError("replay: file missing; name it as in replay:flight.mcap")
    source = _address(options, config.node_id) or b""
    return ReplayLink(path, config.profile.link, speed=float(options.get("speed", "1")), source=source)


_OPENERS: Mapping[str, tuple[tuple[str, ...], Callable[[str, Options, NodeConfig], Link]]] = {
    "eth": (("source", "type", "size"), _open_eth),
    "udp": (("interface", "ttl", "size"), _open_udp),
    "replay": (("speed", "source"), _open_replay),
}


def _number(options: Options, name: str, default: int | None) -> int | None:
    """Return the integer in an option, decimal or with a prefix such as 0x; ``default`` if absent."""
    return int(options[name], 0) if name in options else default


def _address(options: Options, node: bytes) -> bytes | None:
    """Return the address in option ``source``: a MAC address, or the node identifier for ``node``; None if absent."""
    text = options.get("source")
    if text is None:
        return None
    if text == "node":
        return node
    if not re.fullmatch(r"[0-9A-Fa-f]{2}([:-][0-9A-Fa-f]{2}){5}", text):
        raise LinkError(f"source {text!r} is neither 'node' nor an address such as 02:00:00:00:00:01")
    return bytes.fromhex(re.sub("[:-]", "", text))
