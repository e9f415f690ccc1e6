"""Judge a recording: pass each frame once, in order, to every invariant, and make a run result of the findings."""

from __future__ import annotations

import shlex
import time
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple

import msgspec

from dcp_codec.analysis.chain import sources
from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_codec.common.garbage import few_collections
from dcp_codec.framing.locate import OtherTraffic, locate
from dcp_conformance.definitions.case import Case
from dcp_conformance.definitions.declared import declarations
from dcp_conformance.definitions.outcome import assemble
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import (
    CaseResult,
    Check,
    EventRecord,
    LinkResult,
    Mark,
    RunResult,
    Sut,
    timestamp,
)
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.frames.received import ReceivedBeacon

from .base import MOST_VARIABLES, Context, Finding, Invariant, Outcome, Seen, name
from .numbers import Numbers
from .places import placed
from .reception import Reception, reception_of
from .reception.links import Link, Whole, summary
from .rules import bp as rules_bp
from .rules import data as rules_data
from .rules import dialogue as rules_dialogue
from .rules import network as rules_network
from .rules import repetition as rules_repetition
from .rules import srp as rules_srp
from .rules import vardis as rules_vardis
from .rules import variables as rules_variables
from .topology import Topology
from .wording import CONSEQUENCES

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
OF_REACTIONS = frozenset(rule for rule in RULES if rule.of_reactions)
#: Rules about single beacons: they need neither the ledger nor the news of a beacon.
_OF_BEACONS = frozenset((*rules_data.RULES, *rules_bp.RULES, *rules_srp.RULES, *rules_vardis.RULES))
_STIMULUS: Final = "none: the recording is judged unchanged"
#: Minimum number of beacons in the recording for the verdict pass.
LEAST_BEACONS: Final = 30
#: A link is reported if at least the share ``_SOME`` of beacons is heard for certain, or if at most this share is heard
#: in at least ``_TRIALS`` trials.
_SOME, _TRIALS = 0.02, 20
#: The command that shows a finding covers its frames whose numbers differ from the last one by less than this.
_NEAR = 10
Needs = Literal["ledger", "news", "beacons"]
"""The needs of rules beside the beacon: the states of all variables, or the news in the beacon only, or nothing."""
#: Number of frames that are kept as evidence for later findings; older frames are cited by number only.
_KEPT = 20_000


def cases() -> tuple[Case, ...]:
    """Return the invariants as test cases, for files of expected results. Nothing executes them."""
    return tuple(rule.as_case(rule.section, _STIMULUS) for rule in RULES)


def _counted(requirements: Sequence[str], occasions: Mapping[str, int]) -> str:
    """Return ``12 occasions``, or ``3 to 12 occasions`` if the numbers of the requirements differ."""
    counts = sorted({occasions[each] for each in requirements})
    many = f"{counts[0]:,}" if len(counts) == 1 else f"{counts[0]:,} to {counts[-1]:,}"
    return f"{many} occasion{'' if counts == [1] else 's'}"


class RecorderClock:
    """The recorder's clock without steps backwards.

    Rules compare times: no beacon of a node is missing since a record, for example. A clock that is set back during the
    recording would make a later time look like an earlier one.
    """

    def __init__(self) -> None:
        self._last: int | None = None
        self._usual = 1
        """Time between the last two frames without a step backwards, ns."""
        self._shift = 0
        """Sum of the steps backwards, ns."""

    def time(self, recorded: int) -> int:
        """Return the time of the next frame in ns since 1970, not earlier than that of the frame before."""
        last, self._last = self._last, recorded
        if last is None:
            return recorded
        step = recorded - last
        if step > 0:
            self._usual = step
        elif step < 0:
            self._shift += self._usual - step
        return recorded + self._shift


class Task(NamedTuple):
    """The part of one process in the judgement of a recording (:mod:`.sharing`)."""

    rules: frozenset[type[Invariant]]
    needs: Needs = "ledger"


def tasks(processes: int) -> list[Task]:
    """Divide the rules among one to three processes that take about the same time; the first one keeps the ledger."""
    others = [Task(OF_REACTIONS, "news"), Task(_OF_BEACONS, "beacons")][: processes - 1]
    return [Task(frozenset(RULES).difference(*[each.rules for each in others])), *others]


class Share(NamedTuple):
    """The results of some rules: by the identifier of the rule, the frames that they cite, by number, and the links."""

    outcomes: dict[str, Outcome]
    cited: dict[int, EventRecord]
    links: list[Link]


