"""Octets <-> values: codec, dissector, captures and exports for the Drone Coordination Protocol.

The names below are the package's interface; everything is built on :class:`Codec`::

    >>> from dcp_codec import Codec
    >>> codec = Codec("dcp-2.0")
    >>> beacon = codec.decode(octets)              # strict: a value, or DecodeError
    >>> octets == codec.encode(beacon)
    >>> codec.dissect(octets).problems             # lenient: never raises
    >>> codec.salvage(octets).beacon               # what can be read of damaged octets

Tables of whole recordings, with the extra ``table``::

    >>> from dcp_codec import open_table
    >>> open_table("flight.mcap", "updates").polars()
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcp_spec.exports import exported

if TYPE_CHECKING:
    from .codec import Codec, get_codec
    from .errors import CodecError, DecodeError, EncodeError, Problem
    from .table.opening import OpenTable, Source
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


def open_table(
    path: Source, table: str = "beacons", *, profile: str = "auto", ether_type: int | None = None
) -> OpenTable:
    """Open one table of recordings for Arrow, pandas or Polars: :func:`dcp_codec.table.opening.open_table`.

    Raises ImportError without the extra ``table``.
    """
    # Imported here, so that only users of tables load Numba and Arrow.
    from .table.opening import open_table as opened

    return opened(path, table, profile=profile, ether_type=ether_type)


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
    "open_table",
]
