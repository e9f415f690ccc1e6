"""Results as data: what ``results.json`` holds, and what reports are made of.

The file's ``schema`` says which version of these structs it follows; members are only ever added within a version.
"""

from __future__ import annotations

import time
from typing import Any, Literal

import msgspec

from .verdict import Verdict

#: Minimum number of cases for a statement about a fault without "probably".
_SEVERAL = 3
SCHEMA = "dcp-conformance-results/1"
Table = Literal["conformance", "robustness"]


def timestamp() -> str:
    """Return the present time, ISO 8601 in UTC, to the second."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


class Mark(msgspec.Struct, frozen=True, omit_defaults=True):
    """A place that matters for a check: frame number in the case's recording, octets from the frame's start."""

    frame: int
    offset: int = 0
    length: int = 0
    """0: the whole frame."""
    path: str = ""
    """The field, as the dissector calls it."""


class Check(msgspec.Struct, frozen=True, omit_defaults=True):
    """One check of a case."""

    verdict: Verdict
    requirements: tuple[str, ...]
    expected: str
    observed: str = ""
    frames: tuple[Mark, ...] = ()
    table: Table = "conformance"
    shown: bool = False
    """A failure that is proved by what was received, which nothing that happened later can explain."""
    seconds: float | None = None
    """Of a recording: when it showed first, in seconds since the first frame."""

    @property
    def text(self) -> str:
        """Expectation and observation in one line."""
        return f"{self.expected}: {self.observed}" if self.observed else self.expected

    def excused(self, why: str) -> Check:
        """Return a failed check as inconclusive for the reason ``why``; any other check unchanged."""
        if self.verdict is not Verdict.FAIL:
            return self
        return msgspec.structs.replace(self, verdict=Verdict.INCONCLUSIVE, observed=f"{self.observed}; but {why}")


class EventRecord(msgspec.Struct, frozen=True, omit_defaults=True):
    """A line of the timeline: ``time`` is ns since 1970, ``frame`` a frame number (0: none), ``octets`` are hex."""

    time: int
    direction: str
    who: str = ""
    frame: int = 0
    text: str = ""
    octets: str = ""
    start: int = 0


class CaseResult(msgspec.Struct, frozen=True, kw_only=True):
    """The result of one case."""

    id: str
    purpose: str
    section: str
    kind: str
    requirements: tuple[str, ...]
    verdict: Verdict
    reason: str = ""
    """Why it is not a pass: of the check that decided it."""
    stimulus: str = ""
    expectation: str = ""
    window: float = 0.0
    duration: float = 0.0
    """Seconds on the lower tester's clock; virtual seconds in process."""
    table: Table = "conformance"
    checks: tuple[Check, ...] = ()
    occasions: dict[str, int] = {}
    """Of a recording: by requirement, how often it gave an occasion to break it."""
    consequence: str = ""
    """The consequence of the findings for the network, in a sentence."""
    show: str = ""
    """The command that shows the frame of the first finding."""
    readings: dict[str, str] = {}
    """Disputed texts (A.7) and which of their readings was observed."""
    evidence: tuple[EventRecord, ...] = ()
    left_out: int = 0
    recording: str = ""
    """The files with exactly this case's traffic, without suffix, relative to the report's folder."""
    rerun: str = ""
    """The command that runs this case again."""
    killed: bool = False
    """The implementation ended or fell silent because of this case."""
    death: str = ""
    """How it died, without numbers that differ from time to time: equal for deaths that look alike."""
    counted: bool = True
    """Whether it counts as a case: repetitions of the sanity case do not."""
    attempt: int = 1
    executions: int = 1
    """Number of executions. It is above 1 if the only reason for an undecided case was that the tester itself was late
    or lost frames: then the result is that of the last one. It is also above 1 if lateness may explain a failure, which
    is inconclusive unless it recurs each time."""
    side_by_side: bool = False
    """Whether other cases were executed at the same time. Only a pass can be; all else is repeated alone."""
    short_period: float = 0.0
    """The beacon period in ms that the tester has set for this case; 0: as configured. Only a pass can have one."""
    error_detail: str = ""
    """For a fault of the tester: where it happened."""


