"""Python data as Lua source."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

_WIDTH = 118
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n"}


def quoted(text: str) -> str:
    """Return a Lua string literal of the UTF-8 octets of ``text``; all except printable ASCII is escaped by number."""
    octets = text.encode(errors="replace")
    return '"' + "".join(_ESCAPES.get(chr(o), chr(o) if 32 <= o < 127 else f"\\{o:03d}") for o in octets) + '"'


def literal(value: Any, depth: int = 0) -> str:
    """Return a Lua expression for numbers, booleans, strings, sequences and mappings, without members that are None.

    Tables that fit are on one line, others have a line for each member, indented by ``depth``.
    """
    match value:
        case bool():
            return "true" if value else "false"
        case int():
            return str(value)
        case str():
            return quoted(value)
        case Mapping():
            items = [(_key(key), member) for key, member in value.items() if member is not None]
        case Sequence():
            items = [("", member) for member in value]
        case _:
            raise TypeError(f"no Lua literal for {type(value).__name__}")
    rendered = [key + literal(member, depth + 1) for key, member in items]
    flat = "{ " + ", ".join(rendered) + " }" if rendered else "{}"
    if "\n" not in flat and 4 * depth + len(flat) <= _WIDTH:
        return flat
    inner = "    " * (depth + 1)
    return "\n".join(["{", *(f"{inner}{line}," for line in rendered), "    " * depth + "}"])


def _key(key: str | int) -> str:
    if isinstance(key, int):
        return f"[{key}] = "
    return (
        f"{key} = " if key.isidentifier() and key.isascii() and not _RESERVED.fullmatch(key) else f"[{quoted(key)}] = "
    )


_RESERVED = re.compile(
    "and|break|do|else|elseif|end|false|for|function|goto|if|in|local|nil|not|or|repeat|return|then|true|until|while"
)
