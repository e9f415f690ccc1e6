"""Records that the tester sends, with values in the fields that a profile adds to them."""

from __future__ import annotations

from typing import Any, cast

from dcp_spec.profile.definition import OwnField

from dcp_codec.codec import Codec
from dcp_codec.plan.layout import neutral
from dcp_codec.records import RecordFactory
from dcp_codec.values import VALUE_CLASSES, AnyRecord


def sampler(codec: Codec) -> RecordFactory:
    """Return a factory that gives the fields that a profile adds to records values other than zero.

    Equal records get equal values, and records with different sequence numbers usually different ones. So an
    implementation that does not forward a field, or forwards that of another record, is noticed.
    """
    return RecordFactory(codec, _sample)


def plain(record: AnyRecord) -> AnyRecord:
    """Return ``record`` without the fields that a profile adds, for a comparison of what the specification defines."""
    made: Any = VALUE_CLASSES[type(record).__name__]
    return cast(AnyRecord, made(*[getattr(record, name) for name in made.__struct_fields__]))


def _sample(record: Any, member: OwnField) -> int | float | bytes:
    """Return a value that every layout of the field can hold; octets without a known meaning are zeros."""
    number = getattr(record, "seqno", 0)
    if member.opaque is not None:
        return neutral(member)
    small = 1 + number % 100
    if member.real is not None:
        return float(small)
    # Printable, so that it is also valid as text.
    return bytes((0x20 + small % 90,)) if member.block is not None else small
