"""dcp-vardis.md: what each payload shows for itself."""

from __future__ import annotations

import itertools

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate
from dcp_conformance.heard import Instruction
from dcp_conformance.verdict import Verdict

from .base import Context, Invariant, Seen, name
from .said import Said

#: What says which number of a variable its sender has.
SENT = (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES)


def seqno_of(instruction: Instruction | Said) -> int:
    """The number that a VC, VU, VS or RU carries."""
    record = instruction.record
    number: int = record.upd.seqno if isinstance(record, VarCreate) else record.seqno
    return number


class ContainerOrder(Invariant):
    """The order of containers."""

    id = "CK_VD_ORDER"
    section = "dcp-vardis.md: Payload Construction"
    purpose = "Containers stand in the order in which payloads are composed"
    requirements = ("VD-PAY-01",)
    expect = "containers in the specification's order of composing"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._rank = {kind: rank for rank, kind in enumerate(context.features.container_order)}

    def feed(self, seen: Seen) -> None:
        """Compare neighbours."""
        first = [each for each in seen.heard.instructions() if each.position == 0]
        if len(first) < 2:
            return
        for before, after in itertools.pairwise(first):
            self.exercised()
            if self._rank[after.kind] < self._rank[before.kind]:
                text = f"{name(seen.sender)}: {after.kind.label} behind {before.kind.label}"
                self.violated(text, [before, after], once=(seen.sender, before.kind, after.kind))
        kinds = [each.kind for each in first]
        if len(set(kinds)) < len(kinds):
            doubled = next(kind for kind in kinds if kinds.count(kind) > 1)
            text = f"{name(seen.sender)}: {kinds.count(doubled)} containers {doubled.label}"
            several = self.context.features.several_containers_per_type
            verdict = Verdict.INFO if several else Verdict.FAIL
            expected = (
                "several containers of one type in a payload" if several else "one container of each type at most"
            )
            self.violated(text, [seen], "VD-IC-04", expected=expected, verdict=verdict, once=(seen.sender, doubled))


class PayloadConsistency(Invariant):
    """A payload is composed from one state of the database."""

    id = "CK_VD_PAYLOAD"
    section = "dcp-vardis.md: Payload Construction"
    purpose = "All that one payload says of a variable is of the same state of it"
    requirements = ("VD-CMP-04", "VD-UPD-10", "VD-CMP-05")
    expect = "one sequence number for each variable in a payload, and no summary of a deleted one"

    def feed(self, seen: Seen) -> None:
        """Compare the records about each variable."""
        records: dict[int, Instruction] = {}
        instructions = seen.heard.instructions()
        if len(instructions) < 2:
            return
        deleted = {each.var_id: each for each in instructions if each.kind is ICType.DELETE_VARIABLES}
        for each in instructions:
            if each.kind not in SENT:
                continue
            before = records.setdefault(each.var_id, each)
            if before is not each:
                self.exercised("VD-CMP-04", "VD-UPD-10")
                if seqno_of(before) != seqno_of(each):
                    text = (
                        f"{name(seen.sender)}, variable {each.var_id}: {seqno_of(before)} in {before.kind.label}, "
                        f"{seqno_of(each)} in {each.kind.label}"
                    )
                    self.violated(text, [before, each], "VD-CMP-04", "VD-UPD-10", once=(seen.sender, each.var_id))
            if each.kind is ICType.SUMMARIES and deleted:
                self.exercised("VD-CMP-05")
                if each.var_id in deleted:
                    text = f"{name(seen.sender)} deletes and summarises variable {each.var_id}"
                    self.violated(text, [deleted[each.var_id], each], "VD-CMP-05", once=(seen.sender, each.var_id))


RULES: tuple[type[Invariant], ...] = (
    ContainerOrder,
    PayloadConsistency,
)