class Probable(msgspec.Struct, frozen=True, kw_only=True):
    """A fault that the implementation probably has."""

    fault: str
    """Its identifier in the dictionary."""
    requirements: tuple[str, ...]
    what: str
    """The probable behaviour of the implementation: a sentence without its subject."""
    explains: tuple[str, ...]
    """The failed cases that it accounts for."""
    alone: tuple[str, ...]
    """Cases that no other probable fault explains."""
    share: float
    """The share of all failed cases that it accounts for."""
    missing: tuple[str, ...]
    """Cases that should have failed with this fault, and passed."""
    expected: int
    """The number of decided cases that should fail with this fault."""
    alike: int = 0
    """The number of explained cases in which the same was observed as at a node with this fault."""
    named: int = 0
    """The number of explained cases in which a failed check names a requirement of this fault."""
    sole: bool = False
    """Whether it accounts for all failures of the run."""
    signature: int = 0
    """The number of cases that fail for a node with only this fault, if all are run."""
    alternatives: tuple[str, ...] = ()
    """Other faults with the same consequences in this run."""
    case: str = ""
    """The case that shows it best."""
    check: Check | None = None
    """Its failed check."""
    mark: Mark | None = None
    """The frame that shows it best."""
    rerun: str = ""
    """The command that runs that case again."""

    @property
    def likely(self) -> bool:
        """Whether several cases fail as with this fault, at least half of them with the same observation.

        At most a tenth of the cases that should fail may have passed, and a third of the cases that the fault makes
        fail must have been decided: a fault that prevents most cases is not shown by a few.
        """
        most = 10 * len(self.missing) <= self.expected and 3 * self.expected >= self.signature
        return len(self.explains) > 1 and 2 * self.alike >= len(self.explains) and most

    @property
    def certain(self) -> bool:
        """Whether the implementation certainly has this fault, as no observation contradicts it.

        At least half of the cases that it makes fail were decided. All of them failed with the same observation, which
        names its requirement; nothing else failed, and no other known fault is as likely.
        """
        whole = len(self.explains) >= _SEVERAL and 2 * self.expected >= self.signature and not self.missing
        same = len(self.explains) == self.alike == self.named
        return whole and same and self.sole and not self.alternatives


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """The explanation of the failures of a run."""

    faults: tuple[Probable, ...] = ()
    """The one that accounts for most failures first."""
    failed: int = 0
    """The number of failed cases."""
    unexplained: tuple[str, ...] = ()
    """Failed cases that no probable fault accounts for, without those in ``ended``."""
    ended: tuple[str, ...] = ()
    """Cases in which nothing else failed than that the implementation ended or stopped answering, and that no probable
    fault accounts for. They show no other fault."""
    stated: Check | None = None
    """The failed check of the sanity case, which states by itself what is wrong: most other failures follow from it."""


class Sut(msgspec.Struct, frozen=True, kw_only=True):
    """The implementation under test: its name, and how it was reached."""

    name: str = ""
    version: str = ""
    spec_version: str = ""
    node_id: str = ""
    link: str = ""
    upper_tester: str = ""
    methods: tuple[str, ...] = ()


class LinkResult(msgspec.Struct, frozen=True, omit_defaults=True):
    """That one node of a recording hears another, as its reactions show."""

    listener: str
    speaker: str
    share: float
    """The part of the speaker's beacons that the listener reacts to, 0..1."""
    reactions: int
    trials: int
    """Number of occasions for which the speaker was one of the possible causes of a reaction."""
    until: float | None = None
    """Seconds since the first frame after which nothing was heard any more; None: to the end."""
    told: bool = False
    """Whether the user has told this link; without any told link of the listener, all are inferred."""


