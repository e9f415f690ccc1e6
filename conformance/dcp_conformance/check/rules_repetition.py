"""dcp-vardis.md: how often instructions are sent, and requests that nobody needs to make."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from dcp_spec.constants import ICType

from dcp_conformance.circular import Circle
from dcp_conformance.results import Mark

from .base import MOST_VARIABLES, Context, Invariant, Seen, name
from .rules_dialogue import Counter
from .rules_vardis import SENT, seqno_of
from .said import Said

MS = 1_000_000
#: For how many beacon periods before it is seen on the air a payload may have been composed.
_COMPOSED = 1.6
#: A gap in the recording shows within so many ns, or never.
_GAP_SHOWS = 2_000 * MS
_PENDING = 10_000
_Key = tuple[bytes, int, ICType]


@dataclass(slots=True)
class _Run:
    """The beacons of a node that carry one instruction."""

    what: tuple[Any, ...]
    """Life of the node, creation, number."""
    rep_cnt: int
    begin: int
    last: Said
    beacons: int = 1
    allowed: int = 0
    told: int = 0
    """Requests that told the same number."""


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
        self._senders: dict[tuple[int, ICType], set[bytes]] = {}
        """Who has a run of that kind, by variable."""
        self._reasons: deque[tuple[int, bytes, Said]] = deque()
        """What was said lately that can be a reason for others, when, and by whom."""
        self._closed: deque[tuple[int, _Key, _Run]] = deque()
        self._counters: dict[tuple[bytes, ICType, bool], Counter] = {}
        self._examples: dict[tuple[bytes, ICType, bool], str] = {}
        self._composed = round(_COMPOSED * context.pics.pixit.beacon_period_ms * MS)

    def feed(self, seen: Seen) -> None:
        """Count beacons; requests and older numbers of others allow more."""
        while self._reasons and self._reasons[0][0] < seen.time - self._composed:
            self._reasons.popleft()
        self._count(seen.time)
        for each in seen.said:
            node, var_id = seen.sender, each.var_id
            if each.kind is ICType.CREATE_VARIABLES and (
                (node, var_id) in self._creation or len(self._creation) < MOST_VARIABLES
            ):
                spec = each.record.spec
                self._creation[node, var_id] = (spec.prod_id, spec.creation_time, spec.rep_cnt)
            if each.kind is ICType.DELETE_VARIABLES:
                self._close(seen.time, (node, var_id, ICType.CREATE_VARIABLES), (node, var_id, ICType.UPDATES))
            elif each.kind in SENT:
                # Whoever says anything else of a variable has it: it may be deleted another time.
                self._close(seen.time, (node, var_id, ICType.DELETE_VARIABLES))
            if each.kind in (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES):
                self._sent(each, seen)
            if each.kind is not ICType.DELETE_VARIABLES:
                self._reason(each, seen)

    def _rep_cnt(self, node: bytes, var_id: int) -> int | None:
        """As the node said itself, or as it was said of the only life of the variable; else nobody knows."""
        own = self._creation.get((node, var_id))
        if own is not None:
            return int(own[2])
        first = self.context.lives.first(var_id)
        if first is None or self.context.lives.born(var_id) is None:
            return None
        return int(first[1].record.spec.rep_cnt)

    def _sent(self, each: Said, seen: Seen) -> None:
        key = (seen.sender, each.var_id, each.kind)
        number = seqno_of(each) if each.kind is ICType.UPDATES else 0
        what = (self.context.senders.life(seen.sender), *self._creation.get(key[:2], ())[:2], number)
        run = self._runs.get(key)
        if run is not None and run.what == what:
            run.beacons += 1
            run.last = each
            return
        self._close(seen.time, key)
        allowed = self._rep_cnt(seen.sender, each.var_id)
        if allowed is None or len(self._runs) >= MOST_VARIABLES:
            return
        run = self._runs[key] = _Run(what, allowed, seen.time, each, allowed=allowed)
        self._senders.setdefault((each.var_id, each.kind), set()).add(seen.sender)
        # A payload may have been composed a while before: what was said meanwhile counts for the next one.
        for _, node, reason in self._reasons:
            if node != seen.sender and reason.var_id == each.var_id:
                self._weigh(run, each.kind, number, reason)

    def _reason(self, each: Said, seen: Seen) -> None:
        """What somebody says may be a reason for others to send again."""
        if len(self._reasons) < _PENDING:
            self._reasons.append((seen.time, seen.sender, each))
        for kind in (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES):
            for node in self._senders.get((each.var_id, kind), ()):
                run = self._runs.get((node, each.var_id, kind))
                if run is not None and node != seen.sender:
                    self._weigh(run, kind, seqno_of(run.last) if kind is ICType.UPDATES else 0, each)

    def _weigh(self, run: _Run, kind: ICType, number: int, reason: Said) -> None:
        """Allow more, if this is a reason for that kind of instruction."""
        if kind is ICType.CREATE_VARIABLES:
            run.allowed += run.rep_cnt if reason.kind is ICType.REQUEST_VARCREATES else 0
        elif kind is ICType.DELETE_VARIABLES:
            # Created again, and deleted again before that was passed on.
            run.allowed += run.rep_cnt if reason.kind is ICType.CREATE_VARIABLES else 0
        elif kind is ICType.UPDATES and reason.kind in (ICType.REQUEST_VARUPDATES, ICType.SUMMARIES, ICType.UPDATES):
            told = seqno_of(reason)
            if told == number:
                run.told += reason.kind is ICType.REQUEST_VARUPDATES
            elif not self._circle.newer(told, number):
                # Older, or half the circle away, which can be taken either way (X28).
                run.allowed += run.rep_cnt

    def _close(self, time: int, *keys: _Key) -> None:
        """A run has ended; it is counted when it is certain that no beacon was missed."""
        for key in keys:
            run = self._runs.pop(key, None)
            if run is not None:
                self._senders[key[1:]].discard(key[0])
                self._closed.append((time, key, run))

    def _count(self, now: int) -> None:
        while self._closed and self._closed[0][0] + _GAP_SHOWS < now:
            _, (node, var_id, kind), run = self._closed.popleft()
            if not self.context.senders.complete(run.begin - self._composed, run.last.time):
                continue
            missed, told = run.beacons > run.allowed, bool(run.told) and kind is ICType.UPDATES
            self.exercised(*(("VD-RU-03",) if told else ("VD-SCP-02", "VD-SCP-03")))
            key = (node, kind, told)
            if key not in self._counters and len(self._counters) >= MOST_VARIABLES:
                continue
            self._counters.setdefault(key, Counter()).note(run.last, missed=missed)
            if missed and key not in self._examples:
                what = f"{kind.label} of variable {var_id}" + (f", {run.what[-1]}," if kind is ICType.UPDATES else "")
                self._examples[key] = f"{what} in {run.beacons} beacons, {run.allowed} allowed"

    def finish(self) -> None:
        """Judge the counts."""
        self._close(0, *self._runs)
        self._count(1 << 63)
        for key, counter in self._counters.items():
            if not counter.convincing:
                continue
            node, _, told = key
            text = f"{name(node)}: {counter.missed} of {counter.occasions} times too often, first {self._examples[key]}"
            if told:
                text += "; requests had told the same number, which must not be answered"
            self.violated(text, counter.examples, *(("VD-RU-03",) if told else ("VD-SCP-02", "VD-SCP-03")))


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
        self._has: dict[tuple[bytes, int], Said] = {}
        self._asked: dict[tuple[bytes, int], list[int]] = {}
        self._producers: dict[int, bytes] = {}

    def feed(self, seen: Seen) -> None:
        """Compare requests with what the node last said."""
        for each in seen.said:
            key = (seen.sender, each.var_id)
            if each.kind is ICType.REQUEST_VARCREATES:
                self.exercised()
                self._count(each, seen)
                has = self._has.get(key)
                if has is not None and self.context.senders.unbroken(seen.sender, has.time):
                    text = f"{name(seen.sender)} asks for variable {each.var_id}, which it has"
                    self.violated(text, [has, each], once=key)
            elif each.kind is ICType.DELETE_VARIABLES:
                self._has.pop(key, None)
            elif each.kind is not ICType.REQUEST_VARUPDATES and (key in self._has or len(self._has) < MOST_VARIABLES):
                self._has[key] = each
            if each.kind is ICType.CREATE_VARIABLES:
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
