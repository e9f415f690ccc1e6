"""Escaping of untrusted text (received, from a file, from an implementation) for a terminal, a page or a message.

Names, descriptions, error messages and the output of a crashed process are data. A control sequence in them could move
the cursor of a terminal or change colours and title; a bidirectional override could reorder the line.
"""

from __future__ import annotations


def plain(text: str, *, keep: str = "") -> str:
    """Return ``text`` with all characters that are not printable escaped (``\x1b``), except those in ``keep``.

    Not printable are control characters, line separators, bidirectional marks, and octets that are not valid text.
    """
    if text.isprintable():
        return text
    return "".join(
        char if char in keep or char.isprintable() else char.encode("unicode_escape").decode() for char in text
    )


def printable(text: str) -> str:
    """Return received text for a message, with characters that are not printable escaped."""
    return plain(text, keep="\n").replace("\n", " | ")
