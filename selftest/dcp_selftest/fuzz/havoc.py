"""Mutate octets without a known layout: files, lines of text."""

from __future__ import annotations

import random
from collections.abc import Sequence

_EDGES = (b"\0", b"\xff", b"\x7f", b"\x80", b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\0\0\0\x80")

#: Maximum number of inputs in the pool.
_MOST = 2048


class Havoc:
    """Mutates inputs of a pool. ``words``: tokens of the format, which are inserted at random."""

    def __init__(self, rng: random.Random, pool: Sequence[bytes], words: Sequence[bytes] = ()) -> None:
        """Raises ValueError for an empty pool."""
        if not pool:
            raise ValueError("there is nothing to mutate: the pool is empty")
        self._rng = rng
        self.pool = list(pool)
        """The inputs that are mutated."""
        self._words = (*words, *_EDGES)

    def add(self, octets: bytes) -> None:
        """Add an input to the pool; replace a random one if the pool is full."""
        if len(self.pool) < _MOST:
            self.pool.append(octets)
        else:
            self.pool[self._rng.randrange(_MOST)] = octets

    def mutate(self) -> bytes:
        """Return an input of the pool, changed in one to six places; with a probability of 2 % random octets."""
        rng = self._rng
        if rng.random() < 0.02:
            return rng.randbytes(rng.randrange(80))
        octets = bytearray(rng.choice(self.pool))
        for _ in range(rng.choice((1, 1, 2, 3, 6))):
            self._change(octets)
        return bytes(octets)

    def _change(self, octets: bytearray) -> None:
        rng, size = self._rng, len(octets)
        start = rng.randrange(size + 1)
        stop = min(size, start + rng.choice((1, 2, 4, 8, 16, 64)))
        match rng.randrange(8):
            case 0 if size:
                octets[rng.randrange(size)] ^= 1 << rng.randrange(8)
            case 1:
                octets[start:stop] = rng.choice(self._words)
            case 2:
                octets[start:start] = rng.choice(self._words)
            case 3:
                del octets[start:stop]
            case 4:
                octets[stop:stop] = octets[start:stop] * rng.choice((1, 1, 3, 200))
            case 5:
                del octets[start:]
            case 6:
                other = rng.choice(self.pool)
                begin = rng.randrange(len(other) + 1)
                octets[start:stop] = other[begin : begin + rng.choice((4, 16, 64))]
            case _ if size:
                place = rng.randrange(size)
                octets[place] = (octets[place] + rng.choice((-1, 1))) % 256
            case _:
                octets += rng.choice(self._words)
