"""Records that the tester sends, with values in the fields that a profile adds to them."""

from __future__ import annotations

from typing import Any, cast

import msgspec
from dcp_spec.profile.definition import OwnField

from dcp_codec.codec import Codec
from dcp_codec.plan.layout import neutral
from dcp_codec.values import VALUE_CLASSES, AnyRecord, VarCreate


class Sampler:
    """Gives the fields that a profile adds to VarSpec and to records values other than zero.

    Equal records get equal values, and records with different sequence numbers usually different ones. So an
    implementation that does not forward a field, or forwards that of another record, is noticed.
    """

    def __init__(self, codec: Codec) -> None:
        self._types = codec.types
        self._own = codec.profile.vardis.own_fields()

    def filled(self, record: AnyRecord) -> AnyRecord:
        """Return ``record`` in the class of the profile; one that already is in that class is returned unchanged."""
        if not self._own or hasattr(record, "extra"):
            return record
        if isinstance(record, VarCreate):
            record = msgspec.structs.replace(record, spec=self.filled(record.spec), upd=self.filled(record.upd))
        own = self._own.get(type(record).__name__)
        if own is None:
            return record
        number = getattr(record, "seqno", 0)
        return self._types.extended(record, tuple([_sample(each, number) for each in own]))


def plain(record: AnyRecord) -> AnyRecord:
    """Return ``record`` without the fields that a profile adds, for a comparison of what the specification defines."""
    made: Any = VALUE_CLASSES[type(record).__name__]
    return cast(AnyRecord, made(*[getattr(record, name) for name in made.__struct_fields__]))


def _sample(member: OwnField, number: int) -> int | float | bytes:
    """Return a value that every layout of the field can hold; octets without a known meaning are zeros."""
    if member.opaque is not None:
        return neutral(member)
    small = 1 + number % 100
    if member.real is not None:
        return float(small)
    # Printable, so that it is also valid as text.
    return bytes((0x20 + small % 90,)) if member.block is not None else small
