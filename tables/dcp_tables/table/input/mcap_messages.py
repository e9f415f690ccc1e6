"""Functions for Numba that find raw frames in the chunks of an MCAP file: protobuf messages as our writer writes them.

Any other message ends the walk, and is processed by the reader (``dcp_codec.capture``).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcp_codec.capture.frame import ETHERNET
from dcp_tables.table.kernel.jit import helper

_I64: Any = np.int64
_U64: Any = np.uint64
_HEAD, _MESSAGE_HEAD, _MESSAGE = 9, 22, 5
#: Offset of the log time in a message.
_LOG_TIME = 6
_MOST_32 = (1 << 32) - 1
_MOST_NUMBER = 1 << 62

#: Kinds of channels: not described yet, raw frames in protobuf, others without frames.
UNKNOWN, RAW, OTHER = 0, 1, 2
#: Reasons for the end of the walk: a record for the reader, or no room for another frame.
ODD, FULL = 0, 1

# Tags of protobuf: number of the field and wire type (0 is a number, 2 are octets with their length), in the order of
# `dcp_codec.capture.mcap.raw_frame.FIELDS`. Messages with a timestamp, the first field, are left to the reader, because
# our writer does not write it.
_NUMBER, _INTERFACE, _LINK_TYPE, _ORIG_LEN, _DATA = 0x10, 0x18, 0x20, 0x28, 0x32


@helper
def _little(b: Any, at: int, size: int) -> Any:
    found = _I64(0)
    for i in range(size):
        found |= _I64(b[_U64(at + i)]) << (8 * i)
    return found


@helper
def _varint(b: Any, at: int, stop: int, most: int) -> tuple[int, int]:
    """Return the number at ``at`` and its end; the number is -1 if it is invalid or greater than ``most``."""
    value = shift = _I64(0)
    while at < stop and shift < 63:
        octet = _I64(b[_U64(at)])
        at += 1
        value |= (octet & 0x7F) << shift
        if octet < 0x80:
            return (value, at) if value <= most else (_I64(-1), at)
        shift += 7
    return _I64(-1), at


@helper
def _tagged(b: Any, at: int, stop: int, tag: int, most: int) -> tuple[int, int]:
    """Return the value of the field at ``at`` as :func:`_varint` does; -1 if the field has another tag."""
    if at >= stop or b[_U64(at)] != tag:
        return _I64(-1), at
    return _varint(b, at + 1, stop, most)


def walk_messages(
    b: Any,
    position: int,
    end: int,
    channels: Any,
    count: int,
    starts: Any,
    stops: Any,
    numbers: Any,
    times: Any,
    lengths: Any,
    interfaces: Any,
) -> tuple[int, int, int]:
    """Add the messages of the records ``b[position:end]`` to a block that has ``count`` frames.

    ``channels`` has the kind of each channel. Frames are not copied: ``starts`` and ``stops`` are offsets in ``b``.
    Return the position of the first record that was not added, the new ``count``, and the reason for the end.
    """
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
        if count == starts.size:
            return position, count, FULL
        # The log time, which is negative here for times after 2262.
        time, at = _little(b, start + _LOG_TIME, 8), start + _MESSAGE_HEAD
        if time < 0:
            break
        number, at = _tagged(b, at, stop, _NUMBER, _MOST_NUMBER)
        if number <= 0:
            break
        interface, at = _tagged(b, at, stop, _INTERFACE, _MOST_32)
        if interface < 0:
            break
        link_type, at = _tagged(b, at, stop, _LINK_TYPE, _MOST_32)
        if link_type != ETHERNET:
            break
        orig_len, at = _tagged(b, at, stop, _ORIG_LEN, _MOST_32)
        if orig_len < 0:
            break
        size, at = _tagged(b, at, stop, _DATA, _MOST_32)
        if size < 0 or at + size != stop:
            break
        starts[_U64(count)] = at
        stops[_U64(count)] = stop
        numbers[_U64(count)] = number
        times[_U64(count)] = time
        lengths[_U64(count)] = max(orig_len, size)
        interfaces[_U64(count)] = interface
        count += 1
        position = stop
    return position, count, ODD
