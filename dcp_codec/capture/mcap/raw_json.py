"""Raw frames as JSON with base64, as in older MCAP files and those in `captures/`. Only read, never written."""

from __future__ import annotations

from typing import Annotated

import msgspec

from dcp_codec.capture.frame import ETHERNET

from .raw_frame import RawFrame

MESSAGE_ENCODING = "json"

_SECOND = 1_000_000_000

_U32 = Annotated[int, msgspec.Meta(ge=0, le=2**32 - 1)]
_U62 = Annotated[int, msgspec.Meta(ge=0, le=2**62)]


class _Time(msgspec.Struct, frozen=True, gc=False):
    """Seconds and nanoseconds since the Unix epoch."""

    sec: _U62
    nsec: _U32


class _Message(msgspec.Struct, frozen=True, rename="camel"):
    """The JSON object. Only `data` is required, so that files of other writers with fewer members can be read."""

    data: bytes
    timestamp: _Time | None = None
    number: _U62 = 0
    interface: _U32 = 0
    link_type: _U32 = ETHERNET
    orig_len: _U32 = 0


_DECODER = msgspec.json.Decoder(_Message)


def decode(octets: bytes | memoryview) -> RawFrame:
    """Decode the message in `octets`; raises `ValueError` (of which `msgspec.MsgspecError` is one) otherwise."""
    found = _DECODER.decode(octets)
    stamp = found.timestamp
    time_ns = None if stamp is None else stamp.sec * _SECOND + stamp.nsec
    return RawFrame(found.data, time_ns, found.number, found.interface, found.link_type, found.orig_len)
