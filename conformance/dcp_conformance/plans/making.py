"""Measure how long cases take, and choose the smoke plan."""

from __future__ import annotations

from collections.abc import Callable

from dcp_conformance.diagnosis import load
from dcp_conformance.results import CaseResult
from dcp_conformance.selftest import Suite, cases
from dcp_conformance.verdict import Verdict

from .smoke import choose
from .times import Times

#: The version whose cases are measured.
PROFILE = "dcp-2.0"


def make(on_result: Callable[[CaseResult], None] = lambda _: None) -> Times:
    """Run every case against our node in virtual time, one after the other, and choose the smoke plan."""
    seconds: dict[str, float] = {}
    for result in Suite(PROFILE).run(cases()):
        on_result(result)
        if result.verdict is not Verdict.NOT_APPLICABLE:
            seconds[result.id] = round(result.duration, 1)
    measured = dict(sorted(seconds.items()))
    return Times(smoke=choose(cases(), measured, load()), seconds=measured)
