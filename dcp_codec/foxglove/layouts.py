"""Layouts for Foxglove: the panels that show one of our MCAP files, as JSON for its "Import from file".

The layout is made for one file: one plot line and one colour for each node in it, and the camera near the nodes.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Sequence
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import msgspec
from mcap.exceptions import McapError
from mcap.reader import make_reader

from dcp_codec.capture import CaptureError

POSES, BEACONS = "/dcp/pose/", "/dcp/bp"

#: Colours for successive nodes, distinguishable with any colour vision (Okabe and Ito).
_COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442")
#: Number of poses that are read to locate the nodes.
_LOOKED_AT = 5_000
#: Maximum number of nodes with separate lines in plots.
_MANY = 50
#: Minimum distance of the camera in metres, and its distance in multiples of the extent of the scene.
_LEAST, _AWAY = 10.0, 1.5

#: A PoseStamped in CDR: octets of the encapsulation header, of the stamp, and the length of `frame_id`, which ends in a
#: zero.
_CDR_HEAD, _STAMP, _LENGTH = 4, 8, struct.Struct("<I")
_POINT = struct.Struct("<ddd")
#: Little-endian plain CDR, the only encoding in our bags.
_CDR_LE = b"\x00\x01"

Json = dict[str, Any]


class _Point(msgspec.Struct):
    x: float
    y: float
    z: float


class _Pose(msgspec.Struct):
    position: _Point


class _PoseInFrame(msgspec.Struct):
    pose: _Pose


def layout_of(path: Path) -> Json:
    """Return the layout for an MCAP file made by `convert`, with decoded messages or for ROS 2.

    Raises `CaptureError` if the file is not MCAP, has no summary (it was never finished), or no messages to show.
    """
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            if summary is None or not summary.channels:
                raise CaptureError(f"{path}: has no summary of its topics: it was not finished, or has no messages")
            topics = {channel.topic: channel.message_encoding for channel in summary.channels.values()}
            poses = sorted(topic for topic in topics if topic.startswith(POSES))
            positions = _positions(reader, poses)
            senders = _senders(reader) if topics.get(BEACONS) == "json" else []
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (McapError, struct.error) as error:
        # struct.error: the file is shorter than the magic of MCAP.
        raise CaptureError(f"{path}: is not an MCAP file that can be read from its end ({error})") from error
    if not any(topic.startswith("/dcp/") and topic != "/dcp/frames" for topic in topics):
        raise CaptureError(f"{path}: has no decoded messages: convert it to MCAP first, with its profile")
    return _layout(set(topics), poses, positions, senders)


def _positions(reader: Any, poses: Sequence[str]) -> list[Sequence[float]]:
    """Return the first positions in the file."""
    found: list[Sequence[float]] = []
    if not poses:
        return found
    for schema, channel, message in reader.iter_messages(topics=list(poses)):
        position = position_in(channel.message_encoding, schema.name, message.data)
        if position is not None:
            found.append(position)
        if len(found) >= _LOOKED_AT:
            break
    return found


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


def _senders(reader: Any) -> list[str]:
    """Return the senders of the first beacons in the file."""
    found: set[str] = set()
    for _, _, message in islice(reader.iter_messages(topics=[BEACONS]), _LOOKED_AT):
        sender = msgspec.json.decode(message.data).get("sender")
        if isinstance(sender, str) and '"' not in sender:
            found.add(sender)
    return sorted(found)[:_MANY]


def _layout(
    topics: set[str], poses: Sequence[str], positions: Sequence[Sequence[float]], senders: Sequence[str]
) -> Json:
    panels: Json = {}

    def panel(kind: str, name: str, title: str, settings: Json) -> str:
        panels[f"{kind}!{name}"] = {"foxglovePanelTitle": title, **settings}
        return f"{kind}!{name}"

    colours = {topic: _COLOURS[number % len(_COLOURS)] for number, topic in enumerate(poses)}
    left, right = [], []
    if poses:
        shown = {
            topic: {"visible": True, "type": "arrow", "axisScale": 1, "arrowScale": [5, 1, 1], "color": colour}
            for topic, colour in colours.items()
        }
        scene = {"cameraState": _camera(positions), "followMode": "follow-none", "followTf": "dcp", "topics": shown}
        left.append(panel("3D", "positions", "Positions", scene))
        for axis in "xyz":
            lines = (f"{topic}.pose.position.{axis}" for topic in poses[:_MANY])
            right.append(panel("Plot", f"position-{axis}", f"{axis} in m", _plot(lines, colours.values())))
    if senders:
        # One line for each sender: each has its own sequence.
        lines = (f'{BEACONS}{{sender=="{sender}"}}.seqno' for sender in senders)
        left.append(panel("Plot", "beacons", "Sequence numbers of beacons", _plot(lines, cycle(_COLOURS))))
    if senders and "/dcp/holdings" in topics:
        lines = (f'/dcp/holdings{{sender=="{sender}"}}.lag' for sender in senders)
        right.append(panel("Plot", "lag", "Lag in values", _plot(lines, cycle(_COLOURS))))
    if "/dcp/vardis" in topics:
        path = {"value": "/dcp/vardis.icName", "label": "instructions", "timestampMethod": "receiveTime"}
        left.append(panel("StateTransitions", "instructions", "Instructions", {"paths": [path], "isSynced": True}))
        right.append(panel("RawMessages", "vardis", "VarDis payloads", {"topicPath": "/dcp/vardis"}))
    if "/dcp/variables" in topics:
        right.append(panel("Table", "variables", "Variables", {"topicPath": "/dcp/variables"}))
    if "/dcp/neighbours" in topics:
        left.append(panel("Table", "neighbours", "Neighbours", {"topicPath": "/dcp/neighbours.neighbours[:]"}))
    if "/dcp/errors" in topics:
        right.append(panel("Table", "errors", "Malformed frames", {"topicPath": "/dcp/errors"}))
    sides = [_stack(side, "column") for side in (left, right) if side]
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _stack(sides, "row"),
    }


def _plot(lines: Iterable[str], colours: Iterable[str]) -> Json:
    paths = [
        {"value": line, "enabled": True, "timestampMethod": "receiveTime", "color": colour, "label": _label(line)}
        for line, colour in zip(lines, colours, strict=False)
    ]
    settings = {"showXAxisLabels": True, "showYAxisLabels": True, "showLegend": True, "legendDisplay": "floating"}
    return {"paths": paths, "isSynced": True, "xAxisVal": "timestamp", **settings}


def _label(line: str) -> str:
    """Return the node of a line."""
    return line.removeprefix(POSES).partition(".")[0] if line.startswith(POSES) else line.split('"')[1]


def _stack(parts: Sequence[Any], direction: str) -> Any:
    """Return panels beside or below each other, all of the same size."""
    if len(parts) == 1:
        return parts[0]
    share = 100 / len(parts)
    rest = _stack(parts[1:], direction)
    return {"direction": direction, "first": parts[0], "second": rest, "splitPercentage": share}


def _camera(positions: Sequence[Sequence[float]]) -> Json:
    """Return a camera above the middle of the nodes that shows all of them."""
    axes = list(zip(*positions, strict=True)) or [(0.0,)] * 3
    middle = [(min(axis) + max(axis)) / 2 for axis in axes]
    extent = max(max(axis) - min(axis) for axis in axes)
    distance = max(_LEAST, _AWAY * extent)
    return {
        "perspective": True,
        "distance": distance,
        "phi": 45,
        "thetaOffset": 45,
        "targetOffset": middle,
        "target": [0, 0, 0],
        "targetOrientation": [0, 0, 0, 1],
        "fovy": 45,
        "near": distance / 1000,
        "far": distance * 100,
    }


def layout_text(layout: Json) -> str:
    """Return the text of the layout file."""
    return json.dumps(layout, indent=2) + "\n"
