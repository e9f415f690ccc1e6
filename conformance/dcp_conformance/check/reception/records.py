"""Sizes of records and their offsets in a VarDis payload.

They show whether a receiver processes only the first part of a payload.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_codec.plan.measures import least_size
from dcp_codec.plan.measures import record as layout_of
from dcp_codec.values import RECORD_CLASSES
from dcp_conformance.check.statements import CREATE, UPDATE, Part


class RecordSizes:
    """Sizes of VarDis records in octets, by the plan of a profile.

    Node identifiers and own fields of variable length count with their minimum length.
    """

    def __init__(self, codec: Codec) -> None:
        def least(name: str) -> int:
            """Return the minimum size of a record class in octets."""
            layout = layout_of(codec.containers_plan, name)
            assert layout is not None, f"every profile has {name}"
            return least_size(layout)

        self._least = {kind: least(RECORD_CLASSES[kind].__name__) for kind in ICType}
        self._header = least("Container")

    def create(self, record: Any) -> int:
        """Return the size of a create in octets."""
        return self._least[CREATE] + len(record.spec.descr) + len(record.upd.value)

    def starts(self, parts: Sequence[Part]) -> tuple[list[range | list[int]], int]:
        """Return the offsets of the records of each part in the VarDis payload, and the payload's size, in octets."""
        position, before = 0, None
        starts: list[range | list[int]] = []
        for kind, records, _, _, _ in parts:
            if kind is not before:
                position += self._header
                before = kind
            if kind is CREATE or kind is UPDATE:
                least = self._least[kind]
                sizes = [least + len(each.value) for each in records] if kind is UPDATE else map(self.create, records)
                starts.append([*itertools.accumulate(sizes, initial=position)])
                position = starts[-1][-1]
            else:
                size = self._least[kind]
                end = position + size * len(records)
                starts.append(range(position, end, size))
                position = end
        return starts, position
