"""The smoke plan: the cases that notice most known faults per second."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Final

from dcp_conformance.diagnosis import Dictionary, load
from dcp_conformance.execution.concurrent import why_alone
from dcp_conformance.model.case import SANITY, Case
from dcp_conformance.model.case_times import Times
from dcp_conformance.model.results import CaseResult
from dcp_conformance.model.verdict import Verdict

from .runner import Suite, cases

#: The version whose cases are measured.
PROFILE: Final = "dcp-2.0"
#: Seconds that the plan may take by the cost of its cases: for those without an upper tester, and for all.
BUDGET: Final = (3.5, 9.0)
#: Cases side by side that the costs assume. Fewer than are executed: waves of cases end one by one.
_BESIDE: Final = 8
#: Seconds of the longest case: whatever runs beside it, the plan takes as long.
_LONGEST: Final = 2.0


def cost(case: Case, seconds: Mapping[str, float]) -> float:
    """Seconds by which a case makes the plan longer."""
    return max(seconds[case.id], 0.05) / (1 if why_alone(case) else _BESIDE)


def choose(candidates: Iterable[Case], seconds: Mapping[str, float], dictionary: Dictionary) -> dict[str, int]:
    """Choose cases greedily: always the one that notices most further faults for its cost, until the budget is spent.

    First from those that need no upper tester, then from all, so that the plan is useful for every implementation.
    ``seconds``: how long cases take; others are not chosen. Returns the cases in this order, each with the number of
    faults that no earlier one notices.
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
    """The affordable case with most further faults for its cost; None if there is none."""
    worth = {
        case.id: (len(fails[case.id].difference(noticed)) / cost(case, seconds), case)
        for case in candidates
        if case.id not in chosen and cost(case, seconds) <= left
    }
    value, best = max(worth.values(), key=lambda each: (each[0], each[1].id), default=(0.0, None))
    return best if value > 0 else None


def make(on_result: Callable[[CaseResult], None] = lambda _: None) -> Times:
    """Run every case against our node in virtual time, one after the other, and choose the smoke plan."""
    seconds: dict[str, float] = {}
    for result in Suite(PROFILE).run(cases()):
        on_result(result)
        if result.verdict is not Verdict.NOT_APPLICABLE:
            seconds[result.id] = round(result.duration, 1)
    measured = dict(sorted(seconds.items()))
    return Times(smoke=choose(cases(), measured, load()), seconds=measured)
