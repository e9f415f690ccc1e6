"""Base classes of the invariants that ``check`` applies to a recording: the frame, the shared context, the finding."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import msgspec
from dcp_spec.constants import Features, features
from dcp_spec.profile.definition import Profile

from dcp_codec.analysis.entry import Entry
from dcp_codec.analysis.ledger import Ledger, News
from dcp_codec.codec import Codec
from dcp_codec.views.dissect import Dissection
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import Mark
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.frames.received import Instruction, ReceivedBeacon

from .lifetimes import Lifetimes
from .numbers import Numbers
from .senders import Senders
from .statements import SUMMARY, UPDATE, Part, Statement, parts_of, speaker, statements_in
from .stations import Origin, Stations

#: Maximum number of findings of one verdict that an invariant keeps with their frames; further ones are only counted.
MOST_FINDINGS = 20
#: Maximum numbers of senders, and of pairs of sender and variable, that are followed. They bound the memory that a
#: recording with forged senders can use; anything beyond them is not judged.
MOST_SENDERS = 4096
MOST_VARIABLES = 65_536


class Trace(msgspec.Struct, frozen=True, gc=False):
    """The part of a frame that a rule may keep: it holds neither the decoded values nor the dissection."""

    number: int
    """Frame number in the recording."""
    time: int
    """ns since 1970."""
    seqno: int | None
    octets: bytes


class Seen:
    """A frame of the recording with its decoded values, its dissection and its sender.

    The dissection, the trace and the list of all records are computed on first access. ``start`` is the offset of the
    bearer payload in ``frame``, in octets. ``destination`` is None if frames have no addresses.
    """

    __slots__ = (
        "_codec",
        "_dissection",
        "_statements",
        "_trace",
        "again",
        "destination",
        "frame",
        "heard",
        "news",
        "number",
        "origin",
        "origin_frame",
        "parts",
        "sender",
        "sound",
        "start",
        "time",
    )

    def __init__(
        self, codec: Codec, heard: ReceivedBeacon, frame: bytes, start: int, destination: bytes | None
    ) -> None:
        self.heard = heard
        self.number = heard.number
        """Frame number in the recording."""
        self.time = heard.wall
        """ns since 1970."""
        self.sender = speaker(heard)
        """The node to which the frame is attributed; the source station if senderId is missing or forged."""
        self.origin = Origin.USUAL
        """Result of comparing senderId with the source address of the frame."""
        self.origin_frame: int | None = None
        """Number of an earlier frame that shows the difference if ``origin`` is not USUAL; None if there is none."""
        self.frame = frame
        self.start = start
        self.destination = destination
        self._codec = codec
        self._dissection: Dissection | None = None
        self._statements: tuple[Statement, ...] | None = None
        # Nearly all rules need these, for each frame: properties would cost more than the rules.
        self.sound = not heard.problems and heard.beacon is not None
        """Whether the strict decoder accepts the frame; the dissection of such a frame has no errors."""
        self.parts: list[Part] = parts_of(heard) if heard.containers else []
        """The VarDis records of the frame, by container."""
        self._trace: Trace | None = None
        self.news: Sequence[News] = ()
        """The VarDis records in their order, without the summaries counted in ``again``. Set by :meth:`Context.feed`.
        """
        self.again = 0
        """Number of summaries that repeat the sequence number which the node stated last, with no beacon missing in
        between."""

    @property
    def dissection(self) -> Dissection:
        """The dissection of the frame: a tree of fields with all problems found."""
        if self._dissection is None:
            end = self.start + len(self.heard.octets)
            self._dissection = self._codec.dissect(self.frame[:end], start=self.start, base=self.start)
        return self._dissection

    @property
    def trace(self) -> Trace:
        """The part of the frame that a rule may keep."""
        if self._trace is None:
            self._trace = Trace(self.number, self.time, self.heard.seqno, self.heard.octets)
        return self._trace

    @property
    def statements(self) -> tuple[Statement, ...]:
        """All VarDis records of the frame in their order. Prefer ``parts`` or ``news``, which cost less."""
        if self._statements is None:
            self._statements = statements_in(self.heard, self.sender)
        return self._statements


class Finding(NamedTuple):
    """An observation of an invariant with its verdict and the frames that show it."""

    verdict: Verdict
    requirements: tuple[str, ...]
    expected: str
    observed: str
    frames: tuple[Mark, ...]
    key: object = None
    """Only the first finding with a given key is kept; :meth:`Invariant.times` counts all of them."""
    time: int | None = None
    """Time of the first occurrence in ns since 1970; None if only the recording as a whole shows it."""
    consequence: str = ""
    """One sentence about the effect on the network; empty for the general one of the rule."""


class Outcome(NamedTuple):
    """The results of a rule that was applied in another process, see :meth:`Invariant.adopt`."""

    findings: list[Finding]
    left_out: int
    occasions: dict[str, int]
    times: dict[object, int]


Evidence = Seen | Trace | Statement | Instruction | Entry | Mark
"""Types that a finding accepts as evidence: frames, records, states of the ledger (their first record), and places."""


class Context:
    """State that all invariants share: profile, PICS, and what the recording has shown so far."""

    def __init__(self, codec: Codec, pics: Pics, *, period_known: bool = True, restarts_known: bool = False) -> None:
        """Start with an empty history.

        ``period_known``: the beacon period in ``pics`` was configured. False: it was measured in the recording.
        ``restarts_known``: the caller calls :meth:`Invariant.interrupted` for every restart of a node.
        """
        self.codec = codec
        self.pics = pics
        self.period_known = period_known
        self.restarts_known = restarts_known
        self.parameters: Mapping[str, Any] = {}
        """Parameter values that the implementation reported through its upper tester, by name."""
        self.cite: Callable[[str, Mark], Mark | None] = lambda _rule, mark: mark
        """Converts a place in a frame for a finding of the given rule; returns None if the frame is not kept."""
        self.overload: Callable[[], str] = lambda: ""
        """Returns the reason why the machine was too busy for exact timing; empty if it was not."""
        self.senders = Senders(MOST_SENDERS)
        self.stations = Stations(MOST_SENDERS)
        self.shared: dict[type, object] = {}
        """Objects that several invariants share, by class."""
        self.lives = Lifetimes(self.senders, MOST_VARIABLES, creation_time=self.features.creation_time)
        self.now: int | None = None
        """Time of the current frame in ns since 1970; None before and after the recording."""
        self.withheld: dict[str, str] = {}
        """Requirement -> the reason why it does not get the verdict pass."""
        self.hears: Callable[[bytes, bytes], bool | None] = lambda _listener, _speaker: None
        """Whether a node can hear another one, as stated by the user; None without a statement about the listener."""
        self.changed = False
        """Whether there are findings whose frames :meth:`Judge.feed` has not saved yet."""
        self.ledger = Ledger(MOST_VARIABLES)
        """The states of all variables at all nodes."""
        self.keeper: Ledger | Numbers | None = self.ledger
        """Finds the news: :class:`Numbers` if no rule needs the ledger, None if no rule needs the news. Then
        :attr:`lives` is not kept either."""

    def withhold(self, requirement: str, why: str) -> None:
        """Keep a requirement from the verdict pass; the first reason is kept.

        For observations that raise doubt without proving a violation.
        """
        self.withheld.setdefault(requirement, why)

    def feed(self, seen: Seen) -> None:
        """Update the shared state with the next frame and complete ``seen``. Call before :meth:`Invariant.feed`."""
        self.now = seen.time
        seen.sender, seen.origin, seen.origin_frame = self.stations.attribute(seen.heard)
        self.senders.feed(seen.sender, seen.heard.seqno, seen.time)
        if self.ledger.begin is None:
            self.ledger.begin = seen.time
        if seen.parts and self.keeper is not None:
            sender = self.senders.get(seen.sender)
            if sender is None:
                seen.news = [(each, None, None) for each in seen.statements]
            else:
                seen.news, seen.again = self.keeper.feed_parts(
                    seen.number, seen.time, seen.sender, seen.parts, sender.unbroken
                )
                if self.keeper is not self.ledger:
                    return
            for each, before, _ in seen.news:
                # A later update or summary of a known variable has no effect on its lifetime.
                if before is None or (each.kind is not UPDATE and each.kind is not SUMMARY):
                    self.lives.feed(each)

    @property
    def profile(self) -> Profile:
        """The wire profile."""
        return self.codec.profile

    @property
    def features(self) -> Features:
        """Features of the specification version that the profile follows."""
        return features(self.codec.profile.spec_version)


class Invariant:
    """A rule that holds in every recording of nodes that follow the specification.

    A subclass sets the class attributes and defines :meth:`feed`, which gets every frame in order; :meth:`finish`
    follows after the last frame. It counts the occasions on which the rule could have been broken with
    :meth:`exercised` (a requirement without any occasion gets no verdict), and reports with :meth:`violated`.
    """

    id: ClassVar[str]
    purpose: ClassVar[str]
    requirements: ClassVar[tuple[str, ...]]
    section: ClassVar[str]
    expect: ClassVar[str]
    enough: ClassVar[int] = 10
    """Minimum number of occasions for the verdict pass."""
    of_reactions: ClassVar[bool] = False
    """True if the rule uses :mod:`.reception`."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.findings: list[Finding] = []
        self.left_out = 0
        self._occasions: dict[str, int] = {}
        self._of_all = 0
        """Number of occasions that concern all requirements. Rules count frequent ones here, without
        :meth:`exercised`."""
        self._times: dict[object, int] = {}

    @classmethod
    def as_case(cls, section: str, stimulus: str) -> Case:
        """Return the rule as a test case, for files of expected results and for exclusion. Nothing executes it."""
        return Case(
            id=cls.id,
            purpose=cls.purpose,
            requirements=cls.requirements,
            kind=Kind.VALID,
            stimulus=stimulus,
            expect=cls.expect,
            window=0,
            section=section,
            module=cls.__module__,
            run=_never,
        )

    def applies(self) -> str:
        """Return why the rule does not apply to recordings of this profile; empty if it does."""
        return ""

    def feed(self, seen: Seen) -> None:
        """Process a frame; the default does nothing.

        Called for every frame if a subclass defines it: implementations must be fast and use bounded memory.
        """

    def interrupted(self) -> None:
        """Forget what a restart of the nodes changes: numbers may start again, and frames may be missing."""

    def finish(self) -> None:
        """Process the end of the recording."""

    def exercised(self, *requirements: str, times: int = 1) -> None:
        """Count occasions to break ``requirements`` (default: all requirements of the rule)."""
        if not requirements:
            self._of_all += times
        for each in requirements:
            self._occasions[each] = self._occasions.get(each, 0) + times

    @property
    def occasions(self) -> dict[str, int]:
        """Requirement -> number of occasions to break it."""
        every = dict.fromkeys(self.requirements, self._of_all) if self._of_all else {}
        return every | {each: count + every.get(each, 0) for each, count in self._occasions.items()}

    @property
    def outcome(self) -> Outcome:
        """The results, to be sent to another process."""
        times = {each.key: self._times.get(each.key, 1) for each in self.findings if each.key is not None}
        return Outcome(self.findings, self.left_out, self.occasions, times)

    def adopt(self, outcome: Outcome) -> None:
        """Take the results of the same rule from another process, after :meth:`finish` there."""
        self.findings, self.left_out, self._occasions, self._times = outcome

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
        """Add a finding.

        ``requirements``: default is all requirements of the rule. ``expected``: default is ``expect`` of the rule.
        ``once``: a key; only the first finding with this key is kept, further ones are counted. ``cite``: number of
        findings with one key whose frames are shown. ``consequence``: one sentence about the effect on the network.
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
        # A limit for each verdict: many observations (info) must not displace a failure.
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
        """Return the number of findings with a key (argument ``once`` of :meth:`violated`)."""
        return self._times.get(key, 0)

    def text_of(self, finding: Finding) -> str:
        """Return the text of a finding; with the count if there were several with its key."""
        times = 1 if finding.key is None else self._times.get(finding.key, 1)
        return finding.observed if times == 1 else f"{finding.observed}; {times} times in all"

    def _cite_again(self, key: object, frames: Iterable[Evidence]) -> None:
        """Add the frames of a further finding to the kept one with the same key."""
        for index, finding in enumerate(self.findings):
            if finding.key == key:
                self.context.changed = True
                self.findings[index] = finding._replace(frames=(*finding.frames, *self._marks(frames)))

    def _marks(self, frames: Iterable[Evidence]) -> tuple[Mark, ...]:
        """Return the marks for pieces of evidence, without those whose frame is not kept."""
        cited = (self.context.cite(self.id, self._mark(each)) for each in frames)
        return tuple(mark for mark in cited if mark is not None)

    def _time_of(self, what: Evidence) -> int | None:
        """Return the time of a piece of evidence in ns since 1970; for a mark the time of the current frame."""
        if isinstance(what, Mark):
            return self.context.now
        return what.heard.wall if isinstance(what, Instruction) else what.time

    def note(self, question: str, observed: str, frames: Iterable[Evidence], *requirements: str) -> None:
        """Add a finding without a verdict (info): a choice that the specification leaves open, or a known hazard.

        ``question`` takes the place of the expected behaviour.
        """
        self.violated(
            observed, frames, *requirements, expected=question, verdict=Verdict.INFO, once=(question, observed)
        )

    def _mark(self, what: Evidence) -> Mark:
        """Return the mark for a piece of evidence; for a record with the path "KIND variable"."""
        if isinstance(what, Mark):
            return what
        if isinstance(what, Seen | Trace):
            return Mark(what.number)
        if isinstance(what, Statement | Entry):
            return Mark(what.frame, path=f"{what.kind.label} {what.var_id}")
        return Mark(what.heard.number, path=f"{what.kind.label} {what.var_id}")


def name(node_id: bytes) -> str:
    """Return a node identifier as text: colon-separated hex up to 8 octets, otherwise ASCII."""
    return node_id.hex(":") if len(node_id) <= 8 else node_id.decode("ascii", "replace")


def _never(_bench: object) -> None:
    """Refuse execution."""
    raise AssertionError("an invariant cannot be executed as a case")
