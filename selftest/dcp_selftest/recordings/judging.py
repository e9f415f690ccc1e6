"""Judge a simulated recording with the rules of ``check``."""

from __future__ import annotations

from collections.abc import Iterable

from dcp_conformance.check import Judge
from dcp_conformance.definitions.case import DECLARED
from dcp_conformance.definitions.declared import declared_by
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec


def judged(frames: Iterable[Frame], codec: Codec) -> list[CaseResult]:
    """Return the results of all rules for a recording with an unknown beacon period.

    Violations that the profile itself declares are left out.
    """
    judge = Judge(codec, Pics(), recording="simulated", command="", period_known=False)
    for frame in frames:
        judge.feed(frame)
    declared = set(declared_by(codec.profile))
    return [
        case
        for case in judge.result().cases
        if case.id != DECLARED and not (declared and declared.issuperset(_failed(case)) and _failed(case))
    ]


def _failed(case: CaseResult) -> set[str]:
    return {each for check in case.checks if check.verdict is Verdict.FAIL for each in check.requirements}


def found(cases: Iterable[CaseResult], *verdicts: Verdict) -> dict[str, dict[str, tuple[str, ...]]]:
    """Return the findings with one of ``verdicts``, by rule and text, with the requirements that each names."""
    findings: dict[str, dict[str, tuple[str, ...]]] = {}
    for case in cases:
        for check in case.checks:
            if check.verdict in verdicts:
                findings.setdefault(case.id, {})[check.observed] = check.requirements
    return findings
