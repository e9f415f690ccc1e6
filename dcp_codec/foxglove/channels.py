"""Decoded messages for MCAP files: what Foxglove and other viewers show beside the raw frames.

=====================  ====================  ==============================================================
topic                  schema                one message for each
=====================  ====================  ==============================================================
``/dcp/bp``            dcp.Beacon            beacon: addresses, header, payload blocks, padding, errors
``/dcp/srp``           dcp.StateReport       state report
``/dcp/vardis``        dcp.VardisContainer   instruction container
``/dcp/holdings``      dcp.Holding           change of a variable at a node, as its beacons state it
``/dcp/errors``        dcp.Problem           error or warning
``/dcp/pose/<node>``   foxglove.PoseInFrame  state report with a position, where the profile says which it is
=====================  ====================  ==============================================================

A viewer reads a JSON Schema as typed columns. Therefore what could not be read is missing instead of null, and so
is a float that JSON has no number for. The schema of each message comes from the plan of the profile, and says which
columns are there when ``errors`` is 0.

Positions are poses (and not geographic locations or drawn scenes), because safety data has Cartesian coordinates; one
topic for each node lets a viewer choose, colour and plot nodes one by one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
from dcp_spec.profile.definition import Link, Profile
from dcp_spec.version import __version__

from dcp_codec.analysis.cartesian import cartesian_axes
from dcp_codec.analysis.entry import DELETED, UNKNOWN
from dcp_codec.analysis.ledger import Ledger
from dcp_codec.capture import ChannelMessage, Frame
from dcp_codec.codec import Codec
from dcp_codec.export.jsonrecords import JSONSchema, ViewerRecord
from dcp_codec.export.jsonschema import (
    DRAFT,
    container_group,
    integer_schema,
    problem_properties,
    record_group,
    schema_octets,
    viewer_record,
)
from dcp_codec.export.tomltext import profile_toml
from dcp_codec.framing.frames import DissectedFrame, FrameDissector
from dcp_codec.framing.locate import OtherTraffic
from dcp_codec.jsonform import problem_json
from dcp_codec.plan.layout import walk
from dcp_codec.plan.tree import Group, Scalar

#: The frame of reference of poses, which is that of the nodes.
FRAME_ID = "dcp"

#: Maximum number of nodes with a pose topic. An MCAP file has at most 65,535 channels, and textual identifiers are
#: arbitrary.
MAX_POSE_TOPICS = 1000

_IDENTITY = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


class DecodedChannels:
    """A message source for ``create_capture`` and ``convert``: the decoded DCP frames of one profile.

    Frames that are not DCP in the profile have no messages. No frame makes it raise: a malformed frame has messages for
    its readable parts, except damaged state reports, and one for each error. ``link`` replaces the EtherType or UDP
    port of the profile. An instance is for one file: it remembers which nodes have a topic, and what nodes hold.
    """

    def __init__(self, codec: Codec, link: Link | None = None) -> None:
        self._dissector = FrameDissector(codec, link)
        self._beacon = _Channel("/dcp/bp", "dcp.Beacon", "One beacon.", *_beacon_columns(codec))
        self._container = _Channel(
            "/dcp/vardis",
            "dcp.VardisContainer",
            "One VarDis instruction container.",
            _BLOCK | {"container": integer_schema("index of the container in its payload, from 0")},
            viewer_record(codec, container_group(codec)),
        )
        self._report: _Channel | None = None
        if codec.srp_plan is not None:
            columns = viewer_record(codec, record_group(codec.srp_plan))
            name, about = ("dcp.StateReport", "One state report.")
            if codec.report_plan is None:
                name, about = ("dcp.OwnReport", "One SRP payload; this profile has no state reports.")
            self._report = _Channel("/dcp/srp", name, about, _BLOCK, columns)
        self._holding = _Channel("/dcp/holdings", "dcp.Holding", "A change of a variable at a node.", _HOLDING)
        self._ledger = Ledger()
        self._problem = _Channel("/dcp/errors", "dcp.Problem", "One problem of a frame.", _PROBLEM)
        self._poses = _Poses(codec.profile)

    def messages(self, frame: Frame) -> Iterator[ChannelMessage]:
        """Yield the messages of one frame, the beacon first; their time is the time of capture."""
        dissected = self._dissector.dissect(frame)
        if isinstance(dissected, OtherTraffic):
            return
        errors, warnings = dissected.dissection.errors, dissected.dissection.warnings
        common = {"timestamp": _time(frame.time_ns), "frame": frame.number, "sender": dissected.sender}
        whole = dissected.as_json()
        payloads = whole.get("payloads", [])
        addresses = {name: whole[name] for name in ("src", "dst", "etherType")}
        counts = {"padding": whole["padding"], "errors": len(errors), "warnings": len(warnings)}
        header = whole.get("bp", {})
        yield self._beacon.message(frame, {**header, **common, **addresses, "payloads": payloads, **counts})
        damaged, clear = self._damage(dissected) if errors else (set(), True)
        for index, payload in enumerate(payloads):
            block = {**common, "payload": index, "errors": len(errors)}
            yield from self._content(frame, payload, block, sound=index not in damaged, clear=clear)
        if any("vardis" in payload for payload in payloads):
            yield from self._holdings(dissected, common)
        for problem in (*errors, *warnings):
            about = {"severity": problem.severity, "message": str(problem), **problem_json(problem)}
            yield self._problem.message(frame, common | about)

    @staticmethod
    def _damage(dissected: DissectedFrame) -> tuple[set[int], bool]:
        """Return the indices of the payload blocks with damaged content, and whether the positions of the blocks are
        known.
        """
        framing = dissected.framing
        found = dissected.codec.salvage(dissected.frame.data[framing.start : framing.end])
        clear = found.beacon is not None and found.clear and found.reading == "length"
        return {each.payload for each in found.damaged}, clear

    def _holdings(self, dissected: DissectedFrame, common: dict[str, Any]) -> Iterator[ChannelMessage]:
        """Yield the changes of variables that a beacon states."""
        framing, frame = dissected.framing, dissected.frame
        beacon = dissected.codec.salvage(frame.data[framing.start : framing.end]).beacon
        if beacon is None:
            return
        node = beacon.bp.sender_id if beacon.bp is not None else framing.src or b""
        for entry in self._ledger.feed(frame.number, frame.time_ns, node, beacon):
            values = {
                "varId": entry.var_id,
                "state": {DELETED: "deleted", UNKNOWN: "unknown"}.get(entry.number, "held"),
                "seqno": entry.number if entry.number >= 0 else None,
                "lag": self._ledger.lag(entry) if entry.number >= 0 else None,
            }
            yield self._holding.message(frame, common | values)

    def _content(
        self, frame: Frame, payload: dict[str, Any], block: dict[str, Any], *, sound: bool, clear: bool
    ) -> Iterator[ChannelMessage]:
        report = payload.get("srp")
        # A damaged report may have any value: a viewer would plot it, and a position would move the view.
        if report is not None and self._report is not None and sound:
            yield self._report.message(frame, {**report, **block})
            if clear:
                yield from self._poses.messages(frame, report)
        for number, container in enumerate(payload.get("vardis", ())):
            yield self._container.message(frame, {**container, **block, "container": number})


class _Channel:
    """One topic and its schema. The columns in ``own`` take precedence over equally named ones of ``record``."""

    def __init__(
        self,
        topic: str,
        name: str,
        about: str,
        own: dict[str, JSONSchema],
        record: ViewerRecord | None = None,
    ) -> None:
        record = record or ViewerRecord({}, [], [])
        self.topic = topic
        self.name = name
        # First in position and in precedence.
        self.properties = {**_COMMON, **own, **record.properties, **_COMMON, **own}
        schema: JSONSchema = {
            "$schema": DRAFT,
            "title": name,
            "description": about,
            "type": "object",
            "properties": self.properties,
            "required": [name for name in ("timestamp", "frame", "errors") if name in self.properties],
        }
        if record.required:
            complete: JSONSchema = {"required": record.required}
            if record.alternatives:
                complete["oneOf"] = record.alternatives
            schema |= {"if": {"properties": {"errors": {"const": 0}}}, "then": complete}
        self.schema = schema_octets(schema)

    def message(self, frame: Frame, values: dict[str, Any]) -> ChannelMessage:
        data = msgspec.json.encode(_fit(values, {"properties": self.properties}))
        return ChannelMessage(self.topic, self.name, self.schema, data, frame.time_ns)


def _fit(value: Any, schema: JSONSchema) -> Any:
    """Return the members of ``value`` that ``schema`` has, in its order, except null and invalid numbers."""
    if isinstance(value, list):
        return [_fit(each, schema["items"]) for each in value]
    if not isinstance(value, dict):
        return value
    fitted = {}
    for name, below in schema["properties"].items():
        found = value.get(name)
        if found is not None and not (below["type"] == "number" and isinstance(found, str)):
            fitted[name] = _fit(found, below)
    return fitted


class _Poses:
    """Positions in state reports as ``foxglove.PoseInFrame`` on one topic for each node."""

    def __init__(self, profile: Profile) -> None:
        self._axes = cartesian_axes(profile)
        self._schema = schema_octets(_POSE_IN_FRAME)
        self._topics: dict[str, str] = {}

    def messages(self, frame: Frame, report: Mapping[str, Any]) -> Iterator[ChannelMessage]:
        """Yield the pose in a state report, unless the profile has none or a coordinate is not finite."""
        if not self._axes:
            return
        position = {"x": 0.0, "y": 0.0, "z": 0.0}
        for axis, (name, metres) in self._axes.items():
            value = report["sData"][name]
            if isinstance(value, str):
                return
            position[axis] = value * metres
        topic = self._topic(report["nodeId"])
        if topic is None:
            return
        pose = {"position": position, "orientation": _IDENTITY}
        data = msgspec.json.encode({"timestamp": _time(frame.time_ns), "frame_id": FRAME_ID, "pose": pose})
        yield ChannelMessage(topic, "foxglove.PoseInFrame", self._schema, data, frame.time_ns)

    def _topic(self, node: str) -> str | None:
        if node not in self._topics and len(self._topics) < MAX_POSE_TOPICS:
            self._topics[node] = pose_topic(node)
        return self._topics.get(node)


def pose_topic(node: str) -> str:
    """Return ``/dcp/pose/02-00-00-00-00-01`` for ``02:00:00:00:00:01``: colons have a meaning in viewers' message
    paths.
    """
    return "/dcp/pose/" + (re.sub(r"[^A-Za-z0-9_-]+", "-", node) or "-")


def capture_metadata(codec: Codec, recording: Mapping[str, str] | None = None) -> dict[str, dict[str, str]]:
    """Return metadata records that describe a capture: tool, specification, profile with its complete text.

    ``recording`` becomes a separate record. The same arguments always give the same text.
    """
    profile = codec.profile
    records = {
        "dcp.tool": {"name": "dcp-codec", "version": __version__},
        "dcp.specification": {
            "name": "Drone Coordination Protocol",
            "version": str(profile.spec_version),
            "source": "https://github.com/awillig/dcp-vardis",
        },
        "dcp.profile": {
            "name": profile.name,
            "title": profile.title,
            "toml": profile_toml(profile),
            "json": msgspec.json.encode(profile).decode(),
        },
    }
    if recording:
        records["dcp.recording"] = dict(recording)
    return records


def _time(time_ns: int) -> dict[str, int]:
    sec, nsec = divmod(time_ns, 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _beacon_columns(codec: Codec) -> tuple[dict[str, JSONSchema], ViewerRecord]:
    """Return the columns of a beacon: those of its header, and those of its block headers."""
    beacon = record_group(codec.beacon_plan)
    header = next((member for member in beacon.members if isinstance(member, Group)), None)
    payload = next(node for node in walk(beacon) if isinstance(node, Group) and node.type_name == "Payload")
    columns = viewer_record(codec, payload).properties
    heading = {member.name: columns[member.name] for member in payload.members if isinstance(member, Scalar)}
    own: dict[str, JSONSchema] = {
        "src": {"type": "string", "description": "source address"},
        "dst": {"type": "string", "description": "destination address"},
        "etherType": integer_schema("EtherType"),
        "payloads": {
            "type": "array",
            "description": "headers of the payload blocks",
            "items": {"type": "object", "title": "Payload", "properties": heading},
        },
        "padding": integer_schema("octets of bearer padding after the beacon [BP-RX-14]"),
        **_ERRORS,
        "warnings": integer_schema("rules broken by well-formed parts of the frame"),
    }
    return own, viewer_record(codec, header) if header is not None else ViewerRecord({}, [], [])


_TIME: JSONSchema = {
    "type": "object",
    "title": "time",
    "description": "time of capture, since 1970-01-01T00:00:00Z",
    "properties": {
        "sec": integer_schema("whole seconds"),
        "nsec": {**integer_schema("nanoseconds"), "maximum": 999_999_999},
    },
    "required": ["sec", "nsec"],
}

_COMMON: dict[str, JSONSchema] = {
    "timestamp": _TIME,
    "frame": {**integer_schema("number of the frame in the recording, from 1"), "minimum": 1},
    "sender": {"type": "string", "description": "node that sent the frame"},
}

_ERRORS: dict[str, JSONSchema] = {
    "errors": integer_schema("errors of the frame, see /dcp/errors; where it is not 0, columns may be missing")
}

_BLOCK: dict[str, JSONSchema] = {
    **_ERRORS,
    "payload": integer_schema("index of the payload block in the beacon, from 0"),
}

_HOLDING: dict[str, JSONSchema] = {
    "varId": integer_schema("variable"),
    "state": {
        "type": "string",
        "enum": ["held", "deleted", "unknown"],
        "description": "state of the variable at the sender; unknown: it requests the create",
    },
    "seqno": integer_schema("sequence number that the sender states"),
    "lag": integer_schema("number of later values that the producer has sent; missing if that is not known"),
}

_PROBLEM: dict[str, JSONSchema] = {
    "severity": {"type": "string", "enum": ["error", "warning"], "description": "whether a receiver must detect it"},
    "message": {"type": "string", "description": "the whole problem as one sentence"},
    **problem_properties(nullable=False),
}


def _vector(title: str, about: str, axes: str, unit: str) -> JSONSchema:
    return {
        "type": "object",
        "title": title,
        "description": about,
        "properties": {axis: {"type": "number", "description": f"{axis}{unit}"} for axis in axes},
        "required": list(axes),
    }


#: Foxglove's schema of that name; viewers recognise it by the name and the members.
_POSE_IN_FRAME: JSONSchema = {
    "$schema": DRAFT,
    "title": "foxglove.PoseInFrame",
    "description": "A position reported by a node.",
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "frame_id": {"type": "string", "description": "frame of reference"},
        "pose": {
            "type": "object",
            "title": "foxglove.Pose",
            "description": "position; the orientation has no meaning",
            "properties": {
                "position": _vector("foxglove.Vector3", "position from the safety data", "xyz", ", in m"),
                "orientation": _vector("foxglove.Quaternion", "always the identity", "xyzw", ""),
            },
            "required": ["position", "orientation"],
        },
    },
    "required": ["timestamp", "frame_id", "pose"],
}
