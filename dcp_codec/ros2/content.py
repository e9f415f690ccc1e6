"""Contents of a recording as the fields of ROS 2 messages."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from dcp_spec.profile.definition import Link

from dcp_codec.analysis.cartesian import cartesian_axes
from dcp_codec.capture import Frame
from dcp_codec.codec import Codec
from dcp_codec.framing.locate import Framing, locate, mac
from dcp_codec.jsonform import node_id_text
from dcp_codec.values import Beacon, ExtendedSafetyData, VarCreate, VarDelete, VarUpdate

from .definitions import NEIGHBOURS, POSE, VARIABLE

#: The frame of reference of poses, which is that of the nodes.
FRAME_ID: Final = "dcp"
NEIGHBOURS_TOPIC: Final = "/dcp/neighbours"
VARIABLES_TOPIC: Final = "/dcp/variables"
#: Seconds between two neighbour tables, and seconds without a beacon after which a node is left out of them.
EVERY, WINDOW = 1.0, 5.0
#: Maximum number of nodes with a pose topic, and of nodes in a neighbour table; forged frames could name millions.
MAX_NODES: Final = 1000
#: The last second that ROS 2 time stamps can represent (2038-01-19).
LAST_SECOND: Final = 2**31 - 1

_SECOND = 1_000_000_000
_CREATE, _UPDATE, _DELETE = 1, 2, 3
_IDENTITY = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_ORIGIN = {"x": 0.0, "y": 0.0, "z": 0.0}


class Message(NamedTuple):
    """A message: its topic, type, time of capture in ns since 1970, and fields."""

    topic: str
    type: str
    time_ns: int
    fields: dict[str, Any]


def pose_topic(node: str) -> str:
    """Return ``/dcp/pose/n02_00_00_00_00_01`` for ``02:00:00:00:00:01``: ROS 2 names have neither colons nor
    hyphens.
    """
    return "/dcp/pose/n" + re.sub(r"[^A-Za-z0-9]+", "_", node).rstrip("_")


class Content:
    """Converts the frames of one recording, in their order, to messages.

    Undamaged payloads of damaged beacons are used. Frames that are not DCP, and unreadable beacons, give no messages.
    ``damaged`` counts the beacons with a problem.
    """

    def __init__(self, codec: Codec, link: Link | None = None) -> None:
        self._codec = codec
        self._link = link or codec.profile.link
        self._axes = cartesian_axes(codec.profile)
        self._representation = codec.profile.types.node_id.representation
        self._nodes: dict[str, dict[str, Any]] = {}
        self._heard: dict[str, int] = {}
        self._topics: dict[str, str] = {}
        self._next_table: int | None = None
        self.damaged = 0

    def messages(self, frame: Frame) -> Iterator[Message]:
        """Yield the messages of one frame, after a neighbour table if one is due."""
        framing = locate(frame.data, self._link)
        if not isinstance(framing, Framing):
            return
        found = self._codec.salvage(frame.data[framing.start : framing.end])
        self.damaged += bool(found.problems)
        if found.beacon is None:
            return
        yield from self._table_due(frame.time_ns)
        sender = self._sender(found.beacon, framing)
        self._note(sender, frame.time_ns)
        for payload in found.beacon.payloads:
            if isinstance(payload.content, ExtendedSafetyData):
                yield from self._report(frame, payload.content)
            elif isinstance(payload.content, tuple):
                for container in payload.content:
                    for record in container.records:
                        yield from self._record(frame, sender, record)

    def end(self) -> Iterator[Message]:
        """Yield the neighbour table at the end of the recording."""
        if self._heard:
            yield self._table(max(self._heard.values()))

    # -- nodes --------------------------------------------------------------------------------------------------

    def _text(self, node_id: bytes) -> str:
        return node_id_text(node_id, self._representation)

    def _sender(self, beacon: Beacon, framing: Framing) -> str:
        if beacon.bp is not None:
            return self._text(beacon.bp.sender_id)
        return "" if framing.src is None else mac(framing.src)

    def _entry(self, node: str) -> dict[str, Any] | None:
        """Return the table entry of a node; None if there are too many nodes."""
        if node not in self._nodes and node and len(self._nodes) < MAX_NODES:
            self._nodes[node] = {
                "node_id": node, "last_heard": _time(0), "beacons": 0, "has_report": False, "report_seqno": 0,
                "report_time": _time(0), "has_position": False, "position": _ORIGIN,
            }  # fmt: skip
        return self._nodes.get(node)

    def _note(self, node: str, time_ns: int) -> None:
        entry = self._entry(node)
        if entry is not None:
            entry["last_heard"] = _time(time_ns)
            entry["beacons"] = min(entry["beacons"] + 1, 2**32 - 1)
            self._heard[node] = time_ns

    def _table_due(self, time_ns: int) -> Iterator[Message]:
        every = int(EVERY * _SECOND)
        if self._next_table is None:
            self._next_table = time_ns + every
        elif time_ns >= self._next_table:
            # After a silence there is one table for its end, not one for each second of it.
            yield self._table(time_ns)
            self._next_table = time_ns + every

    def _table(self, time_ns: int) -> Message:
        least = time_ns - int(WINDOW * _SECOND)
        heard = [dict(self._nodes[node]) for node in sorted(self._heard) if self._heard[node] >= least]
        fields = {"header": _header(time_ns), "window": WINDOW, "neighbours": heard}
        return Message(NEIGHBOURS_TOPIC, NEIGHBOURS, time_ns, fields)

    # -- payloads -----------------------------------------------------------------------------------------------

    def _report(self, frame: Frame, report: ExtendedSafetyData) -> Iterator[Message]:
        node = self._text(report.node_id)
        position = self._position(report)
        entry = self._entry(node)
        if entry is None:
            return
        entry |= {
            "has_report": True, "report_seqno": report.seqno, "report_time": _time(frame.time_ns),
            "has_position": position is not None, "position": position or _ORIGIN,
        }  # fmt: skip
        if position is not None:
            pose = {"position": position, "orientation": _IDENTITY}
            fields = {"header": _header(frame.time_ns, FRAME_ID), "pose": pose}
            yield Message(self._topic(node), POSE, frame.time_ns, fields)

    def _position(self, report: ExtendedSafetyData) -> dict[str, float] | None:
        """Return the position in metres; None if there is none, or a coordinate is not finite."""
        if not self._axes:
            return None
        found = dict(_ORIGIN)
        for axis, (name, metres) in self._axes.items():
            found[axis] = float(getattr(report.s_data, name)) * metres
        return found if all(map(math.isfinite, found.values())) else None

    def _topic(self, node: str) -> str:
        """Return the topic of a node; different identifiers have different topics."""
        if node not in self._topics:
            topic, taken, number = pose_topic(node), set(self._topics.values()), 2
            while topic in taken:
                topic, number = f"{pose_topic(node)}_{number}", number + 1
            self._topics[node] = topic
        return self._topics[node]

    def _record(self, frame: Frame, sender: str, record: Any) -> Iterator[Message]:
        update = record.upd if isinstance(record, VarCreate) else record
        if not isinstance(record, VarCreate | VarUpdate | VarDelete):
            return
        fields: dict[str, Any] = {
            "header": _header(frame.time_ns),
            "frame": frame.number,
            "sender": sender,
            "kind": _DELETE,
            "var_id": update.var_id,
            "seqno": 0,
            "value": b"",
            "prod_id": "",
            "descr": "",
            "rep_cnt": 0,
            "timeout_ms": 0,
        }
        if isinstance(update, VarUpdate):
            fields |= {"kind": _UPDATE, "seqno": update.seqno, "value": update.value}
        if isinstance(record, VarCreate):
            fields |= {
                "kind": _CREATE,
                "prod_id": self._text(record.spec.prod_id),
                "descr": record.spec.descr.decode(errors="backslashreplace"),
                "rep_cnt": record.spec.rep_cnt,
                "timeout_ms": record.spec.timeout or 0,
            }
        yield Message(VARIABLES_TOPIC, VARIABLE, frame.time_ns, fields)


def _time(time_ns: int) -> dict[str, int]:
    sec, nanosec = divmod(time_ns, _SECOND)
    return {"sec": sec, "nanosec": nanosec}


def _header(time_ns: int, frame_id: str = "") -> dict[str, Any]:
    return {"stamp": _time(time_ns), "frame_id": frame_id}
