"""Conversion of one execution of a case into its result."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from typing import Final

import msgspec

from dcp_conformance.definitions.results import CaseResult, Check, EventRecord
from dcp_conformance.definitions.verdict import Verdict
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
    case, bench = trial.case, trial.bench
    result = case.result(
        checks,
        requirements=in_force(case.requirements, bench.profile.spec_version),
        window=case.window,
        duration=(ended - trial.begun) / 1e9,
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
    if executions == 1 or not result.checks or result.verdict in (Verdict.PASS, Verdict.NOT_APPLICABLE):
        return result
    return msgspec.structs.replace(result, reason=f"{result.reason}; executed {executions} times")


def doubted(check: Check, executions: int, why: str) -> Check:
    """Return a failed check as inconclusive: it did not fail in each of so many further executions."""
    each = "a further execution" if executions == 1 else f"each of {executions} further executions"
    return check.excused(f"it did not fail in {each}, and {why}")


def _record(event: Event) -> EventRecord:
    text = event.text
    if event.data is not None:
        text = f"{text} {_short(event.data)}"
    return EventRecord(event.wall, event.direction, event.who, event.number, text, event.frame.hex(), event.start)


def _short(data: object) -> str:
    text = msgspec.json.encode(data).decode()
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
