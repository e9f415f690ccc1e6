"""Networks with one faulty node: each mutant in a network of five nodes, with the topologies bus and line."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import cache
from typing import Final, Literal

import msgspec
from dcp_conformance.definitions.verdict import Verdict

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_selftest.mutants import Mutant, all_mutants
from dcp_selftest.recordings.networks import NetworkSituation, Other, record
from dcp_selftest.runner import in_processes

from .judging import found, judged
from .reasons import reason

SHAPES: Final[tuple[Literal["bus", "line"], ...]] = ("bus", "line")
#: Index of the faulty node: the middle of the line, which forwards all information between the two halves.
PLACE: Final = 2

Fate = Literal["found", "otherwise", "doubted", "observed", "missed", "same"]
"""``found``: a failed rule names a violated requirement; ``otherwise``: failed rules name others; ``doubted``: an
inconclusive verdict; ``observed``: a verdict info; ``missed``: no rule reports it; ``same``: the mutant sent the same
octets as the reference node."""


class Outcome(msgspec.Struct, frozen=True):
    """The outcome of one mutant in one network."""

    mutant: str
    requirements: tuple[str, ...]
    what: str
    profile: str
    shape: str
    fate: Fate
    rules: tuple[str, ...] = ()
    """The rules that report the mutant; rules that name a violated requirement are first."""
    text: str = ""
    """The first finding; for ``missed``, the reason why no rule reports the mutant."""


class FaultyResult(msgspec.Struct, frozen=True, kw_only=True):
    """The outcomes of all mutants."""

    outcomes: tuple[Outcome, ...]
    seconds: float
    """Processor time."""

    def by_mutant(self) -> dict[str, dict[str, Outcome]]:
        """Return the outcomes by mutant and topology."""
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
    """Return the frames of the network without a fault, and the observations in it as (rule, text without digits)."""
    codec = Codec(profile)
    frames = record(_situation(profile, shape), {PLACE: Other()}, codec=codec)
    observed = found(judged(frames, codec), Verdict.INFO, Verdict.INCONCLUSIVE)
    return tuple(frame.data for frame in frames), frozenset(
        (rule, _plain(text)) for rule in observed for text in observed[rule]
    )


def _plain(text: str) -> str:
    """Return an observation without its digits."""
    return "".join(each for each in text if not each.isdigit())


def _task(task: tuple[str, Literal["bus", "line"]]) -> tuple[Outcome, float]:
    name, shape = task
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
    jobs: int | None = None,
    on_result: Callable[[Outcome], None] | None = None,
) -> FaultyResult:
    """Judge a network for each mutant and topology in ``jobs`` processes (default: one for each processor).

    ``on_result`` is called with each outcome when it is known.
    """
    outcomes: dict[tuple[str, str], Outcome] = {}
    seconds = 0.0
    for _, (outcome, spent) in in_processes(_task, [(each.id, shape) for each in mutants for shape in shapes], jobs):
        seconds += spent
        outcomes[outcome.mutant, outcome.shape] = outcome
        if on_result is not None:
            on_result(outcome)
    ordered = tuple(outcomes[each.id, shape] for each in mutants for shape in shapes)
    return FaultyResult(outcomes=ordered, seconds=round(seconds, 1))
