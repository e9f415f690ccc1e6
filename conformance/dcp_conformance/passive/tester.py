"""Apply the invariants to the beacons of the implementation during a run, and make case results of the findings."""

from __future__ import annotations

import shlex
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec
from dcp_spec.constants import ProtocolId

from dcp_codec.codec import Codec
from dcp_codec.framing.locate import ETHERNET_HEADER
from dcp_conformance.check.base import Context, Invariant, Seen
from dcp_conformance.check.places import placed
from dcp_conformance.definitions.case import SANITY, Case
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult, Check, EventRecord, Mark
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.frames.received import ReceivedBeacon

from .rules import OF_INSTRUCTIONS, OF_REPORTS, RULES, MostSummaries, RepeatedJitter

SECTION: Final = "Passive testing: every beacon of the run"
SIDE_BY_SIDE: Final = "the cases side by side"
"""Stands for the case if several were executed at the same time."""
_STIMULUS: Final = "none of its own: the stimuli of the cases in the run"
#: Maximum number of frames in a result. Findings with further frames are counted without them.
MOST_FRAMES = 24
#: Number of recent frames that a finding can cite.
_RECENT = 16
#: If a finding cites no frame, the command that repeats it names the cases with the most beacons, until these have
#: ``_ENOUGH_BEACONS`` beacons together, and at most ``_MOST_CASES`` cases.
_ENOUGH_BEACONS, _MOST_CASES = 300, 5

_BLOCKS = frozenset(
    {
        "CK_BP_FORMAT", "CK_BP_EMPTY", "CK_DATA_ORDER", "CK_SRP_OWN", "CK_SRP_SEQNO", "CK_VD_ORDER",
        "CK_VD_PAYLOAD", "CK_VD_DISTINCT", "CK_VD_SUMMARIES",
    }
)  # fmt: skip
"""Rules for payloads of SRP and VarDis, which the tester itself submits when it acts as one of these protocols."""
_OF_PERIOD: Final = frozenset({"CK_BP_PERIOD", "CK_BP_JITTER"})
_DISTURBED: Final[Mapping[str, frozenset[str]]] = {
    "BP-SetParameter": frozenset({"CK_BP_PERIOD", "CK_BP_JITTER", "CK_BP_SIZE", "CK_BP_NETWORK"}),
    "BP-MGMT-Deactivate": _OF_PERIOD,
    "VD-SetParameter": frozenset({"CK_VD_SUMMARIES"}),
}
"""Service -> rules that are suspended from its call to the end of the case."""


