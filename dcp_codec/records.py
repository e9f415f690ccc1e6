"""Make the records and headers of a profile, with values in the fields that it adds to those of the specification."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, cast

import msgspec
from dcp_spec.constants import ICType
from dcp_spec.profile.definition import OwnField

from .codec import Codec
from .plan.layout import neutral
from .values import RECORD_CLASSES, AnyRecord, BPHeader, ExtendedSafetyData, VarCreate, VardisRecord, VarSpec, VarUpdate

#: Returns the value of a field that the profile adds to a record, which has its other fields.
OwnValue = Callable[[Any, OwnField], int | float | bytes]


class RecordFactory:
    """Makes the records, state reports and headers of a profile."""

    def __init__(self, codec: Codec, value: OwnValue = lambda _record, member: neutral(member)) -> None:
        """``value``: for the fields that the profile adds; by default zero."""
        profile = codec.profile
        self._types = codec.types
        self._value = value
        self._own = profile.own_fields()
        self.stamped = "creationTime" in profile.vardis.var_spec
        """Whether the profile has the field creationTime in VarSpec."""
        self._limited = "timeout" in profile.vardis.var_spec
        self._headed = bool(profile.bp.header)
        self._network = (profile.bp.network_id or 0) if profile.has_header_field("networkId") else None
        self._data = {
            each.name: bytes(each.octets) if each.type == "opaque" else 0.0 if each.type.startswith("f") else 0
            for each in profile.srp.safety_data
        }

    def header(self, sender_id: bytes, seqno: int) -> BPHeader | None:
        """Return the header of a beacon in the network of the profile, by default 0; None if it sends no header."""
        return BPHeader(sender_id, seqno, self._network) if self._headed else None

    def filled(self, record: AnyRecord) -> AnyRecord:
        """Return ``record`` in the class of the profile; one that has values for the added fields is not changed."""
        if not self._own or getattr(record, "extra", None):
            return record
        if isinstance(record, VarCreate):
            record = msgspec.structs.replace(record, spec=self.filled(record.spec), upd=self.filled(record.upd))
        own = self._own.get(type(record).__name__)
        if own is None:
            return record
        return self._types.extended(record, tuple([self._value(record, each) for each in own]))

    def spec(
        self, var_id: int, prod_id: bytes, rep_cnt: int, descr: bytes, creation_time: int = 0, timeout: int = 0
    ) -> VarSpec:
        """Return a VarSpec, without ``creation_time`` and ``timeout`` (ms) if the layout lacks them."""
        stamp = creation_time if self.stamped else None
        return self.filled(VarSpec(var_id, prod_id, rep_cnt, descr, stamp, timeout if self._limited else None))

    def create(self, spec: VarSpec, seqno: int, value: bytes) -> VarCreate:
        """Return a VarCreate."""
        return self.filled(VarCreate(spec, VarUpdate(spec.var_id, seqno, value)))

    def record(self, kind: ICType, var_id: int, seqno: int = 0, value: bytes = b"") -> VardisRecord:
        """Return a record of any other type; arguments for which it has no field are ignored."""
        made = RECORD_CLASSES[kind]
        fields = (var_id, seqno, value)[: len(made.__struct_fields__)]
        return self.filled(cast(VardisRecord, made(*fields)))

    def report(
        self, node_id: bytes, t_stamp: int, seqno: int, values: Mapping[str, float | bytes | str] = {}
    ) -> ExtendedSafetyData:
        """Return a state report. ``values``: fields of the safety data by name, octets also in hex; others are zero."""
        data = {**self._data, **values}
        octets = {name: bytes.fromhex(value) for name, value in data.items() if isinstance(value, str)}
        s_data = self._types.safety_data(**{**data, **octets})
        return self.filled(ExtendedSafetyData(s_data, node_id, t_stamp, seqno))
