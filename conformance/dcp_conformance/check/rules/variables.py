"""dcp-vardis.md: what nodes say of a variable, one payload after the other and one node beside the other.

Nothing here is said at once. What a node says that looks wrong may be explained by what comes next (a creation that did
not fit into the payload before), or by a beacon that the recorder has missed, which shows only with the one after it.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import Any, NamedTuple

from dcp_codec.values import VarCreate
from dcp_conformance.check.base import MOST_VARIABLES, Context, Invariant, Seen, name
from dcp_conformance.check.statements import CREATE, DELETE, SUMMARY, UPDATE, Statement
from dcp_conformance.check.wording import differences, spec_text
from dcp_conformance.model.circular import Circle

#: Values of a variable that are remembered: fewer than the circle of its numbers has.
_VALUES = 64
#: So many beacons a node gets to explain itself; creations go first, and many may be waiting.
_PATIENCE = 10
#: A gap in the recording shows within so many ns, or never.
_GAP_SHOWS = 2_000_000_000
_SUSPECTS = 4096
#: Later than anything in a recording, in ns since 1970.
_END = 1 << 63


class _Suspect(NamedTuple):
    """What looks wrong, until it is explained."""

    before: Statement
    after: Statement
    beacons: int
    """How many beacons of the node had been heard by then."""
    text: str


class _OfOneNode(Invariant):
    """Base: a node contradicts itself, unless it says in a moment that the variable was created again."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._suspects: OrderedDict[tuple[bytes, int], _Suspect] = OrderedDict()

    def suspect(self, before: Statement, after: Statement, seen: Seen, text: str) -> None:
        """Only if nothing of the node is missing in between."""
        sender = self.context.senders.get(seen.sender)
        if sender is None or sender.unbroken > before.time or len(self._suspects) >= _SUSPECTS:
            return
        self._suspects.setdefault((seen.sender, after.var_id), _Suspect(before, after, sender.beacons, text))

    def explain(self, node: bytes, var_id: int) -> None:
        """A creation, or a deletion: it was another life."""
        self._suspects.pop((node, var_id), None)

    def due(self, now: int) -> None:
        """Judge those that had their time, in their order."""
        while self._suspects:
            key, suspect = next(iter(self._suspects.items()))
            sender = self.context.senders.get(key[0])
            if sender is None or sender.unbroken > suspect.before.time:
                del self._suspects[key]
            elif sender.beacons >= suspect.beacons + _PATIENCE:
                del self._suspects[key]
                self.violated(suspect.text, [suspect.before, suspect.after], once=key)
            elif suspect.after.time + _PATIENCE * _GAP_SHOWS < now:
                # It has fallen silent.
                del self._suspects[key]
            else:
                break

    def finish(self) -> None:
        """No more time will come: who has not explained itself has fallen silent."""
        self.due(_END)


class SequenceForwards(_OfOneNode):
    """Nobody goes back to an older value."""

    id = "CK_VD_SEQNO"
    section = "dcp-vardis.md: Receive Path"
    purpose = "What a node sends of a variable never becomes older within a creation"
    requirements = ("VD-TYP-03", "VD-PU-06")
    expect = "sequence numbers that stay or grow (circularly)"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._creation: dict[tuple[bytes, int], tuple[Any, ...]] = {}
        """(node, variable) -> the creation that the node has spoken of."""

    def feed(self, seen: Seen) -> None:
        """Compare with what the node sent last."""
        self.due(seen.time)
        if seen.again:
            self.exercised(times=seen.again)
        for each, before in seen.news:
            kind = each.kind
            if kind is DELETE:
                self.explain(seen.sender, each.var_id)
                continue
            if kind is CREATE:
                key = (seen.sender, each.var_id)
                if self._another(key, each.record):
                    self.explain(*key)
                    continue
            elif kind is not UPDATE and kind is not SUMMARY:
                continue
            if before is not None:
                self.exercised()
                if self._circle.older(each.number, before.number):
                    text = f"{name(seen.sender)}, variable {each.var_id}: {each.number} after {before.number}"
                    self.suspect(before, each, seen, text)

    def _another(self, key: tuple[bytes, int], record: VarCreate) -> bool:
        """Whether the node speaks of another creation than before."""
        this = (record.spec.prod_id, record.spec.creation_time)
        before = self._creation.get(key)
        if before is not None or len(self._creation) < MOST_VARIABLES:
            self._creation[key] = this
        return before != this


class Deleted(_OfOneNode):
    """What is deleted is not mentioned."""

    id = "CK_VD_DELETED"
    section = "dcp-vardis.md: RTDB-Delete"
    purpose = "A node that has deleted a variable says nothing more of it, until it is created again"
    requirements = ("VD-DEL-05", "VD-PD-04", "VD-CMP-05")
    expect = "no update or summary after a delete"
    enough = 3

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._deleted: dict[tuple[bytes, int], Statement] = {}

    def feed(self, seen: Seen) -> None:
        """Remember deletes; a create that the node itself sends behind one ends its force."""
        self.due(seen.time)
        for each, _ in seen.news:
            key = (seen.sender, each.var_id)
            if each.kind is DELETE:
                if key in self._deleted or len(self._deleted) < MOST_VARIABLES:
                    self.exercised()
                    self._deleted[key] = each
            elif each.kind is CREATE:
                self._deleted.pop(key, None)
                self.explain(*key)
            elif key in self._deleted and each.kind in (UPDATE, SUMMARY):
                gone = self._deleted.pop(key)
                text = f"{name(seen.sender)} deletes variable {each.var_id}, and then sends {each.kind.label} of it"
                self.suspect(gone, each, seen, text)


