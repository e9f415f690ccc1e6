"""dcp-vardis.md: records of one variable in successive payloads of a node, and at different nodes.

A contradiction is not reported at once. A later record may explain it (a create that did not fit into the earlier
payload), or a beacon that the recorder has missed, which only the next beacon shows.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import Any, NamedTuple

from dcp_codec.values import VarCreate, VarUpdate, own_values
from dcp_conformance.check.base import MOST_VARIABLES, Context, Invariant, Seen, name
from dcp_conformance.check.senders import GAP_SHOWS
from dcp_conformance.check.statements import CREATE, DELETE, SUMMARY, UPDATE, Statement, latest
from dcp_conformance.check.wording import differences, spec_text
from dcp_conformance.definitions.circular import Circle

#: Maximum number of values that are kept for each variable; less than its number of sequence numbers.
_VALUES = 64
#: Beacons to wait before a suspicion is reported: many creates may be waiting, and these are sent first.
_PATIENCE = 10
#: Maximum number of open suspicions.
_SUSPECTS = 4096
#: A time after the end of any recording, in ns since 1970.
_END = 1 << 63


class _Suspect(NamedTuple):
    """A contradiction within one node that a later record may explain."""

    before: Statement
    after: Statement
    beacons: int
    """Number of the node's beacons when ``after`` was heard."""
    text: str
    """Text of the finding."""


class _OfOneNode(Invariant):
    """Base of rules that compare records of one node; a later create or delete explains a contradiction."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._suspects: OrderedDict[tuple[bytes, int], _Suspect] = OrderedDict()

    def suspect(self, before: Statement, after: Statement, seen: Seen, text: str) -> None:
        """Add a suspicion, unless beacons of the node are missing between the two records."""
        sender = self.context.senders.get(seen.sender)
        if sender is None or sender.unbroken > before.time or len(self._suspects) >= _SUSPECTS:
            return
        self._suspects.setdefault((seen.sender, after.var_id), _Suspect(before, after, sender.beacons, text))

    def explain(self, node: bytes, var_id: int) -> None:
        """Drop a suspicion after a create or delete: the records belong to different lifetimes."""
        self._suspects.pop((node, var_id), None)

    def due(self, now: int) -> None:
        """Report the suspicions that were not explained in time, in order; ``now`` in ns since 1970."""
        while self._suspects:
            key, suspect = next(iter(self._suspects.items()))
            sender = self.context.senders.get(key[0])
            if sender is None or sender.unbroken > suspect.before.time:
                del self._suspects[key]
            elif sender.beacons >= suspect.beacons + _PATIENCE:
                del self._suspects[key]
                self.violated(suspect.text, [suspect.before, suspect.after], once=key)
            elif suspect.after.time + _PATIENCE * GAP_SHOWS < now:
                # The node has fallen silent and can no longer explain it.
                del self._suspects[key]
            else:
                break

    def finish(self) -> None:
        """Report or drop the open suspicions at the end of the recording."""
        self.due(_END)


class SequenceForwards(_OfOneNode):
    """Check that a node does not return to an older value."""

    id = "CK_VD_SEQNO"
    section = "dcp-vardis.md: Receive Path"
    purpose = "The sequence number of a variable at a node never decreases within one creation"
    requirements = ("VD-TYP-03", "VD-PU-06")
    expect = "sequence numbers that stay equal or increase (circularly)"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._creation: dict[tuple[bytes, int], tuple[Any, ...]] = {}
        """(node, variable) -> producer and creation time in the node's last create."""

    def feed(self, seen: Seen) -> None:
        """Compare with the previous number of the node."""
        if self._suspects:
            self.due(seen.time)
        self._of_all += seen.again
        for each, before, again in seen.news:
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
                self._of_all += 1
                if each.number != before.number and self._circle.older(each.number, before.number):
                    text = f"{name(seen.sender)}, variable {each.var_id}: {each.number} after {before.number}"
                    self.suspect(latest(before, again), each, seen, text)

    def _another(self, key: tuple[bytes, int], record: VarCreate) -> bool:
        """Whether a create is about another creation than the node's previous one; store it."""
        this = (record.spec.prod_id, record.spec.creation_time)
        before = self._creation.get(key)
        if before is not None or len(self._creation) < MOST_VARIABLES:
            self._creation[key] = this
        return before != this


