"""What the invariants of a recording have in common: what they are called, what they have seen, what they found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

from dcp_spec.constants import Features, features
from dcp_spec.profile.definition import Profile

from dcp_codec.codec import Codec
from dcp_codec.values import VarSumm
from dcp_codec.views.dissect import Dissection
from dcp_conformance.frames.received import Instruction, ReceivedBeacon
from dcp_conformance.model.pics import Pics
from dcp_conformance.model.results import Mark
from dcp_conformance.model.verdict import Verdict

from .lifetimes import Lifetimes
from .senders import Senders
from .statements import CREATE, DELETE, SUMMARY, UPDATE, Part, Statement, parts_of, said_of, speaker
from .stations import Origin, Stations

#: Findings of one invariant that are shown with their frames; all are counted.
MOST_FINDINGS = 20
#: Senders, and variables of each, that are followed; what a forged recording has beyond that is not judged.
MOST_SENDERS = 4096
MOST_VARIABLES = 65_536


class Trace(NamedTuple):
    """What of a frame can be remembered for long."""

    number: int
    time: int
    seqno: int | None
    octets: bytes


class News(NamedTuple):
    """A record that is not just the summary of what the node has said before."""

    said: Statement
    before: Statement | None
    """The last create, update or summary of the variable by this node, if no beacon of it is missing since, and it has
    not deleted the variable."""


class Seen:
    """A frame, taken apart: values where it is sound, the dissection whatever it is. What is costly is made when asked.

    ``start`` is where the bearer payload starts in ``frame``, ``destination`` None where frames have no addresses.
    """

    __slots__ = (
        "_codec",
        "_dissection",
        "_parts",
        "_said",
        "_trace",
        "again",
        "destination",
        "frame",
        "heard",
        "news",
        "number",
        "origin",
        "origin_frame",
        "sender",
        "start",
        "time",
    )

    def __init__(
        self, codec: Codec, heard: ReceivedBeacon, frame: bytes, start: int, destination: bytes | None
    ) -> None:
        self.heard = heard
        self.number = heard.number
        """As in the recording."""
        self.time = heard.wall
        """ns since 1970."""
        self.sender = speaker(heard)
        """The node that speaks; for a beacon without sender, or with a forged one, the station it came from."""
        self.origin = Origin.USUAL
        """What the address of the frame says about its sender, with an earlier frame to compare."""
        self.origin_frame: int | None = None
        self.frame = frame
        self.start = start
        self.destination = destination
        self._codec = codec
        self._dissection: Dissection | None = None
        self._parts: list[Part] | None = None
        self._said: tuple[Statement, ...] | None = None
        self._trace: Trace | None = None
        self.news: Sequence[News] = ()
        """What it says of variables, in order, without ``again``. Set by :meth:`Context.feed`."""
        self.again = 0
        """How many summaries have the number that the node has said of the variable before, with no beacon missing."""

    @property
    def sound(self) -> bool:
        """Whether the strict decoder takes it; the dissection of a sound frame has no errors."""
        return self.heard.problem is None and self.heard.beacon is not None

    @property
    def dissection(self) -> Dissection:
        """The frame as a tree, with every problem in it."""
        if self._dissection is None:
            end = self.start + len(self.heard.octets)
            self._dissection = self._codec.dissect(self.frame[:end], start=self.start, base=self.start)
        return self._dissection

    @property
    def parts(self) -> list[Part]:
        """All that it says of variables, by container."""
        if self._parts is None:
            self._parts = parts_of(self.heard)
        return self._parts

    @property
    def said(self) -> tuple[Statement, ...]:
        """All that it says of variables, in order. Costs more than ``parts`` and ``news``, which say the same."""
        if self._said is None:
            found = [said_of(part.kind, each, self.heard, self.sender) for part in self.parts for each in part.records]
            self._said = tuple(found)
        return self._said

    @property
    def trace(self) -> Trace:
        """What may be kept of it."""
        if self._trace is None:
            self._trace = Trace(self.number, self.time, self.heard.seqno, self.heard.octets)
        return self._trace


class Finding(NamedTuple):
    """Something that an invariant has to say, with the frames that show it."""

    verdict: Verdict
    requirements: tuple[str, ...]
    expected: str
    observed: str
    frames: tuple[Mark, ...]
    key: object = None
    """Findings of one key are told once; :meth:`Invariant.times` counts them."""
    time: int | None = None
    """When it showed first, in ns since 1970; None if it shows in the recording as a whole."""
    consequence: str = ""
    """What follows for the network, in a sentence; empty: what generally follows."""


Evidence = Seen | Trace | Statement | Instruction | Mark
"""What can be cited."""


Stamp = tuple[int, int]
"""Number of a frame, and its time in ns since 1970."""


class _Spoken:
    """What a node has said that it has, since the last gap in its beacons."""

    __slots__ = ("again", "last", "numbers", "unbroken")

    def __init__(self, unbroken: int) -> None:
        self.unbroken = unbroken
        """:attr:`Sender.unbroken` when what it had said was last forgotten."""
        self.numbers: dict[int, int] = {}
        """By variable: the number that it stated last."""
        self.last: dict[int, Statement] = {}
        """By variable: the record with which it did that first, or the last one that is no summary."""
        self.again: dict[int, Stamp] = {}
        """By variable: the last summary after that one, which tells the same number."""


class Context:
    """What all invariants know: beforehand, and of the recording so far."""

    def __init__(self, codec: Codec, pics: Pics, *, period_known: bool = True, restarts_known: bool = False) -> None:
        """``period_known``: the beacon period is stated, and not taken from the recording itself.

        ``restarts_known``: :meth:`Invariant.interrupted` is called whenever a node was restarted by somebody.
        """
        self.codec = codec
        self.pics = pics
        self.period_known = period_known
        self.restarts_known = restarts_known
        self.parameters: Mapping[str, Any] = {}
        """What the implementation itself has told of its parameters."""
        self.cite: Callable[[str, Mark], Mark | None] = lambda _rule, mark: mark
        """What a finding of a rule shows for a place in a frame; None: the frame cannot be shown."""
        self.overload: Callable[[], str] = lambda: ""
        """Why the machine may have slowed down what it runs, in words; empty if it had time for everything."""
        self.senders = Senders(MOST_SENDERS)
        self.stations = Stations(MOST_SENDERS)
        self.shared: dict[type, object] = {}
        """What several invariants make together, by its class."""
        self.lives = Lifetimes(self.senders, MOST_VARIABLES, creation_time=self.features.creation_time)
        self.now: int | None = None
        """The time of the frame that is being judged, in ns since 1970; None before and after the recording."""
        self.withheld: dict[str, str] = {}
        """Requirements that do not pass whatever was shown, and why."""
        self.changed = False
        """Whether there are findings that :meth:`Judge.feed` has not looked at."""
        self._spoken: dict[bytes, _Spoken] = {}
        self._pairs = 0
        self.on_gap: list[Callable[[bytes, Mapping[int, Stamp]], None]] = []
        """Called with a node and its last summaries before they are forgotten, since beacons of it are missing."""

    def withhold(self, requirement: str, why: str) -> None:
        """Something was heard that speaks against a requirement without refuting it: it does not pass."""
        self.withheld.setdefault(requirement, why)

    def feed(self, seen: Seen) -> None:
        """The next frame, before the invariants get it."""
        self.now = seen.time
        seen.sender, seen.origin, seen.origin_frame = self.stations.attribute(seen.heard)
        self.senders.feed(seen.sender, seen.heard.seqno, seen.time)
        if seen.parts:
            self._sort(seen)
            for each, _ in seen.news:
                self.lives.feed(each)

    def said_again(self, node: bytes, var_id: int) -> Stamp | None:
        """When a node last repeated the number of a variable in a summary; None if it has said anything since."""
        spoken = self._spoken.get(node)
        return None if spoken is None else spoken.again.get(var_id)

    def _sort(self, seen: Seen) -> None:
        """Tell what is new from what is said again: most of a recording is, and few rules look at it."""
        node = seen.sender
        sender = self.senders.get(node)
        if sender is None:
            seen.news = [News(each, None) for each in seen.said]
            return
        spoken = self._spoken.get(node)
        if spoken is None:
            spoken = self._spoken[node] = _Spoken(sender.unbroken)
        elif spoken.unbroken != sender.unbroken:
            self._forget(node, spoken, sender.unbroken)
        numbers, stamp, count = spoken.numbers, (seen.number, seen.time), 0
        news: list[News] = []
        for kind, records, ids in seen.parts:
            if kind is not SUMMARY:
                news += [self._news(said_of(kind, each, seen.heard, node), spoken) for each in records]
                continue
            told = [each.seqno for each in records]
            if list(map(numbers.get, ids)) == told:
                spoken.again.update(dict.fromkeys(ids, stamp))
                count += len(ids)
                continue
            for record, var_id, number in zip(records, ids, told, strict=True):
                if numbers.get(var_id) == number:
                    spoken.again[var_id] = stamp
                    count += 1
                else:
                    news.append(self._news(Statement(kind, record, *stamp, node, var_id, number), spoken))
        seen.news, seen.again = news, count

    def _news(self, each: Statement, spoken: _Spoken) -> News:
        """A record, with what the node said before; remembers it."""
        kind, var_id = each.kind, each.var_id
        before = spoken.last.get(var_id)
        if before is not None and (stamp := spoken.again.get(var_id)) is not None:
            number = before.number
            before = Statement(SUMMARY, VarSumm(var_id, number), *stamp, each.sender, var_id, number)
        if kind is SUMMARY or kind is UPDATE or kind is CREATE:
            if before is None:
                if self._pairs >= MOST_VARIABLES:
                    return News(each, None)
                self._pairs += 1
            spoken.last[var_id], spoken.numbers[var_id] = each, each.number
            spoken.again.pop(var_id, None)
        elif kind is DELETE and before is not None:
            self._pairs -= 1
            del spoken.last[var_id], spoken.numbers[var_id]
            spoken.again.pop(var_id, None)
        return News(each, before)

    def _forget(self, node: bytes, spoken: _Spoken, unbroken: int) -> None:
        """Beacons are missing: what the node says next may be another number rightly."""
        for call in self.on_gap:
            call(node, spoken.again)
        self._pairs -= len(spoken.last)
        spoken.unbroken = unbroken
        spoken.numbers.clear()
        spoken.last.clear()
        spoken.again.clear()

    @property
    def profile(self) -> Profile:
        """The wire profile."""
        return self.codec.profile

    @property
    def features(self) -> Features:
        """What the profile's version of the specification has."""
        return features(self.codec.profile.spec_version)


