"""dcp-vardis.md: what payloads show, each for itself and one after the other."""

from __future__ import annotations

import itertools
from collections import OrderedDict
from typing import Any

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate
from dcp_conformance.circular import Circle
from dcp_conformance.heard import Instruction
from dcp_conformance.verdict import Verdict

from .base import MOST_VARIABLES, Context, Invariant, Seen, name

#: Values of a variable that are remembered: fewer than the circle of its numbers has.
_VALUES = 64
_SENT = (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES)


def seqno_of(instruction: Instruction) -> int:
    """The number that a VC, VU, VS or RU carries."""
    record = instruction.record
    number: int = record.upd.seqno if isinstance(record, VarCreate) else record.seqno
    return number


def creation_of(record: VarCreate) -> tuple[Any, ...]:
    """What tells one creation of a variable from another."""
    return (record.spec.prod_id, record.spec.creation_time)


class Creations:
    """Which creation of each variable is on the air: changes with every VarCreate that differs, and with VarDelete."""

    def __init__(self) -> None:
        self._current: dict[int, tuple[tuple[Any, ...] | None, int]] = {}

    def feed(self, instruction: Instruction) -> int:
        """A number for the variable's current creation, after this instruction."""
        var_id = instruction.var_id
        creation, number = self._current.get(var_id, (None, 0))
        if instruction.kind is ICType.CREATE_VARIABLES:
            this = creation_of(instruction.record)
            if creation is not None and this != creation:
                number += 1
            self._set(var_id, this, number)
        elif instruction.kind is ICType.DELETE_VARIABLES and creation is not None and creation[1] is None:
            # Before 2.0 a deleted variable may come back with the same VarSpec.
            number += 1
            self._set(var_id, None, number)
        return number

    def _set(self, var_id: int, creation: tuple[Any, ...] | None, number: int) -> None:
        if var_id in self._current or len(self._current) < MOST_VARIABLES:
            self._current[var_id] = (creation, number)


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
        deleted = {each.var_id: each for each in seen.heard.instructions(ICType.DELETE_VARIABLES)}
        for each in seen.heard.instructions():
            if each.kind not in _SENT:
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


class SequenceForwards(Invariant):
    """Nobody goes back to an older value."""

    id = "CK_VD_SEQNO"
    section = "dcp-vardis.md: Receive Path"
    purpose = "What a node sends of a variable never becomes older within a creation"
    requirements = ("VD-TYP-03", "VD-PU-06")
    expect = "sequence numbers that stay or grow (circularly)"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._creations = Creations()
        self._own: dict[tuple[bytes, int], int] = {}
        """(node, variable) -> the creation that the node itself has spoken of."""
        self._last: dict[tuple[bytes, int], tuple[int, Instruction]] = {}

    def feed(self, seen: Seen) -> None:
        """Compare with what the node sent last, while nobody speaks of another creation than it does."""
        for each in seen.heard.instructions():
            current, key = self._creations.feed(each), (seen.sender, each.var_id)
            if each.kind in (ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES) and (
                key in self._own or len(self._own) < MOST_VARIABLES
            ):
                self._own[key] = current
            if each.kind not in _SENT:
                continue
            creation = self._own.get(key, 0)
            before = self._last.get(key)
            if before is not None and before[0] == creation == current:
                self.exercised()
                old, new = seqno_of(before[1]), seqno_of(each)
                if self._circle.older(new, old) and not self._restarted(each, before[1]):
                    text = f"{name(seen.sender)}, variable {each.var_id}: {new} after {old}"
                    self.violated(text, [before[1], each], once=key)
            if before is not None or len(self._last) < MOST_VARIABLES:
                self._last[key] = (creation, each)

    def _restarted(self, new: Instruction, old: Instruction) -> bool:
        """Whether the node has started again in between: its beacon numbers have."""
        before, after = old.heard.seqno, new.heard.seqno
        return before is not None and after is not None and after < before


class OneValue(Invariant):
    """One number, one value."""

    id = "CK_VD_VALUE"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "The same sequence number of a creation stands for the same value at all nodes"
    requirements = ("VD-PU-05", "VD-PU-07")
    expect = "the same value wherever variable, creation and sequence number are the same"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._creations = Creations()
        self._values: dict[int, OrderedDict[tuple[int, int], tuple[bytes, Instruction]]] = {}

    def feed(self, seen: Seen) -> None:
        """Compare with whoever sent that number first."""
        for each in seen.heard.instructions():
            creation = self._creations.feed(each)
            if each.kind not in (ICType.CREATE_VARIABLES, ICType.UPDATES):
                continue
            record = each.record.upd if isinstance(each.record, VarCreate) else each.record
            known = self._values.get(each.var_id)
            if known is None:
                if len(self._values) >= MOST_VARIABLES:
                    continue
                known = self._values[each.var_id] = OrderedDict()
            before = known.get((creation, record.seqno))
            if before is None:
                known[creation, record.seqno] = (record.value, each)
                if len(known) > _VALUES:
                    known.popitem(last=False)
                continue
            self.exercised()
            if before[0] != record.value:
                text = (
                    f"variable {each.var_id}, seqno {record.seqno}: {before[0].hex()} from "
                    f"{name(before[1].heard.sender or b'')}, {record.value.hex()} from {name(seen.sender)}"
                )
                self.violated(text, [before[1], each], once=(each.var_id, creation, record.seqno))


