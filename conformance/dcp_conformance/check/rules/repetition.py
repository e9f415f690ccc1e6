"""dcp-vardis.md: the number of repetitions of instructions, and unneeded requests."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import islice

from dcp_spec.constants import ICType

from dcp_codec.analysis.entry import Creation
from dcp_conformance.check.base import MOST_VARIABLES, Context, Invariant, Seen, Trace, name
from dcp_conformance.check.senders import GAP_SHOWS
from dcp_conformance.check.statements import (
    ASK_CREATE,
    ASK_UPDATE,
    CREATE,
    DELETE,
    SUMMARY,
    UPDATE,
    Statement,
    latest,
    statements_in,
)
from dcp_conformance.definitions.circular import Circle
from dcp_conformance.definitions.results import Mark
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.frames.received import ReceivedBeacon

from .counters import MS
from .dialogue import Counter

#: Maximum time from the composition of a payload to its beacon, in beacon periods.
_COMPOSED = 1.6
#: Number of beacons that are kept as possible reasons for repetitions: about ten seconds of thirty nodes.
_FRAMES = 4_000
#: Requirements of updates after requests with the same number, and of all other repetitions.
_TOLD, _UNTOLD = ("VD-RU-03",), ("VD-SCP-02", "VD-SCP-03")
_Key = tuple[bytes, int, ICType]
"""Node, variable, and kind of record."""


@dataclass(slots=True)
class _Run:
    """The beacons of a node that repeat one instruction."""

    life: int
    """The node's number of restarts."""
    creation: Creation | None
    """The creation in the node's last create; None if it has sent none."""
    number: int
    """The sequence number of updates; 0 for other records."""
    rep_cnt: int
    """repCnt of the variable."""
    begin: int
    """Time of the first beacon, ns since 1970."""
    last: Statement
    """The record in the last beacon."""
    weighed: int
    """Number of frames (since the start of the recording) that were checked for reasons; at first, up to the one that
    began the run."""
    asked: int
    """Number of requests for updates with this sequence number, by any node, before the run."""
    beacons: int = 1
    """Number of beacons with the instruction."""
    allowed: int = 0
    """Number of beacons that repCnt and the known reasons allow."""
    told: int = 0
    """Number of requests with the same sequence number."""
    fresh: bool = True
    """Whether no frame has been checked for reasons."""


