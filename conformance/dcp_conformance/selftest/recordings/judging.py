"""Judging a simulated recording, and what counts as a finding."""

from __future__ import annotations

from collections.abc import Iterable

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_conformance.check import Judge
from dcp_conformance.model.case import DECLARED
from dcp_conformance.model.declared import declared_by
from dcp_conformance.model.pics import Pics
from dcp_conformance.model.results import CaseResult
from dcp_conformance.model.verdict import Verdict


def judged(frames: Iterable[Frame], codec: Codec) -> list[CaseResult]:
    """The results of all rules about a recording, of which nobody has stated the beacon period."""
    judge = Judge(codec, Pics(), recording="simulated", command="", period_known=False)
    for frame in frames:
        judge.feed(frame)
    declared = set(declared_by(codec.profile))
    # What the profile itself declares is no finding in a recording.
    return [
        case
        for case in judge.result().cases
        if case.id != DECLARED and not (declared and declared.issuperset(_failed(case)) and _failed(case))
    ]


def _failed(case: CaseResult) -> set[str]:
    return {each for check in case.checks if check.verdict is Verdict.FAIL for each in check.requirements}


def found(cases: Iterable[CaseResult], *verdicts: Verdict) -> dict[str, dict[str, tuple[str, ...]]]:
    """By rule: what it found with these verdicts, with the requirements that it names."""
    findings: dict[str, dict[str, tuple[str, ...]]] = {}
    for case in cases:
        for check in case.checks:
            if check.verdict in verdicts:
                findings.setdefault(case.id, {})[check.observed] = check.requirements
    return findings
