"""Pools that number node identifiers and addresses, so that columns of them are dictionary columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pyarrow as pa

#: Capacity of a pool. A swarm has dozens of identifiers; random octets have millions.
MOST = 1 << 15


def text_array(texts: Sequence[str]) -> pa.Array:
    """Return texts as an Arrow array of strings.

    ``pyarrow.array`` would import pandas, if installed, to check whether a list is a pandas object. That takes as long
    as decoding some thousand beacons.
    """
    octets = [text.encode() for text in texts]
    ends = np.zeros(len(octets) + 1, np.int32)
    np.cumsum([len(each) for each in octets], out=ends[1:])
    return pa.Array.from_buffers(pa.string(), len(octets), [None, pa.py_buffer(ends), pa.py_buffer(b"".join(octets))])


class Pool:
    """A pool of identifiers of a fixed ``size`` in octets, or of variable size (``size`` 0).

    ``write`` converts the octets of an identifier to text. ``most`` is the capacity.
    """

    def __init__(self, size: int, write: Callable[[bytes], str], most: int = MOST) -> None:
        self.size = size
        self.most = most
        self._write = write
        self._texts: list[str] = []
        self._dictionary: pa.Array | None = None
        #: Hash table with open addressing: the number of an identifier, or -1. At least three quarters are free.
        self.slots = np.full(4 * most, -1, np.int32)
        short = 0 < size <= 8
        self.keys = np.empty(most if short else 0, np.int64)
        self.ends = np.zeros(1 if short else most + 1, np.int64)
        self.arena = np.empty(0 if short else 32 * most, np.uint8)
        self.many = 0

    def fresh(self, *, times: int = 1) -> Pool:
        """Return an empty pool of ``times`` the capacity."""
        return Pool(self.size, self._write, times * self.most)

    @property
    def dictionary(self) -> pa.Array:
        """The identifiers as texts, in the order of their numbers."""
        if self._dictionary is None or len(self._texts) < self.many:
            self._texts += [self._write(self._octets(number)) for number in range(len(self._texts), self.many)]
            self._dictionary = text_array(self._texts)
        return self._dictionary

    def _octets(self, number: int) -> bytes:
        if self.keys.size:
            return (int(self.keys[number]) & 0xFFFF_FFFF_FFFF_FFFF).to_bytes(8, "big")[8 - self.size :]
        return self.arena[self.ends[number] : self.ends[number + 1]].tobytes()
