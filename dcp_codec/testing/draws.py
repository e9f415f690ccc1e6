"""What a seeded generator draws, without what ``random.Random`` spends on checking its arguments.

A generator of messages draws dozens of small numbers for each of them, so that these checks are a large part of its
time. The numbers are those that ``random.Random`` draws itself: the same seed makes the same messages.
"""

from __future__ import annotations

import random
from typing import Protocol, TypeVar

_T = TypeVar("_T")
_T_co = TypeVar("_T_co", covariant=True)


class Members(Protocol[_T_co]):
    """What can be chosen from."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> _T_co: ...


class Draws:
    """Draws whole numbers and members from ``rng``, which may be drawn from by others in between."""

    __slots__ = ("_bits",)

    def __init__(self, rng: random.Random) -> None:
        self._bits = rng.getrandbits

    def below(self, end: int) -> int:
        """A number in 0..``end`` - 1, as ``randrange(end)`` has it. Raises ValueError if there is none."""
        if end < 1:
            raise ValueError(f"there is no number from 0 and below {end}")
        bits, width = self._bits, end.bit_length()
        number = bits(width)
        while number >= end:
            number = bits(width)
        return number

    def one_of(self, members: Members[_T]) -> _T:
        """A member, as ``choice(members)`` has it. Raises ValueError if there is none."""
        # What below() does: a call of it would be a third of the time.
        bits, end = self._bits, len(members)
        if not end:
            raise ValueError("there is nothing to choose from")
        width = end.bit_length()
        number = bits(width)
        while number >= end:
            number = bits(width)
        return members[number]
