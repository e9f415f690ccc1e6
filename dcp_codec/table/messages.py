"""Finding raw frames in the chunks of an MCAP file, for Numba: JSON as our writer writes it, and nothing else.

A message that is written in any other way ends the walk there, and the reader takes it (``dcp_codec.capture``).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcp_codec.capture.frame import ETHERNET, MAX_TIME_NS

from .jit import helper, machine

_I64: Any = np.int64
_U64: Any = np.uint64
_SECOND = 1_000_000_000
_HEAD, _MESSAGE_HEAD, _MESSAGE = 9, 22, 5

#: What a channel is: not described, raw frames, something else.
UNKNOWN, RAW, OTHER = 0, 1, 2
#: Why the walk ended: something for the reader, or no room for another frame.
ODD, FULL = 0, 1

# The parts of a message between its numbers, and the places where they start.
_PARTS = (
    b'{"timestamp":{"sec":',
    b',"nsec":',
    b'},"number":',
    b',"interface":',
    b',"linkType":',
    b',"origLen":',
    b',"data":"',
    b'"}',
)
_SIZES = np.array([len(part) for part in _PARTS], np.int64)
#: The parts word by word (the last word ends with the part): where each word is, what it is, and whose it is.
_WORD = 8
_PLACES = [[*range(0, len(part) - _WORD, _WORD), len(part) - _WORD] for part in _PARTS[:-1]]
_PLACE = np.array([place for places in _PLACES for place in places], np.int64)
_WORDS = np.array(
    [
        int.from_bytes(part[place : place + _WORD], "little", signed=True)
        for part, places in zip(_PARTS, _PLACES, strict=False)
        for place in places
    ],
    np.int64,
)
_FIRST = np.cumsum([0, *map(len, _PLACES)]).astype(np.int64)
_QUOTE, _BRACE = _PARTS[-1]
_DIGITS = np.array([10, 9, 18, 9, 9, 9], np.int64)
# Of each octet in each of the four places of a group of base64 the bits that it stands for, of others one more.
_NO_DIGIT = 1 << 24
_BASE64 = np.full((4, 256), _NO_DIGIT, np.uint32)
_ALPHABET = np.frombuffer(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/", np.uint8)
for _place in range(4):
    _BASE64[_place, _ALPHABET] = np.arange(64) << (18 - 6 * _place)
_BITS = _BASE64.reshape(-1)
_EQUALS = 61


@helper
def _little(b: Any, at: int, size: int) -> Any:
    found = _I64(0)
    for i in range(size):
        found |= _I64(b[_U64(at + i)]) << (8 * i)
    return found


@helper
def _same(b: Any, at: int, stop: int, part: int) -> bool:
    """Whether a fixed part of the message, but the last, stands at ``at``."""
    if stop - at < _SIZES[part]:
        return False
    for i in range(_FIRST[part], _FIRST[part + 1]):  # noqa: SIM110 - Numba has no generator expressions
        if _little(b, at + _PLACE[i], _WORD) != _WORDS[i]:
            return False
    return True


@machine
def _number(b: Any, at: int, stop: int, most: int) -> tuple[int, int]:
    """The decimal number at ``at`` and where it ends; -1 if there is none of at most ``most`` digits."""
    value, start = _I64(0), at
    while at < stop and at - start < most and 48 <= b[_U64(at)] <= 57:
        value = value * 10 + _I64(b[_U64(at)]) - 48
        at += 1
    if at == start or (b[_U64(start)] == 48 and at - start > 1):
        return _I64(-1), at
    return value, at


@machine
def _group(b: Any, at: int) -> Any:
    """The 24 bits of four characters of base64; ``_NO_DIGIT`` or more if one of them is none."""
    w, x = _I64(_BITS[_U64(b[_U64(at)])]), _I64(_BITS[_U64(b[_U64(at + 1)]) + _U64(256)])
    y, z = _I64(_BITS[_U64(b[_U64(at + 2)]) + _U64(512)]), _I64(_BITS[_U64(b[_U64(at + 3)]) + _U64(768)])
    return w | x | y | z


@machine
def _filled(b: Any, at: int, filled: int) -> Any:
    """As :func:`_group` for one whose last characters say nothing."""
    bits = _I64(_BITS[_U64(b[_U64(at)])]) | _I64(_BITS[_U64(b[_U64(at + 1)]) + _U64(256)])
    return bits if filled == 2 else bits | _I64(_BITS[_U64(b[_U64(at + 2)]) + _U64(512)])


@machine
def _unpack(b: Any, at: int, stop: int, out: Any, used: int) -> Any:
    """Decode base64 to ``out[used:]``; returns how many octets, -1 for what is not in its plainest form.

    ``out`` has room for as many octets as there are characters; what lies behind those that count is anything.
    """
    if (stop - at) % 4:
        return _I64(-1)
    start, seen = used, _I64(0)
    while stop - at > 8:
        first, second = _group(b, at), _group(b, at + 4)
        seen |= first | second
        bits = (first << 40) | (second << 16)
        # Eight at once are one store.
        for i in range(8):
            out[_U64(used + i)] = (bits >> (56 - 8 * i)) & 0xFF
        used += 6
        at += 8
    if seen >= _NO_DIGIT:
        return _I64(-1)
    while at < stop:
        # Only the last group may be filled up with "=", and bits that are no octets are 0.
        filled = _I64(0)
        if at + 4 == stop and b[_U64(at + 3)] == _EQUALS:
            filled = _I64(2) if b[_U64(at + 2)] == _EQUALS else _I64(1)
        bits = _group(b, at) if filled == 0 else _filled(b, at, filled)
        if bits >= _NO_DIGIT or bits & ((1 << (8 * filled)) - 1):
            return _I64(-1)
        for i in range(3 - filled):
            out[_U64(used + i)] = (bits >> (16 - 8 * i)) & 0xFF
        used += 3 - filled
        at += 4
    return used - start


@machine
def walk_messages(
    b: Any,
    position: int,
    channels: Any,
    fields: Any,
    count: int,
    used: int,
    buffer: Any,
    starts: Any,
    stops: Any,
    numbers: Any,
    times: Any,
    lengths: Any,
    interfaces: Any,
) -> tuple[int, int, int, int]:
    """Take the messages of the records ``b[position:]`` into a block that has ``count`` frames and ``used`` octets.

    ``channels`` says of each channel what it is. Returns the position of the first record that was not taken, the new
    ``count`` and ``used``, and why the walk ended. ``fields`` has room for the six numbers of a message.
    """
    end = _I64(b.size)
    while end - position >= _HEAD:
        start = position + _HEAD
        length = _little(b, position + 1, 8)
        if b[_U64(position)] != _MESSAGE or length < _MESSAGE_HEAD or length > end - start:
            break
        stop = start + length
        kind = channels[_little(b, start, 2)]
        if kind == OTHER:
            position = stop
            continue
        if kind != RAW:
            break
        if count == starts.size or used + length > buffer.size:
            return position, count, used, FULL
        at = start + _MESSAGE_HEAD
        good = True
        for part in range(6):
            good = _same(b, at, stop, part)
            if not good:
                break
            fields[part], at = _number(b, at + _SIZES[part], stop, _DIGITS[part])
            good = fields[part] >= 0
            if not good:
                break
        if not good or not _same(b, at, stop, 6):
            break
        at += _SIZES[6]
        if stop - 2 < at or b[_U64(stop - 2)] != _QUOTE or b[_U64(stop - 1)] != _BRACE:
            break
        if fields[0] >= MAX_TIME_NS // _SECOND or fields[2] == 0 or fields[4] != ETHERNET:
            break
        size = _unpack(b, at, stop - 2, buffer, used)
        if size < 0:
            break
        starts[_U64(count)] = used
        stops[_U64(count)] = used + size
        numbers[_U64(count)] = fields[2]
        times[_U64(count)] = fields[0] * _SECOND + fields[1]
        lengths[_U64(count)] = max(fields[5], size)
        interfaces[_U64(count)] = fields[3]
        count += 1
        used += size
        position = stop
    return position, count, used, ODD
