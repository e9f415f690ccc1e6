"""Replacement values of the same type, which changed code computes instead of the correct value."""

from __future__ import annotations

from enum import Enum
from typing import Any


def changed(value: Any) -> Any:
    """Return a plausible value that differs from ``value``; values of unsupported types are returned unchanged.

    Numbers are incremented, Booleans inverted, the last octet or character is changed, an enumeration yields its next
    member, and sequences are reversed. A sequence that equals its reverse is replaced by an empty one.
    """
    if isinstance(value, Enum):
        members = list(type(value))
        return members[(members.index(value) + 1) % len(members)]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, bytes):
        return value[:-1] + bytes([value[-1] ^ 1]) if value else b"\0"
    if isinstance(value, str):
        return value[:-1] + ("x" if value[-1] != "x" else "y") if value else "x"
    if isinstance(value, list | tuple):
        return value[::-1] if len(value) > 1 and value[::-1] != value else type(value)()
    return value


def blank(value: Any) -> Any:
    """Return zero or an empty value of the type of ``value``; Booleans are inverted, octets become zero octets.

    Enumerations and values of unsupported types are returned unchanged.
    """
    if isinstance(value, bool):
        return not value
    if isinstance(value, Enum):
        return value
    if isinstance(value, bytes | str):
        return type(value)(len(value)) if isinstance(value, bytes) else ""
    if isinstance(value, int | float | list | tuple):
        return type(value)()
    return value
