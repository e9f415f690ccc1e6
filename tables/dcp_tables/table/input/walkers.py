"""Functions for Numba that find the frames of a memory-mapped recording.

A walk ends at an unusual record. The readers in :mod:`dcp_codec.capture` process it, report its problems, and continue
from there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcp_tables.table.kernel.jit import helper

# These types are for Numba; for type checkers the numbers are plain integers.
_I64: Any = np.int64
_U64: Any = np.uint64
_SECOND = 1_000_000_000
_RECORD = 16
#: Distance of the prefetch from the current record, in octets.
_AHEAD = 4096


@helper
def word(b: Any, at: int, big: bool) -> Any:
    """Return the unsigned 32-bit number at ``at``, big-endian or little-endian."""
    w, x, y, z = _I64(b[_U64(at)]), _I64(b[_U64(at + 1)]), _I64(b[_U64(at + 2)]), _I64(b[_U64(at + 3)])
    return (w << 24) | (x << 16) | (y << 8) | z if big else (z << 24) | (y << 16) | (x << 8) | w


def walk_pcap(
    b: Any,
    position: int,
    big: bool,
    scale: int,
    limit: int,
    number: int,
    most: int,
    span: int,
    starts: Any,
    stops: Any,
    numbers: Any,
    times: Any,
    lengths: Any,
) -> tuple[int, int, int]:
    """Find up to ``most`` records in about ``span`` octets of a pcap file from ``position``, after frame ``number``.

    Return the number of records, the next position, and a dummy that keeps the prefetching loads alive.
    """
    count, seen = _I64(0), _I64(0)
    size = _I64(b.size)
    last = position + span
    while count < most and position < last:
        if size - position < _RECORD:
            break
        # Prefetch: the position of the next record depends on this one, so that the processor cannot load ahead.
        seen |= _I64(b[_U64(min(position + _AHEAD, size - 1))])
        captured = word(b, position + 8, big)
        length = word(b, position + 12, big)
        body = position + _RECORD
        if captured > limit or captured > size - body:
            break
        seconds, fraction = word(b, position, big), word(b, position + 4, big)
        if length == 0 and seconds == 0 and fraction == 0 and captured == 0:
            break
        number += 1
        starts[_U64(count)] = body
        stops[_U64(count)] = body + captured
        numbers[_U64(count)] = number
        times[_U64(count)] = seconds * _SECOND + fraction * scale
        lengths[_U64(count)] = max(length, captured)
        count += 1
        position = body + captured
    return count, position, seen


#: Columns of the table of interfaces for :func:`walk_pcapng`, which has one row for each interface of the section.
ACCEPTED, MULTIPLY, DIVIDE, SHIFT, INDEX, MOST_TICKS = range(6)

_ENHANCED_PACKET = 6
_FIXED, _LEAST = 28, 32


@helper
def _plain_options(b: Any, at: int, stop: int, big: bool) -> bool:
    """Return whether the options in ``b[at:stop]`` end within this range."""
    while at < stop:
        if stop - at < 4:
            return False
        first = word(b, at, big)
        code, length = (first >> 16, first & 0xFFFF) if big else (first & 0xFFFF, first >> 16)
        if code == 0:
            return True
        at += 4
        if length > stop - at:
            return False
        at += length + -length % 4
    return True


def walk_pcapng(
    b: Any,
    position: int,
    big: bool,
    described: Any,
    limit: int,
    number: int,
    most: int,
    span: int,
    starts: Any,
    stops: Any,
    numbers: Any,
    times: Any,
    lengths: Any,
    interfaces: Any,
) -> tuple[int, int]:
    """Find usual enhanced packet blocks of one section of a pcapng file; see :func:`walk_pcap`.

    ``described`` has for each interface whether its frames are read, how to convert its time stamps (``ticks * MULTIPLY
    // DIVIDE + SHIFT``, exact up to ``MOST_TICKS``), and its index in the file. ``limit`` is the maximum size of a
    block. Return the number of blocks and the next position.
    """
    count = _I64(0)
    size = _I64(b.size)
    last = position + span
    while count < most and position < last:
        if size - position < _LEAST or word(b, position, big) != _ENHANCED_PACKET:
            break
        total = word(b, position + 4, big)
        if total < _LEAST or total % 4 or total > limit or total > size - position:
            break
        if word(b, position + total - 4, big) != total:
            break
        which = word(b, position + 8, big)
        if which >= described.shape[0] or described[which, ACCEPTED] == 0:
            break
        captured, room, body = word(b, position + 20, big), total - _LEAST, position + _FIXED
        if captured > room:
            break
        if room > captured + 3 and not _plain_options(b, body + captured + -captured % 4, body + room, big):
            break
        high = word(b, position + 12, big)
        ticks = (high << 32) | word(b, position + 16, big)
        if ticks < 0 or ticks > described[which, MOST_TICKS]:
            break
        scaled = ticks * described[which, MULTIPLY]
        divide = described[which, DIVIDE]
        if divide != 1 and scaled % divide:
            break
        time = scaled // divide + described[which, SHIFT]
        if time < 0:
            break
        number += 1
        starts[_U64(count)] = body
        stops[_U64(count)] = body + captured
        numbers[_U64(count)] = number
        times[_U64(count)] = time
        lengths[_U64(count)] = max(word(b, position + 24, big), captured)
        interfaces[_U64(count)] = described[which, INDEX]
        count += 1
        position += total
    return count, position