class Deleted(_OfOneNode):
    """Check that a node sends no records of a variable after its delete."""

    id = "CK_VD_DELETED"
    section = "dcp-vardis.md: RTDB-Delete"
    purpose = "A node that has deleted a variable sends no updates or summaries of it until it is created again"
    requirements = ("VD-DEL-05", "VD-PD-04", "VD-CMP-05")
    expect = "no update or summary after a delete"
    enough = 3

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._deleted: dict[tuple[bytes, int], Statement] = {}

    def feed(self, seen: Seen) -> None:
        """Remember deletes until the node sends a create of the variable."""
        if self._suspects:
            self.due(seen.time)
        for each, _, _ in seen.news:
            if each.kind is not DELETE and not self._deleted and not self._suspects:
                continue
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
    """A contradiction between two nodes that missing beacons may explain."""

    begin: int
    """Time since which no beacon may be missing, ns since 1970."""
    before: Statement
    after: Statement
    text: str
    """Text of the finding."""
    key: object
    """Key of the finding (argument ``once`` of :meth:`Invariant.violated`)."""


class _OfAllNodes(Invariant):
    """Base of rules that compare nodes: contradictions about a variable with a single lifetime."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._open: deque[_Contradiction] = deque()

    def contradict(self, begin: int, before: Statement, after: Statement, text: str, key: object) -> None:
        """Add a contradiction; it is dropped if a beacon is missing since ``begin`` (ns since 1970)."""
        if len(self._open) < _SUSPECTS:
            self._open.append(_Contradiction(begin, before, after, text, key))

    def due(self, now: int) -> None:
        """Report the contradictions that are old enough to exclude a gap; ``now`` in ns since 1970."""
        while self._open and self._open[0].after.time + GAP_SHOWS < now:
            each = self._open.popleft()
            if self.context.senders.complete(each.begin, each.after.time):
                self.violated(each.text, [each.before, each.after], once=each.key)

    def finish(self) -> None:
        """Report the open contradictions at the end of the recording."""
        self.due(_END)


class OneValue(_OfAllNodes):
    """Check that a sequence number of a variable has the same value at all nodes."""

    id = "CK_VD_VALUE"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "A sequence number of a variable belongs to the same value at all nodes"
    requirements = ("VD-PU-05", "VD-PU-07")
    expect = "the same value wherever variable, creation and sequence number are the same"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._values: dict[int, OrderedDict[int, tuple[VarUpdate, Statement]]] = {}
        self._newest: dict[int, int] = {}

    def feed(self, seen: Seen) -> None:
        """Compare with the first value that was sent with the same number."""
        if self._open:
            self.due(seen.time)
        lives = self.context.lives
        for each, _, _ in seen.news:
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
        """Forget values more than a quarter of the number circle old: their numbers will be used again."""
        newest = self._newest.get(var_id)
        if newest is None or self._circle.newer(number, newest):
            if newest is None and len(self._newest) >= MOST_VARIABLES:
                return
            self._newest[var_id] = number
            known = self._values.setdefault(var_id, OrderedDict())
            for old in [each for each in known if self._far(each, number)]:
                del known[old]

    def _far(self, number: int, newest: int) -> bool:
        """Whether a number is at least a quarter of the circle older than the newest one."""
        return (newest - number) % self._circle.modulus >= self._circle.modulus // 4

    def _compare(self, each: Statement, born: int, seen: Seen) -> None:
        """Compare the value of a create or update with the known one of its number; ``born`` in ns since 1970.

        Fields that the profile adds to VarUpdate belong to the value.
        """
        record = each.record.upd if isinstance(each.record, VarCreate) else each.record
        newest = self._newest.get(each.var_id)
        if newest is None or self._far(record.seqno, newest):
            return
        known = self._values[each.var_id]
        before = known.get(record.seqno)
        if before is None:
            known[record.seqno] = (record, each)
            if len(known) > _VALUES:
                known.popitem(last=False)
            return
        self._of_all += 1
        first, statement = before
        about = f"variable {each.var_id}, seqno {record.seqno}"
        if first.value != record.value:
            text = (
                f"{about}: {first.value.hex()} from {name(statement.sender)}, "
                f"{record.value.hex()} from {name(seen.sender)}"
            )
        elif own_values(first) != own_values(record):
            text = f"{about}: {differences(first, record)} at {name(seen.sender)}, after {name(statement.sender)}"
        else:
            return
        self.contradict(born, statement, each, text, (each.var_id, record.seqno))


class OneSpec(_OfAllNodes):
    """Check that nodes forward the attributes of a variable unchanged."""

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
        """Whether old creations were dropped from ``_specs``."""
        self._producers: dict[tuple[int, int], Statement] = {}
        """(variable, creation time) -> the first create."""

    def feed(self, seen: Seen) -> None:
        """Compare with the first create of the same creation."""
        if self._open:
            self.due(seen.time)
        for each, _, _ in seen.news:
            if each.kind is not CREATE:
                continue
            spec = each.record.spec
            key = (each.var_id, spec.prod_id, spec.creation_time)
            before = self._specs.get(key)
            if before is None or (spec.creation_time is None and spec.prod_id == seen.sender):
                if before is None:
                    self._producer(each)
                    if spec.prod_id != seen.sender and not self._forgotten:
                        self._without_sigint(each, seen)
                self._specs[key] = each
                if len(self._specs) > MOST_VARIABLES:
                    self._specs.popitem(last=False)
                    self._forgotten = True
                continue
            if before.sender != seen.sender:
                self._of_all += 1
            if before.record.spec == spec:
                continue
            changed = differences(before.record.spec, spec)
            text = f"variable {each.var_id}: {changed} at {name(seen.sender)}, after {name(before.sender)}"
            if spec.creation_time is not None:
                self.violated(text, [before, each], once=key)
            else:
                # Before 2.0, creations cannot be distinguished: a single lifetime is required.
                born = self.context.lives.born(each.var_id)
                if born is not None:
                    self.contradict(born, before, each, text, key)

    def _producer(self, each: Statement) -> None:
        """Report a create that differs from an earlier one only in the producer."""
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
        # Before 2.0: only if number and value are equal, too, and the named producer was never heard.
        alike = before.record.upd == each.record.upd and self.context.senders.get(spec.prod_id) is None
        if spec.creation_time is None and not alike:
            return
        later_is_wrong = before.sender == first.prod_id or each.sender != spec.prod_id
        wrong, right = (each, before) if later_is_wrong else (before, each)
        text = (
            f"variable {each.var_id}: {name(wrong.sender)} forwards the creation of {name(right.record.spec.prod_id)} "
            f"with prodId {name(wrong.record.spec.prod_id)}"
        )
        self.contradict(before.time, before, each, text, ("prodId", *key))

    def _without_sigint(self, each: Statement, seen: Seen) -> None:
        """Report a forwarded creation that its producer never sent, if it is later than one in the recording.

        An earlier creation may be older than the recording, and arrive with a node that was out of range.
        """
        spec, first = each.record.spec, self.context.lives.first(each.var_id)
        if first is None or spec.creation_time is None:
            return
        begin, original = first
        known = original.record.spec
        if spec.prod_id == known.prod_id and spec.creation_time > known.creation_time:
            text = (
                f"variable {each.var_id}: {name(seen.sender)} forwards a creation ({spec_text(spec)}) that "
                f"{name(spec.prod_id)} never sent"
            )
            self.contradict(begin, original, each, text, (each.var_id, seen.sender))


class Recreation(Invariant):
    """Compare successive creations of a variable by one producer."""

    id = "CK_VD_CREATION"
    section = "dcp-vardis.md: RTDB-Create"
    purpose = "A variable that is created again gets a later creationTime and starts with sequence number 0"
    requirements = ("VD-CRE-09", "VD-CRE-10")
    expect = "a later creationTime, unless the node's clock was set back; 0 as the first sequence number"
    enough = 2

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._last: dict[int, Statement] = {}
        self._life: dict[int, int] = {}
        """Variable -> number of the producer's restarts at its last create."""

    def applies(self) -> str:
        """Exclude versions before 2.0, which have no creationTime."""
        return "" if self.context.features.creation_time else "there is no creationTime before 2.0"

    def feed(self, seen: Seen) -> None:
        """Compare the creates that producers send themselves."""
        for each, _, _ in seen.news:
            if each.kind is not CREATE or each.record.spec.prod_id != seen.sender:
                continue
            self._judge(each, seen)
            if each.var_id in self._last or len(self._last) < MOST_VARIABLES:
                self._last[each.var_id] = each
                self._life[each.var_id] = self.context.senders.life(seen.sender)

    def _judge(self, each: Statement, seen: Seen) -> None:
        """Compare a create with the previous one of the same variable."""
        before = self._last.get(each.var_id)
        if before is None or before.record.spec.creation_time == each.record.spec.creation_time:
            return
        if before.record.spec.prod_id != each.record.spec.prod_id:
            self.note("a variable identifier used by another producer (H4)", f"variable {each.var_id}", [before, each])
            return
        self.exercised()
        if each.record.spec.creation_time < before.record.spec.creation_time:
            # The clock may have been set back: RTDB-Create only demands the current time (X38).
            text = f"variable {each.var_id} is created again with an earlier creationTime"
            restarted = self.context.senders.life(seen.sender) != self._life.get(each.var_id)
            what = "the one before a restart" if restarted else "the previous one"
            self.note(f"a creation that is older than {what} (H5)", text, [before, each], "VD-CRE-09")
        if each.record.upd.seqno > 1:
            text = f"variable {each.var_id} starts again with sequence number {each.record.upd.seqno}"
            self.note("the first number heard of a creation", text, [each], "VD-CRE-10")


RULES: tuple[type[Invariant], ...] = (
    SequenceForwards,
    OneValue,
    OneSpec,
    Deleted,
    Recreation,
)
