"""Text of others (from the air, a file, an implementation) for a terminal, a page or a message.

Names, descriptions, error messages and last words are data. In a terminal a control sequence in them would move the
cursor, change colours or the title, and a bidirectional override would reorder the line.
"""

from __future__ import annotations


def plain(text: str, *, keep: str = "") -> str:
    """``text`` with every character that is not printable as an escape (``\\x1b``), except those in ``keep``.

    Not printable are control characters, line separators, bidirectional marks, and octets that are no text.
    """
    if text.isprintable():
        return text
    return "".join(
        char if char in keep or char.isprintable() else char.encode("unicode_escape").decode() for char in text
    )