class RunResult(msgspec.Struct, frozen=True, kw_only=True):
    """A whole run."""

    schema: str = SCHEMA
    tool: str = ""
    kind: Literal["run", "check", "replay", "selftest", "fuzz"] = "run"
    started: str = ""
    """ISO 8601, UTC."""
    duration: float = 0.0
    """Seconds that passed for the person who waited."""
    command: str = ""
    profile: str = ""
    profile_title: str = ""
    spec_version: str = ""
    sut: Sut = Sut()
    pics: dict[str, Any] = {}
    cases: tuple[CaseResult, ...] = ()
    invariants: tuple[CaseResult, ...] = ()
    """Invariants over all beacons of the run that held, or gave no occasion; those that did not are among the cases."""
    requirements: dict[str, Verdict] = {}
    occasions: dict[str, int] = {}
    """Of a recording: by requirement, how often it gave an occasion to break it, over all cases."""
    holdings: dict[str, Any] = {}
    """Of a recording: who holds what and when (:meth:`dcp_codec.analysis.ledger.Ledger.as_json`)."""
    links: tuple[LinkResult, ...] = ()
    """Of a recording: who hears whom, where reactions are enough to say."""
    summary: dict[str, dict[str, int]] = {}
    """By table, then by verdict: number of cases."""
    readings: dict[str, tuple[str, ...]] = {}
    """Disputed texts and the readings that were observed."""
    declared: dict[str, str] = {}
    """Requirements that the profile itself declares as not met, and what it says instead; each of them fails."""
    denied: dict[str, str] = {}
    """Mandatory requirements that the PICS denies, and how; each of them fails."""
    reference_readings: dict[str, str] = {}
    """Of those texts for which another reading than the reference's was observed: the reference's."""
    diagnosis: Diagnosis | None = None
    """Which faults explain the failed cases; None if none failed, or where no diagnosis is made."""
    notes: tuple[str, ...] = ()
    """Notes about the whole run: losses of the tester, restarts, a fallback of the link."""


def requirement_verdicts(cases: tuple[CaseResult, ...]) -> dict[str, Verdict]:
    """Return the verdict of each requirement from the checks of the cases.

    A failed case says it of the requirements that its failed checks name, and nothing of its others; a requirement
    that only cases without a verdict about it mention is inconclusive.
    """
    found: dict[str, list[Verdict]] = {}
    for case in cases:
        decided: dict[str, list[Verdict]] = {}
        for check in case.checks:
            for each in check.requirements:
                decided.setdefault(each, []).append(check.verdict)
        for each in dict.fromkeys((*case.requirements, *decided)):
            verdicts = decided.get(each, [])
            if case.verdict in (Verdict.FAIL, Verdict.ERROR, Verdict.INCONCLUSIVE):
                bad = [verdict for verdict in verdicts if verdict.rank > Verdict.PASS.rank]
                found.setdefault(each, []).extend(bad or ([] if verdicts else [Verdict.INCONCLUSIVE]))
            elif Verdict.TOO_LITTLE in verdicts:
                found.setdefault(each, []).extend(verdicts)
            else:
                found.setdefault(each, []).append(case.verdict)
    return {each: _joined(verdicts) for each, verdicts in found.items()}


def _joined(verdicts: list[Verdict]) -> Verdict:
    """The worst; but what one case could not show, another may have shown."""
    shown = [verdict for verdict in verdicts if verdict is not Verdict.INCONCLUSIVE]
    return max(shown or verdicts or [Verdict.INCONCLUSIVE], key=lambda verdict: verdict.rank)


def summarise(cases: tuple[CaseResult, ...]) -> dict[str, dict[str, int]]:
    """Numbers of cases by table and verdict; every verdict is there, also with 0."""
    counts: dict[str, dict[str, int]] = {
        table: {str(verdict): 0 for verdict in Verdict} for table in ("conformance", "robustness")
    }
    for case in cases:
        if not case.counted:
            continue
        counts[case.table][str(case.verdict)] += 1
    return counts
