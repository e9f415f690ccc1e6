"""dcp-vardis.md: how often instructions are sent, and requests that nobody needs to make."""

from __future__ import annotations

from collections import Counter as Counts
from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple

from dcp_spec.constants import ICType

from dcp_conformance.circular import Circle
from dcp_conformance.results import Mark

from .base import MOST_VARIABLES, Context, Invariant, Seen, name
from .rules_dialogue import Counter
from .said import ASK_CREATE, ASK_UPDATE, CREATE, DELETE, SUMMARY, UPDATE, Said

MS = 1_000_000
#: For how many beacon periods before it is seen on the air a payload may have been composed.
_COMPOSED = 1.6
#: A gap in the recording shows within so many ns, or never.
_GAP_SHOWS = 2_000 * MS
#: Reasons of a variable that are kept until they are weighed: so many, and in dense networks up to so many.
_LEAST, _MOST = 64, 1024
_TOLD, _UNTOLD = ("VD-RU-03",), ("VD-SCP-02", "VD-SCP-03")
_Key = tuple[bytes, int, ICType]


class _Reason(NamedTuple):
    """Something that may make others send again."""

    time: int
    node: bytes
    kind: ICType
    number: int


@dataclass(slots=True)
class _Run:
    """The beacons of a node that carry one instruction."""

    what: tuple[Any, ...]
    """Life of the node, creation, number."""
    number: int
    """The sequence number of updates, else 0."""
    rep_cnt: int
    begin: int
    last: Said
    weighed: int
    """How many reasons of the variable had been there, in all, when they were last weighed."""
    asked: int
    """Requests for updates that had told the number before, by whomever."""
    beacons: int = 1
    allowed: int = 0
    told: int = 0
    """Requests that told the same number."""


class _Reasons:
    """What was said of a variable that may be a reason to send something of it again.

    Reasons are only kept here, and weighed when a run is longer than it may be without any: nearly none is. What is
    thrown away is weighed before.
    """

    __slots__ = ("asked", "dropped", "kept", "room")

    def __init__(self) -> None:
        self.asked: dict[int, int] = {}
        """How many requests for updates told a number, in all."""
        self.dropped = 0
        self.kept: list[_Reason] = []
        self.room = _LEAST

    @property
    def count(self) -> int:
        """All that there were so far."""
        return self.dropped + len(self.kept)

    def since(self, time: int) -> int:
        """How many came before ``time``."""
        place = len(self.kept)
        while place and self.kept[place - 1].time >= time:
            place -= 1
        return self.dropped + place


