"""Finding the frames of a memory-mapped recording, for Numba. Whatever is unusual ends the walk there.

What is to be said about the unusual is the business of the readers in :mod:`dcp_codec.capture`, which go on from
where the walk ended.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcp_codec.table.kernel.jit import helper

# Numba knows these types; to everybody else the numbers are plain integers.
_I64: Any = np.int64
_U64: Any = np.uint64
_SECOND = 1_000_000_000
_RECORD = 16
#: Octets that are fetched from memory ahead of the walk.
_AHEAD = 4096


@helper
def word(b: Any, at: int, big: bool) -> Any:
    """The unsigned 32-bit number at ``at``."""
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
    """Up to ``most`` records, and about ``span`` octets, of a pcap file from ``position``, behind frame ``number``.

    Returns how many, the position behind them, and something of no meaning.
    """
    count, seen = _I64(0), _I64(0)
    size = _I64(b.size)
    last = position + span
    while count < most and position < last:
        if size - position < _RECORD:
            break
        # Where the next record starts is known when this one was read from memory; so that this has begun before.
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


#: Columns of the description of interfaces that :func:`walk_pcapng` is given: one row for each of the section.
ACCEPTED, MULTIPLY, DIVIDE, SHIFT, INDEX, MOST_TICKS = range(6)

_ENHANCED_PACKET = 6
_FIXED, _LEAST = 28, 32


@helper
def _plain_options(b: Any, at: int, stop: int, big: bool) -> bool:
    """Whether the options in ``b[at:stop]`` lie within it."""
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
    """As :func:`walk_pcap` for the enhanced packet blocks of one section, over those with plain contents.

    ``described`` says of each interface whether it is wanted, how to read its clock (``ticks * MULTIPLY // DIVIDE +
    SHIFT``, exact for all stamps up to ``MOST_TICKS``), and its index in the file. ``limit`` is the longest block.
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