class OneSpec(Invariant):
    """Attributes are forwarded as they are."""

    id = "CK_VD_SPEC"
    section = "dcp-vardis.md: Basic Transmissible Data Types"
    purpose = "All nodes send the same VarSpec of a creation"
    requirements = ("VD-TYP-06", "VD-PC-10")
    expect = "prodId, repCnt, creationTime, timeout and description as the producer sent them"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._creations = Creations()
        self._specs: OrderedDict[tuple[int, int], Instruction] = OrderedDict()

    def feed(self, seen: Seen) -> None:
        """Compare with whoever sent the creation first."""
        for each in seen.heard.instructions():
            creation = self._creations.feed(each)
            if each.kind is not ICType.CREATE_VARIABLES:
                continue
            key = (each.var_id, creation)
            before = self._specs.get(key)
            if before is None:
                self._specs[key] = each
                if len(self._specs) > MOST_VARIABLES:
                    self._specs.popitem(last=False)
                continue
            if before.heard.sender != seen.sender:
                self.exercised()
            if before.record.spec != each.record.spec:
                text = f"variable {each.var_id}: {before.record.spec} becomes {each.record.spec}"
                self.violated(text, [before, each], once=key)


class Deleted(Invariant):
    """What is deleted is not mentioned."""

    id = "CK_VD_DELETED"
    section = "dcp-vardis.md: RTDB-Delete"
    purpose = "A node that has deleted a variable says nothing more of it, until it is created again"
    requirements = ("VD-DEL-05", "VD-PD-04", "VD-CMP-05")
    expect = "no create, update or summary behind a delete"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._deleted: dict[tuple[bytes, int], Instruction] = {}
        self._created: dict[int, Instruction] = {}

    def feed(self, seen: Seen) -> None:
        """Remember deletes; a create that anybody sends behind one ends its force."""
        for each in seen.heard.instructions():
            key = (seen.sender, each.var_id)
            gone = self._deleted.get(key)
            if each.kind is ICType.DELETE_VARIABLES:
                if gone is not None or len(self._deleted) < MOST_VARIABLES:
                    self._deleted[key] = each
                continue
            if each.kind is ICType.CREATE_VARIABLES and (
                each.var_id in self._created or len(self._created) < MOST_VARIABLES
            ):
                self._created[each.var_id] = each
            if gone is None or each.kind not in _SENT:
                continue
            again = self._created.get(each.var_id)
            if again is not None and again.heard.wall >= gone.heard.wall:
                del self._deleted[key]
                continue
            self.exercised()
            text = f"{name(seen.sender)} deletes variable {each.var_id}, and then sends {each.kind.label} of it"
            self.violated(text, [gone, each], once=key)

    def finish(self) -> None:
        """A delete that stayed in force was an occasion."""
        for _ in self._deleted:
            self.exercised()


class Recreation(Invariant):
    """Creations of one producer follow each other."""

    id = "CK_VD_CREATION"
    section = "dcp-vardis.md: RTDB-Create"
    purpose = "A variable that is created again gets a later creationTime and starts with sequence number 0"
    requirements = ("VD-CRE-09", "VD-CRE-10")
    expect = "a later creationTime, and 0 as the first sequence number"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[int, Instruction] = {}

    def applies(self) -> str:
        """Since 2.0."""
        return "" if self.context.features.creation_time else "there is no creationTime before 2.0"

    def feed(self, seen: Seen) -> None:
        """Compare what producers themselves create."""
        for each in seen.heard.instructions(ICType.CREATE_VARIABLES):
            if each.record.spec.prod_id != seen.sender:
                continue
            before = self._last.get(each.var_id)
            if before is not None or len(self._last) < MOST_VARIABLES:
                self._last[each.var_id] = each
            if before is None or before.record.spec.creation_time == each.record.spec.creation_time:
                continue
            if before.record.spec.prod_id != each.record.spec.prod_id:
                self.note("another node takes a variable over (H4)", f"variable {each.var_id}", [before, each])
                continue
            self.exercised()
            if each.record.spec.creation_time < before.record.spec.creation_time:
                text = f"variable {each.var_id} is created again with an earlier creationTime"
                self.violated(text, [before, each], "VD-CRE-09", once=each.var_id)
            if each.record.upd.seqno > 1:
                text = f"variable {each.var_id} starts again with sequence number {each.record.upd.seqno}"
                self.note("the first number of a creation that was heard", text, [each], "VD-CRE-10")


RULES: tuple[type[Invariant], ...] = (
    ContainerOrder,
    PayloadConsistency,
    SequenceForwards,
    OneValue,
    OneSpec,
    Deleted,
    Recreation,
)