class Repetitions(Invariant):
    """Check that a node repeats an instruction at most as often as repCnt allows.

    A node that the recorder does not hear may have given a reason to send an instruction again. Therefore a single
    excess is not a failure (see :class:`~dcp_conformance.check.rules.dialogue.Counter`), and runs with missing beacons
    do not count. If creates name a producer without any recorded beacon, there is such a node, and the rule is
    inconclusive.
    """

    id = "CK_VD_REPEAT"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "A node sends an instruction in at most repCnt beacons for each reason to send it"
    requirements = ("VD-SCP-02", "VD-SCP-03", "VD-RU-03")
    expect = "at most repCnt beacons with the same instruction for each reason to send it"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._circle = Circle(context.profile.types.var_seqno.width)
        self._creation: dict[tuple[bytes, int], tuple[Creation, int]] = {}
        """(node, variable) -> producer and creation time, and repCnt, in the node's last create."""
        self._producers: set[bytes] = set()
        """Producers that creates name."""
        self._runs: dict[_Key, _Run] = {}
        self._frames: deque[tuple[bytes, Trace]] = deque()
        """Recent beacons, with their nodes: their records may be a reason to send an instruction again. They are
        decoded again only for the few runs that exceed repCnt."""
        self._records: dict[int, dict[int, list[Statement]]] = {}
        """Number of a decoded frame -> its records by variable."""
        self._dropped = 0
        """Number of frames that were removed from the start of ``_frames``."""
        self._asked: dict[tuple[int, int], int] = {}
        """(variable, number) -> number of requests for updates with this number."""
        self._deleting = 0
        """Number of open runs of deletes."""
        self._closed: deque[tuple[int, _Key, _Run]] = deque()
        """Ended runs, with the time of their end in ns since 1970, until a gap in the recording is excluded."""
        self._counters: dict[tuple[bytes, ICType, bool], Counter] = {}
        """(node, kind, whether requests had the same number) -> numbers of runs and of excessive ones."""
        self._examples: dict[tuple[bytes, ICType, bool], str] = {}
        """The same key -> text about the first excessive run."""
        self._ended = [0, 0]
        """Number of runs that were counted, without and with requests that had the same number."""
        self._composed = round(_COMPOSED * context.pics.pixit.beacon_period_ms * MS)

    def feed(self, seen: Seen) -> None:
        """Count the beacons with each instruction; requests and older numbers from other nodes allow more of them."""
        node, now = seen.sender, seen.time
        if self._closed and self._closed[0][0] + GAP_SHOWS < now:
            self._count(now)
        if not seen.parts:
            return
        self._frames.append((node, seen.trace))
        if len(self._frames) > _FRAMES:
            # A reason has an effect soon, or not at all.
            _, gone = self._frames.popleft()
            self._records.pop(gone.number, None)
            self._dropped += 1
        life = self.context.senders.life(node)
        for each, _, _ in seen.news:
            kind, var_id = each.kind, each.var_id
            if kind is CREATE and ((node, var_id) in self._creation or len(self._creation) < MOST_VARIABLES):
                spec = each.record.spec
                self._creation[node, var_id] = ((spec.prod_id, spec.creation_time), spec.rep_cnt)
                self._producers.add(spec.prod_id)
            if kind is DELETE:
                self._close(now, (node, var_id, CREATE), (node, var_id, UPDATE))
            elif self._deleting and (kind is CREATE or kind is UPDATE or kind is SUMMARY):
                # A node that sends another record of the variable holds it, and may delete it again.
                self._close(now, (node, var_id, DELETE))
            if kind is CREATE or kind is UPDATE or kind is DELETE:
                self._sent(each, now, life)
            elif kind is ASK_UPDATE and ((var_id, each.number) in self._asked or len(self._asked) < MOST_VARIABLES):
                self._asked[var_id, each.number] = self._asked.get((var_id, each.number), 0) + 1

    def _rep_cnt(self, var_id: int) -> int | None:
        """Return repCnt in the first create of a variable with a single lifetime; None if unknown."""
        first = self.context.lives.first(var_id)
        if first is None or self.context.lives.born(var_id) is None:
            return None
        return int(first[1].record.spec.rep_cnt)

    def _sent(self, each: Statement, now: int, life: int) -> None:
        """Add a create, update or delete to its run, or start a new run.

        ``now``: ns since 1970. ``life``: number of restarts of the node.
        """
        node, var_id, kind = each.sender, each.var_id, each.kind
        key = (node, var_id, kind)
        number = each.number if kind is UPDATE else 0
        known = self._creation.get((node, var_id))
        creation = None if known is None else known[0]
        run = self._runs.get(key)
        if run is not None and run.number == number and run.life == life and run.creation == creation:
            run.beacons += 1
            run.last = each
            if run.beacons > run.allowed:
                self._weigh(key, run)
            return
        if run is not None:
            self._close(now, key)
        allowed = self._rep_cnt(var_id) if known is None else known[1]
        if allowed is None or len(self._runs) >= MOST_VARIABLES:
            return
        asked = self._asked.get((var_id, number), 0) if kind is UPDATE else 0
        place = self._dropped + len(self._frames)
        self._runs[key] = _Run(life, creation, number, allowed, now, each, place, asked, allowed=allowed)
        self._deleting += kind is DELETE

    def _weigh(self, key: _Key, run: _Run, *, complete: bool = False) -> None:
        """Allow more beacons for each reason in frames not checked yet, until the run is allowed.

        ``complete``: check all frames.
        """
        begin = max(run.weighed - self._dropped, 0)
        if run.fresh:
            # The first payload may have been composed earlier: records heard since then are reasons for the next one.
            run.fresh = False
            while begin and self._frames[begin - 1][1].time >= run.begin - self._composed:
                begin -= 1
        for node, frame in islice(self._frames, begin, None):
            begin += 1
            if node != key[0]:
                for each in self._of(frame, node).get(key[1], ()):
                    self._allow(key, run, each.kind, each.number)
                if run.allowed >= run.beacons and not complete:
                    break
        run.weighed = self._dropped + begin

    def _of(self, frame: Trace, node: bytes) -> dict[int, list[Statement]]:
        """Return the records of a recent beacon of ``node`` by variable."""
        found = self._records.get(frame.number)
        if found is None:
            found = self._records[frame.number] = {}
            heard = ReceivedBeacon(self.context.codec, frame.number, frame.time, frame.time, frame.octets, node)
            for each in statements_in(heard, node):
                found.setdefault(each.var_id, []).append(each)
        return found

    def _allow(self, key: _Key, run: _Run, kind: ICType, told: int) -> None:
        """Allow more beacons if this record of another node is a reason; ``told`` is its sequence number."""
        if key[2] is CREATE:
            run.allowed += run.rep_cnt if kind is ASK_CREATE else 0
        elif key[2] is DELETE:
            # The variable was created again, and deleted again before the node forwarded the create.
            run.allowed += run.rep_cnt if kind is CREATE else 0
        elif kind is ASK_UPDATE or kind is SUMMARY or kind is UPDATE:
            if told == run.number:
                run.told += kind is ASK_UPDATE
            elif not self._circle.newer(told, run.number):
                # Older, or half the circle away, which may count as older or newer (X28).
                run.allowed += run.rep_cnt

    def _close(self, time: int, *keys: _Key) -> None:
        """End runs; :meth:`_count` evaluates them when missing beacons are excluded. ``time`` in ns since 1970."""
        for key in keys:
            run = self._runs.pop(key, None)
            if run is not None:
                self._deleting -= key[2] is DELETE
                told = key[2] is UPDATE and self._asked.get((key[1], run.number), 0) != run.asked
                if told or run.beacons > run.allowed:
                    self._weigh(key, run, complete=told)
                self._closed.append((time, key, run))

    def _count(self, now: int) -> None:
        """Count the ended runs that are old enough to exclude missing beacons; ``now`` in ns since 1970."""
        while self._closed and self._closed[0][0] + GAP_SHOWS < now:
            _, (node, var_id, kind), run = self._closed.popleft()
            if not self.context.senders.complete(run.begin - self._composed, run.last.time):
                continue
            missed, told = run.beacons > run.allowed, bool(run.told) and kind is UPDATE
            self._ended[told] += 1
            key = (node, kind, told)
            counter = self._counters.get(key)
            if counter is None:
                if len(self._counters) >= MOST_VARIABLES:
                    continue
                counter = self._counters[key] = Counter()
            counter.note(run.last, missed=missed)
            if missed and key not in self._examples:
                what = f"{kind.label} of variable {var_id}" + (f", {run.number}," if kind is UPDATE else "")
                self._examples[key] = f"{what} in {run.beacons} beacons, {run.allowed} allowed"

    def finish(self) -> None:
        """End the open runs, and report nodes that mostly exceed the number of repetitions."""
        self._close(0, *list(self._runs))
        self._count(1 << 63)
        for rules, count in zip((_UNTOLD, _TOLD), self._ended, strict=True):
            self.exercised(*rules, times=count)
        silent = sorted(each for each in self._producers if self.context.senders.get(each) is None)
        verdict = Verdict.INCONCLUSIVE if silent else Verdict.FAIL
        for key, counter in self._counters.items():
            if not counter.convincing:
                continue
            node, _, told = key
            text = (
                f"{name(node)}: too many beacons in {counter.missed} of {counter.occasions} cases, "
                f"first {self._examples[key]}"
            )
            if told:
                text += "; requests with the same number must not be answered"
            if silent:
                text += (
                    f"; the recording has no beacon of the producer {name(silent[0])}, which may have asked for them"
                )
            self.violated(text, counter.examples, *(_TOLD if told else _UNTOLD), verdict=verdict)