class PassiveTester:
    """Judges every beacon of the implementation by the invariants in :data:`RULES`. Its memory use is bounded.

    The caller passes only frames of the implementation to :meth:`heard`, and must call :meth:`interrupted` at every
    reset and restart, since numbers start again then.
    """

    def __init__(
        self, codec: Codec, pics: Pics, parameters: Mapping[str, Any], overload: Callable[[], str] | None = None
    ) -> None:
        """Prepare the rules.

        ``parameters``: parameter values that the implementation has reported; the caller may add entries later.
        ``overload``: returns at the end of the run why the machine was too busy for exact timing; None in virtual time.
        """
        self._codec = codec
        self._context = Context(codec, pics, restarts_known=True)
        self._context.cite = self._cite
        self._context.parameters = parameters
        if overload is not None:
            self._context.overload = overload
        self._rules = [rule(self._context) for rule in RULES]
        # MostSummaries applies as soon as the implementation has reported the parameter.
        self._active = [rule for rule in self._rules if not rule.applies() or isinstance(rule, MostSummaries)]
        self._suspended: dict[str, frozenset[str]] = {}
        """Case -> rules that are suspended until it ends."""
        self._side_by_side = False
        self._another_period = False
        """Whether the tester has set another beacon period than the configured one."""
        self._deal()
        self._since = -1
        """Frames up to this time (ns of the lower tester's clock) belong to the time before the last interruption."""
        self._traffic: object = None
        self._recent: deque[_Place] = deque(maxlen=_RECENT)
        self._evidence: dict[str, list[_Place]] = {}
        self._executions: Counter[str] = Counter()
        """Case -> number of its executions; each one numbers its frames from 1."""
        self._beacons: Counter[str] = Counter()
        """Case -> number of beacons judged during it."""
        self._heard_in: Counter[str] = Counter()
        """Case -> number of beacons judged during it; those during several cases count for each of them."""
        self._beside: set[str] = set()
        """The cases that are being executed at the same time."""

    @property
    def frames(self) -> int:
        """The number of beacons that were judged."""
        return self._beacons.total()

    # -- events of the run ---------------------------------------------------------------------------------------------

    def begin(self, now: int, traffic: object, case: str = "") -> None:
        """Announce the start of a case. ``now``: lower tester's clock in ns; earlier frames are not judged.

        ``traffic``: object that records the frames of the case; only frames for this object are judged.
        """
        self._traffic = traffic
        self._side_by_side = False
        self._executions[case] += 1
        if self._suspended:
            self._suspended.clear()
            self._deal()
        self.interrupted(now)

    def begin_side_by_side(self, now: int) -> None:
        """Announce the start of several cases at once; announce each of them with :meth:`enter`. ``now`` in ns."""
        if self._suspended:
            self._suspended.clear()
            self._deal()
        self._side_by_side = True
        self.interrupted(now)

    def without_intervals(self) -> None:
        """Stop judging the intervals between beacons: the link changes them."""
        self._active = [rule for rule in self._active if rule.id not in _OF_PERIOD]
        self._deal()

    def enter(self, case: str) -> None:
        """Announce that a case starts while others are being executed."""
        self._executions[case] += 1
        self._beside.add(case)

    def leave(self, case: str) -> None:
        """Announce the end of a case that was announced with :meth:`enter`."""
        self._beside.discard(case)
        if self._suspended.pop(case, None):
            self._deal()

    def interrupted(self, now: int) -> None:
        """Announce that the implementation was, or may have been, reset or restarted: its numbers may start again.

        Frames up to ``now`` (ns of the lower tester's clock) that arrive later are not judged.
        """
        self._since = max(self._since, now)
        self._recent.clear()
        for rule in self._active:
            rule.interrupted()

    def called(self, method: str, params: Mapping[str, Any], case: str = "") -> None:
        """Announce the call of a service, and suspend the rules that it disturbs until the end of the case.

        ``case``: the calling case, if several are executed at the same time.
        """
        if method == "BP-TransmitPayload" and params.get("protId") in (ProtocolId.SRP, ProtocolId.VARDIS):
            self._suspend(case, _BLOCKS)
        elif method in _DISTURBED:
            self._suspend(case, _DISTURBED[method])

    def another_period(self, is_set: bool) -> None:
        """Announce that the tester has changed the configured beacon period (True) or restored it (False)."""
        self._another_period = is_set
        self._deal()
        for rule in self._active:
            if rule.id in _OF_PERIOD:
                rule.interrupted()

    def _suspend(self, case: str, rules: frozenset[str]) -> None:
        """Suspend rules until the end of a case, and make them forget the previous beacons."""
        self._suspended[case] = self._suspended.get(case, frozenset()) | rules
        self._deal()
        for rule in self._active:
            if rule.id in rules:
                rule.interrupted()

    def _deal(self) -> None:
        """Sort the rules that are not suspended by the beacons that they need."""
        suspended = frozenset().union(*self._suspended.values())
        if self._another_period:
            suspended |= _OF_PERIOD
        fed = [rule for rule in self._active if rule.id not in suspended]
        self._fed_reports = [rule for rule in fed if rule.id in OF_REPORTS]
        self._fed_instructions = [rule for rule in fed if rule.id in OF_INSTRUCTIONS]
        self._fed = [rule for rule in fed if rule.id not in OF_REPORTS | OF_INSTRUCTIONS]

    def heard(self, heard: ReceivedBeacon, frame: bytes, start: int, case: str, traffic: object) -> None:
        """Judge a frame of the implementation.

        ``heard.number``: its number in the recording of ``case``. ``start``: offset of the bearer payload in ``frame``,
        in octets. ``traffic``: object that records the frame.
        """
        if heard.time <= self._since or not (self._side_by_side or traffic is self._traffic):
            return
        self._beacons[case] += 1
        self._heard_in.update(self._beside if case == SIDE_BY_SIDE else (case,))
        self._recent.append(_Place(case, self._executions[case], heard, frame, start))
        seen = Seen(self._codec, heard, frame, start, frame[:6] if start >= ETHERNET_HEADER else None)
        for rule in self._fed:
            rule.feed(seen)
        if heard.report is not None:
            for rule in self._fed_reports:
                rule.feed(seen)
        if heard.has_vardis:
            for rule in self._fed_instructions:
                rule.feed(seen)

    def _cite(self, rule: str, mark: Mark) -> Mark | None:
        """Keep a frame as evidence of a rule; return the mark with its number there, or None if it cannot be kept."""
        place = next((each for each in self._recent if each.heard.number == mark.frame), None)
        kept = self._evidence.setdefault(rule, [])
        if place is None or (place not in kept and len(kept) >= MOST_FRAMES):
            return None
        if place not in kept:
            kept.append(place)
        return msgspec.structs.replace(mark, frame=kept.index(place) + 1)

    # -- results -------------------------------------------------------------------------------------------------------

    def results(self, rerun: str, options: Mapping[str, Sequence[str]] | None = None) -> tuple[CaseResult, ...]:
        """Return a result for each invariant; call once, at the end of the run.

        ``rerun``: the command of the run, without cases. ``options``: case identifier -> further options that define
        the case. An invariant without a finding decides no requirement, since a test case demands more than the absence
        of a fault.
        """
        for rule in self._active:
            rule.finish()
        return tuple(self._result(rule, rerun, options or {}) for rule in self._rules)

    def _cases_again(self, cited: str | None) -> list[str]:
        """Return the cases that repeat a finding: the one that it cites, or else those with the most beacons."""
        if cited is not None and cited != SIDE_BY_SIDE:
            return [cited]
        chosen: list[str] = []
        beacons = 0
        for case, count in self._heard_in.most_common(_MOST_CASES):
            if beacons >= _ENOUGH_BEACONS:
                break
            chosen.append(case)
            beacons += count
        # Every run includes the sanity case.
        return [case for case in chosen if case != SANITY] or chosen

    def _result(self, rule: Invariant, rerun: str, options: Mapping[str, Sequence[str]]) -> CaseResult:
        """Return the case result of one invariant."""
        kept = self._evidence.get(rule.id, [])
        checks = [
            Check(
                each.verdict,
                each.requirements,
                each.expected,
                self._with_places(rule.text_of(each), each.frames, kept),
                tuple(placed(self._codec, mark, *kept[mark.frame - 1][-2:]) for mark in each.frames),
            )
            for each in rule.findings
            if each.verdict is not Verdict.INFO or isinstance(rule, RepeatedJitter)
        ]
        occasions = max(rule.occasions.values(), default=0)
        if not checks:
            holds = bool(occasions)
            text = (
                f"{rule.expect} (checked {occasions} times)" if holds else rule.applies() or "no occasion in this run"
            )
            checks.append(Check(Verdict.PASS if holds else Verdict.NOT_APPLICABLE, (), text))
        cited = next((kept[mark.frame - 1].case for check in checks for mark in check.frames), None)
        again: list[str] = []
        for case in self._cases_again(cited):
            again += [*options.get(case, ()), case]
        return rule.as_case(SECTION, _STIMULUS).result(
            checks,
            requirements=tuple(dict.fromkeys(each for check in checks for each in check.requirements)),
            evidence=tuple(each.event(number, self._where(each)) for number, each in enumerate(kept, 1)),
            left_out=rule.left_out,
            # Only failures count in the summary: an invariant without a finding is not an executed test case.
            counted=any(check.verdict is Verdict.FAIL for check in checks),
            rerun=f"{rerun} {shlex.join(again)}" if again else rerun,
        )

    def _where(self, place: _Place) -> str:
        """Return the text that says in which case a frame was heard."""
        case = place.case
        if self._executions[case] > 1:
            case = f"execution {place.execution} of {case}"
        return f"frame {place.heard.number} of {case}"

    def _with_places(self, observed: str, marks: Iterable[Mark], kept: list[_Place]) -> str:
        """Append the places of the cited frames to the text of a finding."""
        places = [self._where(kept[number - 1]) for number in dict.fromkeys(mark.frame for mark in marks)]
        return f"{observed}; {', '.join(places)}" if places else observed


