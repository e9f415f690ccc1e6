"""Locate the record that a finding is about in its frame."""

from __future__ import annotations

from dcp_codec.codec import Codec
from dcp_conformance.definitions.results import Mark


def placed(codec: Codec, mark: Mark, frame: bytes, start: int) -> Mark:
    """Replace the path "KIND variable" of a mark by the offset, length and path of that record; keep other marks.

    ``start`` is the offset of the bearer payload in ``frame``, in octets. If the frame has no such record, the mark of
    the whole frame is returned.
    """
    if mark.length or not mark.path:
        return mark
    found = codec.dissect(frame, start=start, base=start)
    kind, _, var_id = mark.path.rpartition(" ")
    for container in found.root.walk():
        label = container.child("icType")
        if label is None or label.label != kind:
            continue
        records = container.child("records")
        for record in records.children if records is not None else ():
            field = (record.child("spec") or record).child("varId")
            if field is not None and str(field.value) == var_id:
                return Mark(mark.frame, record.offset, record.length, record.path)
    return Mark(mark.frame)
