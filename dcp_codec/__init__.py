"""Octets <-> values: codec, dissector, captures and exports for the Drone Coordination Protocol.

The names below are the package's interface; everything is built on :class:`Codec`::

    >>> from dcp_codec import Codec
    >>> codec = Codec("dcp-2.0")
    >>> beacon = codec.decode(octets)              # strict: a value, or DecodeError
    >>> octets == codec.encode(beacon)
    >>> codec.dissect(octets).problems             # lenient: never raises
    >>> codec.salvage(octets).beacon               # what can be read of damaged octets
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcp_spec.exports import exported

if TYPE_CHECKING:
    from .codec import Codec, get_codec
    from .errors import CodecError, DecodeError, EncodeError, Problem
    from .values import (
        Beacon,
        BPHeader,
        Container,
        ExtendedSafetyData,
        OwnRecord,
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
    from .views.fields import Dissection, Field
    from .views.salvage import Damaged, Salvaged

# Lazy imports: commands that only print their help load neither schemas nor profiles.
__getattr__ = exported(
    __name__,
    {
        "codec": ("Codec", "get_codec"),
        "errors": ("CodecError", "DecodeError", "EncodeError", "Problem"),
        "views.fields": ("Dissection", "Field"),
        "views.salvage": ("Damaged", "Salvaged"),
        "values": (
            *(
                "BPHeader",
                "Beacon",
                "Container",
                "ExtendedSafetyData",
                "OwnRecord",
                "Payload",
                "SafetyData",
                "VarCreate",
            ),
            *("VarDelete", "VarReqCreate", "VarReqUpdate", "VarSpec", "VarSumm", "VarUpdate"),
        ),
    },
)


__all__ = [
    "BPHeader",
    "Beacon",
    "Codec",
    "CodecError",
    "Container",
    "Damaged",
    "DecodeError",
    "Dissection",
    "EncodeError",
    "ExtendedSafetyData",
    "Field",
    "OwnRecord",
    "Payload",
    "Problem",
    "SafetyData",
    "Salvaged",
    "VarCreate",
    "VarDelete",
    "VarReqCreate",
    "VarReqUpdate",
    "VarSpec",
    "VarSumm",
    "VarUpdate",
    "get_codec",
]
