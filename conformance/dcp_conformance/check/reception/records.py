"""How long records are, and where in a payload they start: what a receiver that loses part of a payload gets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dcp_spec.constants import ICType
from dcp_spec.profile.definition import Profile

from dcp_conformance.check.statements import Statement

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

    def starts(self, said: Sequence[Statement]) -> tuple[list[int], int]:
        """Where each record starts, in octets from the start of the VarDis payload; and the size of the payload."""
        position, before, begins = 0, None, []
        for each in said:
            if each.kind is not before:
                position += _CONTAINER
                before = each.kind
            begins.append(position)
            position += self.of(each.kind, each.record)
        return begins, position
