"""Node identifiers as people, files and upper testers write them."""

from __future__ import annotations

import re

_HEX = re.compile(r"[0-9A-Fa-f]{2}(:?[0-9A-Fa-f]{2})*")


def node_id_octets(text: str) -> bytes:
    """The octets of an identifier in hexadecimal, with or without colons, in the order of transmission.

    Raises ``ValueError`` whose message says what is wrong, and what a right one looks like.
    """
    if not _HEX.fullmatch(text):
        raise ValueError(
            f"{text!r} is not a node identifier; expected octets in hex, such as 02:00:00:00:00:01 or 020000000001"
        )
    return bytes.fromhex(text.replace(":", ""))
