"""What the invariants of a recording have in common: what they are called, what they have seen, what they found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, ClassVar, NamedTuple

from dcp_spec.constants import Features, features
from dcp_spec.profile import Profile

from dcp_codec.codec import Codec
from dcp_codec.dissect import Dissection
from dcp_conformance.heard import Heard, Instruction
from dcp_conformance.pics import Pics
from dcp_conformance.results import Mark
from dcp_conformance.verdict import Verdict

from .lives import Lives
from .said import Said, said_in, speaker
from .senders import Senders
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


class Seen:
    """A frame, taken apart: values where it is sound, the dissection whatever it is. What is costly is made when asked.

    ``start`` is where the bearer payload starts in ``frame``, ``destination`` None where frames have no addresses.
    """

    __slots__ = (
        "_codec",
        "_dissection",
        "_said",
        "_trace",
        "destination",
        "frame",
        "heard",
        "number",
        "origin",
        "origin_frame",
        "sender",
        "start",
        "time",
    )

    def __init__(self, codec: Codec, heard: Heard, frame: bytes, start: int, destination: bytes | None) -> None:
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
        self._said: tuple[Said, ...] | None = None
        self._trace: Trace | None = None

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
    def said(self) -> tuple[Said, ...]:
        """All that it says of variables, in order."""
        if self._said is None:
            self._said = said_in(self.heard, self.sender)
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


Evidence = Seen | Trace | Said | Instruction | Mark
"""What can be cited."""


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
        self.lives = Lives(self.senders, MOST_VARIABLES, creation_time=self.features.creation_time)

    def feed(self, seen: Seen) -> None:
        """The next frame, before the invariants get it."""
        seen.sender, seen.origin, seen.origin_frame = self.stations.attribute(seen.heard)
        self.senders.feed(seen.sender, seen.heard.seqno, seen.time)
        for each in seen.said:
            self.lives.feed(each)

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

    def exercised(self, *requirements: str) -> None:
        """There was an occasion to break these (by default all of the invariant)."""
        if not requirements:
            self._of_all += 1
        for each in requirements:
            self._occasions[each] = self._occasions.get(each, 0) + 1

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
    ) -> None:
        """Something does not hold. With ``once``, only the first finding of that key is kept, others are counted.

        ``cite``: of so many of them the frames are shown.
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
        rules = requirements or self.requirements
        self.findings.append(Finding(verdict, rules, expected or self.expect, observed, self._marks(frames), once))

    def told(self, finding: Finding) -> str:
        """What was observed, and how often."""
        times = 1 if finding.key is None else self._times.get(finding.key, 1)
        return finding.observed if times == 1 else f"{finding.observed}; {times} times in all"

    def _cite_again(self, key: object, frames: Iterable[Evidence]) -> None:
        for index, finding in enumerate(self.findings):
            if finding.key == key:
                self.findings[index] = finding._replace(frames=(*finding.frames, *self._marks(frames)))

    def _marks(self, frames: Iterable[Evidence]) -> tuple[Mark, ...]:
        cited = (self.context.cite(self.id, self._mark(each)) for each in frames)
        return tuple(mark for mark in cited if mark is not None)

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
        if isinstance(what, Said):
            return Mark(what.frame, path=f"{what.kind.label} {what.var_id}")
        return Mark(what.heard.number, path=f"{what.kind.label} {what.var_id}")


def name(node_id: bytes) -> str:
    """A node identifier for people."""
    return node_id.hex(":") if len(node_id) <= 8 else node_id.decode("ascii", "replace")
