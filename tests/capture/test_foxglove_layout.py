"""Layouts have the settings that Foxglove documents: Foxglove cannot be run here.

Names, types and choices are those of the panel classes of the Foxglove SDK for Python (``foxglove.layouts``, 0.30),
which is the only published description; what is around the panels is as in layouts that the application exports.
An unknown setting is an error here, while Foxglove ignores it in silence.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jsonschema
import pytest

from dcp_codec import get_codec
from dcp_codec.capture import CaptureError, convert
from dcp_codec.foxglove.channels import DecodedChannels
from dcp_codec.foxglove.layouts import layout_of
from dcp_codec.ros2 import write_bag

CAPTURES = Path(__file__).resolve().parents[2] / "captures"

TEXT, FLAG, NUMBER = {"type": "string"}, {"type": "boolean"}, {"type": "number"}
COLOUR = {"type": "string", "pattern": "^#[0-9a-f]{6}$"}
TIMESTAMPS = {"enum": ["receiveTime", "publishTime", "headerStamp", "customField"]}


def numbers(many: int) -> dict[str, Any]:
    return {"type": "array", "items": NUMBER, "minItems": many, "maxItems": many}


def settings(required: tuple[str, ...] = (), **known: Any) -> dict[str, Any]:
    """Settings that may be there, and no others."""
    return {"type": "object", "properties": known, "required": list(required), "additionalProperties": False}


SERIES = settings(
    ("value",), value=TEXT, label=TEXT, enabled=FLAG, color=COLOUR, timestampMethod=TIMESTAMPS, showLine=FLAG
)
CAMERA = settings(
    perspective=FLAG,
    distance=NUMBER,
    phi=NUMBER,
    thetaOffset=NUMBER,
    target=numbers(3),
    targetOffset=numbers(3),
    targetOrientation=numbers(4),
    fovy=NUMBER,
    near=NUMBER,
    far=NUMBER,
)
POSE = settings(visible=FLAG, type={"enum": ["axis", "arrow"]}, axisScale=NUMBER, arrowScale=numbers(3), color=COLOUR)
TITLE = {"foxglovePanelTitle": TEXT}
PANELS = {
    "3D": settings(
        cameraState=CAMERA,
        followMode={"enum": ["follow-pose", "follow-heading", "follow-position", "follow-none"]},
        followTf=TEXT,
        topics={"type": "object", "additionalProperties": POSE},
        **TITLE,
    ),
    "Plot": settings(
        ("paths",),
        paths={"type": "array", "items": SERIES, "minItems": 1},
        isSynced=FLAG,
        xAxisVal={"enum": ["timestamp", "index", "custom", "currentCustom"]},
        showLegend=FLAG,
        legendDisplay={"enum": ["floating", "top", "left"]},
        showXAxisLabels=FLAG,
        showYAxisLabels=FLAG,
        **TITLE,
    ),
    "StateTransitions": settings(
        ("paths",),
        paths={
            "type": "array",
            "items": settings(("value",), value=TEXT, label=TEXT, enabled=FLAG, timestampMethod=TIMESTAMPS),
            "minItems": 1,
        },
        isSynced=FLAG,
        **TITLE,
    ),
    "RawMessages": settings(("topicPath",), topicPath=TEXT, **TITLE),
    "Table": settings(("topicPath",), topicPath=TEXT, **TITLE),
}
LAYOUT = settings(
    ("configById", "globalVariables", "userNodes", "playbackConfig", "layout"),
    configById={
        "type": "object",
        "minProperties": 1,
        "patternProperties": {f"^{kind}![a-z-]+$": known for kind, known in PANELS.items()},
        "additionalProperties": False,
    },
    globalVariables={"type": "object"},
    userNodes={"type": "object"},
    playbackConfig=settings(speed=NUMBER),
    layout={"$ref": "#/$defs/part"},
) | {
    "$defs": {
        "part": {
            "oneOf": [
                TEXT,
                settings(
                    ("direction", "first", "second"),
                    direction={"enum": ["row", "column"]},
                    first={"$ref": "#/$defs/part"},
                    second={"$ref": "#/$defs/part"},
                    splitPercentage={"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 100},
                ),
            ]
        }
    }
}


@pytest.mark.parametrize("ros2", [False, True], ids=["decoded", "ros2"])
@pytest.mark.parametrize("name", ["a_bus3", "b_crud"])
def test_settings_are_those_that_foxglove_documents(tmp_path, name, ros2):
    source, path, codec = CAPTURES / f"{name}.mcap", tmp_path / "file.mcap", get_codec("cpp-2.0")
    if ros2:
        write_bag(source, path, codec)
    else:
        convert(source, path, messages=DecodedChannels(codec))
    layout = layout_of(path)
    jsonschema.Draft202012Validator(LAYOUT).validate(layout)
    assert all(panel["foxglovePanelTitle"] for panel in layout["configById"].values())


@pytest.mark.parametrize("octets", [b"", b"abc", b"# no recording", b"\x89MCAP0\r\n"])
def test_files_that_are_not_mcap_get_a_message(tmp_path, octets):
    path = tmp_path / "some.mcap"
    path.write_bytes(octets)
    with pytest.raises(
        CaptureError, match=r"some\.mcap: (is not an MCAP file that can be read from its end|cannot be read)"
    ):
        layout_of(path)
