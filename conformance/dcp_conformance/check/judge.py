"""Judging a recording: every frame through every invariant, once, in order."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterable
from typing import Final

import msgspec

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_codec.framing import OtherTraffic, locate
from dcp_conformance.case import Case, Kind
from dcp_conformance.declared import declarations
from dcp_conformance.heard import Heard
from dcp_conformance.moment import timestamp
from dcp_conformance.outcome import assemble
from dcp_conformance.pics import Pics
from dcp_conformance.results import (
    CaseResult,
    Check,
    EventRecord,
    Mark,
    RunResult,
    Sut,
)
from dcp_conformance.verdict import Verdict, worst

from . import (
    rules_bp,
    rules_data,
    rules_dialogue,
    rules_network,
    rules_repetition,
    rules_srp,
    rules_vardis,
    rules_variables,
)
from .base import Context, Invariant, Seen
from .places import placed

RULES: tuple[type[Invariant], ...] = (
    *rules_data.RULES,
    *rules_bp.RULES,
    *rules_srp.RULES,
    *rules_vardis.RULES,
    *rules_variables.RULES,
    *rules_repetition.RULES,
    *rules_dialogue.RULES,
    *rules_network.RULES,
)
_STIMULUS: Final = "none: the recording as it is"
#: Frames that are kept for findings that are made later; older ones are cited by number only.
_KEPT = 20_000


def cases() -> tuple[Case, ...]:
    """The invariants as cases, for files of expected results. They are never run as such."""
    return tuple(
        Case(
            id=rule.id,
            purpose=rule.purpose,
            requirements=rule.requirements,
            kind=Kind.VALID,
            stimulus=_STIMULUS,
            expect=rule.expect,
            window=0,
            section=rule.section,
            module=rule.__module__,
            run=lambda _: None,
        )
        for rule in RULES
    )


class Judge:
    """Feed it frames, and ask for the result. Nothing in a frame makes it raise."""

    def __init__(
        self, codec: Codec, pics: Pics, *, recording: str = "", command: str = "", period_known: bool = True
    ) -> None:
        """``period_known`` False: the beacon period in ``pics`` was measured in the recording, and proves nothing."""
        self._codec = codec
        self._pics = pics
        self._recording = recording
        self._command = command
        self._context = Context(codec, pics, period_known=period_known)
        self._rules = [rule(self._context) for rule in RULES]
        self._active = [rule for rule in self._rules if not rule.applies()]
        self._recent: OrderedDict[int, tuple[Frame, int, bytes]] = OrderedDict()
        self._cited: dict[int, EventRecord] = {}
        self._findings = 0
        self._began = time.monotonic()
        self._started = timestamp()
        self.frames = self.other = self.cut = 0
        self._senders: dict[bytes, int] = {}

    def feed(self, frame: Frame) -> None:
        """The next frame of the recording."""
        framing = locate(frame.data, self._codec.profile.link)
        if isinstance(framing, OtherTraffic):
            self.other += 1
            return
        if frame.orig_len > len(frame.data):
            # What is missing was cut off by the recorder; the sender may have sent it all.
            self.cut += 1
            return
        self.frames += 1
        octets = frame.data[framing.start : framing.end]
        heard = Heard(self._codec, frame.number, frame.time_ns, frame.time_ns, octets, framing.src or b"")
        seen = Seen(self._codec, heard, frame.data, framing.start, framing.dst)
        if seen.sender in self._senders or len(self._senders) < 4096:
            self._senders[seen.sender] = self._senders.get(seen.sender, 0) + 1
        self._recent[frame.number] = (frame, framing.start, seen.sender)
        if len(self._recent) > _KEPT:
            self._recent.popitem(last=False)
        self._context.feed(seen)
        for rule in self._active:
            rule.feed(seen)
        self._cite()

    def _cite(self) -> None:
        """Keep the frames of new findings while they are there."""
        count = sum(len(rule.findings) for rule in self._active)
        if count == self._findings:
            return
        self._findings = count
        for rule in self._active:
            for finding in rule.findings:
                for mark in finding.frames:
                    kept = self._recent.get(mark.frame)
                    if mark.frame not in self._cited and kept is not None:
                        frame, start, sender = kept
                        who = sender.hex(":") if len(sender) <= 8 else sender.decode("ascii", "replace")
                        self._cited[mark.frame] = EventRecord(
                            frame.time_ns, "heard", who, frame.number, "", frame.data.hex(), start
                        )

    def result(self, notes: Iterable[str] = ()) -> RunResult:
        """What came of it; call once, at the end."""
        for rule in self._active:
            rule.finish()
        self._cite()
        cases = (*declarations(self._pics.pics, self._codec.profile, self._command), *map(self._case, self._rules))
        about = [f"{self.frames} frames of {len(self._senders)} senders"]
        if self.other:
            about.append(f"{self.other} frames of other traffic were passed over")
        if self.cut:
            about.append(f"{self.cut} frames were not recorded to their end, and not judged")
        run = assemble(
            self._codec.profile,
            self._pics,
            cases,
            kind="check",
            sut=Sut(name=self._pics.sut.name or self._recording, link=f"recording {self._recording}"),
            started=self._started,
            duration=time.monotonic() - self._began,
            command=self._command,
            notes=(*about, *notes),
        )
        open_ones = (Verdict.NOT_APPLICABLE, Verdict.INCONCLUSIVE)
        decided = {name: verdict for name, verdict in run.requirements.items() if verdict not in open_ones}
        return msgspec.structs.replace(run, requirements=decided)

    def _case(self, rule: Invariant) -> CaseResult:
        checks = [
            Check(each.verdict, each.requirements, each.expected, rule.told(each), self._marks(each.frames))
            for each in rule.findings
        ]
        failed = {each for check in checks if check.verdict is Verdict.FAIL for each in check.requirements}
        exercised = tuple(each for each in rule.requirements if rule.occasions.get(each) and each not in failed)
        reason = rule.applies()
        if exercised:
            count = max(rule.occasions[each] for each in exercised)
            times = "once" if count == 1 else f"{count} times"
            checks.append(Check(Verdict.PASS, exercised, f"{rule.expect} (looked at {times})"))
        elif not checks:
            reason = reason or "the recording gave no occasion"
            checks.append(Check(Verdict.NOT_APPLICABLE, rule.requirements, reason))
        verdict = worst(check.verdict for check in checks) or Verdict.NOT_APPLICABLE
        decisive = next(check for check in checks if check.verdict is verdict)
        text = f"{decisive.expected}: {decisive.observed}" if decisive.observed else decisive.expected
        numbers = sorted({mark.frame for check in checks for mark in check.frames})
        return CaseResult(
            id=rule.id,
            purpose=rule.purpose,
            section=rule.section,
            kind="BV",
            requirements=rule.requirements,
            verdict=verdict,
            reason="" if verdict is Verdict.PASS else text,
            stimulus=_STIMULUS,
            expectation=rule.expect,
            checks=tuple(checks),
            evidence=tuple(self._cited[number] for number in numbers if number in self._cited),
            left_out=rule.left_out,
            rerun=self._command,
        )

    def _marks(self, marks: tuple[Mark, ...]) -> tuple[Mark, ...]:
        """With the octets of records whose place was given as "KIND variable"."""
        return tuple(self._placed(mark) for mark in marks)

    def _placed(self, mark: Mark) -> Mark:
        event = self._cited.get(mark.frame)
        return mark if event is None else placed(self._codec, mark, bytes.fromhex(event.octets), event.start)