class Invariant:
    """Something that holds in every recording of nodes that follow the specification.

    Subclasses say what they are, and get every frame in order with :meth:`feed`, and :meth:`finish` at the end. What
    they look at, they count with :meth:`exercised`: a recording that never gave an occasion decides nothing.
    """

    id: ClassVar[str]
    purpose: ClassVar[str]
    requirements: ClassVar[tuple[str, ...]]
    section: ClassVar[str]
    expect: ClassVar[str]
    enough: ClassVar[int] = 10
    """Occasions from which a recording shows that something holds."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.findings: list[Finding] = []
        self.left_out = 0
        self._occasions: dict[str, int] = {}
        self._of_all = 0
        self._times: dict[object, int] = {}

    def applies(self) -> str:
        """Why the invariant does not concern recordings of this profile; empty if it does."""
        return ""

    def feed(self, seen: Seen) -> None:
        """A frame. Must be cheap, and keep what it remembers bounded."""
        raise NotImplementedError

    def interrupted(self) -> None:
        """The nodes may have been restarted since the last frame: numbers may start again, and frames be missing."""

    def finish(self) -> None:
        """The recording has ended."""

    def exercised(self, *requirements: str, times: int = 1) -> None:
        """There was an occasion to break these (by default all of the invariant), or so many."""
        if not requirements:
            self._of_all += times
        for each in requirements:
            self._occasions[each] = self._occasions.get(each, 0) + times

    @property
    def occasions(self) -> dict[str, int]:
        """By requirement: how often the recording gave an occasion to break it."""
        every = dict.fromkeys(self.requirements, self._of_all) if self._of_all else {}
        return every | {each: count + every.get(each, 0) for each, count in self._occasions.items()}

    def violated(
        self,
        observed: str,
        frames: Iterable[Evidence],
        *requirements: str,
        expected: str = "",
        verdict: Verdict = Verdict.FAIL,
        once: object = None,
        cite: int = 1,
        consequence: str = "",
    ) -> None:
        """Something does not hold. With ``once``, only the first finding of that key is kept, others are counted.

        ``cite``: of so many of them the frames are shown. ``consequence``: what follows for the network, in a sentence.
        """
        if once is not None:
            times = self._times.get(once, 0)
            if times or len(self._times) < MOST_VARIABLES:
                self._times[once] = times + 1
            if times:
                self.left_out += 1
                if times < cite:
                    self._cite_again(once, frames)
                return
        # By verdict: what is merely observed must not crowd out what does not hold.
        if sum(each.verdict is verdict for each in self.findings) >= MOST_FINDINGS:
            self.left_out += 1
            return
        rules, shown = requirements or self.requirements, list(frames)
        time = self._time_of(shown[-1]) if shown else None
        self.context.changed = True
        marks = self._marks(shown)
        expected = expected or self.expect
        self.findings.append(Finding(verdict, rules, expected, observed, marks, once, time, consequence))

    def times(self, key: object) -> int:
        """How often there was something to say under a key (``once`` of :meth:`violated`)."""
        return self._times.get(key, 0)

    def told(self, finding: Finding) -> str:
        """What was observed, and how often."""
        times = 1 if finding.key is None else self._times.get(finding.key, 1)
        return finding.observed if times == 1 else f"{finding.observed}; {times} times in all"

    def _cite_again(self, key: object, frames: Iterable[Evidence]) -> None:
        for index, finding in enumerate(self.findings):
            if finding.key == key:
                self.context.changed = True
                self.findings[index] = finding._replace(frames=(*finding.frames, *self._marks(frames)))

    def _marks(self, frames: Iterable[Evidence]) -> tuple[Mark, ...]:
        cited = (self.context.cite(self.id, self._mark(each)) for each in frames)
        return tuple(mark for mark in cited if mark is not None)

    def _time_of(self, what: Evidence) -> int | None:
        """When that was, in ns since 1970; of a mark the time of the frame that is being judged."""
        if isinstance(what, Mark):
            return self.context.now
        return what.heard.wall if isinstance(what, Instruction) else what.time

    def note(self, question: str, observed: str, frames: Iterable[Evidence], *requirements: str) -> None:
        """Something that the specification leaves open, or a hazard that it brings about."""
        self.violated(
            observed, frames, *requirements, expected=question, verdict=Verdict.INFO, once=(question, observed)
        )

    def _mark(self, what: Evidence) -> Mark:
        if isinstance(what, Mark):
            return what
        if isinstance(what, Seen | Trace):
            return Mark(what.number)
        if isinstance(what, Statement):
            return Mark(what.frame, path=f"{what.kind.label} {what.var_id}")
        return Mark(what.heard.number, path=f"{what.kind.label} {what.var_id}")


def name(node_id: bytes) -> str:
    """A node identifier for people."""
    return node_id.hex(":") if len(node_id) <= 8 else node_id.decode("ascii", "replace")