class _Place(NamedTuple):
    """A frame, and the case during which it was heard."""

    case: str
    execution: int
    """Number of the case's execution, from 1."""
    heard: ReceivedBeacon
    frame: bytes
    start: int

    def event(self, number: int, text: str) -> EventRecord:
        """Return the frame as evidence with the given number and text."""
        who = (self.heard.sender or self.heard.source).hex(":")
        return EventRecord(self.heard.wall, "heard", who, number, text, self.frame.hex(), self.start)


def cases() -> tuple[Case, ...]:
    """Return the invariants as cases, for files of expected results and for exclusion. Nothing executes them."""
    return tuple(rule.as_case(SECTION, _STIMULUS) for rule in RULES)


def joined(results: Iterable[CaseResult]) -> list[CaseResult]:
    """Merge the results of several passive testers (one for each node of a run) into one result for each invariant."""
    found: dict[str, CaseResult] = {}
    for each in results:
        before = found.get(each.id)
        found[each.id] = each if before is None else _both(before, each)
    return list(found.values())


def _both(first: CaseResult, second: CaseResult) -> CaseResult:
    """Merge two results of one invariant: the worse one, or both together if both fail."""
    if Verdict.FAIL not in (first.verdict, second.verdict) or first.verdict is not second.verdict:
        return max(second, first, key=lambda result: result.verdict.rank)
    behind = len(first.evidence)
    checks = [
        msgspec.structs.replace(
            check, frames=tuple(msgspec.structs.replace(mark, frame=mark.frame + behind) for mark in check.frames)
        )
        for check in second.checks
    ]
    evidence = [msgspec.structs.replace(each, frame=each.frame + behind) for each in second.evidence]
    return msgspec.structs.replace(
        first,
        checks=(*first.checks, *checks),
        evidence=(*first.evidence, *evidence),
        requirements=tuple(dict.fromkeys((*first.requirements, *second.requirements))),
        left_out=first.left_out + second.left_out,
    )
