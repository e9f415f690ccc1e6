"""Conversion of one execution of a case into its result."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from typing import Final

import msgspec

from dcp_conformance.model.results import CaseResult, Check, EventRecord
from dcp_conformance.model.verdict import Verdict, worst
from dcp_conformance.test_system.judgement.verdicts import in_force
from dcp_conformance.test_system.traffic import Event

from .survival.attribution import Trial

#: Maximum number of characters of the parameters or the answer of a call in the evidence.
_SHOWN: Final = 400


def result_of(
    trial: Trial,
    checks: Iterable[Check],
    ended: int,
    rerun: str,
    *,
    attempt: int = 1,
    killed: bool = False,
    executions: int = 1,
    side_by_side: bool = False,
) -> CaseResult:
    """Return the result of a case with these checks, and with the evidence of the execution ``trial``.

    ``ended`` is the time of the lower tester's clock in ns. ``rerun`` is the command of the run, without cases.
    ``killed``: whether the case ended the implementation. ``executions``: how often the case was executed.
    ``side_by_side``: whether other cases were executed at the same time.
    """
    case, bench, checks = trial.case, trial.bench, tuple(checks)
    verdict = worst(check.verdict for check in checks) or Verdict.INCONCLUSIVE
    return CaseResult(
        id=case.id,
        purpose=case.purpose,
        section=case.section,
        kind=str(case.kind),
        requirements=in_force(case.requirements, bench.profile.spec_version),
        verdict=verdict,
        reason=_reason(checks, verdict, executions),
        stimulus=case.stimulus,
        expectation=case.expect,
        window=case.window,
        duration=(ended - trial.begun) / 1e9,
        table="robustness" if case.robustness else "conformance",
        checks=checks,
        readings=bench.verdicts.readings,
        evidence=tuple(map(_record, bench.traffic.events)),
        left_out=bench.traffic.left_out,
        rerun=f"{rerun} {shlex.join([*case.options, case.id])}",
        killed=killed,
        attempt=attempt,
        executions=executions,
        side_by_side=side_by_side,
        short_period=0.0 if bench.session.short_period is None else bench.session.short_period.milliseconds,
        error_detail=trial.detail,
    )


def doubted(check: Check, executions: int, why: str) -> Check:
    """Return a failed check as inconclusive: it did not fail in each of so many further executions."""
    each = "a further execution" if executions == 1 else f"each of {executions} further executions"
    return excused(check, f"it did not fail in {each}, and {why}")


def excused(check: Check, why: str) -> Check:
    """Return a failed check as inconclusive for the reason ``why``."""
    if check.verdict is not Verdict.FAIL:
        return check
    return msgspec.structs.replace(check, verdict=Verdict.INCONCLUSIVE, observed=f"{check.observed}; but {why}")


def _reason(checks: Iterable[Check], verdict: Verdict, executions: int) -> str:
    """Return the text of the check that decided the verdict; empty for a pass."""
    decisive = next((check for check in checks if check.verdict is verdict), None)
    if decisive is None:
        return "the case has made no check"
    if verdict is Verdict.NOT_APPLICABLE:
        return decisive.expected
    if verdict is Verdict.PASS:
        return ""
    reason = f"{decisive.expected}: {decisive.observed}" if decisive.observed else decisive.expected
    return f"{reason}; executed {executions} times" if executions > 1 else reason


def _record(event: Event) -> EventRecord:
    text = event.text
    if event.data is not None:
        text = f"{text} {_short(event.data)}"
    return EventRecord(event.wall, event.direction, event.who, event.number, text, event.frame.hex(), event.start)


def _short(data: object) -> str:
    text = msgspec.json.encode(data).decode()
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
