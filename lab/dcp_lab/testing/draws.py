"""Draws from a seeded generator without the argument checks of ``random.Random``.

A generator of messages draws dozens of small numbers for each message, so these checks would take a large part of its
time. The numbers are those of ``random.Random``: the same seed gives the same messages.
"""

from __future__ import annotations

import random
from typing import Protocol, TypeVar

_T = TypeVar("_T")
_T_co = TypeVar("_T_co", covariant=True)


class Members(Protocol[_T_co]):
    """A collection prepared for choice."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> _T_co: ...


class Draws:
    """Draws integers and members from ``rng``; other code may draw from it in between."""

    __slots__ = ("_bits",)

    def __init__(self, rng: random.Random) -> None:
        self._bits = rng.getrandbits

    def below(self, end: int) -> int:
        """Draw a number in 0..``end`` - 1, as ``randrange(end)`` does. Raises ValueError if ``end`` is 0."""
        if end < 1:
            raise ValueError(f"cannot draw a number below {end}")
        bits, width = self._bits, end.bit_length()
        number = bits(width)
        while number >= end:
            number = bits(width)
        return number

    def one_of(self, members: Members[_T]) -> _T:
        """Draw a member, as ``choice(members)`` does. Raises ValueError if there is none."""
        # Inlined below(): a call would take a third of the time.
        bits, end = self._bits, len(members)
        if not end:
            raise ValueError("cannot choose from an empty collection")
        width = end.bit_length()
        number = bits(width)
        while number >= end:
            number = bits(width)
        return members[number]