class Requests(Invariant):
    """Check that a node does not request variables that it holds."""

    id = "CK_VD_REQUEST"
    section = "dcp-vardis.md: Global versus Local Dissemination"
    purpose = "A node requests only variables that it does not hold, and does not forward the requests of other nodes"
    requirements = ("VD-SCP-01",)
    expect = "no request for a variable that the node has in the same payload, or has summarised before"

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._asked: dict[tuple[bytes, int], list[int]] = {}
        """(node, variable) -> number of requests, and frame number of the first one."""
        self._producers: dict[int, bytes] = {}
        """Variable -> producer in the last create."""
        self._sent: dict[int, int] = {}
        """Variable -> number of creates after the first request for it."""

    def feed(self, seen: Seen) -> None:
        """Compare requests with the node's previous record of the variable."""
        for each, before, again in seen.news:
            if each.kind is ASK_CREATE:
                self.exercised()
                self._count(each, seen)
                if before is not None:
                    text = f"{name(seen.sender)} asks for variable {each.var_id}, which it holds"
                    self.violated(text, [latest(before, again), each], once=(seen.sender, each.var_id))
            elif each.kind is CREATE:
                self._producers[each.var_id] = each.record.spec.prod_id
                if each.var_id in self._sent:
                    self._sent[each.var_id] += 1

    def _count(self, each: Statement, seen: Seen) -> None:
        """Count a request."""
        key = (seen.sender, each.var_id)
        if key in self._asked or len(self._asked) < MOST_VARIABLES:
            self._asked.setdefault(key, [0, each.frame])[0] += 1
            self._sent.setdefault(each.var_id, 0)

    def finish(self) -> None:
        """Report hazards of the design: requests that never end, and producers that request their own variables."""
        by_variable: dict[int, list[tuple[bytes, int, int]]] = {}
        for (node, var_id), (count, first) in self._asked.items():
            by_variable.setdefault(var_id, []).append((node, count, first))
            if self._producers.get(var_id) == node:
                text = f"{name(node)} asks {count} times for variable {var_id}, whose producer it is"
                self.note("a producer that has forgotten its own variable (H2)", text, [Mark(first)])
        for var_id, askers in by_variable.items():
            often = [each for each in askers if each[1] >= 10]
            # If the create is sent repeatedly, some node holds the variable: CK_VD_ENDLESS reports the likely reason.
            if len(often) >= 2 and self._sent[var_id] < len(often):
                who = ", ".join(f"{name(node)} {count} times" for node, count, _ in often)
                marks = [Mark(first) for _, _, first in often]
                self.note(
                    "nodes that request a variable from each other that neither holds (H1)",
                    f"variable {var_id}: {who}",
                    marks,
                )


RULES: tuple[type[Invariant], ...] = (Repetitions, Requests)
