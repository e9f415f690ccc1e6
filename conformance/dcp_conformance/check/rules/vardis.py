"""dcp-vardis.md: rules that a single VarDis payload can break."""

from __future__ import annotations

import itertools

from dcp_conformance.check.base import Context, Invariant, Seen, name
from dcp_conformance.check.statements import CREATE, DELETE, SUMMARY, UPDATE, Statement
from dcp_conformance.definitions.verdict import Verdict

#: Maximum number of container sequences that are remembered as valid.
_SEQUENCES = 1024


class ContainerOrder(Invariant):
    """Check the order of containers in a payload."""

    id = "CK_VD_ORDER"
    section = "dcp-vardis.md: Payload Construction"
    purpose = "The containers of a payload have the order in which payloads are composed"
    requirements = ("VD-PAY-01",)
    expect = "containers in the order that the specification gives for composing payloads"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._rank = {kind: rank for rank, kind in enumerate(context.features.container_order)}
        self._sound: set[tuple[type, ...]] = set()
        """Sequences of record types without a violation."""

    def feed(self, seen: Seen) -> None:
        """Compare each container with the next one."""
        containers = seen.heard.containers
        if len(containers) < 2:
            return
        kinds_seen = tuple([type(each.records[0]) for each in containers if each.records])
        if kinds_seen in self._sound:
            self._of_all += len(kinds_seen) - 1
            return
        before = self.left_out + len(self.findings)
        self._judge(seen)
        if self.left_out + len(self.findings) == before and len(self._sound) < _SEQUENCES:
            self._sound.add(kinds_seen)

    def _judge(self, seen: Seen) -> None:
        """Report containers in another order, and several containers of one type."""
        first = [each for each in seen.heard.instructions() if each.position == 0]
        if len(first) < 2:
            return
        for before, after in itertools.pairwise(first):
            self.exercised()
            if self._rank[after.kind] < self._rank[before.kind]:
                text = f"{name(seen.sender)}: {after.kind.label} after {before.kind.label}"
                self.violated(text, [before, after], once=(seen.sender, before.kind, after.kind))
        kinds = [each.kind for each in first]
        if len(set(kinds)) < len(kinds):
            doubled = next(kind for kind in kinds if kinds.count(kind) > 1)
            text = f"{name(seen.sender)}: {kinds.count(doubled)} containers {doubled.label}"
            several = self.context.features.several_containers_per_type
            verdict = Verdict.INFO if several else Verdict.FAIL
            expected = (
                "several containers of one type in a payload" if several else "at most one container of each type"
            )
            self.violated(text, [seen], "VD-IC-04", expected=expected, verdict=verdict, once=(seen.sender, doubled))


class PayloadConsistency(Invariant):
    """Check that the records of one payload agree with one state of the database."""

    id = "CK_VD_PAYLOAD"
    section = "dcp-vardis.md: Payload Construction"
    purpose = "All records of a variable in one payload show the same state of the variable"
    requirements = ("VD-CMP-04", "VD-UPD-10", "VD-CMP-05")
    expect = "one sequence number for each variable in a payload, and no summary of a deleted one"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._pairs = 0
        """Number of pairs of records of one variable in one payload."""

    def feed(self, seen: Seen) -> None:
        """Compare the records of each variable."""
        if self._agree(seen):
            return
        statements = seen.statements
        records: dict[int, Statement] = {}
        deleted = {each.var_id: each for each in statements if each.kind is DELETE}
        for each in statements:
            kind = each.kind
            if kind is not SUMMARY and kind is not UPDATE and kind is not CREATE:
                continue
            before = records.setdefault(each.var_id, each)
            if before is not each:
                self._pairs += 1
                if before.number != each.number:
                    text = (
                        f"{name(seen.sender)}, variable {each.var_id}: {before.number} in {before.kind.label}, "
                        f"{each.number} in {each.kind.label}"
                    )
                    self.violated(text, [before, each], "VD-CMP-04", "VD-UPD-10", once=(seen.sender, each.var_id))
            if kind is SUMMARY and deleted:
                self.exercised("VD-CMP-05")
                if each.var_id in deleted:
                    text = f"{name(seen.sender)} deletes and summarises variable {each.var_id} in one payload"
                    self.violated(text, [deleted[each.var_id], each], "VD-CMP-05", once=(seen.sender, each.var_id))

    def _agree(self, seen: Seen) -> bool:
        """Whether nothing is deleted, and all records of each variable have one number; count the pairs."""
        before: dict[int, int] = {}
        last: dict[int, int] = {}
        pairs = 0
        for kind, _, ids, _, stated in seen.parts:
            if kind is DELETE:
                return False
            if kind is SUMMARY or kind is UPDATE or kind is CREATE:
                if len(stated) < len(ids):
                    return False
                if last:
                    before = before | last if before else last
                    common = before.keys() & stated.keys()
                    for var_id in common:
                        if before[var_id] != stated[var_id]:
                            return False
                    pairs += len(common)
                last = stated
        self._pairs += pairs
        return True

    def finish(self) -> None:
        """Count the occasions."""
        self.exercised("VD-CMP-04", "VD-UPD-10", times=self._pairs)


RULES: tuple[type[Invariant], ...] = (
    ContainerOrder,
    PayloadConsistency,
)
