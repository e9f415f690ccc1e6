"""Compare the verdicts of cases that are executed side by side with those of the same cases one after the other."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from typing import Final

import msgspec

from dcp_conformance.case import SANITY, Case
from dcp_conformance.mutants.mutant import Mutant
from dcp_conformance.results import CaseResult
from dcp_conformance.selftest import Suite
from dcp_conformance.verdict import Verdict

from .executor import WIDTH

#: Cases that are executed beside those that name a requirement of the mutant.
COMPANIONS: Final = 40


class Difference(msgspec.Struct, frozen=True):
    """A case with another verdict side by side."""

    mutant: str
    profile: str
    case: str
    alone: str
    """Its verdict, and the reason, with one case after the other."""
    side_by_side: str

    def __str__(self) -> str:
        return f"{self.mutant} ({self.profile}): {self.case}: alone {self.alone}; side by side {self.side_by_side}"


def compare(
    mutant: Mutant | None,
    profile: str,
    cases: Sequence[Case],
    *,
    companions: int = COMPANIONS,
    seed: int = 1,
    width: int = WIDTH,
) -> list[Difference]:
    """Execute cases against a mutant (or our node) both ways. Returns where the verdicts differ.

    With a mutant: the cases that name one of its requirements, and ``companions`` others, drawn with ``seed``.
    """
    rng = random.Random(f"{seed} {mutant.id if mutant else ''}")  # noqa: S311 - a draw of cases, no secret
    chosen = list(cases)
    if mutant is not None:
        named = {case.id for case in cases if set(case.requirements) & set(mutant.requirements)}
        others = [case.id for case in cases if case.id not in named and case.id != SANITY]
        drawn = named | set(rng.sample(others, min(companions, len(others))))
        chosen = [case for case in cases if case.id in drawn]
    make = {} if mutant is None else {"make": mutant.make}
    alone = _verdicts(Suite(profile, **make).run(chosen))
    beside = _verdicts(Suite(profile, **make).run_side_by_side(chosen, width))
    name = mutant.id if mutant is not None else "our node"
    return [
        Difference(name, profile, case, _text(alone.get(case)), _text(beside.get(case)))
        for case in {**alone, **beside}
        if _verdict(alone.get(case)) is not _verdict(beside.get(case))
    ]


def _verdicts(results: Iterable[CaseResult]) -> dict[str, CaseResult]:
    """The last result of each case, which is the one that counts."""
    return {result.id: result for result in results}


def _verdict(result: CaseResult | None) -> Verdict | None:
    return None if result is None else result.verdict


def _text(result: CaseResult | None) -> str:
    return "none" if result is None else f"{result.verdict} {result.reason}".strip()
