"""Variants with transmissible types of other widths, which implementations may choose since 1.1."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
from dcp_conformance.reference.surroundings import Setup
from dcp_spec.constants import SpecVersion
from dcp_spec.profile.definition import IntType, NodeIdType, Profile, SafetyField, TextType, TimestampType

from .variant import Variant, by_letter, derived, setup

_V = SpecVersion
_replace = msgspec.structs.replace


def _types(**types: Any) -> Callable[[str], Setup]:
    def change(profile: Profile) -> Profile:
        return _replace(profile, types=_replace(profile.types, **types))

    return lambda name: setup(derived(name, change))


def _safety(*fields: SafetyField) -> Callable[[str], Setup]:
    def change(profile: Profile) -> Profile:
        return _replace(profile, srp=_replace(profile.srp, safety_data=fields, record_size=None))

    return lambda name: setup(derived(name, change))


_WHY = "dcp-data-types.md, Conventions: implementers choose the widths of transmissible types"
_SAFETY_WHY = "SRP-TYP-01: the implementation defines SafetyDataT"
_WIDE: dict[str, Any] = {
    "network_id": IntType(4), "var_id": IntType(2), "var_rep_cnt": IntType(2),
    "var_seqno": IntType(4), "var_timeout": IntType(4), "value": TextType((IntType(2),)),
}  # fmt: skip


def _wider(name: str, what: str, since: SpecVersion = _V.V1_1, **types: Any) -> Variant:
    return Variant(f"V-TYPE-{name}", f"has {what}", _WHY, _types(**types), since=since, where=by_letter)


VARIANTS = (
    _wider("node-id-2", "a NodeIdentifierT of 2 octets", node_id=NodeIdType(2, "hex")),
    _wider("node-id-4", "a NodeIdentifierT of 4 octets", node_id=NodeIdType(4, "hex")),
    _wider("node-id-8", "a NodeIdentifierT of 8 octets", node_id=NodeIdType(8, "hex")),
    _wider("timestamp-ms", "time stamps in ms", timestamp=TimestampType(8, unit="ms")),
    _wider("timestamp-us", "time stamps in us", timestamp=TimestampType(8, unit="us")),
    _wider("timestamp-unsigned", "unsigned time stamps", timestamp=TimestampType(8, signed=False)),
    _wider("timestamp-gps", "time stamps since 1980", timestamp=TimestampType(8, epoch="gps")),
    _wider("timestamp-6", "time stamps of 6 octets in ms", timestamp=TimestampType(6, unit="ms")),
    _wider("var-id-2", "a VarIdT of 2 octets", var_id=IntType(2)),
    _wider("var-id-4", "a VarIdT of 4 octets", var_id=IntType(4)),
    _wider("var-rep-cnt-2", "a VarRepCntT of 2 octets", var_rep_cnt=IntType(2)),
    _wider("var-seqno-2", "a VarSeqnoT of 2 octets", var_seqno=IntType(2)),
    _wider("var-seqno-4", "a VarSeqnoT of 4 octets", var_seqno=IntType(4)),
    _wider("var-timeout-1", "a VarTimeoutT of one octet", _V.V2_0, var_timeout=IntType(1)),
    _wider("var-timeout-4", "a VarTimeoutT of 4 octets", _V.V2_0, var_timeout=IntType(4)),
    _wider("var-len-2", "a VarLenT of 2 octets", value=TextType((IntType(2),))),
    _wider("network-id-3", "a BPNetworkIdentifierT of 3 octets", _V.V2_0, network_id=IntType(3)),
    _wider("network-id-4", "a BPNetworkIdentifierT of 4 octets", _V.V2_0, network_id=IntType(4)),
    Variant("V-TYPE-all-wide", "has wider types throughout", _WHY, _types(**_WIDE), since=_V.V1_1, where=by_letter),
    Variant("V-TYPE-safety-integers", "has safety data of integers", _SAFETY_WHY,
        _safety(SafetyField("latitude", "i32"), SafetyField("longitude", "i32"), SafetyField("speed", "u16")),
        where=by_letter),
    Variant("V-TYPE-safety-one", "has safety data of one octet", _SAFETY_WHY, _safety(SafetyField("state", "u8")),
        where=by_letter),
    Variant("V-TYPE-safety-large", "has safety data of 96 octets", _SAFETY_WHY,
        _safety(*(SafetyField(f"f{number}", "f64") for number in range(12))), where=by_letter),
)  # fmt: skip