class Judge:
    """Judges the frames given to :meth:`feed`; :meth:`result` returns the verdicts. No frame makes it raise."""

    def __init__(
        self,
        codec: Codec,
        pics: Pics,
        *,
        recording: str = "",
        path: str = "",
        command: str = "",
        period_known: bool = True,
        enough: int | None = None,
        topology: Topology | None = None,
        task: Task | None = None,
    ) -> None:
        """Prepare the rules for the profile of ``codec``.

        ``recording``: name of the recording in the result. ``path``: its file, for the commands that show a frame.
        ``command``: the command line in the result. ``period_known``: False if the beacon period in ``pics`` was
        measured in this recording, which therefore cannot break it. ``enough``: minimum number of occasions and of
        beacons for the verdict pass; None for the minimum of each rule and ``LEAST_BEACONS``. ``topology``: the links
        that the user tells; None: they are inferred. ``task``: the rules to apply; None for all of them.
        """
        self.codec = codec
        """The codec of the profile."""
        self._pics = pics
        self._recording = recording
        self._path = path or recording
        self._enough = enough
        self._first: int | None = None
        self._clock = RecorderClock()
        self._command = command
        self._context = Context(codec, pics, period_known=period_known)
        self.ledger = self._context.ledger
        """The states of all variables at all nodes."""
        self._topology = topology
        if topology is not None:
            self._context.hears = topology.hears
        task = task or Task(frozenset(RULES))
        if task.needs != "ledger":
            self._context.keeper = Numbers(MOST_VARIABLES) if task.needs == "news" else None
        self._rules = [rule(self._context) for rule in RULES]
        self._active = [rule for rule in self._rules if not rule.applies() and type(rule) in task.rules]
        # Rules without a method of their own wait for the end.
        self._feeds = [rule.feed for rule in self._active if type(rule).feed is not Invariant.feed]
        self._recent: OrderedDict[int, tuple[Frame, int, bytes]] = OrderedDict()
        self._cited: dict[int, EventRecord] = {}
        self._began = time.monotonic()
        self._started = timestamp()
        self.frames = self.other = self.cut = 0
        self._senders: dict[bytes, None] = {}
        self._summary: dict[tuple[bytes, bytes], Whole] | None = None

    def feed(self, frame: Frame) -> None:
        """Judge the next frame of the recording; frames of other traffic and truncated frames are only counted."""
        framing = locate(frame.data, self.codec.profile.link)
        if isinstance(framing, OtherTraffic):
            self.other += 1
            return
        if frame.orig_len > len(frame.data):
            # The recorder truncated the frame; the sender may have sent a correct one.
            self.cut += 1
            return
        self.frames += 1
        if self._first is None:
            self._first = frame.time_ns
        octets = frame.data[framing.start : framing.end]
        time_ns = self._clock.time(frame.time_ns)
        heard = ReceivedBeacon(self.codec, frame.number, time_ns, time_ns, octets, framing.src or b"")
        seen = Seen(self.codec, heard, frame.data, framing.start, framing.dst)
        if seen.sender not in self._senders and len(self._senders) < 4096:
            self._senders[seen.sender] = None
        self._recent[frame.number] = (frame, framing.start, seen.sender)
        if len(self._recent) > _KEPT:
            self._recent.popitem(last=False)
        self._context.feed(seen)
        for feed in self._feeds:
            feed(seen)
        if self._context.changed:
            self._cite()

    @property
    def reception(self) -> Reception:
        """The links between nodes, and the proofs of reception."""
        return reception_of(self._context)

    @property
    def links_origin(self) -> str:
        """A sentence about the origin of the links."""
        if self._topology is None:
            return "links: inferred from reactions"
        text = f"links: as told by {self._topology.origin}; what the reactions show is beside them"
        unknown = self._topology.unknown(self._senders)
        return f"{text}; {', '.join(unknown)} fit no node, or several" if unknown else text

    def hears(self, listener: bytes, speaker: bytes) -> bool | None:
        """Return whether a node hears another one, as told or inferred (after :meth:`result`); None if unknown."""
        if (told := self._context.hears(listener, speaker)) is not None:
            return told
        if self._summary is None:
            self._summary = summary(self.reception.links)
        link = self._summary.get((listener, speaker))
        if link is None:
            return None
        if link.alone and link.at_least >= _SOME:
            return True
        return False if link.share <= _SOME and link.trials >= _TRIALS else None

    def restarted(self, node_id: bytes) -> None:
        """Announce that a node has been restarted since the last frame.

        Sequence numbers alone do not show a restart after a single beacon.
        """
        self._context.senders.restarted(node_id)

    def _cite(self) -> None:
        """Save the frames that new findings cite, before they leave the buffer of recent frames."""
        self._context.changed = False
        for rule in self._active:
            for finding in rule.findings:
                for mark in finding.frames:
                    kept = self._recent.get(mark.frame)
                    if mark.frame not in self._cited and kept is not None:
                        frame, start, sender = kept
                        self._cited[mark.frame] = EventRecord(
                            frame.time_ns, "heard", name(sender), frame.number, "", frame.data.hex(), start
                        )

    def share(self) -> Share:
        """Return the results of the rules that were applied, for :meth:`adopt` in another process; call once."""
        self._finish()
        return Share({rule.id: rule.outcome for rule in self._active}, self._cited, self.reception.links)

    def _finish(self) -> None:
        """Process the end of the recording."""
        self._context.now = None
        for rule in self._active:
            rule.finish()
        self._cite()

    def adopt(self, share: Share) -> None:
        """Take the results of the rules that this judge does not apply."""
        for rule in self._rules:
            if rule.id in share.outcomes:
                rule.adopt(share.outcomes[rule.id])
        self._cited |= share.cited
        self.reception.links += share.links

    def result(self, notes: Iterable[str] = ()) -> RunResult:
        """Return the verdicts; call once, after the last frame. ``notes`` are added to those of the result."""
        with few_collections():
            return self._result(notes)

    def _result(self, notes: Iterable[str]) -> RunResult:
        self._finish()
        for rule in self._rules:
            for finding in rule.findings:
                if finding.verdict is Verdict.INCONCLUSIVE:
                    # A requirement that one rule doubts must not pass by another rule.
                    for each in finding.requirements:
                        self._context.withhold(each, finding.observed)
        cases = (*declarations(self._pics.pics, self.codec.profile, self._command), *map(self._case, self._rules))
        about = [f"{self.frames} frames of {len(self._senders)} senders"]
        about.append(self.links_origin)
        if self.other:
            about.append(f"{self.other} frames of other traffic were skipped")
        if self.cut:
            about.append(f"{self.cut} frames are truncated in the recording and were not judged")
        run = assemble(
            self.codec.profile,
            self._pics,
            cases,
            kind="check",
            sut=Sut(name=self._pics.sut.name or self._recording, link=f"recording {self._recording}"),
            started=self._started,
            duration=time.monotonic() - self._began,
            command=self._command,
            notes=(*about, *notes),
        )
        withheld = self._context.withheld
        decided = {
            name: verdict
            for name, verdict in run.requirements.items()
            if verdict is not Verdict.NOT_APPLICABLE and (verdict is not Verdict.INCONCLUSIVE or name in withheld)
        }
        occasions: dict[str, int] = {}
        for case in cases:
            for requirement, count in case.occasions.items():
                occasions[requirement] = occasions.get(requirement, 0) + count
        return msgspec.structs.replace(
            run,
            requirements=decided,
            occasions=dict(sorted(occasions.items())),
            holdings=self._holdings(),
            links=tuple(self._links()),
        )

    def _holdings(self) -> dict[str, Any]:
        """Return the states of all variables for the result."""
        ledger = self.ledger
        entries = ledger.entries()
        hops = sources(entries, ledger.producers, self.hears)
        came = [(hop.source, 0 if hop.frame is None else hop.frame[0]) for hop in hops]
        period = self._context.pics.pixit.beacon_period_ms * 1e6
        return ledger.as_json(self.codec.profile.types.node_id.representation, came, period, entries)

    def _links(self) -> Iterator[LinkResult]:
        """Yield the links between nodes for which the recording shows either reactions or their absence."""
        nodes = list(self._senders)
        told: set[tuple[bytes, bytes]] = set()
        if self._topology is not None:
            told = {(a, b) for a in nodes for b in nodes if a != b and self._context.hears(a, b)}
        for (listener, speaker), link in sorted(summary(self.reception.links).items()):
            if link.at_least < _SOME and (link.share > _SOME or link.trials < _TRIALS):
                continue
            told.discard((listener, speaker))
            until = None if link.lasts or self._first is None else round((link.end - self._first) / 1e9, 3)
            is_told = self._context.hears(listener, speaker)
            yield LinkResult(
                name(listener), name(speaker), round(link.share, 3), round(link.reactions), link.trials, until,
                told=is_told or False,
            )  # fmt: skip
        for listener, speaker in sorted(told):
            yield LinkResult(name(listener), name(speaker), 0.0, 0, 0, told=True)

    def _case(self, rule: Invariant) -> CaseResult:
        """Return the result of one rule."""
        checks = [
            Check(
                each.verdict,
                each.requirements,
                each.expected,
                rule.text_of(each),
                tuple(map(self._placed, each.frames)),
                seconds=self._seconds(each),
            )
            for each in rule.findings
        ]
        failed = {each for check in checks if check.verdict is Verdict.FAIL for each in check.requirements}
        doubted = {each for check in checks if check.verdict is Verdict.INCONCLUSIVE for each in check.requirements}
        occasions = {each: rule.occasions[each] for each in rule.requirements if rule.occasions.get(each)}
        held = [each for each in occasions if each not in failed | doubted]
        reason = rule.applies()
        checks += self._passes(rule, held, occasions)
        if not checks:
            reason = reason or "the recording gave no occasion"
            checks.append(Check(Verdict.NOT_APPLICABLE, rule.requirements, reason))
        numbers = sorted({mark.frame for check in checks for mark in check.frames})
        result = rule.as_case(rule.section, _STIMULUS).result(
            checks,
            evidence=tuple(self._cited[number] for number in numbers if number in self._cited),
            left_out=rule.left_out,
            rerun=self._command,
            occasions=occasions,
        )
        finding = next((each for each in rule.findings if each.verdict is result.verdict), None)
        if finding is None:
            return result
        consequence = (finding.consequence or CONSEQUENCES.get(rule.id, "")) if failed else ""
        return msgspec.structs.replace(result, consequence=consequence, show=self._show(finding))

    def _passes(self, rule: Invariant, held: list[str], occasions: dict[str, int]) -> Iterator[Check]:
        """Yield checks for the requirements in ``held``, which have no finding.

        Their verdict is pass, too-little (not enough occasions), or inconclusive (withheld by another observation).
        """
        withheld = self._context.withheld
        enough = rule.enough if self._enough is None else self._enough
        least = LEAST_BEACONS if self._enough is None else self._enough
        speaks = [each for each in held if each in withheld]
        few = tuple(each for each in held if each not in withheld and (occasions[each] < enough or self.frames < least))
        shown = tuple(each for each in held if each not in withheld and each not in few)
        if shown:
            yield Check(Verdict.PASS, shown, f"{rule.expect} ({_counted(shown, occasions)})")
        if few:
            seen = f"{_counted(few, occasions)} in {self.frames} beacon{'' if self.frames == 1 else 's'}"
            wanted = f"{rule.expect}, in at least {enough} occasion{'' if enough == 1 else 's'} and {least} beacons"
            yield Check(Verdict.TOO_LITTLE, few, wanted, f"too few for a verdict: {seen}")
        for each in speaks:
            yield Check(Verdict.INCONCLUSIVE, (each,), f"{rule.expect}, without contrary observations", withheld[each])

    def _seconds(self, finding: Finding) -> float | None:
        """Return the time of a finding in seconds since the first frame; None if it has no time."""
        if finding.time is None or self._first is None:
            return None
        return round((finding.time - self._first) / 1e9, 6)

    def _show(self, finding: Finding) -> str:
        """Return the command that shows the last frame of a finding and those shortly before it; empty if none."""
        numbers = sorted({mark.frame for mark in finding.frames if mark.frame})
        if not numbers:
            return ""
        last = numbers[-1]
        near = next(each for each in numbers if last - each < _NEAR)
        frames = str(last) if near == last else f"{near}-{last}"
        profile = self.codec.profile.name
        return shlex.join(["dcp-codec", "decode", self._path, "--profile", profile, "--frames", frames])

    def _placed(self, mark: Mark) -> Mark:
        """Locate the record of a mark in its saved frame (:func:`placed`); keep the mark if the frame is not saved."""
        event = self._cited.get(mark.frame)
        return mark if event is None else placed(self.codec, mark, bytes.fromhex(event.octets), event.start)
