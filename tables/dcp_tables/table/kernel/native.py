"""Functions for Numba that every generated decoder calls: locate the bearer payload of a frame, number identifiers.

:func:`locate` must have the same results as :func:`dcp_codec.framing.locate.locate`; tests compare the two.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .jit import helper

# These types are for Numba; for type checkers the numbers are plain integers.
_I64: Any = np.int64
_U64: Any = np.uint64
_HEADER, _IPV4, _IPV6, _UDP = 14, 0x0800, 0x86DD, 17
_VLAN, _VLAN_OUTER = 0x8100, 0x88A8
_HASH_MULTIPLIER = 0x100000001B3
_HASH_START = 0x4BF29CE484222325


@helper
def _pair(b: Any, at: int) -> Any:
    """Return the 16-bit number at ``at``, big-endian."""
    return (_I64(b[_U64(at)]) << 8) | _I64(b[_U64(at + 1)])


@helper
def wrapped(number: Any) -> Any:
    """Return the signed number with the 64 bits of ``number``: in machine code ``number`` itself."""
    return number


@helper
def locate(b: Any, start: int, stop: int, udp: bool, kind: int) -> tuple[int, int, int]:
    """Return start and end of the bearer payload of the frame ``b[start:stop]``, and the EtherType.

    The start is -1 for other traffic, and the EtherType is -1 if the frame is too short. ``kind`` is the UDP port or
    the EtherType of DCP.
    """
    if stop - start < _HEADER:
        return -1, -1, -1
    at = start + _HEADER
    ether = _pair(b, start + 12)
    while (ether == _VLAN or ether == _VLAN_OUTER) and at < start + _HEADER + 8 and stop >= at + 4:  # noqa: SIM109
        ether = _pair(b, at + 2)
        at += 4
    if not udp:
        if ether != kind:
            return -1, -1, ether
        return at, stop, ether
    if ether == _IPV4 and stop >= at + 20 and 0x45 <= b[_U64(at)] <= 0x4F:
        if _pair(b, at + 6) & 0x3FFF:
            return -1, -1, ether
        protocol = _I64(b[_U64(at + 9)])
        segment = at + 4 * (_I64(b[_U64(at)]) & 0x0F)
    elif ether == _IPV6 and stop >= at + 40 and (b[_U64(at)] >> 4) == 6:
        protocol = _I64(b[_U64(at + 6)])
        segment = at + 40
    else:
        return -1, -1, ether
    if protocol != _UDP or stop < segment + 8 or _pair(b, segment + 2) != kind:
        return -1, -1, ether
    end = min(stop, segment + _pair(b, segment + 4))
    return segment + 8, max(segment + 8, end), ether


@helper
def intern(b: Any, at: int, size: int, slots: Any, ends: Any, arena: Any, many: int) -> Any:
    """Return the number of the identifier ``b[at:at + size]`` in a pool of ``many``; append a new identifier.

    Return -1 if the pool is full. ``ends[n]`` is the start of identifier ``n`` in ``arena``, and the end of the one
    before.
    """
    mask = _I64(len(slots) - 1)
    mixed = _I64(_HASH_START)
    for i in range(size):
        mixed = (mixed ^ _I64(b[_U64(at + i)])) * _HASH_MULTIPLIER
    place = (mixed ^ (mixed >> 32)) & mask
    while True:
        found = _I64(slots[_U64(place)])
        if found < 0:
            break
        start = ends[_U64(found)]
        if ends[_U64(found + 1)] - start == size:
            same = True
            for i in range(size):
                if arena[_U64(start + i)] != b[_U64(at + i)]:
                    same = False
                    break
            if same:
                return found
        place = (place + 1) & mask
    start = ends[_U64(many)]
    if many + 1 >= len(ends) or start + size > len(arena):
        return -1
    for i in range(size):
        arena[_U64(start + i)] = b[_U64(at + i)]
    ends[_U64(many + 1)] = start + size
    slots[_U64(place)] = many
    return many


@helper
def move(stage: Any, rows: int, target: Any, done: int, moves: Any, begin: int, end: int) -> None:
    """Append the first ``rows`` rows of the columns ``moves[begin:end]`` to the ``done`` rows that they have.

    ``moves`` has for each column its start in ``stage``, its start in ``target``, and the size of a row in octets.
    """
    for column in range(begin, end):
        size = moves[column, 2]
        at, to = moves[column, 0], moves[column, 1] + done * size
        for i in range(rows * size):
            target[_U64(to + i)] = stage[_U64(at + i)]