class Repetitions(Invariant):
    """Saids are repeated as often as the VarSpec says.

    Somebody whom the recorder does not hear may have given a reason to send again. So a node is judged by most of what
    it repeats, and by nothing during which a beacon was missed.
    """

    id = "CK_VD_REPEAT"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "A node sends an instruction in at most repCnt beacons, unless somebody gives it a reason to begin again"
    requirements = ("VD-SCP-02", "VD-SCP-03", "VD-RU-03")
    expect = "at most repCnt beacons with the same instruction for each reason to send it"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._creation: dict[tuple[bytes, int], tuple[Any, ...]] = {}
        """(node, variable) -> the creation that it spoke of last, and its repCnt."""
        self._runs: dict[_Key, _Run] = {}
        self._of_variable: dict[int, dict[_Key, _Run]] = {}
        """The runs about a variable."""
        self._reasons: dict[int, _Reasons] = {}
        self._deleting = 0
        """Runs of deletes."""
        self._closed: deque[tuple[int, _Key, _Run]] = deque()
        self._counters: dict[tuple[bytes, ICType, bool], Counter] = {}
        self._examples: dict[tuple[bytes, ICType, bool], str] = {}
        self._composed = round(_COMPOSED * context.pics.pixit.beacon_period_ms * MS)

    def feed(self, seen: Seen) -> None:
        """Count beacons; requests and older numbers of others allow more."""
        node, now = seen.sender, seen.time
        if self._closed:
            self._count(now)
        for each in seen.again:
            self._reason(_Reason(now, node, SUMMARY, each.number), each.var_id)
        for each, _ in seen.news:
            kind, var_id = each.kind, each.var_id
            if kind is CREATE and ((node, var_id) in self._creation or len(self._creation) < MOST_VARIABLES):
                spec = each.record.spec
                self._creation[node, var_id] = (spec.prod_id, spec.creation_time, spec.rep_cnt)
            if kind is DELETE:
                self._close(now, (node, var_id, CREATE), (node, var_id, UPDATE))
            elif self._deleting and (kind is CREATE or kind is UPDATE or kind is SUMMARY):
                # A node that says anything else of a variable has it: it may be deleted another time.
                self._close(now, (node, var_id, DELETE))
            if kind is CREATE or kind is UPDATE or kind is DELETE:
                self._sent(each, now)
            if kind is not DELETE:
                self._reason(_Reason(now, node, kind, each.number), var_id)

    def _rep_cnt(self, node: bytes, var_id: int) -> int | None:
        """As the node said itself, or as it was said of the only life of the variable; else nobody knows."""
        own = self._creation.get((node, var_id))
        if own is not None:
            return int(own[2])
        first = self.context.lives.first(var_id)
        if first is None or self.context.lives.born(var_id) is None:
            return None
        return int(first[1].record.spec.rep_cnt)

    def _sent(self, each: Said, now: int) -> None:
        key = (each.sender, each.var_id, each.kind)
        number = each.number if each.kind is UPDATE else 0
        what = (self.context.senders.life(each.sender), *self._creation.get(key[:2], ())[:2], number)
        run = self._runs.get(key)
        if run is not None and run.what == what:
            run.beacons += 1
            run.last = each
            return
        self._close(now, key)
        allowed = self._rep_cnt(each.sender, each.var_id)
        if allowed is None or len(self._runs) >= MOST_VARIABLES:
            return
        # A payload may have been composed a while before: what was said meanwhile counts for the next one.
        reasons = self._reasons.get(each.var_id)
        weighed = 0 if reasons is None else reasons.since(now - self._composed)
        asked = 0 if reasons is None else reasons.asked.get(number, 0)
        run = self._runs[key] = _Run(what, number, allowed, now, each, weighed, asked, allowed=allowed)
        self._of_variable.setdefault(each.var_id, {})[key] = run
        self._deleting += each.kind is DELETE

    def _reason(self, reason: _Reason, var_id: int) -> None:
        """What a node says may be a reason for others to send again."""
        reasons = self._reasons.get(var_id)
        if reasons is None:
            if len(self._reasons) >= MOST_VARIABLES:
                return
            reasons = self._reasons[var_id] = _Reasons()
        kept = reasons.kept
        kept.append(reason)
        if reason.kind is ASK_UPDATE:
            reasons.asked[reason.number] = reasons.asked.get(reason.number, 0) + 1
        if len(kept) >= reasons.room:
            self._forget(reasons, var_id, reason.time)

    def _forget(self, reasons: _Reasons, var_id: int, now: int) -> None:
        """Weigh the older reasons of a variable for all its runs, and drop them."""
        # Those of the last moment may still count for a run that begins now.
        many = reasons.since(now - self._composed) - reasons.dropped
        if reasons.room >= _MOST and not many:
            many = len(reasons.kept) // 2
        if many:
            until, dropped = reasons.dropped + many, reasons.kept[:many]
            totals = Counts((each.kind, each.number) for each in dropped)
            own = Counts((each.node, each.kind, each.number) for each in dropped)
            for key, run in self._of_variable.get(var_id, {}).items():
                if run.weighed > reasons.dropped:
                    self._weigh(key, run, reasons, until)
                    continue
                run.weighed = until
                for (kind, number), count in totals.items():
                    self._allow(key, run, kind, number, count - own[key[0], kind, number])
            del reasons.kept[:many]
            reasons.dropped = until
        reasons.room = min(max(_LEAST, 3 * len(reasons.kept)), _MOST)

    def _weigh(self, key: _Key, run: _Run, reasons: _Reasons, until: int) -> None:
        """Allow more for each reason up to one of that number."""
        begin = max(run.weighed, reasons.dropped)
        run.weighed = max(run.weighed, until)
        if begin >= until:
            return
        others = reasons.kept[begin - reasons.dropped : until - reasons.dropped]
        counts = Counts((each.kind, each.number) for each in others if each.node != key[0])
        for (kind, number), count in counts.items():
            self._allow(key, run, kind, number, count)

    def _allow(self, key: _Key, run: _Run, kind: ICType, told: int, count: int) -> None:
        """Allow more for so many records of others that tell a number."""
        if key[2] is CREATE:
            run.allowed += count * run.rep_cnt if kind is ASK_CREATE else 0
        elif key[2] is DELETE:
            # Created again, and deleted again before that was passed on.
            run.allowed += count * run.rep_cnt if kind is CREATE else 0
        elif kind is ASK_UPDATE or kind is SUMMARY or kind is UPDATE:
            if told == run.number:
                run.told += count if kind is ASK_UPDATE else 0
            elif not self._circle.newer(told, run.number):
                # Older, or half the circle away, which can be taken either way (X28).
                run.allowed += count * run.rep_cnt

    def _close(self, time: int, *keys: _Key) -> None:
        """A run has ended; it is counted when it is certain that no beacon was missed."""
        for key in keys:
            run = self._runs.pop(key, None)
            if run is not None:
                self._deleting -= key[2] is DELETE
                self._of_variable[key[1]].pop(key)
                reasons = self._reasons.get(key[1])
                if reasons is not None and (run.beacons > run.allowed or run.asked != reasons.asked.get(run.number, 0)):
                    self._weigh(key, run, reasons, reasons.count)
                self._closed.append((time, key, run))

    def _count(self, now: int) -> None:
        while self._closed and self._closed[0][0] + _GAP_SHOWS < now:
            _, (node, var_id, kind), run = self._closed.popleft()
            if not self.context.senders.complete(run.begin - self._composed, run.last.time):
                continue
            missed, told = run.beacons > run.allowed, bool(run.told) and kind is UPDATE
            self.exercised(*(_TOLD if told else _UNTOLD))
            key = (node, kind, told)
            if key not in self._counters and len(self._counters) >= MOST_VARIABLES:
                continue
            self._counters.setdefault(key, Counter()).note(run.last, missed=missed)
            if missed and key not in self._examples:
                what = f"{kind.label} of variable {var_id}" + (f", {run.what[-1]}," if kind is UPDATE else "")
                self._examples[key] = f"{what} in {run.beacons} beacons, {run.allowed} allowed"

    def finish(self) -> None:
        """Judge the counts."""
        self._close(0, *list(self._runs))
        self._count(1 << 63)
        for key, counter in self._counters.items():
            if not counter.convincing:
                continue
            node, _, told = key
            text = f"{name(node)}: {counter.missed} of {counter.occasions} times too often, first {self._examples[key]}"
            if told:
                text += "; requests had told the same number, which must not be answered"
            self.violated(text, counter.examples, *(_TOLD if told else _UNTOLD))


