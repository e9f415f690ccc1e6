"""How long records are, and where in a payload they start: what a receiver that loses part of a payload gets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dcp_spec.constants import ICType
from dcp_spec.profile.definition import Profile

from dcp_conformance.check.statements import CREATE, UPDATE, Part

#: icType and icNumRecords.
_CONTAINER = 2


class RecordSizes:
    """Sizes in octets by the widths of a profile; fields that only the profile has are not counted."""

    def __init__(self, profile: Profile) -> None:
        types = profile.types
        number, identifier = types.var_seqno.width, types.var_id.width
        self._summary = identifier + number
        self._identifier = identifier
        self._spec = identifier + types.node_id.width + types.var_rep_cnt.width
        if profile.spec_version >= "2.0":
            self._spec += types.timestamp.width + types.var_timeout.width

    def of(self, kind: ICType, record: Any) -> int:
        """The size of a record."""
        if kind is ICType.CREATE_VARIABLES:
            return self._spec + 2 + len(record.spec.descr) + self._summary + len(record.upd.value)
        if kind is ICType.UPDATES:
            return self._summary + 1 + len(record.value)
        if kind in (ICType.SUMMARIES, ICType.REQUEST_VARUPDATES):
            return self._summary
        return self._identifier

    def starts(self, parts: Sequence[Part]) -> tuple[list[range | list[int]], int]:
        """Where each record starts, in octets from the start of the VarDis payload; and the size of the payload."""
        position, before = 0, None
        starts: list[range | list[int]] = []
        for kind, records, _ in parts:
            if kind is not before:
                position += _CONTAINER
                before = kind
            if kind is CREATE or kind is UPDATE:
                begins = []
                for each in records:
                    begins.append(position)
                    position += self.of(kind, each)
                starts.append(begins)
            else:
                size = self.of(kind, records[0])
                end = position + size * len(records)
                starts.append(range(position, end, size))
                position = end
        return starts, position
