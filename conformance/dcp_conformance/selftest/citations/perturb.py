"""Another value of the same type: what changed code computes in place of the right one."""

from __future__ import annotations

from enum import Enum
from typing import Any


def changed(value: Any) -> Any:
    """A value that differs from ``value`` and is as plausible; values of types that have no such neighbour stay.

    Numbers grow by one, truth is inverted, octets and texts differ in the last place, an enumeration gives its next
    member, sequences are reversed (those with fewer than two elements become empty).
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
    """Zero, nothing, or an empty value of the type of ``value``; values of other types stay."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, Enum):
        return value
    if isinstance(value, bytes | str):
        return type(value)(len(value)) if isinstance(value, bytes) else ""
    if isinstance(value, int | float | list | tuple):
        return type(value)()
    return value
