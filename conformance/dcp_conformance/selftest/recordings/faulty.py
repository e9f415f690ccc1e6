"""Networks with one faulty node: each mutant that shows on the air, in a network of five, on a bus and in a line."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from functools import cache
from typing import Final, Literal

import msgspec

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.reference.networks import NetworkSituation, Other, record
from dcp_conformance.selftest.mutants import Mutant, all_mutants
from dcp_conformance.selftest.runner import process_pool

from .judging import found, judged
from .reasons import reason

SHAPES: Final[tuple[Literal["bus", "line"], ...]] = ("bus", "line")
#: The place of the faulty node: in a line everything between the halves passes it.
PLACE: Final = 2

Fate = Literal["found", "otherwise", "doubted", "observed", "missed", "same"]
"""Found by a rule that names the requirement; by others; a pass is withheld; observed only; not found; our octets."""


class Outcome(msgspec.Struct, frozen=True):
    """What came of one mutant in one network."""

    mutant: str
    requirements: tuple[str, ...]
    what: str
    profile: str
    shape: str
    fate: Fate
    rules: tuple[str, ...] = ()
    """The rules that found it, those first that name its requirement."""
    text: str = ""
    """The first finding; of a mutant that was not found, why not."""


class FaultyResult(msgspec.Struct, frozen=True, kw_only=True):
    """What came of all mutants."""

    outcomes: tuple[Outcome, ...]
    seconds: float

    def by_mutant(self) -> dict[str, dict[str, Outcome]]:
        """Mutant -> shape -> outcome."""
        table: dict[str, dict[str, Outcome]] = {}
        for each in self.outcomes:
            table.setdefault(each.mutant, {})[each.shape] = each
        return table


@cache
def _situation(profile: str, shape: Literal["bus", "line"]) -> NetworkSituation:
    return NetworkSituation(
        profile=profile, shape=shape, nodes=5, seconds=30.0, busy=2.0, deletes=0.25, restarts=True, late=True, seed=7
    )


@cache
def _baseline(profile: str, shape: Literal["bus", "line"]) -> tuple[tuple[bytes, ...], frozenset[tuple[str, str]]]:
    """The octets of the network without a fault, and what is observed in it."""
    codec = Codec(profile)
    frames = record(_situation(profile, shape), {PLACE: Other()}, codec=codec)
    observed = found(judged(frames, codec), Verdict.INFO, Verdict.INCONCLUSIVE)
    return tuple(frame.data for frame in frames), frozenset(
        (rule, _plain(text)) for rule in observed for text in observed[rule]
    )


def _plain(text: str) -> str:
    """An observation without its numbers."""
    return "".join(each for each in text if not each.isdigit())


def _task(name: str, shape: Literal["bus", "line"]) -> tuple[Outcome, float]:
    began = time.process_time()
    mutant = all_mutants()[name]
    profile = mutant.profile
    frames = record(_situation(profile, shape), {PLACE: Other(mutant.make)}, codec=Codec(profile))
    outcome = _outcome(mutant, profile, shape, frames)
    return outcome, time.process_time() - began


def _outcome(mutant: Mutant, profile: str, shape: Literal["bus", "line"], frames: list[Frame]) -> Outcome:
    def outcome(fate: Fate, rules: Sequence[str] = (), text: str = "") -> Outcome:
        return Outcome(mutant.id, mutant.requirements, mutant.what, profile, shape, fate, tuple(rules), text)

    octets, usual = _baseline(profile, shape)
    if tuple(frame.data for frame in frames) == octets:
        return outcome("same")
    cases = judged(frames, Codec(profile))
    fails = found(cases, Verdict.FAIL, Verdict.ERROR)
    if fails:
        named = [
            rule for rule, texts in fails.items() if any(set(mutant.requirements) & set(ids) for ids in texts.values())
        ]
        rules = [*named, *(rule for rule in fails if rule not in named)]
        return outcome("found" if named else "otherwise", rules, next(iter(fails[rules[0]])))
    for fate, verdict in (("doubted", Verdict.INCONCLUSIVE), ("observed", Verdict.INFO)):
        new = {
            rule: text
            for rule, texts in found(cases, verdict).items()
            for text in texts
            if rule not in ("CK_NET_HEARS", "CK_BP_PERIOD") and (rule, _plain(text)) not in usual
        }
        if new:
            return outcome("doubted" if fate == "doubted" else "observed", list(new), next(iter(new.values())))
    sent = [frame.data for frame in frames]
    return outcome("missed", text=reason(mutant.requirements, sent, octets, cases, Codec(profile)))


def faulty(
    mutants: Sequence[Mutant],
    *,
    shapes: Sequence[Literal["bus", "line"]] = SHAPES,
    jobs: int = 1,
    on_result: Callable[[Outcome], None] | None = None,
) -> FaultyResult:
    """Judge a network for each mutant and shape in ``jobs`` processes; ``on_result`` is told of each as it is done."""
    outcomes: dict[tuple[str, str], Outcome] = {}
    seconds = 0.0
    with process_pool(jobs) as processes:
        tasks = [processes.submit(_task, each.id, shape) for each in mutants for shape in shapes]
        for task in as_completed(tasks):
            outcome, spent = task.result()
            seconds += spent
            outcomes[outcome.mutant, outcome.shape] = outcome
            if on_result is not None:
                on_result(outcome)
    ordered = tuple(outcomes[each.id, shape] for each in mutants for shape in shapes)
    return FaultyResult(outcomes=ordered, seconds=round(seconds, 1))
