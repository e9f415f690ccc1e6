"""What the invariants of a recording have in common: what they are called, what they have seen, what they found."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, NamedTuple

from dcp_spec.constants import Features, features
from dcp_spec.profile import Profile

from dcp_codec.codec import Codec
from dcp_codec.dissect import Dissection
from dcp_conformance.heard import Heard, Instruction
from dcp_conformance.pics import Pics
from dcp_conformance.results import Mark
from dcp_conformance.verdict import Verdict

from .lives import Lives
from .said import Said, speaker
from .senders import Senders

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


class Seen(NamedTuple):
    """A frame of the recording, taken apart: values where it is sound, the dissection whatever it is."""

    heard: Heard
    dissection: Dissection
    destination: bytes | None
    start: int
    """Where the bearer payload starts in the frame."""
    frame: bytes
    said: tuple[Said, ...]
    """All that it says of variables, in order."""

    @property
    def trace(self) -> Trace:
        """What may be kept of it."""
        return Trace(self.number, self.time, self.heard.seqno, self.heard.octets)

    @property
    def number(self) -> int:
        """As in the recording."""
        return self.heard.number

    @property
    def time(self) -> int:
        """ns since 1970."""
        return self.heard.wall

    @property
    def sender(self) -> bytes:
        """The node that speaks; for a beacon without sender the station it came from."""
        return speaker(self.heard)


class Finding(NamedTuple):
    """Something that an invariant has to say, with the frames that show it."""

    verdict: Verdict
    requirements: tuple[str, ...]
    expected: str
    observed: str
    frames: tuple[Mark, ...]


Evidence = Seen | Trace | Said | Instruction | Mark
"""What can be cited."""


class Context:
    """What all invariants know: beforehand, and of the recording so far."""

    def __init__(self, codec: Codec, pics: Pics, *, period_known: bool = True) -> None:
        """``period_known``: the beacon period is stated, and not taken from the recording itself."""
        self.codec = codec
        self.pics = pics
        self.period_known = period_known
        self.senders = Senders(MOST_SENDERS)
        self.lives = Lives(self.senders, MOST_VARIABLES, creation_time=self.features.creation_time)

    def feed(self, seen: Seen) -> None:
        """The next frame, before the invariants get it."""
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
        self.occasions: dict[str, int] = {}
        """By requirement: how often the recording gave an occasion to break it."""
        self._keys: set[object] = set()

    def applies(self) -> str:
        """Why the invariant does not concern recordings of this profile; empty if it does."""
        return ""

    def feed(self, seen: Seen) -> None:
        """A frame. Must be cheap, and keep what it remembers bounded."""
        raise NotImplementedError

    def finish(self) -> None:
        """The recording has ended."""

    def exercised(self, *requirements: str) -> None:
        """There was an occasion to break these (by default all of the invariant)."""
        for each in requirements or self.requirements:
            self.occasions[each] = self.occasions.get(each, 0) + 1

    def violated(
        self,
        observed: str,
        frames: Iterable[Evidence],
        *requirements: str,
        expected: str = "",
        verdict: Verdict = Verdict.FAIL,
        once: object = None,
    ) -> None:
        """Something does not hold. With ``once``, only the first finding of that key is kept, others are counted."""
        if once is not None:
            if once in self._keys:
                self.left_out += 1
                return
            if len(self._keys) < MOST_VARIABLES:
                self._keys.add(once)
        # By verdict: what is merely observed must not crowd out what does not hold.
        if sum(each.verdict is verdict for each in self.findings) >= MOST_FINDINGS:
            self.left_out += 1
            return
        marks = tuple(self._mark(each) for each in frames)
        self.findings.append(
            Finding(verdict, requirements or self.requirements, expected or self.expect, observed, marks)
        )

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
