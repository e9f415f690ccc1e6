"""Reading of positions from the pose messages of our MCAP files."""

from __future__ import annotations

import struct

import msgspec

#: A PoseStamped in CDR: octets of the encapsulation header, of the stamp, and the length of `frame_id`, which ends in a
#: zero.
_CDR_HEAD, _STAMP, _LENGTH = 4, 8, struct.Struct("<I")
_POINT = struct.Struct("<ddd")
#: Little-endian plain CDR, the only encoding in our bags.
_CDR_LE = b"\x00\x01"


class _Point(msgspec.Struct):
    x: float
    y: float
    z: float


class _Pose(msgspec.Struct):
    position: _Point


class _PoseInFrame(msgspec.Struct):
    pose: _Pose


def position_in(encoding: str, schema: str, data: bytes) -> tuple[float, float, float] | None:
    """Return x, y, z in metres of a ``foxglove.PoseInFrame`` in JSON or a ``PoseStamped`` in CDR; None for other
    schemas.
    """
    try:
        if (encoding, schema) == ("json", "foxglove.PoseInFrame"):
            point = msgspec.json.decode(data, type=_PoseInFrame).pose.position
            return point.x, point.y, point.z
        if (encoding, schema) == ("cdr", "geometry_msgs/msg/PoseStamped") and data[:2] == _CDR_LE:
            (length,) = _LENGTH.unpack_from(data, _CDR_HEAD + _STAMP)
            at = _STAMP + _LENGTH.size + length
            # Alignment counts from the end of the encapsulation header.
            x, y, z = _POINT.unpack_from(data, _CDR_HEAD + at + -at % 8)
            return x, y, z
    except (msgspec.MsgspecError, struct.error):
        return None
    return None
