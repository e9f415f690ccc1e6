"""Measure the diagnosis on nodes with several known faults."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Final

import msgspec
from dcp_conformance.definitions.results import CaseResult, Check, Diagnosis
from dcp_conformance.definitions.survival import SURVIVAL
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.diagnosis.dictionary import Dictionary, Fault, load
from dcp_conformance.diagnosis.explain import explain
from dcp_conformance.errors import UpperTesterError

from dcp_selftest.mutants import Mutant, all_mutants
from dcp_selftest.mutants.combination import combined
from dcp_selftest.runner import Suite, cases, in_processes

PROFILE: Final = "dcp-2.0"


class Outcome(msgspec.Struct, frozen=True):
    """The diagnosis of one node with several faults."""

    faults: tuple[str, ...]
    """The mutants that were combined."""
    failed: int
    """The number of failed cases."""
    hidden: tuple[str, ...]
    """Faults that the others conceal: no case of their signature fails."""
    named: tuple[str, ...]
    """The faults that the diagnosis names first."""
    found: tuple[str, ...]
    """The members of ``faults`` that are named, or that cause the same failures in this node as a named fault."""
    false: tuple[str, ...]
    """Named faults that are not in ``faults`` and do not cause the same failures as one of them."""


class Measurement(msgspec.Struct, frozen=True):
    """The outcomes of many nodes, with summary figures."""

    outcomes: tuple[Outcome, ...]

    @property
    def recall(self) -> float:
        """The share of faults that were found, 0 to 1; hidden faults do not count."""
        there = sum(len(each.faults) - len(each.hidden) for each in self.outcomes)
        return sum(len(set(each.found) - set(each.hidden)) for each in self.outcomes) / there if there else 1.0

    @property
    def false_share(self) -> float:
        """The share of named faults that are false, 0 to 1."""
        named = sum(len(each.named) for each in self.outcomes)
        return sum(len(each.false) for each in self.outcomes) / named if named else 0.0


def draw(number: int, size: int, seed: int) -> list[tuple[str, ...]]:
    """Draw ``number`` groups of ``size`` mutants that can be combined in one node, reproducibly by ``seed``."""
    rng = random.Random(seed)  # noqa: S311 - a draw, no secret
    able = [name for name, each in sorted(all_mutants().items()) if each.part is not None and each.profile == PROFILE]
    found: list[tuple[str, ...]] = []
    while len(found) < number:
        group = tuple(rng.sample(able, size))
        try:
            combined([all_mutants()[name] for name in group])
        except TypeError:
            # Two of the mutants change the same class in ways that cannot be combined.
            continue
        found.append(group)
    return found


def diagnose(mutants: Sequence[Mutant], dictionary: Dictionary) -> tuple[Diagnosis, set[str]]:
    """Run the suite against a node with the faults of all ``mutants``. Returns the diagnosis and the failed cases."""
    results = {result.id: result for result in Suite(PROFILE, combined(mutants)).run(cases())}
    return explain(results.values(), dictionary), {name for name, each in results.items() if each.verdict == "fail"}


def measure(
    groups: Sequence[tuple[str, ...]],
    *,
    jobs: int | None = None,
    on_result: Callable[[Outcome], None] = lambda _: None,
) -> Measurement:
    """Diagnose a node for each group of mutants in ``jobs`` processes; call ``on_result`` with each outcome."""
    found: list[Outcome] = []
    for _, each in in_processes(_task, groups, jobs):
        found.append(each)
        on_result(each)
    return Measurement(tuple(found))


class HeldBack(msgspec.Struct, frozen=True):
    """The diagnoses of single faults, each with a dictionary without that fault: how many there are of each kind."""

    faults: int = 0
    same: int = 0
    """Explained by another fault of the same requirement."""
    other: int = 0
    """Explained by faults of other requirements only."""
    none: int = 0
    """Not explained."""
    statements: int = 0
    """Sentences without "probably"."""
    true: int = 0
    """The number of such sentences that name the requirement of the fault."""


def hold_back(number: int, seed: int, dictionary: Dictionary) -> HeldBack:
    """Diagnose ``number`` single faults, drawn by ``seed``, with a dictionary without them. No case is run."""
    able = [fault for fault in dictionary.faults if fault.fails]
    rng = random.Random(seed)  # noqa: S311 - a draw, no secret
    every = frozenset(case for fault in dictionary.faults for case in fault.fails | fault.undecided)
    count = HeldBack()
    for fault in rng.sample(able, min(number, len(able))):
        observed: dict[str, frozenset[str]] = dict.fromkeys(fault.fails, frozenset())
        for case, digest in fault.observed:
            observed[case] |= {digest}
        rest = Dictionary(tuple(each for each in dictionary.faults if each is not fault))
        results = [_result_with(fault, case, survived=bool(observed.get(case))) for case in sorted(every)]
        found = explain(results, rest, observed=observed).faults
        named = [fault.requirements[0] in each.requirements for each in found]
        count = HeldBack(
            faults=count.faults + 1,
            same=count.same + any(named),
            other=count.other + (bool(named) and not any(named)),
            none=count.none + (not named),
            statements=count.statements + sum(each.certain for each in found),
            true=count.true + sum(each.certain and right for each, right in zip(found, named, strict=True)),
        )
    return count


def _result_with(fault: Fault, case: str, *, survived: bool) -> CaseResult:
    """Return the result of a case for a node with this fault, as the dictionary has it."""
    verdict = Verdict.FAIL if case in fault.fails else Verdict.INCONCLUSIVE if case in fault.undecided else Verdict.PASS
    expected = SURVIVAL if fault.crashes and not survived else ""
    checks = (Check(verdict, fault.requirements, expected, ""),) if verdict is Verdict.FAIL else ()
    return CaseResult(id=case, purpose="", section="", kind="", requirements=(), verdict=verdict, checks=checks)


def _task(group: tuple[str, ...]) -> Outcome:
    return outcome(group, load())


def outcome(group: tuple[str, ...], dictionary: Dictionary) -> Outcome:
    """Diagnose a node with a group of faults, and compare the named faults with the group."""
    known = all_mutants()
    try:
        diagnosis, failed = diagnose([known[name] for name in group], dictionary)
    except UpperTesterError:
        # The node closes its connection before the first case: no case shows any of the faults.
        return Outcome(group, 0, hidden=group, named=(), found=(), false=())
    signatures = {fault.id: fault.fails for fault in dictionary.faults}
    hidden = tuple(name for name in group if not signatures[name] & failed)
    named = tuple(each.fault for each in diagnosis.faults)
    same = {
        name: {each for each in named if signatures[each] & failed == signatures[name] & failed} | {name}
        for name in group
    }
    found = tuple(name for name in group if same[name] & set(named))
    true = set().union(*same.values())
    return Outcome(group, len(failed), hidden, named, found, tuple(each for each in named if each not in true))