class _Contradiction(NamedTuple):
    """Two nodes that say different things of one variable, until it is certain that nothing of either was missed."""

    begin: int
    before: Statement
    after: Statement
    text: str
    key: object


class _OfAllNodes(Invariant):
    """Base: nodes contradict each other about a variable that has had a single life."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._open: deque[_Contradiction] = deque()

    def contradict(self, begin: int, before: Statement, after: Statement, text: str, key: object) -> None:
        """``begin``: nothing may be missing since then."""
        if len(self._open) < _SUSPECTS:
            self._open.append(_Contradiction(begin, before, after, text, key))

    def due(self, now: int) -> None:
        """Judge those of which it is certain now that nothing was missed."""
        while self._open and self._open[0].after.time + _GAP_SHOWS < now:
            each = self._open.popleft()
            if self.context.senders.complete(each.begin, each.after.time):
                self.violated(each.text, [each.before, each.after], once=each.key)

    def finish(self) -> None:
        """No gap will show any more."""
        self.due(_END)


class OneValue(_OfAllNodes):
    """One number, one value."""

    id = "CK_VD_VALUE"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "The same sequence number of a variable stands for the same value at all nodes"
    requirements = ("VD-PU-05", "VD-PU-07")
    expect = "the same value wherever variable, creation and sequence number are the same"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._values: dict[int, OrderedDict[int, tuple[bytes, Statement]]] = {}
        self._newest: dict[int, int] = {}

    def feed(self, seen: Seen) -> None:
        """Compare with whoever sent that number first."""
        self.due(seen.time)
        lives = self.context.lives
        for each, _ in seen.news:
            kind = each.kind
            if kind is not UPDATE and kind is not SUMMARY and kind is not CREATE:
                continue
            born = lives.born(each.var_id)
            if born is None:
                self._values.pop(each.var_id, None)
                self._newest.pop(each.var_id, None)
                continue
            self._advance(each.var_id, each.number)
            if kind is not SUMMARY:
                self._compare(each, born, seen)

    def _advance(self, var_id: int, number: int) -> None:
        """Forget what lies a quarter of the circle back: its numbers will come again."""
        newest = self._newest.get(var_id)
        if newest is None or self._circle.newer(number, newest):
            if newest is None and len(self._newest) >= MOST_VARIABLES:
                return
            self._newest[var_id] = number
            known = self._values.setdefault(var_id, OrderedDict())
            for old in [each for each in known if self._far(each, number)]:
                del known[old]

    def _far(self, number: int, newest: int) -> bool:
        return (newest - number) % self._circle.modulus >= self._circle.modulus // 4

    def _compare(self, each: Statement, born: int, seen: Seen) -> None:
        record = each.record.upd if isinstance(each.record, VarCreate) else each.record
        newest = self._newest.get(each.var_id)
        if newest is None or self._far(record.seqno, newest):
            return
        known = self._values[each.var_id]
        before = known.get(record.seqno)
        if before is None:
            known[record.seqno] = (record.value, each)
            if len(known) > _VALUES:
                known.popitem(last=False)
            return
        self.exercised()
        if before[0] != record.value:
            text = (
                f"variable {each.var_id}, seqno {record.seqno}: {before[0].hex()} from "
                f"{name(before[1].sender)}, {record.value.hex()} from {name(seen.sender)}"
            )
            self.contradict(born, before[1], each, text, (each.var_id, record.seqno))


class OneSpec(_OfAllNodes):
    """Attributes are forwarded as they are."""

    id = "CK_VD_SPEC"
    section = "dcp-vardis.md: Basic Transmissible Data Types"
    purpose = "All nodes send the same VarSpec of a creation"
    requirements = ("VD-TYP-06", "VD-PC-10")
    expect = "prodId, repCnt, creationTime, timeout and description as the producer sent them"
    enough = 4

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._specs: OrderedDict[tuple[Any, ...], Statement] = OrderedDict()
        self._forgotten = False
        """Whether there were more creations than are remembered."""
        self._producers: dict[tuple[int, int], Statement] = {}
        """(variable, creation time) -> the creation with the producer that was named first."""

    def feed(self, seen: Seen) -> None:
        """Compare with whoever sent the creation first."""
        self.due(seen.time)
        for each in [said for said, _ in seen.news if said.kind is CREATE]:
            spec = each.record.spec
            key = (each.var_id, spec.prod_id, spec.creation_time)
            before = self._specs.get(key)
            if before is None or (spec.creation_time is None and spec.prod_id == seen.sender):
                if before is None:
                    self._producer(each)
                    if spec.prod_id != seen.sender and not self._forgotten:
                        self._unheard(each, seen)
                self._specs[key] = each
                if len(self._specs) > MOST_VARIABLES:
                    self._specs.popitem(last=False)
                    self._forgotten = True
                continue
            if before.sender != seen.sender:
                self.exercised()
            if before.record.spec == spec:
                continue
            changed = differences(before.record.spec, spec)
            text = f"variable {each.var_id}: {changed} at {name(seen.sender)}, after {name(before.sender)}"
            if spec.creation_time is not None:
                self.violated(text, [before, each], once=key)
            else:
                # Before 2.0 nothing tells creations apart; this is one only if there was a single life.
                born = self.context.lives.born(each.var_id)
                if born is not None:
                    self.contradict(born, before, each, text, key)

    def _producer(self, each: Statement) -> None:
        """Whether a creation was said before with another producer and everything else alike."""
        spec = each.record.spec
        key = (each.var_id, spec.creation_time or 0)
        before = self._producers.get(key)
        if before is None:
            if len(self._producers) < MOST_VARIABLES:
                self._producers[key] = each
            return
        first = before.record.spec
        if first.prod_id == spec.prod_id or (first.rep_cnt, first.timeout, first.descr) != (
            spec.rep_cnt, spec.timeout, spec.descr,
        ):  # fmt: skip
            return
        # Before 2.0: only if number and value are the same, too, and nobody else could be the producer.
        alike = before.record.upd == each.record.upd and self.context.senders.get(spec.prod_id) is None
        if spec.creation_time is None and not alike:
            return
        later_is_wrong = before.sender == first.prod_id or each.sender != spec.prod_id
        wrong, right = (each, before) if later_is_wrong else (before, each)
        text = (
            f"variable {each.var_id}: {name(wrong.sender)} passes on the creation of {name(right.record.spec.prod_id)} "
            f"with prodId {name(wrong.record.spec.prod_id)}"
        )
        self.contradict(before.time, before, each, text, ("prodId", *key))

    def _unheard(self, each: Statement, seen: Seen) -> None:
        """A creation that its producer never sent, later than the one that it made before our eyes.

        An earlier one may be older than the recording, and come with a node that has been out of reach.
        """
        spec, first = each.record.spec, self.context.lives.first(each.var_id)
        if first is None or spec.creation_time is None:
            return
        begin, original = first
        known = original.record.spec
        if spec.prod_id == known.prod_id and spec.creation_time > known.creation_time:
            text = (
                f"variable {each.var_id}: {name(seen.sender)} passes on a creation ({spec_text(spec)}) that "
                f"{name(spec.prod_id)} never sent"
            )
            self.contradict(begin, original, each, text, (each.var_id, seen.sender))


class Recreation(Invariant):
    """Creations of one producer follow each other."""

    id = "CK_VD_CREATION"
    section = "dcp-vardis.md: RTDB-Create"
    purpose = "Whether a variable that is created again gets a later creationTime and starts with sequence number 0"
    requirements = ("VD-CRE-09", "VD-CRE-10")
    expect = "a later creationTime, unless its clock was set back; 0 as the first sequence number"
    enough = 2

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[int, Statement] = {}
        self._life: dict[int, int] = {}
        """The life of the producer in which it created the variable last."""

    def applies(self) -> str:
        """Since 2.0."""
        return "" if self.context.features.creation_time else "there is no creationTime before 2.0"

    def feed(self, seen: Seen) -> None:
        """Compare what producers themselves create."""
        for each in [said for said, _ in seen.news if said.kind is CREATE]:
            if each.record.spec.prod_id != seen.sender:
                continue
            self._judge(each, seen)
            if each.var_id in self._last or len(self._last) < MOST_VARIABLES:
                self._last[each.var_id] = each
                self._life[each.var_id] = self.context.senders.life(seen.sender)

    def _judge(self, each: Statement, seen: Seen) -> None:
        before = self._last.get(each.var_id)
        if before is None or before.record.spec.creation_time == each.record.spec.creation_time:
            return
        if before.record.spec.prod_id != each.record.spec.prod_id:
            self.note("another node takes a variable over (H4)", f"variable {each.var_id}", [before, each])
            return
        self.exercised()
        if each.record.spec.creation_time < before.record.spec.creation_time:
            # Its clock may have been set back: the current time is all that RTDB-Create asks for (X38).
            text = f"variable {each.var_id} is created again with an earlier creationTime"
            restarted = self.context.senders.life(seen.sender) != self._life.get(each.var_id)
            what = "the one before a restart" if restarted else "the one before it"
            self.note(f"a creation that is older than {what} (H5)", text, [before, each], "VD-CRE-09")
        if each.record.upd.seqno > 1:
            text = f"variable {each.var_id} starts again with sequence number {each.record.upd.seqno}"
            self.note("the first number of a creation that was heard", text, [each], "VD-CRE-10")


RULES: tuple[type[Invariant], ...] = (
    SequenceForwards,
    OneValue,
    OneSpec,
    Deleted,
    Recreation,
)
