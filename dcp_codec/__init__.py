"""Octets <-> values: codec, dissector, captures and exports for the Drone Coordination Protocol.

The names below are the package's interface; everything is built on :class:`Codec`::

    >>> from dcp_codec import Codec
    >>> codec = Codec("dcp-2.0")
    >>> beacon = codec.decode(octets)              # strict: a value, or DecodeError
    >>> octets == codec.encode(beacon)
    >>> codec.dissect(octets).problems             # lenient: never raises
"""

from .codec import Codec, get_codec
from .dissect import Dissection, Field
from .errors import CodecError, DecodeError, EncodeError, Problem
from .values import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    Payload,
    SafetyData,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)

__all__ = [
    "BPHeader",
    "Beacon",
    "Codec",
    "CodecError",
    "Container",
    "DecodeError",
    "Dissection",
    "EncodeError",
    "ExtendedSafetyData",
    "Field",
    "Payload",
    "Problem",
    "SafetyData",
    "VarCreate",
    "VarDelete",
    "VarReqCreate",
    "VarReqUpdate",
    "VarSpec",
    "VarSumm",
    "VarUpdate",
    "get_codec",
]
