"""How a frame stands in an MCAP file: one JSON message on a topic of its own."""

from __future__ import annotations

import json
from typing import Annotated, Any

import msgspec

from dcp_codec.capture.frame import ETHERNET, Frame

TOPIC = "/dcp/frames"
SCHEMA_NAME = "dcp.RawFrame"
SCHEMA_ENCODING = "jsonschema"
MESSAGE_ENCODING = "json"

_SECOND = 1_000_000_000

_U32 = Annotated[int, msgspec.Meta(ge=0, le=2**32 - 1)]
_U62 = Annotated[int, msgspec.Meta(ge=0, le=2**62)]


class Time(msgspec.Struct, frozen=True, gc=False):
    """Foxglove's time: seconds and nanoseconds since the Unix epoch."""

    sec: _U62
    nsec: _U32


class RawFrame(msgspec.Struct, frozen=True, rename="camel"):
    """The message. Only `data` is required, so that files by others that say less can be read."""

    data: bytes
    timestamp: Time | None = None
    #: 0 for none.
    number: _U62 = 0
    interface: _U32 = 0
    link_type: _U32 = ETHERNET
    #: 0 for as many as `data` has.
    orig_len: _U32 = 0


def _integer(title: str, description: str, minimum: int = 0) -> dict[str, Any]:
    return {"type": "integer", "minimum": minimum, "title": title, "description": description}


#: JSON Schema of the message, without references, as Foxglove wants it.
SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": SCHEMA_NAME,
    "description": "One link-layer frame as it was captured.",
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object",
            "title": "time",
            "description": "Time of capture since the Unix epoch.",
            "properties": {
                "sec": _integer("Seconds", "Whole seconds since 1970-01-01T00:00:00Z."),
                "nsec": {
                    **_integer("Nanoseconds", "Nanoseconds within the second."),
                    "maximum": _SECOND - 1,
                },
            },
            "required": ["sec", "nsec"],
        },
        "number": _integer("Frame number", "Number of the frame where it was captured, from 1.", 1),
        "interface": _integer("Interface", "Number of the interface it was captured on, from 0."),
        "linkType": _integer("Link type", "What the data begin with: 1 is Ethernet (tcpdump.org/linktypes)."),
        "origLen": _integer("Length on the wire", "Octets the frame had; more than in data if it was cut."),
        "data": {
            "type": "string",
            "contentEncoding": "base64",
            "title": "Octets",
            "description": "The octets of the frame from the destination address on, in base64.",
        },
    },
    "required": ["timestamp", "number", "interface", "linkType", "origLen", "data"],
}


def schema_octets() -> bytes:
    """`SCHEMA` as it stands in the file."""
    return json.dumps(SCHEMA, indent=1).encode()


_ENCODER = msgspec.json.Encoder()
_DECODER = msgspec.json.Decoder(RawFrame)


def encode(frame: Frame) -> bytes:
    """The message of a frame, UTF-8."""
    sec, nsec = divmod(frame.time_ns, _SECOND)
    # In the order of the schema, which is the order that people will read it in.
    return _ENCODER.encode(
        {
            "timestamp": Time(sec, nsec),
            "number": frame.number,
            "interface": frame.interface,
            "linkType": ETHERNET,
            "origLen": frame.orig_len,
            "data": frame.data,
        }
    )


def decode(octets: bytes | memoryview) -> RawFrame:
    """The message in `octets`; raises `msgspec.MsgspecError` if it is none."""
    return _DECODER.decode(octets)


def time_of(message: RawFrame, log_time: int) -> int:
    """Time of capture in nanoseconds: the message's own, else that of the log."""
    stamp = message.timestamp
    return log_time if stamp is None else stamp.sec * _SECOND + stamp.nsec
