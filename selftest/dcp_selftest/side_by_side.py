"""Compare the verdicts of concurrently executed cases with the verdicts of the same cases in succession."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Final

import msgspec
from dcp_conformance.definitions.case import SANITY, Case
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.concurrent.executor import WIDTH
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import plain_node
from dcp_conformance.reference.process import reference_process
from dcp_conformance.test_system.session import Session

from dcp_codec.codec import Codec

from .mutants import Mutant, all_mutants
from .runner import PROFILES, Suite, cases, in_processes

#: Number of further cases that are executed concurrently with the cases that name a requirement of the mutant.
COMPANIONS: Final = 40


class Difference(msgspec.Struct, frozen=True):
    """A case whose verdict differs when it is executed concurrently with others."""

    mutant: str
    profile: str
    case: str
    alone: str
    """Verdict and reason with the cases in succession; ``none`` without a result."""
    side_by_side: str
    """Verdict and reason with concurrent cases."""

    def __str__(self) -> str:
        return f"{self.mutant} ({self.profile}): {self.case}: alone {self.alone}; side by side {self.side_by_side}"


class Comparison(msgspec.Struct, frozen=True):
    """The outcome for one mutant, or for the reference node, on one profile."""

    mutant: str
    profile: str
    differences: tuple[Difference, ...]
    killed: tuple[bool, bool]
    """Whether a case that names a requirement of the mutant failed: in succession, and concurrently."""
    period: int = 0
    """The beacon period in ms of the node on a virtual Ethernet, for concurrent cases; 0: in virtual time."""
    our_node: bool = False
    """Whether the comparison is that of the reference node, without a mutant."""

    @property
    def false_passes(self) -> tuple[Difference, ...]:
        """The cases that fail in succession and pass concurrently."""
        return tuple(
            each
            for each in self.differences
            if each.alone.startswith(Verdict.FAIL) and each.side_by_side.startswith(Verdict.PASS)
        )

    @property
    def survives(self) -> bool:
        """Whether the mutant is detected only by cases in succession."""
        return self.killed == (True, False)


class Comparisons(msgspec.Struct, frozen=True):
    """The content of ``side-by-side.json``."""

    comparisons: tuple[Comparison, ...]

    def summary(self) -> str:
        """Return the numbers of comparisons and of different verdicts in one line."""
        mutants = [each for each in self.comparisons if not each.our_node]
        different = [each for each in mutants if each.differences]
        ours = [each for each in self.comparisons if each.our_node]
        return (
            f"reference node on {len(ours)} profiles: {sum(len(each.differences) for each in ours)} verdicts differ; "
            f"{len(mutants)} comparisons with mutants: {sum(all(each.killed) for each in mutants)} detected in both "
            f"modes, {sum(each.survives for each in mutants)} by cases in succession only, "
            f"{sum(len(each.false_passes) for each in mutants)} failed cases pass side by side, "
            f"{sum(len(each.differences) for each in mutants)} verdicts differ, of {len(different)} mutants"
        )

    def exit_status(self) -> int:
        """Return 0 if the reference node gets the same verdicts and the same mutants are detected, otherwise 1."""
        ours = any(each.our_node and each.differences for each in self.comparisons)
        return 1 if ours or any(each.survives for each in self.comparisons) else 0


def compare(
    mutant: Mutant | None,
    profile: str,
    suite: Sequence[Case],
    *,
    companions: int = COMPANIONS,
    seed: int = 1,
    width: int = WIDTH,
    period: int = 0,
) -> Comparison:
    """Execute cases against a mutant in succession and concurrently, and compare the verdicts.

    With a mutant, the cases that name one of its requirements are executed, and ``companions`` others, drawn with
    ``seed``. Without a mutant, all cases of ``suite`` are executed against the reference node. ``width`` is the number
    of concurrent cases. ``period``: see :class:`Comparison`. Cases in succession are always executed in virtual time,
    as in the campaign of mutants: over a link they would take minutes for each mutant.
    """
    rng = random.Random(f"{seed} {mutant.id if mutant else ''}")  # noqa: S311 - a draw of cases, no secret
    chosen = list(suite)
    if mutant is not None:
        named = {case.id for case in suite if set(case.requirements) & set(mutant.requirements)}
        others = [case.id for case in suite if case.id not in named and case.id != SANITY]
        drawn = named | set(rng.sample(others, min(companions, len(others))))
        chosen = [case for case in suite if case.id in drawn]
    with _suite(mutant, profile, 0) as suite_alone:
        alone = _verdicts(suite_alone.run(chosen))
    with _suite(mutant, profile, period) as suite_beside:
        beside = _verdicts(suite_beside.run_side_by_side(chosen, width))
    name = mutant.id if mutant is not None else "our node"
    differences = tuple(
        Difference(name, profile, case, _text(alone.get(case)), _text(beside.get(case)))
        for case in {**alone, **beside}
        if _verdict(alone.get(case)) is not _verdict(beside.get(case))
    )
    killed = (_killed(mutant, alone), _killed(mutant, beside))
    return Comparison(name, profile, differences, killed, period, mutant is None)


@contextmanager
def _suite(mutant: Mutant | None, profile: str, period: int) -> Iterator[Suite]:
    if not period:
        yield Suite(profile, plain_node if mutant is None else mutant.make)
        return
    program = ("dcp_stack.cli", "run") if mutant is None else ("dcp_selftest.mutants", mutant.id)
    codec, pics = Codec(profile), Pics(pixit=Testing(beacon_period_ms=period))
    with reference_process(codec, beacon_period_ms=period, link="ethernet", program=program) as node:
        yield Suite(profile, runner=Runner(Session(codec, node.lower, node.upper, pics), node.control))


def compare_all(
    mutants: Sequence[Mutant],
    *,
    profiles: Sequence[str] = (),
    jobs: int | None = None,
    seed: int = 1,
    periods: Sequence[int] = (),
    on_start: Callable[[int], None] = lambda _: None,
    on_result: Callable[[Comparison], None] = lambda _: None,
) -> Comparisons:
    """Compare the reference node on ``profiles`` (default: ``PROFILES``), and each mutant on its newest version.

    ``jobs`` is the number of processes, by default one for each processor. ``on_start`` is called with the number of
    comparisons, and ``on_result`` with each comparison when it is complete. ``periods``: beacon periods in ms at which
    concurrent cases are executed against nodes on a virtual Ethernet instead of in virtual time; then the reference
    node only on ``profiles``.
    """
    tasks = [("", name, period) for name in profiles for period in periods]
    tasks += [(each.id, each.profile, period) for each in mutants for period in periods]
    if not periods:
        tasks = [("", name, 0) for name in profiles or PROFILES]
        tasks += [(each.id, each.profile, 0) for each in mutants]
    on_start(len(tasks))
    found = []
    for _, comparison in in_processes(partial(_task, seed), tasks, jobs):
        found.append(comparison)
        on_result(comparison)
    return Comparisons(tuple(sorted(found, key=lambda each: (not each.our_node, each.mutant, each.profile))))


def _task(seed: int, task: tuple[str, str, int]) -> Comparison:
    mutant, profile, period = task
    return compare(all_mutants()[mutant] if mutant else None, profile, cases(), seed=seed, period=period)


def _killed(mutant: Mutant | None, results: Mapping[str, CaseResult]) -> bool:
    """Whether a failed check names a requirement of the mutant."""
    failed = {
        each
        for result in results.values()
        for check in result.checks
        if check.verdict is Verdict.FAIL
        for each in check.requirements
    }
    return mutant is not None and not failed.isdisjoint(mutant.requirements)


def _verdicts(results: Iterable[CaseResult]) -> dict[str, CaseResult]:
    """Return the last result of each case by identifier: a later result revises an earlier one."""
    return {result.id: result for result in results}


def _verdict(result: CaseResult | None) -> Verdict | None:
    return None if result is None else result.verdict


def _text(result: CaseResult | None) -> str:
    return "none" if result is None else f"{result.verdict} {result.reason}".strip()
