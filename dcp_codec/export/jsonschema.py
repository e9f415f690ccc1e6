"""JSON Schemas (draft 2020-12) of the objects that the codec prints, made from the plan of a profile.

:func:`frame_schema` describes every line of ``dcp-codec decode --format jsonl``: if ``errors`` is empty, the beacon has
all of its members and each is within its bounds; otherwise unreadable members are null or missing. The other functions
describe well-formed parts. All schemas are self-contained: references stay inside ``$defs``.

:func:`viewer_record` is for the channels of an MCAP file. Foxglove and similar viewers read a JSON Schema as a list of
typed columns: one single ``type`` for each property, no references, no alternatives below the root.
"""

from __future__ import annotations

import json
from typing import Any

from dcp_spec.profile.definition import Profile
from dcp_spec.reasons import REASONS, WARNINGS

from dcp_codec.codec import Codec
from dcp_codec.plan.tree import Exact, Group, Many, Node

from .jsonrecords import JSONSchema, RecordSchemas, ViewerRecord

DRAFT = "https://json-schema.org/draft/2020-12/schema"

_MAC = "^[0-9a-f]{2}(?::[0-9a-f]{2}){5}$"
_MAX_TIME_NS = 2**63 - 1


#: Only present if the profile was guessed and the guess is weak.
_DOUBT: dict[str, JSONSchema] = {
    "profileDoubt": {"type": "string", "description": "why the profile, which was guessed, may be the wrong one"}
}


def frame_schema(codec: Codec) -> JSONSchema:
    """Return the schema of :meth:`dcp_codec.framing.frames.DissectedFrame.as_json`, for well-formed and other
    beacons.
    """
    strict, partial = RecordSchemas(codec.profile, "strict"), RecordSchemas(codec.profile, "partial")
    beacon = record_group(codec.beacon_plan)
    well_formed, remains = strict.group(beacon), partial.group(beacon)
    members = {
        name: {"type": member.get("type", "object"), "description": member["description"]}
        for name, member in well_formed["properties"].items()
    }
    own = _frame_members()
    return _root(
        codec.profile,
        "DissectedFrame",
        "One DCP frame of a recording. Octets are lower-case hex. Where errors is not empty, members of the beacon "
        "that could not be read are null or missing.",
        {
            "type": "object",
            "properties": {**own, **_DOUBT, **members, **_findings()},
            "required": [*own, *_findings()],
            "additionalProperties": False,
            "if": {"properties": {"errors": {"maxItems": 0}}},
            "then": {"properties": well_formed["properties"], "required": well_formed["required"]},
            "else": {"properties": remains["properties"]},
        },
        {**strict.defs, **partial.defs, "Problem": _problem()},
    )


def beacon_schema(codec: Codec) -> JSONSchema:
    """Return the schema of a well-formed beacon as a JSON object (``bp`` and ``payloads``)."""
    return record_schema(codec, record_group(codec.beacon_plan), "One well-formed beacon. Octets are lower-case hex.")


def container_group(codec: Codec) -> Group:
    """Return the plan of one instruction container."""
    plan = codec.containers_plan
    assert isinstance(plan, Many)
    return plan.element


def viewer_record(codec: Codec, group: Group) -> ViewerRecord:
    """Return the members of ``group`` for a viewer.

    Every property may be missing and has one type. Floats are not ``required``: JSON has no number for those that are
    not finite, and a message for viewers leaves them out.
    """
    return RecordSchemas(codec.profile, "viewer").viewer_record(group)


def schema_octets(schema: JSONSchema) -> bytes:
    """Return a schema as a JSON text, UTF-8, on one line."""
    return json.dumps(schema, separators=(",", ":"), ensure_ascii=False).encode()


def record_group(plan: Node) -> Group:
    """Return the record of a plan."""
    content = plan.content if isinstance(plan, Exact) else plan
    assert isinstance(content, Group)
    return content


def record_schema(codec: Codec, group: Group, about: str) -> JSONSchema:
    """Return the schema of one well-formed record as a JSON object."""
    builder = RecordSchemas(codec.profile, "strict")
    schema = builder.group(group)
    del schema["title"], schema["description"]
    return _root(codec.profile, group.type_name, about, schema, builder.defs)


def _root(profile: Profile, name: str, about: str, schema: JSONSchema, defs: dict[str, JSONSchema]) -> JSONSchema:
    whole: JSONSchema = {
        "$schema": DRAFT,
        "title": f"dcp.{name}",
        "description": f"{about} Profile {profile.name}, {profile.title}.",
        **schema,
    }
    return {**whole, "$defs": defs} if defs else whole


def integer_schema(about: str, minimum: int = 0, maximum: int | None = None) -> JSONSchema:
    """Return the schema of an integer."""
    bounds = {"minimum": minimum} if maximum is None else {"minimum": minimum, "maximum": maximum}
    return {"type": "integer", **bounds, "description": about}


def _frame_members() -> dict[str, JSONSchema]:
    """Return the members that :class:`dcp_codec.framing.frames.DissectedFrame` prints before the beacon."""
    absent = "; null without a link-layer header"
    return {
        "frame": integer_schema("number of the frame in the recording, from 1", 1),
        "time_ns": integer_schema("time of capture, in ns since 1970-01-01T00:00:00Z", 0, _MAX_TIME_NS),
        "src": {"type": ["string", "null"], "pattern": _MAC, "description": f"source address{absent}"},
        "dst": {"type": ["string", "null"], "pattern": _MAC, "description": f"destination address{absent}"},
        "etherType": {
            "type": ["integer", "null"],
            "minimum": 0,
            "maximum": 0xFFFF,
            "description": f"EtherType{absent}",
        },
    }


def _findings() -> dict[str, JSONSchema]:
    """Return the members after the beacon."""
    problems: JSONSchema = {"type": "array", "items": {"$ref": "#/$defs/Problem"}}
    return {
        "padding": integer_schema("octets of bearer padding after the beacon [BP-RX-14]", 0),
        "errors": {
            **problems,
            "description": "errors because of which the octets are not a beacon of the profile, in wire order",
        },
        "warnings": {**problems, "description": "rules broken by well-formed parts, in wire order"},
    }


def _problem() -> JSONSchema:
    """Return the schema of :func:`dcp_codec.jsonform.problem_json`."""
    return {
        "title": "Problem",
        "description": "One problem of the octets.",
        "type": "object",
        "properties": problem_properties(nullable=True),
        "required": list(problem_properties(nullable=True)),
        "additionalProperties": False,
    }


def problem_properties(*, nullable: bool) -> dict[str, JSONSchema]:
    """Return the members of a problem; without ``nullable`` those that do not apply must be left out."""
    integer: Any = ["integer", "null"] if nullable else "integer"
    text: Any = ["string", "null"] if nullable else "string"
    return {
        "reason": {
            "type": "string",
            "enum": [*REASONS, *WARNINGS],
            "description": "the kind of problem, as a fixed word",
        },
        "path": {"type": "string", "description": "the field, with indices"},
        "offset": integer_schema("octet where the field starts, from the first octet of the frame", 0),
        "needed": {"type": integer, "description": "octets, or the number, that would have been correct"},
        "available": {"type": integer, "description": "octets that are present, or the number that was found"},
        "requirement": {
            "type": text,
            "pattern": "^[A-Z]+(?:-[A-Z]+)*-[0-9]+$",
            "description": "the broken rule",
        },
    }