class Requests(Invariant):
    """Nobody asks for what it has."""

    id = "CK_VD_REQUEST"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = (
        "A node asks for the creation of variables that it does not have, and does not pass on the requests of others"
    )
    requirements = ("VD-SCP-01",)
    expect = "no request for a variable that the node has in the same payload, or has summarised right before"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._asked: dict[tuple[bytes, int], list[int]] = {}
        self._producers: dict[int, bytes] = {}

    def feed(self, seen: Seen) -> None:
        """Compare requests with what the node last said."""
        for each, before in seen.news:
            if each.kind is ASK_CREATE:
                self.exercised()
                self._count(each, seen)
                if before is not None:
                    text = f"{name(seen.sender)} asks for variable {each.var_id}, which it has"
                    self.violated(text, [before, each], once=(seen.sender, each.var_id))
            elif each.kind is CREATE:
                self._producers[each.var_id] = each.record.spec.prod_id

    def _count(self, each: Said, seen: Seen) -> None:
        key = (seen.sender, each.var_id)
        if key in self._asked or len(self._asked) < MOST_VARIABLES:
            self._asked.setdefault(key, [0, each.frame])[0] += 1

    def finish(self) -> None:
        """Hazards of the design: requests that never end, and producers that ask for their own variables."""
        by_variable: dict[int, list[tuple[bytes, int, int]]] = {}
        for (node, var_id), (count, first) in self._asked.items():
            by_variable.setdefault(var_id, []).append((node, count, first))
            if self._producers.get(var_id) == node:
                text = f"{name(node)} asks {count} times for variable {var_id}, whose producer it is"
                self.note("a producer that has forgotten its own variable (H2)", text, [Mark(first)])
        for var_id, askers in by_variable.items():
            often = [each for each in askers if each[1] >= 10]
            if len(often) >= 2:
                who = ", ".join(f"{name(node)} {count} times" for node, count, _ in often)
                marks = [Mark(first) for _, _, first in often]
                self.note("nodes that ask each other for what neither has (H1)", f"variable {var_id}: {who}", marks)


RULES: tuple[type[Invariant], ...] = (Repetitions, Requests)
