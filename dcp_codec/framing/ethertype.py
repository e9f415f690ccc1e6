"""Parse EtherTypes that the user gives, by one rule for all commands.

``0x4953`` is hexadecimal. A number without ``0x`` is accepted only if it has one possible meaning: ``88b5`` has letters
and is hexadecimal; ``18771`` has too many digits for two octets in hexadecimal and is decimal. ``4953`` could be 0x4953
or 0x1359 and is refused.
"""

from __future__ import annotations

import re

#: A smaller number in this field is a length (IEEE 802.3).
LOWEST, HIGHEST = 0x0600, 0xFFFF


def parse_ether_type(text: str) -> int:
    """Return the EtherType that ``text`` stands for. Raises ValueError; its message says what to write instead."""
    text = text.strip().lower()
    readings = set()
    if re.fullmatch("0x[0-9a-f]+", text):
        readings.add(int(text, 16))
    elif re.fullmatch("[0-9a-f]+", text):
        readings.add(int(text, 16))
        if text.isdecimal():
            readings.add(int(text))
    else:
        raise ValueError(f"{text!r} is not an EtherType; write it in hex, as in 0x4953")
    possible = sorted(number for number in readings if LOWEST <= number <= HIGHEST)
    if not possible:
        raise ValueError(f"{text} is not an EtherType: it is not within 0x0600 to 0xffff")
    if len(possible) > 1:
        low, high = possible
        raise ValueError(f"{text} can be hex or decimal: write {high:#06x} or {low:#06x}")
    return possible[0]
