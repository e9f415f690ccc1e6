"""Selection of the smoke plan: the cases that detect the most known faults per second."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Final

from dcp_conformance.definitions.case import SANITY, Case
from dcp_conformance.definitions.case_times import Times
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.diagnosis import Dictionary, load
from dcp_conformance.execution.concurrent import why_alone

from .runner import Suite, cases

#: The profile on which the durations of cases are measured.
PROFILE: Final = "dcp-2.0"
#: Upper bounds of the cost of the plan, in seconds: for its cases that need no upper tester, and for all its cases.
BUDGET: Final = (3.5, 9.0)
#: Number of concurrent cases that the costs assume. It is less than the width of the executor, because cases that start
#: together do not end together.
_BESIDE: Final = 8
#: Duration in seconds of the longest case that may be chosen: the plan takes at least as long as its longest case.
_LONGEST: Final = 2.0


def cost(case: Case, seconds: Mapping[str, float]) -> float:
    """Return the seconds by which a case extends the plan."""
    return max(seconds[case.id], 0.05) / (1 if why_alone(case) else _BESIDE)


def choose(candidates: Iterable[Case], seconds: Mapping[str, float], dictionary: Dictionary) -> dict[str, int]:
    """Choose cases greedily: the case that detects the most further faults for its cost, until the budget is spent.

    Cases that need no upper tester are chosen first, so that the plan is useful for every implementation. ``seconds``
    has the durations of cases by identifier; cases without a duration are not chosen. Return the identifiers in the
    order of their choice, each with the number of faults that no earlier case detects.
    """
    able = [case for case in candidates if _is_able(case, seconds)]
    fails = {case.id: {fault.id for fault in dictionary.faults if case.id in fault.fails} for case in able}
    found: dict[str, int] = {}
    noticed: set[str] = set()
    spent = 0.0
    for affordable, budget in (([case for case in able if not case.needs.ut], BUDGET[0]), (able, BUDGET[1])):
        while best := _best(affordable, found, fails, noticed, seconds, budget - spent):
            found[best.id] = len(fails[best.id] - noticed)
            noticed |= fails[best.id]
            spent += cost(best, seconds)
    return found


def _is_able(case: Case, seconds: Mapping[str, float]) -> bool:
    if case.id not in seconds or case.id == SANITY or seconds[case.id] > _LONGEST:
        return False
    return not (case.destructive or case.robustness or case.long or case.needs.restart or case.needs.link)


def _best(
    candidates: Iterable[Case],
    chosen: Collection[str],
    fails: Mapping[str, set[str]],
    noticed: Collection[str],
    seconds: Mapping[str, float],
    left: float,
) -> Case | None:
    """Return the case of cost ``left`` or less with the most further faults for its cost; None if no case has any."""
    worth = {
        case.id: (len(fails[case.id].difference(noticed)) / cost(case, seconds), case)
        for case in candidates
        if case.id not in chosen and cost(case, seconds) <= left
    }
    value, best = max(worth.values(), key=lambda each: (each[0], each[1].id), default=(0.0, None))
    return best if value > 0 else None


def make(on_result: Callable[[CaseResult], None] = lambda _: None) -> Times:
    """Measure all cases in succession with the reference node in virtual time, and choose the smoke plan."""
    seconds: dict[str, float] = {}
    for result in Suite(PROFILE).run(cases()):
        on_result(result)
        if result.verdict is not Verdict.NOT_APPLICABLE:
            seconds[result.id] = round(result.duration, 1)
    measured = dict(sorted(seconds.items()))
    return Times(smoke=choose(cases(), measured, load()), seconds=measured)
